"""Form factors and solutions as work: patches are read and checked, lines are cast, results are made and written."""

from __future__ import annotations

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, TypeVar

from etendue.core import EtendueError, Iterations, OutputError, describe, format_count, logger
from etendue.engine import Job, Runner, replicated
from etendue.radiosity import (
    PartialSegments,
    ambient_solution,
    check_balance,
    form_factors,
    partial_form_factors,
    save_form_factors,
    solve,
)

from .files import Writing, about, add_to_message, rescued
from .lines import LinesJob, LinesTask
from .linesrequest import LinesRequest
from .requests import MULTIPATH, FormFactorRequest, RadiosityRequest
from .results import FormFactorResult, RadiosityResult

if TYPE_CHECKING:
    from etendue.core import Progress
    from etendue.distributed import Cluster, Recipe
    from etendue.engine import Checkpoint, MakeExecutor, RunResult
    from etendue.radiosity import CastLines, Objects, Patches, Segments
    from etendue.scene import Problem

Q = TypeVar("Q", bound=LinesRequest)
R = TypeVar("R")
#: Receives a description of the current step.
Tell = Callable[[str], object]
#: Receives the number of bundles that were cast, and their segments.
Counted = Callable[[int, "Segments"], object]


def _silent(*_: object) -> None: ...


class RequestedWork(ABC, Generic[Q, R]):
    """A request whose source has been read and checked; see :class:`Work`. ``saved`` is the checkpoint to resume.

    Attributes
    ----------
    problem: the scene, if the source is one.
    kept: plural noun for the content of a checkpoint, in messages.
    cluster: makes the passes; without it this process does.
    """

    problem: Problem | None
    kept: ClassVar[str] = "lines"
    started_by: ClassVar[str] = "etendue.start_radiosity"
    cluster: Cluster | None = None

    def __init__(self, request: Q, saved: Checkpoint | None) -> None:
        self.request, self.saved = request, saved
        self._checkpoint: Path | None = None  # once it is written, with everything that was cast
        self._job: Job | None = None
        self.budget = request.budget(saved)
        #: Number of lines or bundles, and the standard error, at each new estimate.
        self.history: list[tuple[float, float]] = []
        self.notes = request.notes() or ({} if saved is None else dict(saved.notes))

    @abstractmethod
    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """All that is needed to resume ``run`` later."""
        assert self._job is not None, "there is no run without a runner"
        return self._job.checkpoint(run)

    def observe(self, progress: Progress) -> None:
        """Note the error after a pass. See :class:`Work`."""
        if progress.relative_error is None:
            return
        error = math.sqrt(progress.relative_error)
        if not self.history or error != self.history[-1][1]:
            self.history.append((float(progress.samples), error))

    def told(self, progress: Progress) -> Progress:
        """See :class:`Work`: the progress in words, as "3 bundles, 1.2e+06 segments"."""
        return replace(progress, made=self.progress_text(progress), traced="segments")

    @abstractmethod
    def progress_text(self, progress: Progress) -> str:
        """The amount cast in words, as "3 bundles, 1.2e+06 segments"."""

    def keep(self, run: RunResult) -> None:
        """Write the checkpoint, if one is requested; in the system's temporary folder if that fails. The error then
        says where it is."""
        if (path := self.request.checkpoint) is None:
            return
        try:
            self._save(run, path)
        except EtendueError as error:
            if (kept := self._rescued(run)) is not None:
                add_to_message(error, f"; the {self.kept} are kept: {self._how_to_resume(run, kept)}")
            raise

    def finish(self, run: RunResult, tell: Tell = _silent, counted: Counted = _silent) -> R:
        """Write the checkpoint, make the result and write its files. ``counted`` receives the number of bundles and
        their segments, if segments are stored.

        If something fails, the error names the checkpoint with everything that was cast: the requested one, or one in
        the system's temporary folder.
        """
        writing = Writing()
        with self._all_kept(run):
            if (path := self.request.checkpoint) is not None:
                with writing.attempt(f"write '{path}'"):
                    self._save(run, path)
                    self._checkpoint = path
            result = self._make(run, writing, tell, counted)
            writing.finish()
        return result

    @abstractmethod
    def _make(self, run: RunResult, writing: Writing, tell: Tell, counted: Counted) -> R:
        """Make the result and write its files."""

    @abstractmethod
    def _how_to_resume(self, run: RunResult, checkpoint: Path) -> str:
        """How to resume ``run`` from a checkpoint."""

    def _run(self, problem: Any, method: Any, recipe_of: Callable[[Any, Any], Recipe], **options: Any) -> Runner:
        """The runner of a prepared method, which continues the checkpoint if there is one. Workers of a cluster make
        the method from the recipe ``recipe_of(problem, method)``."""
        saved, seed, earlier, done = self.saved, int(self.request.seed), 0.0, Iterations()
        made = method
        state: Any = None
        if saved is not None:
            earlier, state, done = saved.earlier + saved.elapsed, saved.state, saved.measurement.iterations
            method = replicated(method, saved.state, problem, seed)
            options |= {"start": saved.measurement}
        if self.cluster is not None:
            options["executor"] = self._executor(self.cluster, problem, made, recipe_of)
            method, state = self.cluster.replicate(method, problem, seed, state, done)
        options["state"] = state
        self._job = Job(problem, method, seed=seed, budget=self.budget, place={}, earlier=earlier, notes=self.notes)
        return Runner(method, seed=seed, budget=self.budget, **self._with_saves(options))

    def _executor(
        self, cluster: Cluster, problem: Any, method: Any, recipe_of: Callable[[Any, Any], Recipe]
    ) -> MakeExecutor:
        """The executor of the passes on a cluster."""
        return cluster.executor(recipe_of(problem, method))

    def _with_saves(self, options: dict[str, Any]) -> dict[str, Any]:
        """Options of the runner, and those of intermediate checkpoints."""
        if (path := self.request.checkpoint) is not None:
            options |= {"on_save": lambda run: self._save(run, path), "save_every": self.request.save_every}
        return options

    def _save(self, run: RunResult, path: Path) -> None:
        self.checkpoint(run).write(path)

    def _rescued(self, run: RunResult) -> Path | None:
        """A checkpoint in the system's temporary folder; ``None`` if it cannot be written."""
        return rescued(f"{self.kept}.checkpoint", ("", lambda path: self._save(run, path)))

    @contextmanager
    def _all_kept(self, run: RunResult) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            known = error if isinstance(error, EtendueError) else None
            failure = known or OutputError(f"the {self.kept} could not be evaluated: {describe(error)}")
            if (path := self._checkpoint or self._rescued(run)) is not None:
                add_to_message(failure, f"; the {self.kept} are kept: {self._how_to_resume(run, path)}")
            raise failure from (error.__cause__ if known else error)

    def _metadata(self, **more: Any) -> dict[str, Any]:
        """Metadata of the files."""
        source = self.request.name if self.problem is None else self.problem.source
        if isinstance(self.request, RadiosityRequest):
            more["settings"] = self.request.asked
        return about(source, seed=self.request.seed, **more)


