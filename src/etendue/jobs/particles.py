"""Particles as work: light paths are traced, and each pass is written to a file, or kept in memory."""

from __future__ import annotations

import shutil
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import (
    CheckpointError,
    InNotebooks,
    Iterations,
    Measurement,
    OptionError,
    Pass,
    Record,
    State,
    describe,
    logger,
    prepared,
    suggest,
)
from etendue.engine import (
    Budget,
    Checkpoint,
    InTurn,
    Job,
    MakeExecutor,
    Order,
    Runner,
    RunResult,
    fit_samples,
    remaining,
    settle_samples,
)
from etendue.film import replacing
from etendue.methods import (
    MetropolisParticles,
    ParticleTracing,
    box_arguments,
    check_divisible,
    gathered,
    make_box_tracing,
)
from etendue.particles import BoxGrid, Codec, ParticleFile, Particles, ParticleWriter
from etendue.scene import load, shape_boxes, unmerged

from .wording import PYTHON, Wording

if TYPE_CHECKING:
    from etendue.distributed import Cluster, Traffic

#: Light paths, if no budget is given.
DEFAULT_PATHS = 1_000_000
_ROWS = "particles"  #: name of the record of particles
_PASS = "after_pass"  #: name of the number of the last pass in the file of a state
#: Ways to trace particles, by name.
TRACINGS: dict[str, Any] = {kind.name: kind for kind in (ParticleTracing, MetropolisParticles)}


@dataclass(frozen=True, kw_only=True)
class ParticleRequest:
    """Particles of a scene. The first limit that is reached ends the tracing; passes are whole, so there may be a few
    more particles. Without ``output`` they stay in memory."""

    scene: Any
    output: Path | None = None
    paths: int | None = None
    particles: int | None = None  #: approximate, in place of ``paths``: a pilot estimates the number of paths
    seconds: float | None = None
    codec: str = "packed"
    method: str = ParticleTracing.name  #: one of :data:`TRACINGS`
    #: With workers: numbers of boxes along x, y and z into which the scene is cut; each worker holds a share of them.
    boxes: tuple[int, int, int] | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    parameters: Mapping[str, Any] | None = None
    memory: int | None = None
    wording: Wording = PYTHON

    def __post_init__(self) -> None:
        self.wording.check_either("paths", self.paths, "particles", self.particles)
        Budget(self.seconds)
        Codec.parse(self.codec)
        if self.method not in TRACINGS:
            raise OptionError(f"no way '{self.method}' to trace particles; {suggest(self.method, TRACINGS)}")
        TRACINGS[self.method].Settings.from_mapping(self.settings, owner=f"tracing by {self.method}")
        if self.boxes is not None:
            BoxGrid.check_counts(self.boxes)
        if self.output is not None and self.output.exists():
            resume = self.wording.resume(self.output)
            raise OptionError(f"'{self.output}' exists: choose another name, remove it, or go on with it by {resume}")


@dataclass
class ParticleResult(InNotebooks):
    """The result of a run. ``particles`` are in memory; ``None`` if they are in the file."""

    particles: Particles | None
    file: Path | None
    counters: dict[str, float]
    passes: int
    stopped_by: str
    elapsed: float
    traffic: Traffic | None = None  #: for a scene in boxes: the tasks of the workers


