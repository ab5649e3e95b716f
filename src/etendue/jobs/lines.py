"""Lines cast through patches until a budget is used up, for form factors or for a solution."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from etendue.engine import Budget, Checkpoint, Job, Runner, RunResult
from etendue.radiosity import (
    REPLICATES,
    CastingSettings,
    CastLines,
    LineCasting,
    Patches,
    PatchProblem,
    RadiosityError,
)

from .files import rescued

#: Share of the memory that is filled where no number of bundles was asked for.
_MEMORY_SHARE = 0.6


@dataclass(frozen=True)
class LinesTask:
    """What lines are cast for. A sample of the budget is a bundle, and its error the *square* of a standard error: see
    :class:`LineCasting`."""

    patches: Patches
    goal: Literal["rows", "irradiance"]  #: errors of the rows of form factors, or of the irradiance
    budget: Budget
    source: str = "<patches>"
    seed: int = 0
    lines: float = 0.0
    shot: bool = True
    local_rays: bool = True
    #: Whether an error ends the run, now or when it was begun, so that lines are to tell it.
    to_error: bool = False
    #: Whether errors are estimated on the way where the budget does not ask for it.
    is_watched: bool = False
    #: Whether form factors will be made of the segments, which takes memory.
    needs_matrix: bool = False
    #: What the caller wants to find in checkpoints: plain values.
    notes: Mapping[str, Any] = field(default_factory=dict)
    #: How a message calls the number of bundles.
    bundles_option: str = "bundles="


class LinesJob:
    """A task, and the casting that works on it, from where the checkpoint ``saved`` ended."""

    def __init__(self, task: LinesTask, saved: Checkpoint | None = None) -> None:
        self.task, self._saved = task, saved
        self._job: Job | None = None
        estimated = task.is_watched or task.budget.error is not None
        self.casting = LineCasting(
            CastingSettings(
                lines=task.lines,
                shot=task.shot,
                local_rays=task.local_rays,
                replicates=REPLICATES if task.to_error else 1,
            ),
            goal=task.goal if estimated else None,
        )

    def runner(self, **options: Any) -> Runner:
        """Prepare the casting; ``options`` are those of :class:`Runner`. Raises :class:`RadiosityError` if memory does
        not hold the bundles that are asked for, :class:`CheckpointError` if the checkpoint is of other patches."""
        task, saved, casting = self.task, self._saved, self.casting
        problem = PatchProblem(task.patches, task.source)
        begin = time.perf_counter()
        if saved is not None:
            asked = casting.settings.to_dict()
            del asked["bundles_per_pass"]  # as it was, also on a machine that would choose otherwise
            settings = saved.settings_of(LineCasting, asked, task.seed)
            saved.require_scene(problem.fingerprint)
            casting = self.casting = LineCasting(settings, goal=casting.goal)  # type: ignore[arg-type]
        casting.prepare(problem, task.seed)
        casting.most, limited = self._limited(0 if saved is None else casting.bundles(saved.measurement))
        earlier = 0.0
        if saved is not None:
            casting.go_on(saved.measurement)
            earlier = saved.earlier + saved.elapsed
            options |= {"start": saved.measurement, "state": saved.state}
        known: Any = {"seed": task.seed, "budget": task.budget, "place": {}, "earlier": earlier, "notes": task.notes}
        self._job = Job(problem, casting, **known)  # type: ignore[arg-type]
        return Runner(casting, seed=task.seed, budget=limited, spent=time.perf_counter() - begin, **options)

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """All that is needed to go on with ``run`` later."""
        assert self._job is not None, "there is no run before there is a runner"
        return self._job.checkpoint(run)

    def cast(self, run: RunResult) -> CastLines:
        """Cast no more: the lines of ``run``."""
        self.casting.close()
        return CastLines(self.casting, run.measurement)

    def rescued(self, run: RunResult) -> Path | None:
        """A checkpoint among the temporary files, for lines of which nothing could be made; ``None`` if not even that
        can be written."""
        return rescued("lines.checkpoint", ("", lambda path: self.checkpoint(run).write(path)))

    def is_full(self, run: RunResult) -> bool:
        """Whether memory ended the run, not the budget."""
        return self.task.budget.samples is None and run.stopped_by == "samples"

    def _limited(self, before: int) -> tuple[int, Budget]:
        """Bundles to end at, ``before`` of which there are, and a budget that says so."""
        budget, casting = self.task.budget, self.casting
        fits = before + casting.memory(self.task.needs_matrix)
        most = budget.samples or before + int(_MEMORY_SHARE * casting.memory(self.task.needs_matrix))
        if most > fits or most < 1:
            raise RadiosityError(
                f"{most} bundles of lines through {len(casting.patches)} patches do not fit into memory, {fits} do: "
                f"ask for fewer ({self.task.bundles_option}), or make patches larger"
            )
        return most, Budget(budget.seconds, most, None, budget.error)
