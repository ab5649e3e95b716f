"""Form factors and solutions as work: patches are read and checked, lines cast, and made what was asked for."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, Generic, Literal, TypeVar

from etendue.core import EtendueError, OutputError, describe, logger
from etendue.engine import Checkpoint, Runner, RunResult
from etendue.radiosity import CastLines, Segments, form_factors, save_form_factors, solve

from .files import Writing, add_to_message
from .lines import LinesJob, LinesTask
from .requests import FormFactorRequest, LinesRequest, RadiosityRequest
from .results import FormFactorResult, RadiosityResult

Q = TypeVar("Q", bound=LinesRequest)
R = TypeVar("R")
#: Is given what is being done.
Tell = Callable[[str], object]
#: Is given the number of bundles that were cast, and their segments.
Counted = Callable[[int, Segments], object]


def _silent(*_: object) -> None: ...


class LinesWork(ABC, Generic[Q, R]):
    """A request whose source has been read and checked, and the lines cast for it; see :class:`Work`.

    saved: a checkpoint to go on with, of the same patches, seed and options. is_watched: whether errors are estimated
    on the way even if no budget asks for it.
    """

    goal: ClassVar[Literal["rows", "irradiance"]]

    def __init__(
        self, request: Q, saved: Checkpoint | None = None, *, is_watched: bool = False, tell: Tell = logger.info
    ) -> None:
        self.request = request
        self._kept: Path | None = None  # where the lines are
        budget = request.budget(saved)
        self.problem, self.patches = request.load(tell)
        # Lines that are to tell their error are cast in another way; those of a checkpoint as they were begun.
        to_error = request.error is not None if saved is None else json.loads(saved.settings).get("replicates", 1) > 1
        self.lines = LinesJob(
            LinesTask(
                self.patches,
                self.goal,
                budget,
                request.name,
                int(request.seed),
                request.lines,
                shot=self._wants_shot,
                local_rays=request.local_rays,
                to_error=to_error,
                is_watched=is_watched,
                needs_matrix=request.needs_matrix,
                notes=request.notes() or ({} if saved is None else saved.notes),
                bundles_option=request.wording.option("bundles"),
            ),
            saved,
        )

    @property
    def _wants_shot(self) -> bool:
        return False

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        if (path := self.request.checkpoint) is not None and self.request.save_every is not None:
            options |= {"on_save": lambda run: self._save(run, path), "save_every": self.request.save_every}
        return self.lines.runner(**options)

    def keep(self, run: RunResult) -> None:
        """Write the checkpoint, if one is asked for."""
        self.lines.cast(run)
        if self.request.checkpoint is not None:
            self._save(run, self.request.checkpoint)

    def finish(self, run: RunResult, tell: Tell = _silent, counted: Counted = _silent) -> R:
        """Write the checkpoint, make what was asked for and write its files. ``counted`` is given the number of bundles
        and their segments.

        If something fails, the error says where the lines are kept: in the checkpoint, or in one among the temporary
        files.
        """
        writing = Writing()
        lines = self.lines.cast(run)
        with self._lines_kept(run):
            if (path := self.request.checkpoint) is not None:
                with writing.attempt(f"write '{path}'"):
                    self._save(run, path)
                    self._kept = path
            if self.lines.is_full(run):
                logger.warning(
                    "memory holds no more than these %d bundles of lines: free some, or make patches larger",
                    lines.count,
                )
            tell("counting")
            segments = lines.segments()
            counted(lines.count, segments)
            result = self._make(run, lines, segments, writing, tell)
            writing.finish()
        return result

    @abstractmethod
    def _make(self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell) -> R:
        """Make what was asked for of the segments, and write its files."""

    def _save(self, run: RunResult, path: Path) -> None:
        self.lines.checkpoint(run).write(path)

    @contextmanager
    def _lines_kept(self, run: RunResult) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            known = error if isinstance(error, EtendueError) else None
            failure = known or OutputError(f"nothing could be made of the lines: {describe(error)}")
            if (path := self._kept or self.lines.rescued(run)) is not None:
                how = self.request.wording.resume(path, self.lines.cast(run).count)
                add_to_message(failure, f"; the lines are kept: {how}")
            raise failure from (error.__cause__ if known else error)

    def _cast(self, run: RunResult, lines: CastLines, segments: Segments) -> dict[str, Any]:
        """The fields of :class:`LinesResult`."""
        return {
            "patches": self.patches,
            "segments": segments,
            "bundles": lines.count,
            "stopped_by": run.stopped_by,
            "elapsed": run.elapsed,
        }

    def _metadata(self, lines: CastLines, **more: Any) -> dict[str, Any]:
        """For the files."""
        source = self.request.name if self.problem is None else self.problem.source
        return about(source, bundles=lines.count, seed=self.request.seed, **more)


class FormFactorWork(LinesWork[FormFactorRequest, FormFactorResult]):
    """Form factors by lines."""

    goal: ClassVar[Literal["rows", "irradiance"]] = "rows"

    def _make(
        self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell
    ) -> FormFactorResult:
        estimator: Any = self.request.estimator
        factors = form_factors(segments, estimator)
        known = self._metadata(lines, estimator=estimator)
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

    def _make(
        self, run: RunResult, lines: CastLines, segments: Segments, writing: Writing, tell: Tell
    ) -> RadiosityResult:
        request, solver = self.request, self.request.solver
        tell("solving")
        shot = lines.shot()
        transport: Any = form_factors(segments) if request.needs_matrix else segments
        solution = solve(self.patches, transport, solver, shot=shot)  # type: ignore[arg-type]
        error = solution.irradiance_error(segments) if segments.batch_count > 1 else None
        known = self._metadata(lines, solver=solver, imbalance=solution.imbalance)
        shown = request.outputs.write(writing, self.problem, solution, error, known, request.wording, tell)
        return RadiosityResult(
            **self._cast(run, lines, segments),
            solution=solution,
            irradiance_error=error,
            shot=shot,
            picture=shown.picture,
            lightmap=shown.lightmap,
        )


def about(source: str, **more: Any) -> dict[str, Any]:
    """Metadata of files: what made them, and of what."""
    return {"software": f"etendue {metadata.version('etendue')}", "source": source, **more}
