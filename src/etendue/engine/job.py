"""Tasks and jobs: a requested rendering, and the same with a loaded scene and a prepared method, for runs that can be
saved and resumed.

The caller passes the class of the method: the engine knows no concrete method.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from etendue.core import (
    CheckpointError,
    Measurement,
    Method,
    OptionError,
    Result,
    SceneError,
    Settings,
    State,
    is_whole,
    logger,
    prepared,
)
from etendue.scene import (
    BundledScene,
    Camera,
    Change,
    Problem,
    bundled_scene,
    checked_size,
    is_described,
    load,
    locate,
    unmerged,
)

from .budget import Budget
from .checkpoint import Checkpoint
from .fitting import fit_samples, settle_samples
from .replicas import replicated
from .runner import Runner, RunResult

#: Smallest memory bound in bytes: 16 MB.
LEAST_MEMORY = 16 << 20


@dataclass(frozen=True)
class Task:
    """A requested rendering. Settings are checked when it is made, before the scene is read.

    Settings that are not given are those of the scene's integrator (such as its depth), or else the defaults of the
    method. Without a budget the scene's own sample count is used.
    """

    scene: Any
    method: type[Method]
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    budget: Budget = field(default_factory=Budget)
    size: tuple[int, int] | None = None
    sensor: int = 0
    parameters: Mapping[str, Any] | None = None
    memory: int | None = None
    camera: Camera | None = None
    merge: bool = True  #: whether meshes may be merged; if not, shapes keep their names and order

    def __post_init__(self) -> None:
        for what, value, least in (
            ("a seed is a whole number", self.seed, 0),
            ("a sensor is a whole number", self.sensor, 0),
            ("a memory bound is a whole number of bytes", self.memory, LEAST_MEMORY),
        ):
            if value is not None and (not is_whole(value) or value < least):
                raise OptionError(f"{what} of at least {least}, not {value!r}")
        for name in ("seed", "sensor", "memory"):  # for checkpoints, as plain numbers
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, int(value))
        if self.size is not None:
            object.__setattr__(self, "size", checked_size(self.size))
        settings = self.method.Settings.from_mapping(self.settings, owner=f"method '{self.method.name}'")
        if getattr(settings, "cryptomatte", False):  # Cryptomatte identifies shapes by their names
            object.__setattr__(self, "merge", False)

    def place(self) -> dict[str, Any]:
        """Arguments of ``scene.load`` as plain values, to load the scene again. The scene is ``source``, a file, or
        ``bundled``, a name; neither if it is in memory."""
        place: dict[str, Any] = {"sensor": self.sensor}
        scene = self.scene
        if isinstance(scene, (str, os.PathLike)):
            scene = locate(scene, logger.debug)
        if isinstance(scene, Path):
            place["source"] = str(scene.absolute())
        elif isinstance(scene, BundledScene):
            place["bundled"] = scene.name
        for name in ("size", "memory"):
            if (value := getattr(self, name)) is not None:
                place[name] = value
        if self.parameters:
            place["parameters"] = {k: str(v) for k, v in self.parameters.items()}
        if self.camera is not None:
            place["camera"] = self.camera.to_dict()
        if not self.merge:
            place["merge"] = False
        return place


def _change(scene: Any, merge: bool) -> Change | None:
    """The change that keeps the shapes of a scene apart, if they may not be merged; a loaded scene has its shapes."""
    return None if merge or not is_described(scene) else unmerged


class Job:
    """A task whose scene is loaded and whose method is prepared."""

    def __init__(
        self,
        problem: Problem,
        method: Method,
        *,
        seed: int,
        budget: Budget,
        place: Mapping[str, Any],
        start: Measurement | None = None,
        state: State | None = None,
        earlier: float = 0.0,
        preparation: float = 0.0,
        notes: Mapping[str, Any] | None = None,
        task: Task | None = None,
    ) -> None:
        self.problem = problem
        self.method = method
        self.seed = seed
        self.budget = budget
        self.place = dict(place)
        self.start, self.state = start, state
        #: Seconds of the runs that this one resumes, as their budgets counted them; 0 for the first run.
        self.earlier = earlier
        #: Seconds of preparing the method, which count towards the budget.
        self.preparation = preparation
        #: Plain values of the caller, for the checkpoint.
        self.notes: dict[str, Any] = dict(notes or {})
        #: What was asked for, for executors that load the scene again.
        self.task = task

    @classmethod
    def open(cls, task: Task) -> Job:
        """Load the scene and prepare the method. A Mitsuba variant must be set."""
        problem = load(
            task.scene,
            size=task.size,
            sensor=task.sensor,
            parameters=task.parameters,
            memory=task.memory,
            camera=task.camera,
            change=_change(task.scene, task.merge),
        )
        begin = time.perf_counter()
        budget = task.budget or Budget(samples=max(1, problem.spp))
        kind: Any = task.method
        method: Method = kind(task_settings(task, problem))
        if budget.samples is None or method.samples_for(problem) is None:
            method = prepared(method, problem, task.seed)
        if budget.samples is not None:
            method = fit_samples(method, budget.samples, problem, task.seed)
        settle_samples(method)
        preparation = time.perf_counter() - begin
        return cls(
            problem, method, seed=task.seed, budget=budget, place=task.place(), preparation=preparation, task=task
        )

    @classmethod
    def resume(
        cls,
        checkpoint: Checkpoint,
        method: type[Any],
        *,
        budget: Budget | None = None,
        scene: Any = None,
    ) -> Job:
        """Continue ``checkpoint``; ``method`` is the class of its method.

        ``budget`` replaces the saved one: its seconds are those of this run, its samples and error are limits of the
        whole picture. Without it, the rest of the saved budget is used. ``scene`` is the new place of the scene, if it
        has moved. Raises :class:`CheckpointError` if method or scene differ, or if the saved budget is used up.
        """
        settings = checkpoint.settings_of(method)
        place = checkpoint.scene
        if scene is None and not {"source", "bundled"} & place.keys():
            raise CheckpointError("the checkpoint was made from a scene in memory; give the scene to resume it with")
        budget = budget or remaining(checkpoint)
        wanted: dict[str, Any] = {k: place[k] for k in ("size", "sensor", "parameters", "memory") if k in place}
        merge = bool(place.get("merge", True))
        if "size" in wanted:
            wanted["size"] = tuple(wanted["size"])
        if "camera" in place:
            wanted["camera"] = Camera(**place["camera"])
        try:
            source = scene if scene is not None else place.get("source") or bundled_scene(place["bundled"])
            problem = load(source, **wanted, change=_change(source, merge))
        except SceneError as error:
            raise CheckpointError(f"the scene of the checkpoint cannot be loaded: {error}") from error
        checkpoint.require_scene(problem.fingerprint)
        begin = time.perf_counter()
        instance = prepared(method(settings), problem, checkpoint.seed)
        instance = replicated(instance, checkpoint.state, problem, checkpoint.seed)
        instance.enter(checkpoint.state)
        preparation = time.perf_counter() - begin
        task = Task(source, method, seed=checkpoint.seed, **wanted, merge=merge)
        return cls(
            problem,
            instance,
            seed=checkpoint.seed,
            budget=budget,
            place=task.place(),
            start=checkpoint.measurement,
            state=checkpoint.state,
            earlier=checkpoint.earlier + checkpoint.elapsed,
            preparation=preparation,
            notes=checkpoint.notes,
            task=task,
        )

    def runner(self, **options: Any) -> Runner:
        """A :class:`Runner` of this job; ``options`` are its callbacks, ``save_every`` and ``cancel``.

        It adds to the measurement of a resumed job in place, so a job has one runner.
        """
        start, self.start = self.start, None
        options |= {"start": start, "state": self.state, "spent": self.preparation}
        return Runner(self.method, seed=self.seed, budget=self.budget, **options)

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """All that is needed to resume ``run`` later."""
        return Checkpoint(
            measurement=run.measurement,
            method=self.method.name,
            settings=self.method.settings.to_json(),
            seed=self.seed,
            fingerprint=self.problem.fingerprint,
            state=dict(run.state),
            scene=self.place,
            budget=self.budget.to_dict(),
            stopped_by=run.stopped_by,
            versions=versions(),
            elapsed=run.elapsed,
            earlier=self.earlier,
            notes=self.notes,
        )

    def result(self, run: RunResult) -> Result:
        """The developed picture of ``run`` with the metadata of its files."""
        result = run.result
        measurement = run.measurement
        counters = {
            k: v for k, v in measurement.counters.items() if k not in ("samples", "seconds", "rays", "nonfinite")
        }
        error = measurement.relative_error() if measurement.has_error() else float("nan")
        result.metadata = {
            **result.metadata,
            "method": self.method.name,
            "settings": self.method.settings.to_dict(),
            "seed": self.seed,
            "scene": self.problem.source,
            "fingerprint": self.problem.fingerprint,
            "passes": run.passes,
            "samples": run.samples,
            "seconds": round(measurement.counters.get("seconds", run.elapsed), 3),
            "rays": measurement.counters.get("rays", 0.0),
            "nonfinite": measurement.counters.get("nonfinite", 0.0),
            "relative_error": error if error == error else None,
            "stopped_by": run.stopped_by,
            **({"counters": counters} if counters else {}),
            "versions": versions(),
        }
        return result


def versions() -> dict[str, str]:
    """Versions of étendue, Mitsuba and Dr.Jit, and the Mitsuba variant."""
    import drjit as dr
    import mitsuba as mi

    try:
        own = metadata.version("etendue")
    except metadata.PackageNotFoundError:  # run from a source tree
        own = "unknown"
    return {"etendue": own, "mitsuba": mi.__version__, "drjit": dr.__version__, "variant": mi.variant() or ""}


def task_settings(task: Task, problem: Problem) -> Settings:
    """The settings of a method: given ones first, then those of the scene's integrator, then the defaults."""
    known = task.method.Settings.names()
    from_scene: dict[str, Any] = {"max_depth": problem.max_depth}
    if problem.integrator and problem.integrator in (task.method.name, task.method.plugin_name()):
        unknown = sorted(problem.integrator_options.keys() - set(known))
        if unknown:
            logger.warning(
                "option '%s' of the scene's integrator '%s' is not supported and is ignored",
                "', '".join(unknown),
                problem.integrator,
            )
        from_scene |= problem.integrator_options
    values = {k: v for k, v in from_scene.items() if k in known} | dict(task.settings)
    return task.method.Settings.from_mapping(values, owner=f"method '{task.method.name}'")


def remaining(checkpoint: Checkpoint, options: str = "seconds=, samples= or error=") -> Budget:
    """The rest of the budget of an interrupted run. ``options`` names the options of a new budget, for the message.
    Raises :class:`CheckpointError` if the budget is used up."""
    if checkpoint.stopped_by in ("seconds", "samples", "error"):
        raise CheckpointError(f"the budget of the checkpoint is used up; give a new one with {options}")
    saved = dict(checkpoint.budget)
    if "seconds" in saved:
        saved["seconds"] -= checkpoint.elapsed
        if saved["seconds"] <= 0:
            raise CheckpointError(f"the time of the checkpoint is used up; give a new budget with {options}")
    return Budget(**saved)