class PatchWork(RequestedWork[Q, R]):
    """Work on patches in one mesh."""

    def __init__(self, request: Q, saved: Checkpoint | None, tell: Tell) -> None:
        super().__init__(request, saved)
        self.problem, self.patches = request.load(tell)


class LinesWork(PatchWork[Q, R]):
    """Work on stored lines of bundles.

    saved: a checkpoint to resume, of the same patches, seed and options. is_watched: whether errors are estimated
    during the run even if no budget asks for them.
    """

    goal: ClassVar[Literal["rows", "irradiance"]]

    def __init__(
        self, request: Q, saved: Checkpoint | None = None, *, is_watched: bool = False, tell: Tell = logger.info
    ) -> None:
        super().__init__(request, saved, tell)
        # The lines of a run to an error are cast as replicates; a resumed run continues as it was begun.
        to_error = request.error is not None if saved is None else json.loads(saved.settings).get("replicates", 1) > 1
        self.lines = LinesJob(
            LinesTask(
                self.patches,
                self.goal,
                self.budget,
                request.name,
                int(request.seed),
                request.lines,
                shot=self._wants_shot,
                local_rays=request.local_rays,
                objects=self._objects(),
                hierarchy=self._hierarchy,
                to_error=to_error,
                is_watched=is_watched or request.is_watched,
                entry_bytes=request.entry_bytes,
                checkpoint=request.checkpoint,
                notes=self.notes,
                bundles_option=request.wording.option("bundles"),
            ),
            saved,
        )

    @property
    def _wants_shot(self) -> bool:
        return False

    def _objects(self) -> Objects | None:
        """The objects of a hierarchy of lines; ``None`` for lines through the whole scene."""
        return None

    @property
    def _hierarchy(self) -> dict[str, Any]:
        return {}

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        if (path := self.request.checkpoint) is not None:
            options["on_save"] = lambda run: self._save(run, path)
            options["save_if"] = self.lines.fills_memory
        return self.lines.runner(self.cluster, **self._with_saves(options))

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """See :class:`RequestedWork`."""
        return self.lines.checkpoint(run)

    def progress_text(self, progress: Progress) -> str:
        """See :class:`RequestedWork`."""
        count = min(progress.samples, self.lines.casting.most or progress.samples)
        return f"{format_count(count, 'bundle')}, {progress.rays:.3g} segments"

    def keep(self, run: RunResult) -> None:
        """See :class:`RequestedWork`."""
        self.lines.cast(run)
        super().keep(run)

    def finish(self, run: RunResult, tell: Tell = _silent, counted: Counted = _silent) -> R:
        """See :class:`RequestedWork`."""
        self.lines.cast(run)
        return super().finish(run, tell, counted)

    def _make(self, run: RunResult, writing: Writing, tell: Tell, counted: Counted) -> R:
        lines = self.lines.cast(run)
        if self.lines.is_full(run):
            logger.warning("%s", self.lines.why_full(lines.count))
        tell("counting")
        segments = lines.segments()
        counted(lines.count, segments)
        return self._evaluate(run, lines, segments, writing, tell)

    @abstractmethod
    def _evaluate(self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell) -> R:
        """Make the result from the segments and write its files."""

    def _how_to_resume(self, run: RunResult, checkpoint: Path) -> str:
        return self.request.wording.resume(checkpoint, "bundles", self.lines.cast(run).count)

    def _cast(self, run: RunResult, lines: CastLines, segments: Segments) -> dict[str, Any]:
        """The fields that form factors and solutions have in common."""
        return {
            "patches": self.patches,
            "segments": segments,
            "bundles": lines.count,
            "stopped_by": run.stopped_by,
            "elapsed": run.elapsed,
        }