class ParticleWork:
    """A request whose scene has been loaded, or a file that is continued; see :class:`Work`.

    Raises the errors of loading a scene, and :class:`OutputError` if the file cannot be made.
    """

    counted = "path"

    def __init__(self, job: Job, writer: ParticleWriter | None) -> None:
        self._job, self._writer = job, writer
        self.cluster: Cluster | None = None  #: traces the paths; without it this process does
        self.boxes: tuple[int, int, int] | None = None  #: of a divided scene
        self._traffic: Traffic | None = None

    @classmethod
    def open(cls, request: ParticleRequest) -> ParticleWork:
        """Load the scene, prepare the tracing and make the file."""
        from etendue.engine import Task, versions

        merge = request.boxes is None
        change = None if merge else unmerged
        problem = load(request.scene, parameters=request.parameters, memory=request.memory, change=change)
        begin = time.perf_counter()
        kind = TRACINGS[request.method]
        settings = kind.Settings.from_mapping(request.settings)
        if (steps := request.paths or request.particles) and kind is MetropolisParticles:
            settings = settings.for_budget(steps, request.settings)
        tracing: Any = prepared(kind(settings), problem, request.seed)
        paths = request.paths
        if request.particles is not None:
            paths = tracing.paths_for(request.particles)
        elif paths is None and request.seconds is None:
            paths = DEFAULT_PATHS
        budget = Budget(request.seconds, paths)
        if budget.samples is not None:
            tracing = fit_samples(tracing, budget.samples, problem, request.seed)
        settle_samples(tracing)
        given: dict[str, Any] = {"parameters": request.parameters, "memory": request.memory, "merge": merge}
        task = Task(request.scene, kind, seed=request.seed, **given)
        spent = time.perf_counter() - begin
        job = Job(problem, tracing, seed=task.seed, budget=budget, place=task.place(), preparation=spent, task=task)
        if request.output is None:
            return cls(job, None)._cut(request.boxes)
        header = {
            "scene": problem.source,
            "fingerprint": problem.fingerprint,
            "light_fingerprint": problem.light_fingerprint,
            "place": job.place,
            "seed": job.seed,
            "method": request.method,
            "settings": tracing.settings.to_json(),
            "paths_per_pass": tracing.samples_per_iteration,
            "versions": versions(),
        } | ({} if request.boxes is None else {"boxes": list(request.boxes)})
        writer = ParticleWriter.create(request.output, header, tracing.surfaces, Codec.parse(request.codec))
        return cls(job, writer)._cut(request.boxes)

    def _cut(self, boxes: Sequence[int] | None) -> ParticleWork:
        self.boxes = None if boxes is None else (boxes[0], boxes[1], boxes[2])
        return self

    @classmethod
    def resume(
        cls, path: Path, budget: Budget, particles: int | None = None, scene: Any = None, wording: Wording = PYTHON
    ) -> ParticleWork:
        """Continue a file; without a budget, with the rest of the budget of its run. ``scene``: its new place.

        Raises :class:`OptionError` for limits as in a request, :class:`ParticleError` for a file that cannot be read,
        :class:`CheckpointError` if the scene has changed or the budget is used up."""
        wording.check_either("paths", budget.samples, "particles", particles)
        known = ParticleFile(path)
        saved = _checkpoint(known)
        if particles is not None:
            per_path = len(known) / max(known.paths, 1) or 1.0
            budget = Budget(budget.seconds, max(1, round(particles / per_path)))
        one, other, time_ = map(wording.option, ("paths", "particles", "seconds"))
        budget = budget or remaining(saved, f"{one}, {other} or {time_}")
        job = Job.resume(saved, TRACINGS[saved.method], budget=budget, scene=scene)
        return cls(job, ParticleWriter.resume(known))._cut(known.header.get("boxes"))

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        make: MakeExecutor = InTurn
        if self.boxes is not None and self.cluster is None and self._job.start is None:
            logger.info("without workers the scene is not divided into boxes")
        if self.cluster is not None:
            try:
                make = self._divided(self.cluster)
            except Exception:
                if self._writer is not None and not self._writer.passes:
                    self._writer.discard()
                raise
        options["executor"] = make if self._writer is None else partial(_Written, self._writer, self._job, make)
        return self._job.runner(**options)

    def _divided(self, cluster: Cluster) -> MakeExecutor:
        """The executor of the workers, which send passes singly, because the file contains single passes."""
        if self._job.method.carries_on:
            raise OptionError(
                f"'{self._job.method.name}' cannot be divided among workers, because its chains go on from pass to "
                f"pass; trace by '{ParticleTracing.name}', or without workers"
            )
        if self.boxes is None:
            return cluster.rendering(self._job, longest=1)
        return self._in_boxes(cluster, self.boxes)

    def _in_boxes(self, cluster: Cluster, boxes: tuple[int, int, int]) -> MakeExecutor:
        """The executor of a divided scene."""
        from etendue.distributed import Divided, Traffic, part_ingredients, recipe

        job, tracing = self._job, self._job.method
        assert isinstance(tracing, ParticleTracing) and job.task is not None
        check_divisible(tracing)
        ids, bounds = shape_boxes(job.problem)
        grid = BoxGrid.even(bounds, boxes)
        recipes = []
        for box in range(len(grid)):
            part = part_ingredients(job.task, {ids[k] for k in grid.touching(box, bounds)})
            make = f"{make_box_tracing.__module__}:{make_box_tracing.__name__}"
            recipes.append(recipe(part, tracing, None, box_arguments(grid, box, ids), make))
        self._traffic = traffic = Traffic()
        paths = tracing.samples_per_iteration
        return lambda order: Divided(cluster.pool, recipes, order, paths, gathered, traffic=traffic)

    def keep(self, run: RunResult) -> None:
        """See :class:`Work`: passes are in the file already."""
        if self._writer is not None and self._writer.passes:
            self._writer.close(stopped_by=run.stopped_by, elapsed=run.elapsed, **_budget_of(self._job))

    def finish(self, run: RunResult) -> ParticleResult:
        """See :class:`Work`."""
        self.keep(run)
        if bad := int(run.measurement.counters["nonfinite"]):
            logger.warning("%d particles had a power that is not finite, and were left out", bad)
        tracing: Any = self._job.method
        return ParticleResult(
            tracing.particles(run.measurement) if self._writer is None else None,
            None if self._writer is None else self._writer.path,
            dict(run.measurement.counters),
            run.passes,
            str(run.stopped_by),
            run.elapsed,
            self._traffic,
        )


