"""Multipath as work: power exchanged along single lines until a budget is used up, and the solution written."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import CheckpointError, format_count, logger, prepared
from etendue.radiosity import MultipathPasses, MultipathSettings, PatchProblem, RadiosityError, check_balance

from .lines import patch_recipe
from .requests import RadiosityRequest
from .results import RadiosityResult
from .solving import PatchWork, Tell

if TYPE_CHECKING:
    from etendue.core import Progress
    from etendue.engine import Checkpoint, Runner, RunResult
    from etendue.radiosity import FirstShot

    from .files import Writing
    from .solving import Counted

#: Points of a pass, and the smallest number of passes of a budget in points, so that the error can be estimated.
_POINTS_PER_PASS, _PASSES = 1 << 16, 16
#: Rays of the first shot, at most as many as lines.
_SHOT_RAYS = 1 << 20
#: For a budget in error: rays to begin with, and the largest number.
_LEAST_SHOT_RAYS, _MOST_SHOT_RAYS = 1 << 16, 1 << 27
#: Share of missed segments from which a warning is given.
_MISSED = 2e-3
#: Largest share of the requested error that may come from the first shot.
_SHOT_SHARE = 0.5


class MultipathWork(PatchWork[RadiosityRequest, RadiosityResult]):
    """A solution by multipath; see :class:`Work`."""

    def __init__(
        self,
        request: RadiosityRequest,
        saved: Checkpoint | None = None,
        *,
        is_watched: bool = False,
        tell: Tell = logger.info,
    ) -> None:
        super().__init__(request, saved, tell)
        self.method = MultipathPasses(self._settings())
        self._watched = is_watched or request.is_watched

    def runner(self, **options: Any) -> Runner:
        """Prepare the method; ``options`` are those of :class:`Runner`.

        Raises :class:`CheckpointError` for a checkpoint of another method, of other patches or options, or with more
        points than requested; :class:`RadiosityError` if the first shot cannot reach the requested error.
        """
        request, saved = self.request, self.saved
        problem, seed = PatchProblem(self.patches, request.name), int(request.seed)
        begin = time.perf_counter()
        if saved is not None:
            self.method = self._of_checkpoint(saved, problem.fingerprint)
        prepared(self.method, problem, seed)
        if saved is None:
            self._refine_shot(problem, seed)
        else:
            self._check_shot()
        options |= {"watched": self._watched, "spent": time.perf_counter() - begin}
        return self._run(problem, self.method, patch_recipe, **options)

    def progress_text(self, progress: Progress) -> str:
        """See :class:`RequestedWork`."""
        return f"{format_count(progress.samples, 'line')}, {progress.rays:.3g} segments"

    def _make(self, run: RunResult, writing: Writing, tell: Tell, counted: Counted) -> RadiosityResult:
        tell("solving")
        missed = self.method.missed(run.measurement)
        if missed > _MISSED and missed**2 * run.samples > 9:  # noise is at most 1 / sqrt(samples)
            logger.warning(
                "lines missed %.1f %% of the surface, and the solution has an error of this size: faces lie on each "
                "other; separate them, or take another solver",
                100 * missed,
            )
        solution, error = self.method.solved(run.measurement), self.method.irradiance_error(run.measurement)
        unshot = solution.residual
        known = self._metadata(
            points=run.samples, solver=self.request.chosen_solver, imbalance=solution.imbalance, unshot=unshot
        )
        request = self.request
        making = request.making(self.history)
        shown = request.outputs.write(writing, self.problem, solution, error, known, request.wording, tell, making)
        return RadiosityResult(
            patches=self.patches,
            stopped_by=run.stopped_by,
            elapsed=run.elapsed,
            solution=solution,
            irradiance_error=error,
            is_balanced=check_balance(solution, error),
            points=run.samples,
            shot=self.method.shot,
            picture=shown.picture,
            lightmap=shown.lightmap,
        )

    def _how_to_resume(self, run: RunResult, checkpoint: Path) -> str:
        return self.request.wording.resume(checkpoint, "points", run.samples)

    def _settings(self) -> MultipathSettings:
        points = self.budget.samples
        in_pass = _POINTS_PER_PASS if points is None else min(_POINTS_PER_PASS, -(-points // _PASSES))
        rays = _LEAST_SHOT_RAYS if self.request.error is not None else min(points or _SHOT_RAYS, _SHOT_RAYS)
        return MultipathSettings(
            points_per_pass=in_pass, shot_rays=float(rays) if self.request.shot else 0.0, **self.request.line_settings
        )

    def _of_checkpoint(self, saved: Checkpoint, fingerprint: str) -> MultipathPasses:
        """The method with the settings of a checkpoint."""
        settings: Any = saved.settings_of(MultipathPasses, self.request.line_settings, int(self.request.seed))
        if (settings.shot_rays > 0) != self.request.shot:
            begun = settings.shot_rays > 0
            raise CheckpointError(f"the checkpoint was begun with shot={begun}, not shot={self.request.shot}")
        saved.require_scene(fingerprint)
        done, wanted = len(saved.measurement.iterations) * settings.points_per_pass, self.budget.samples
        if wanted is not None and wanted <= done - settings.points_per_pass:
            raise CheckpointError(f"the checkpoint has {done} points, more than {wanted}")
        return MultipathPasses(settings)

    def _check_shot(self) -> None:
        """Raise :class:`CheckpointError` if the error of the checkpoint's shot is above the requested one."""
        wanted, shot = self.request.error, self.method.shot
        if wanted is None or shot is None:
            return
        share = self._share_of_shot(shot)
        if share >= wanted:
            raise CheckpointError(
                f"the first shot of the checkpoint has a standard error of {share:.2g} already: ask for an "
                f"{self.request.wording.option('error')} above it, or begin again with the lower one"
            )

    def _share_of_shot(self, shot: FirstShot) -> float:
        """Standard error of the shot's irradiance, mean over the surface, relative to the mean irradiance."""
        areas = self.patches.areas[:, None]
        return float((areas * shot.error).sum() / max((areas * shot.irradiance).sum(), 1e-300))

    def _refine_shot(self, problem: PatchProblem, seed: int) -> None:
        """Repeat the first shot with more rays until its error is small beside the requested one."""
        wanted = self.request.error
        while wanted is not None and (shot := self.method.shot) is not None:
            share = self._share_of_shot(shot)
            if share <= _SHOT_SHARE * wanted:
                return
            settings: Any = self.method.settings
            if settings.shot_rays >= _MOST_SHOT_RAYS:
                option = self.request.wording.option
                raise RadiosityError(
                    f"a first shot of {int(settings.shot_rays)} rays has a standard error of {share:.2g}: ask for an "
                    f"{option('error')} above {share / _SHOT_SHARE:.2g}, or leave out the shot ({option('shot')})"
                )
            more = min(2 * (share / (_SHOT_SHARE * wanted)) ** 2, 64.0) * settings.shot_rays
            self.method = MultipathPasses(settings.replace(shot_rays=float(min(more, _MOST_SHOT_RAYS))))
            prepared(self.method, problem, seed)