class FormFactorWork(LinesWork[FormFactorRequest, FormFactorResult]):
    """Form factors by lines."""

    started_by = "etendue.start_form_factors"
    goal: ClassVar[Literal["rows", "irradiance"]] = "rows"

    def _objects(self) -> Objects | None:
        return self.request.objects(self.patches)

    @property
    def _hierarchy(self) -> dict[str, Any]:
        return self.request.hierarchy_settings

    def _evaluate(
        self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell
    ) -> FormFactorResult:
        estimator: Any = self.request.chosen_estimator
        make: Any = partial_form_factors if isinstance(segments, PartialSegments) else form_factors
        factors = make(segments, estimator)
        known = self._metadata(bundles=lines.count, estimator=estimator)
        for path in self.request.outputs:
            with writing.attempt(f"write '{path}'"):
                save_form_factors(path, factors, emissivity=1 - self.patches.reflectance[:, 0], metadata=known)
        return FormFactorResult(**self._cast(run, lines, segments), factors=factors)


class RadiosityWork(LinesWork[RadiosityRequest, RadiosityResult]):
    """A solution by lines."""

    goal: ClassVar[Literal["rows", "irradiance"]] = "irradiance"

    @property
    def _wants_shot(self) -> bool:
        return self.request.shot

    def _evaluate(
        self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell
    ) -> RadiosityResult:
        request, solver = self.request, self.request.chosen_solver
        tell("solving")
        shot = lines.shot()
        transport = form_factors(segments) if request.needs_matrix else segments
        rest: Any = {} if request.bounces is None else {"max_iterations": request.bounces, "ambient": request.ambient}
        solution = solve(self.patches, transport, solver, shot=shot, **rest)  # type: ignore[arg-type]
        error = solution.irradiance_error(segments) if segments.batch_count > 1 else None
        known = self._metadata(bundles=lines.count, solver=solver, imbalance=solution.imbalance)
        making = request.making(self.history)
        shown = request.outputs.write(writing, self.problem, solution, error, known, request.wording, tell, making)
        return RadiosityResult(
            **self._cast(run, lines, segments),
            solution=solution,
            irradiance_error=error,
            is_balanced=check_balance(solution, error),
            shot=shot,
            picture=shown.picture,
            lightmap=shown.lightmap,
        )


def radiosity_work(
    request: RadiosityRequest, saved: Checkpoint | None = None, **options: Any
) -> RequestedWork[RadiosityRequest, RadiosityResult]:
    """The work for the solver of a request; ``options`` are those of :class:`LinesWork`."""
    if request.chosen_solver == MULTIPATH:
        from .multipath import MultipathWork

        return MultipathWork(request, saved, **options)
    return RadiosityWork(request, saved, **options)


def solve_ambient(
    request: RadiosityRequest, tell: Tell = logger.info, patches_read: Callable[[Patches], object] = _silent
) -> RadiosityResult:
    """A solution without lines, and its files. ``patches_read`` receives the patches before the solution."""
    assert request.ambient is not None
    problem, patches = request.load(tell)
    patches_read(patches)
    parts = request.scene_in_parts(patches)
    begin = time.perf_counter()
    solution = ambient_solution(patches, request.ambient, parts)  # type: ignore[arg-type]
    elapsed = time.perf_counter() - begin
    source = request.name if problem is None else problem.source
    known = about(source, solver=f"ambient, {request.ambient}", imbalance=solution.imbalance, settings=request.asked)
    writing = Writing()
    shown = request.outputs.write(writing, problem, solution, None, known, request.wording, tell, request.making())
    writing.finish()
    about_run: Any = {"patches": patches, "stopped_by": "ambient", "elapsed": elapsed, "irradiance_error": None}
    return RadiosityResult(
        **about_run,
        solution=solution,
        is_balanced=check_balance(solution, None),
        picture=shown.picture,
        lightmap=shown.lightmap,
    )