def _budget_of(job: Job) -> dict[str, Any]:
    """What a file notes of the budget, so that a resumed run has the rest."""
    return {"budget": job.budget.to_dict(), "earlier": job.earlier}


class _Written:
    """Takes the passes of an executor, writes their particles, and removes these from the measurement."""

    def __init__(self, writer: ParticleWriter, job: Job, make: MakeExecutor, order: Order) -> None:
        self._writer, self._job = writer, job
        try:
            self._inner = make(order)
        except BaseException:
            self._give_up()
            raise
        self._last = time.perf_counter()
        self._began = self._last - job.preparation

    @property
    def keeps_time(self) -> bool:
        """See :class:`Executor`."""
        return self._inner.keeps_time

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        made = self._inner.next()
        return None if made is None else self._write(made)

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`."""
        return map(self._write, self._inner.rest())

    def shares(self) -> dict[str, int]:
        """Passes of each worker."""
        return dict(getattr(self._inner, "shares", dict)())

    def _write(self, made: Pass) -> Pass:
        measurement, begin = made.measurement, self._last
        ((key, rows),) = ((key, measurement.records[_ROWS][key]) for key in measurement.records[_ROWS].passes)
        self._last = time.perf_counter()
        counters = measurement.counters | {"seconds": self._last - begin}
        elapsed = round(self._last - self._began, 3)
        if made.state:  # first: without it, the particles of a killed run could not go on
            _save_state(self._writer.path, made.state, key[1])
        self._writer.add(key[1], rows, counters, elapsed=elapsed, **_budget_of(self._job))
        # A file contains only particles and counters.
        kept = Measurement({}, {}, measurement.iterations, counters=measurement.counters, records={_ROWS: Record()})
        return Pass(kept, made.state)

    def close(self) -> None:
        """See :class:`Executor`: a run that ends before its first pass leaves no file."""
        self._inner.close()
        self._give_up()

    def _give_up(self) -> None:
        if not self._writer.passes:
            self._writer.discard()


def state_file(path: Path) -> Path:
    """The file beside a file of particles with the state after its last pass, of tracings that have one."""
    return path.with_name(path.name + ".state")


def _save_state(path: Path, state: State, iteration: int) -> None:
    arrays: dict[str, Any] = {name: np.asarray(values) for name, values in state.items()} | {_PASS: iteration}
    with replacing(state_file(path)) as part, open(part, "wb") as file:
        np.savez(file, **arrays)


def _load_state(path: Path, iteration: int) -> State:
    """The state after the last pass, ``iteration``, or the next one, if the run was killed before that was written."""
    place = state_file(path)
    try:
        with np.load(place, allow_pickle=False) as arrays:
            state = {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise CheckpointError(
            f"the chains of '{path}' cannot go on without '{place}', which cannot be read ({describe(error)}): put it "
            "back, or trace a new file"
        ) from error
    if (after := int(state.pop(_PASS, iteration))) not in (iteration, iteration + 1):
        where = f"'{place}' has their state after pass {after}, but the last pass is {iteration}"
        raise CheckpointError(f"the chains of '{path}' cannot go on: {where}; trace a new file")
    return state


def _checkpoint(known: ParticleFile) -> Checkpoint:
    """A checkpoint of a run, made from its file of particles."""
    header = known.header
    passes = [[0, int(block.head["pass"]), int(block.head["pass"]) + 1] for block in known.passes]
    if not passes:
        raise CheckpointError(f"'{known.path}' has no whole pass; remove it, and trace the particles anew")
    ending = {"stopped_by": "running"} | known.passes[-1].head | known.ending
    names = {_ROWS: Record()}
    method = str(header.get("method", ParticleTracing.name))
    if method not in TRACINGS:
        raise CheckpointError(f"'{known.path}' was traced by '{method}', which this étendue does not have")
    return Checkpoint(
        measurement=Measurement({}, {}, Iterations.from_json(passes), counters=dict(known.counters), records=names),
        method=method,
        state=dict(_load_state(Path(known.path), passes[-1][1])) if TRACINGS[method].carries_on else {},
        settings=header["settings"],
        seed=int(header["seed"]),
        fingerprint=header["fingerprint"],
        scene=dict(header["place"]),
        budget=dict(ending["budget"]),
        stopped_by=str(ending["stopped_by"]),
        versions=dict(header["versions"]),
        elapsed=float(ending["elapsed"]),
        earlier=float(ending["earlier"]),
    )


def repack(source: Path, output: Path, codec: str, tell: Callable[[int, int], object] = lambda done, of: None) -> Path:
    """Write the particles of a file by another codec; ``tell`` gets the number of passes done and of all passes.

    Raises :class:`ParticleError` for a file that cannot be read, :class:`OutputError` if ``output`` exists or cannot be
    written; an incomplete ``output`` is removed."""
    chosen, known = Codec.parse(codec), ParticleFile(source)
    header = {name: value for name, value in known.header.items() if name not in ("crc", "surfaces", "format")}
    if known.codec.is_bounded:
        header["before"] = [*known.header.get("before", []), str(known.codec)]
        logger.info("%s is packed with bounded loss already", source)
    writer = ParticleWriter.create(output, header, known.surfaces, chosen)
    try:
        for done, (end, rows) in enumerate(known.rows_of_passes(), start=1):
            more = {name: value for name, value in end.head.items() if name not in ("pass", "counters", "crc")}
            writer.add(int(end.head["pass"]), rows, end.head["counters"], **more)
            tell(done, len(known.passes))
        ending = {name: value for name, value in known.ending.items() if name != "crc"}
        if state_file(source).exists():  # of chains, which go on with it
            shutil.copyfile(state_file(source), state_file(output))
        writer.close(**ending)  # without an ending the copy is not finished either
    except BaseException:
        writer.discard()
        raise
    return output
