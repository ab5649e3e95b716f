"""Base of what is made from lines through patches: the checkpoint and its rescue, progress, metadata of files."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

from etendue.core import BackendError, EtendueError, Method, OutputError, Settings, describe, format_count, logger
from etendue.engine import Budget, Job, Product, Task, check_period, check_records, silent
from etendue.radiosity import REPLICATES, LineCasting, MultipathPasses, PatchSource

from ..files import Writing, about, add_to_message, check_files, rescued
from .room import LineRoom

if TYPE_CHECKING:
    from etendue.core import Progress
    from etendue.engine import RunResult
    from etendue.radiosity import Segments

R = TypeVar("R")

#: Libraries of the extra `radiosity`.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
#: The budget of a run for which none is given, by what its method counts.
_BUDGETS = {"bundles": Budget(samples=1024), "points": Budget(samples=1 << 22), "passes": Budget(iterations=16)}


@dataclass(kw_only=True)
class PatchProduct(Product[R]):
    """Base of :class:`FormFactorProduct` and :class:`SolutionProduct`.

    checkpoint: with it, lines are stored in a folder beside it instead of memory. if_stopped: where a checkpoint is
    written in place of that if the run ends early, by a cancel or a failure.
    is_watched: whether errors are estimated during the run even if no budget asks for them. settings: those that were
    asked for, for the metadata of files. on_segments: receives the number of bundles and their segments.
    """

    checkpoint: Path | None = None
    if_stopped: Path | None = None
    save_every: float | None = None
    is_watched: bool = False
    asked: dict[str, Any] = field(default_factory=dict)
    on_segments: Callable[[int, Segments], object] = silent

    goal: ClassVar[Literal["rows", "irradiance"]]

    def __post_init__(self) -> None:
        if missing := [name for name in _LIBRARIES if find_spec(name) is None]:
            raise BackendError(f"radiosity needs {', '.join(missing)}, not installed: pip install 'etendue[radiosity]'")
        check_period(self.save_every)
        self._room: LineRoom | None = None
        self._saved: Path | None = None  # the checkpoint, once it is written with everything that was cast
        #: Number of bundles, lines or passes, and the standard error, at each new estimate.
        self.history: list[tuple[float, float]] = []

    def check_files(self, stores_lines: bool) -> None:
        """Raise the error of a file that cannot be written. ``stores_lines``: whether the method stores its lines."""
        check_files(self.files if self.checkpoint is None else (*self.files, self.checkpoint))
        if self.checkpoint is not None and stores_lines:
            check_records(self.checkpoint)

    @property
    @abstractmethod
    def entry_bytes(self) -> float:
        """Bytes of each form factor while it is computed from the lines; 0 if none are."""

    # ------------------------------------------------------------------ the run

    def default_budget(self, task: Task, problem: Any) -> Budget:
        """1024 bundles, four million points, or 16 passes."""
        return _BUDGETS[task.method.counts]

    def make_method(self, task: Task, settings: Settings, problem: Any, budget: Budget) -> Method:
        """See :class:`Product`."""
        kind: Any = task.method
        if issubclass(kind, LineCasting):
            # The number of bundles is for the size of passes: few make enough for an error.
            own = {"goal": self.goal if self.is_watched or budget.error is not None else None, "most": budget.samples}
            return self._casting(task, kind, settings, problem, **own)
        made: Method = kind(settings)
        return made

    def settings(self, task: Task, problem: Any, budget: Budget) -> Settings:
        """See :class:`Product`. Lines of a run to an error are cast as the product wants them."""
        given = dict(task.settings)
        if budget.error is not None and task.method.name == LineCasting.name:
            given = {**self._to_error(budget.error**0.5, problem, given), **given}
        made: Settings = task.method.Settings.from_mapping(given)
        return made

    def _to_error(self, error: float, problem: Any, given: dict[str, Any]) -> dict[str, Any]:
        """Settings of lines to an error, beside those that are ``given``: replicates, whose variance is the error."""
        return {"replicates": REPLICATES}

    def _casting(self, task: Task, kind: Any, settings: Settings, problem: Any, **own: Any) -> LineCasting:
        made: LineCasting = kind(settings, **own)
        return made

    def prepared(self, job: Job) -> None:
        """See :class:`Product`."""
        if isinstance(job.method, LineCasting):
            self._room = LineRoom(job, self.checkpoint, self.entry_bytes)

    def saving(self, job: Job) -> dict[str, Any]:
        """See :class:`Product`."""
        options: dict[str, Any] = {}
        if isinstance(job.method, MultipathPasses):
            options["watched"] = self.is_watched
        if (path := self.checkpoint) is not None:
            options |= {"on_save": lambda run: job.checkpoint(run).write(path), "save_every": self.save_every}
            if self._room is not None:
                options["save_if"] = self._room.fills_memory
        return options

    def described(self, job: Job, progress: Progress) -> Progress:
        """The progress in words, as "3 bundles, 1.2e+06 segments"; notes the error."""
        error = progress.error
        if error is not None and (not self.history or error != self.history[-1][1]):
            self.history.append((float(progress.samples), error))
        if isinstance(job.method, LineCasting):
            count = min(progress.samples, job.method.most or progress.samples)
            made = f"{format_count(count, 'bundle')}, {progress.rays:.3g} segments"
        elif isinstance(job.method, MultipathPasses):
            made = f"{format_count(progress.samples, 'line')}, {progress.rays:.3g} segments"
        else:
            made = f"{progress.samples:.3g} lines"
        return replace(progress, made=made, traced="segments")

    # ------------------------------------------------------------------ the end

    def keep(self, job: Job, run: RunResult) -> None:
        """Write the checkpoint, if one is requested; in the system's temporary folder if that fails. The error then
        says where it is."""
        if isinstance(job.method, LineCasting):
            job.method.close()
        if (path := self._kept_at(run)) is None:
            return
        try:
            job.checkpoint(run).write(path)
        except EtendueError as error:
            if (kept := self._rescued(job, run)) is not None:
                add_to_message(error, self._how_to_resume(kept, job, run))
            raise

    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> R:
        """Write the checkpoint, make the result and write its files.

        If something fails, the error names the checkpoint with everything that was cast: the requested one, or one in
        the system's temporary folder.
        """
        if isinstance(job.method, LineCasting):
            job.method.close()
        writing = Writing()
        with self._all_kept(job, run):
            if (path := self._kept_at(run)) is not None:
                with writing.attempt(f"write '{path}'"):
                    job.checkpoint(run).write(path)
                    self._saved = path
            result = self._make(job, run, writing, tell)
            writing.finish()
        return result

    def _kept_at(self, run: RunResult) -> Path | None:
        return self.checkpoint or (self.if_stopped if run.stopped_by in ("cancel", "failure") else None)

    @abstractmethod
    def at_once(
        self, source: PatchSource, tell: Callable[[str], object] = silent, on_patches: Callable[[Any], object] = silent
    ) -> R:
        """Make the product without passes, and write its files. ``on_patches`` receives the patches beforehand."""

    @abstractmethod
    def _make(self, job: Job, run: RunResult, writing: Writing, tell: Callable[[str], object]) -> R:
        """Make the result and write its files."""

    def _counted(self, job: Job, run: RunResult, tell: Callable[[str], object]) -> tuple[int, Segments]:
        """Number of bundles, and their segments."""
        assert isinstance(job.method, LineCasting) and self._room is not None
        if (warning := self._room.warning(run)) is not None:
            logger.warning("%s", warning)
        tell("counting")
        bundles, segments = job.method.bundles(run.measurement), job.method.segments(run.measurement)
        self.on_segments(bundles, segments)
        return bundles, segments

    def _rescued(self, job: Job, run: RunResult) -> Path | None:
        """A checkpoint in the system's temporary folder; ``None`` if it cannot be written."""
        return rescued(f"{job.method.name}.checkpoint", ("", lambda path: job.checkpoint(run).write(path)))

    @contextmanager
    def _all_kept(self, job: Job, run: RunResult) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            known = error if isinstance(error, EtendueError) else None
            failure = known or OutputError(f"the lines could not be evaluated: {describe(error)}")
            if (path := self._saved or self._rescued(job, run)) is not None:
                add_to_message(failure, self._how_to_resume(path, job, run))
            raise failure from (error.__cause__ if known else error)

    def _how_to_resume(self, path: Path, job: Job, run: RunResult) -> str:
        """To the number of what was cast, so that no more lines are cast."""
        count, number = job.method.counts, run.samples
        if isinstance(job.method, LineCasting):
            number = job.method.bundles(run.measurement)
        elif count == "passes":
            number = run.passes
        return f"; the lines are kept: etendue resume '{path}' --{count} {number}"

    def _metadata(self, job: Job, **more: Any) -> dict[str, Any]:
        """Metadata of the files."""
        return about(job.problem.source, seed=job.seed, **more)
