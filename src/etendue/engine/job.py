"""Tasks and jobs: what is asked for, and the same with an opened source and a prepared method.

The caller passes the class of the method: the engine knows no concrete method, source or product.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from etendue.core import (
    VERSION,
    CheckpointError,
    EtendueError,
    Ingredients,
    Measurement,
    Method,
    OptionError,
    State,
    is_whole,
    logger,
    optimise_kernels,
    prepared,
)

from .budget import Budget
from .checkpoint import Checkpoint
from .executor import InTurn, MakeExecutor
from .fitting import fit_samples, settle_samples
from .product import Product
from .replicas import replicated
from .runner import Runner, RunResult


class Source(Protocol):
    """What a run works on: a scene, patches, or parts with copies."""

    def open(self, tell: Callable[[str], object] = logger.info) -> Any:
        """The problem of the method, with the attributes ``source``, its name, and ``fingerprint``. ``tell`` receives
        remarks."""
        ...

    def place(self) -> dict[str, Any]:
        """Plain values from which the source is made again; without the place of what is in memory."""
        ...

    def ingredients(self, problem: Any) -> Ingredients:
        """What a worker makes the problem from. Raises :class:`SceneError` for what cannot be sent."""
        ...


@dataclass(frozen=True)
class Task:
    """What is asked for. Settings are checked when it is made, before the source is read.

    Settings that are not given are those of the scene's integrator (such as its depth), or else the defaults of the
    method. Without a budget that of the product is used.
    """

    source: Source
    method: type[Method]
    product: Product[Any]
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        if not is_whole(self.seed) or self.seed < 0:
            raise OptionError(f"a seed is a whole number of at least 0, not {self.seed!r}")
        object.__setattr__(self, "seed", int(self.seed))  # for checkpoints, as a plain number
        self.method.Settings.from_mapping(self.settings, owner=f"method '{self.method.name}'")


class Job:
    """A task whose source is opened and whose method is prepared."""

    def __init__(
        self,
        task: Task,
        problem: Any,
        method: Method,
        budget: Budget,
        *,
        start: Measurement | None = None,
        state: State | None = None,
        earlier: float = 0.0,
        preparation: float = 0.0,
        notes: Mapping[str, Any] | None = None,
    ) -> None:
        self.task, self.problem, self.method = task, problem, method
        self.seed, self.product = task.seed, task.product
        self.budget = budget
        #: The limits of this run, if they are not those of the budget, which a checkpoint keeps.
        self.limits = budget
        self.start, self.state = start, state
        #: Seconds of the runs that this one resumes, as their budgets counted them; 0 for the first run.
        self.earlier = earlier
        #: Seconds of preparing the method, which count towards the budget.
        self.preparation = preparation
        #: Plain values for the checkpoint.
        self.notes: dict[str, Any] = {**(notes or {}), **task.product.notes()}

    @classmethod
    def open(cls, task: Task, tell: Callable[[str], object] = logger.info) -> Job:
        """Open the source and prepare the method. A Mitsuba variant must be set. ``tell`` receives remarks."""
        problem = task.source.open(tell)
        task.product.check(problem)
        begin = time.perf_counter()
        budget = task.budget or task.product.default_budget(task, problem)
        optimise_kernels(not task.product.is_brief(problem, budget))
        method = task.product.make_method(task, task.product.settings(task, problem, budget), problem, budget)
        if budget.samples is None or method.samples_for(problem) is None:
            method = prepared(method, problem, task.seed)
        budget = task.product.budget(method, budget)
        if budget.samples is not None:
            method = fit_samples(method, budget.samples, problem, task.seed)
        settle_samples(method)
        job = cls(task, problem, method, budget)
        task.product.prepared(job)
        job.preparation = time.perf_counter() - begin
        return job

    @classmethod
    def resume(cls, checkpoint: Checkpoint, task: Task, tell: Callable[[str], object] = logger.info) -> Job:
        """Continue ``checkpoint`` with the source, method and product of ``task``, which need not have settings.

        The budget of the task replaces the saved one: its seconds are those of this run, its other limits are those of
        the whole. Without it, the rest of the saved budget is used. Raises :class:`CheckpointError` if method or scene
        differ, or if the saved budget is used up.
        """
        settings = checkpoint.settings_of(task.method, task.settings, task.seed)
        budget = task.budget or remaining(checkpoint)
        try:
            problem = task.source.open(tell)
        except EtendueError as error:
            raise CheckpointError(f"the scene of the checkpoint cannot be loaded: {error}") from error
        checkpoint.require_scene(problem.fingerprint)
        task.product.check(problem)
        begin = time.perf_counter()
        optimise_kernels(not task.product.is_brief(problem, budget))
        method = prepared(task.product.make_method(task, settings, problem, budget), problem, checkpoint.seed)
        method = replicated(method, checkpoint.state, problem, checkpoint.seed)
        method.enter(checkpoint.state)
        job = cls(
            task,
            problem,
            method,
            task.product.budget(method, budget),
            start=checkpoint.measurement,
            state=checkpoint.state,
            earlier=checkpoint.earlier + checkpoint.elapsed,
            notes=checkpoint.notes,
        )
        task.product.prepared(job)
        job.preparation = time.perf_counter() - begin
        return job

    def ingredients(self) -> Ingredients:
        """What a worker makes the problem from."""
        return self.task.source.ingredients(self.problem)

    def keep(self, run: RunResult) -> object:
        """Save the finished passes after a failure."""
        return self.product.keep(self, run)

    def runner(self, make: MakeExecutor = InTurn, **options: Any) -> Runner:
        """A :class:`Runner` of this job; ``make`` makes the executor of its passes, ``options`` are further ones.

        It adds to the measurement of a resumed job in place, so a job has one runner.
        """
        options |= self.product.saving(self) | {"executor": self.product.executor(self, make)}
        start, self.start = self.start, None
        options |= {"start": start, "state": self.state, "spent": self.preparation}
        options |= {"least": self.product.least_passes}
        runner = Runner(self.method, seed=self.seed, budget=self.limits, **options)
        runner.described = lambda progress: self.product.described(self, progress)
        return runner

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """All that is needed to resume ``run`` later."""
        return Checkpoint(
            measurement=run.measurement,
            method=self.method.name,
            settings=self.method.settings.to_json(),
            seed=self.seed,
            fingerprint=self.problem.fingerprint,
            state=dict(run.state),
            scene=self.task.source.place(),
            budget=self.budget.to_dict(),
            stopped_by=run.stopped_by,
            versions=versions(),
            elapsed=run.elapsed,
            earlier=self.earlier,
            notes=self.notes,
        )


def versions() -> dict[str, str]:
    """Versions of étendue, Mitsuba and Dr.Jit, and the Mitsuba variant."""
    import drjit as dr
    import mitsuba as mi

    return {"etendue": VERSION, "mitsuba": mi.__version__, "drjit": dr.__version__, "variant": mi.variant() or ""}


def remaining(checkpoint: Checkpoint) -> Budget:
    """The rest of the budget of an interrupted run. Raises :class:`CheckpointError` if the budget is used up."""
    if checkpoint.stopped_by in ("seconds", "samples", "error"):
        raise CheckpointError("the budget of the checkpoint is used up; give a new one")
    saved = dict(checkpoint.budget)
    if "seconds" in saved:
        saved["seconds"] -= checkpoint.elapsed
        if saved["seconds"] <= 0:
            raise CheckpointError("the time of the checkpoint is used up; give a new budget")
    return Budget(**saved)
