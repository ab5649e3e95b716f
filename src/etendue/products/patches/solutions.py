"""Solutions of radiosity: by stored lines and a solver, by multipath, by boxes, by given form factors, or by an
ambient term alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from etendue.core import OptionError, Settings, is_whole, logger, prepared, suggest
from etendue.distributed import Correspondence, Rounds, recipe
from etendue.engine import Budget, Job, MakeExecutor, Replicated, RunResult, Task, silent
from etendue.radiosity import (
    AMBIENT_TERMS,
    SOLVERS,
    DividedMultipath,
    LineCasting,
    MultipathPasses,
    PartProblem,
    PartSource,
    Patches,
    PatchProblem,
    PatchSource,
    RadiosityError,
    SubScene,
    ambient_solution,
    check_balance,
    check_direct,
    check_divisible,
    entry_bytes,
    factors_of_patches,
    form_factors,
    is_balanced,
    part_ingredients,
    relative_error,
    solve,
    sub_scenes,
    sub_scenes_of,
)

from ..files import Writing, about
from ..results import RadiosityResult
from .base import PatchProduct
from .page import Making
from .solution_files import SolutionFiles

if TYPE_CHECKING:
    from etendue.distributed import Cluster
    from etendue.radiosity import Solution
    from etendue.scene import Problem

#: Sub-scenes that are boxes around groups of objects.
BOXES = "boxes"
#: Solvers that work on segments; the others need the matrix.
_ON_SEGMENTS = ("jacobi", "conjugate-gradient")
#: Points of a pass of multipath, and the smallest number of passes of a budget in points, for an estimate of the error.
_POINTS_PER_PASS, _PASSES = 1 << 16, 16
#: Rays of the first shot of multipath, at most as many as lines; for a budget in error, rays to begin with.
_SHOT_RAYS, _LEAST_SHOT_RAYS = 1 << 20, 1 << 16
#: Largest number of rays of the first shot for a budget in error, and the largest share of that error due to it.
_MOST_SHOT_RAYS, _SHOT_SHARE = 1 << 27, 0.5
#: Share of missed segments from which a warning is given.
_MISSED = 2e-3


@dataclass(kw_only=True)
class SolutionProduct(PatchProduct[RadiosityResult]):
    """A solution and its files.

    solver: for method ``lines``; by default conjugate-gradient, or jacobi with ``bounces``, whose iterations are
        bounces.
    ambient, bounces: an ambient term for all light, without lines; or for the light that is left after so many
        iterations.
    sub_scenes: with an ambient term for all light, whether light stays for longer in parts of the scene: the objects of
        the source, or ``boxes`` around groups of them.
    factors: a file of the form factors of all patches, which are solved; no lines are cast.
    divide: with method ``boxes`` and workers, each worker has some of the boxes, with their lines; otherwise each makes
        whole passes.
    """

    kind: ClassVar[str] = "solution"
    goal: ClassVar[Literal["rows", "irradiance"]] = "irradiance"

    solver: str | None = None
    ambient: str | None = None
    bounces: int | None = None
    sub_scenes: str | None = None
    factors: Path | None = None
    divide: bool = False
    outputs: SolutionFiles = field(default_factory=SolutionFiles)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._correspondence: Correspondence | None = None
        self.is_watched |= bool(self.outputs.pages)  # for the plot of convergence
        if self.solver is not None and self.solver not in SOLVERS:
            raise OptionError(f"there is no solver '{self.solver}'; {suggest(self.solver, SOLVERS)}")
        if self.ambient is not None and self.ambient not in AMBIENT_TERMS:
            raise OptionError(f"there is no ambient term '{self.ambient}'; {suggest(self.ambient, AMBIENT_TERMS)}")
        if self.bounces is not None:
            if not is_whole(self.bounces) or self.bounces < 1:
                raise OptionError(f"bounces is a whole number of at least 1, not {self.bounces!r}")
            if self.ambient is None:
                raise OptionError("bounces leaves light over: say by ambient how to spread it")
            if self.solver == "conjugate-gradient" and self.bounces > 1:
                logger.warning(
                    "an iteration of conjugate-gradient is no bounce, and after two an ambient term gains nothing: "
                    "leave out the solver for jacobi, whose iterations are bounces"
                )
        self.outputs.check()

    @property
    def chosen_solver(self) -> str:
        """The requested solver, or the default."""
        return self.solver or ("conjugate-gradient" if self.bounces is None else "jacobi")

    @property
    def files(self) -> Any:
        """See :class:`Product`."""
        return self.outputs.written

    @property
    def entry_bytes(self) -> float:
        """See :class:`PatchProduct`."""
        return 0.0 if self.chosen_solver in _ON_SEGMENTS else entry_bytes("F1")

    def notes(self) -> dict[str, Any]:
        """See :class:`Product`."""
        known = {name: getattr(self, name) for name in ("solver", "ambient", "bounces", "divide", "asked")}
        return {"product": {"kind": self.kind, **known, "outputs": self.outputs.to_dict()}}

    # ------------------------------------------------------------------ the run

    def check(self, problem: PatchProblem | PartProblem) -> None:
        """See :class:`Product`."""
        if isinstance(problem, PartProblem) and self.divide:
            check_divisible(problem.root)
        if problem.patches is not None:
            if self.solver == "direct":
                check_direct(len(problem.patches))
            self.outputs.check_source(problem.patches, problem.scene)

    def settings(self, task: Task, problem: Any, budget: Budget) -> Settings:
        """See :class:`PatchProduct`. Passes and first shot of multipath suit the budget."""
        if not issubclass(task.method, MultipathPasses):
            return super().settings(task, problem, budget)
        points = budget.samples
        in_pass = _POINTS_PER_PASS if points is None else min(_POINTS_PER_PASS, -(-points // _PASSES))
        rays = _LEAST_SHOT_RAYS if budget.error is not None else min(points or _SHOT_RAYS, _SHOT_RAYS)
        chosen: Settings = task.method.Settings.from_mapping(
            {"points_per_pass": in_pass, "shot": float(rays), **task.settings}
        )
        return chosen

    def prepared(self, job: Job) -> None:
        """See :class:`PatchProduct`. A first shot of multipath is repeated with more rays until its error is small
        beside the requested one; the shot of a checkpoint or of the settings is as it is."""
        super().prepared(job)
        while isinstance(job.method, MultipathPasses) and job.budget.error is not None:
            known: Any = job.method.settings
            shot, wanted = job.method.shot, math.sqrt(job.budget.error)
            share = 0.0 if shot is None else shot.relative_error
            is_given = job.start is not None or "shot" in job.task.settings
            if share <= (1.0 if is_given else _SHOT_SHARE) * wanted:
                return
            rays = float(known.shot)
            if is_given or rays >= _MOST_SHOT_RAYS:
                raise RadiosityError(
                    f"the first shot, of {rays:.0f} rays, has a standard error of {share:.2g}: ask for an error above "
                    f"{share / _SHOT_SHARE:.2g}, or begin again with another shot, or with none (shot=0)"
                )
            more = min(2 * (share / (_SHOT_SHARE * wanted)) ** 2, 64.0) * rays
            settings = known.replace(shot=float(min(more, _MOST_SHOT_RAYS)))
            job.method = prepared(MultipathPasses(settings), job.problem, job.seed)

    def divided(self, job: Job, cluster: Cluster) -> MakeExecutor:
        """See :class:`Product`: with ``divide``, the workers have the boxes."""
        if not self.divide:
            return super().divided(job, cluster)
        method: Any = job.method
        divided = DividedMultipath(method.settings, len(cluster.pool.workers()))
        divided.prepare(job.problem, job.seed)
        job.method = divided
        recipes = [
            recipe(part_ingredients(u.problem), divided, u.problem.fingerprint, divided.arguments(u), divided.inside)
            for u in divided.units
        ]
        weights = [float(divided.weight(unit)) for unit in divided.units]
        self._correspondence = told = Correspondence()
        return lambda order: Rounds(cluster.pool, recipes, weights, order, divided.talk, correspondence=told)

    # ------------------------------------------------------------------ the end

    def _make(self, job: Job, run: RunResult, writing: Writing, tell: Callable[[str], object]) -> RadiosityResult:
        method = job.method.method if isinstance(job.method, Replicated) else job.method
        if isinstance(method, LineCasting):
            result, known = self._by_lines(job, run, tell)
        elif isinstance(method, MultipathPasses):
            result, known = self._by_multipath(method, run, tell)
        else:
            result, known = self._by_boxes(method, job, run, tell)
        if result.solution is not None:
            known = self._metadata(job, **known, imbalance=result.solution.imbalance, settings=self.asked)
            unit = "bundles" if isinstance(method, LineCasting) else "lines"
            self._write(writing, job.problem.scene, result, known, tell, Making(self.asked, self.history, unit))
        return result

    def _by_lines(
        self, job: Job, run: RunResult, tell: Callable[[str], object]
    ) -> tuple[RadiosityResult, dict[str, Any]]:
        method, patches, solver = job.method, job.problem.patches, self.chosen_solver
        assert isinstance(method, LineCasting)
        bundles, segments = self._counted(job, run, tell)
        tell("solving")
        shot = method.shot(run.measurement)
        transport = segments if solver in _ON_SEGMENTS else form_factors(segments)
        rest: Any = {} if self.bounces is None else {"max_iterations": self.bounces, "ambient": self.ambient}
        solution = solve(patches, transport, solver, shot=shot, **rest)  # type: ignore[arg-type]
        error = solution.irradiance_error(segments) if segments.batch_count > 1 else None
        result = self._result(run, patches, solution, error, bundles=bundles, segments=segments, shot=shot)
        return result, {"bundles": bundles, "solver": solver}

    def _by_multipath(
        self, method: MultipathPasses, run: RunResult, tell: Callable[[str], object]
    ) -> tuple[RadiosityResult, dict[str, Any]]:
        tell("solving")
        missed = method.missed(run.measurement)
        if missed > _MISSED and missed**2 * run.samples > 9:  # noise is at most 1 / sqrt(samples)
            logger.warning(
                "lines missed %.1f %% of the surface, and the solution has an error of this size: faces lie on each "
                "other; separate them, or take another method",
                100 * missed,
            )
        solution, error = method.solved(run.measurement), method.irradiance_error(run.measurement)
        result = self._result(run, method.patches, solution, error, points=run.samples, shot=method.shot)
        return result, {"points": run.samples, "solver": method.name, "unshot": solution.residual}

    def _by_boxes(
        self, method: Any, job: Job, run: RunResult, tell: Callable[[str], object]
    ) -> tuple[RadiosityResult, dict[str, Any]]:
        parts, patches = method.solution(run.measurement), job.problem.patches
        is_joined = patches is None and bool(self.outputs.written)
        if is_joined:
            tell("putting all copies into one mesh")
            patches = parts.tree.joined()
            self.outputs.check_source(patches, job.problem.scene)
        result = RadiosityResult(
            patches=patches,
            solution=None if patches is None else parts.on(patches, is_joined),
            irradiance_error=None if patches is None else parts.irradiance_on(patches, is_joined)[1],
            stopped_by=str(run.stopped_by),
            elapsed=run.elapsed,
            is_balanced=is_balanced(parts.imbalance, relative_error(parts)),
            passes=run.passes,
            parts=parts,
            correspondence=self._correspondence,
        )
        known: dict[str, Any] = {"passes": run.passes, "solver": method.name}
        if (told := self._correspondence) is not None:
            known |= {"workers": len(told.workers), "bytes_to_workers": told.sent}
            known |= {"bytes_from_workers": told.received}
            known |= {"bytes_of_workers": [shared.kept for shared in told.workers.values()]}
        return result, known

    def _result(self, run: RunResult, patches: Any, solution: Solution, error: Any, **more: Any) -> RadiosityResult:
        return RadiosityResult(
            patches=patches,
            solution=solution,
            irradiance_error=error,
            stopped_by=str(run.stopped_by),
            elapsed=run.elapsed,
            is_balanced=check_balance(solution, error),
            **more,
        )

    def _write(
        self,
        writing: Writing,
        scene: Problem | None,
        result: RadiosityResult,
        known: Mapping[str, Any],
        tell: Callable[[str], object],
        making: Making,
    ) -> None:
        assert result.solution is not None
        shown = self.outputs.write(writing, scene, result.solution, result.irradiance_error, known, tell, making)
        result.picture, result.lightmap = shown.picture, shown.lightmap

    # ------------------------------------------------------------------ without lines

    def at_once(
        self, source: PatchSource, tell: Callable[[str], object] = silent, on_patches: Callable[[Any], object] = silent
    ) -> RadiosityResult:
        """A solution without lines."""
        problem = PatchSource.open(source, tell)
        if problem.lamps is not None:
            raise OptionError("without lines there is no light of lamps without a surface; use method lines")
        self.check(problem)
        on_patches(problem.patches)
        parts = self._parts(source, problem)
        begin = time.perf_counter()
        if self.factors is None:
            assert self.ambient is not None
            solution = ambient_solution(problem.patches, self.ambient, parts)  # type: ignore[arg-type]
            known: dict[str, Any] = {"solver": f"ambient, {self.ambient}"}
        else:
            tell("solving")
            solution = self._by_factors(self.factors, problem.patches)
            known = {"solver": self.chosen_solver, "factors": str(self.factors)}
        result = RadiosityResult(
            patches=problem.patches,
            solution=solution,
            stopped_by="ambient" if self.factors is None else "factors",
            elapsed=time.perf_counter() - begin,
            is_balanced=check_balance(solution, None),
        )
        known |= {"imbalance": solution.imbalance, "settings": self.asked}
        writing = Writing()
        self._write(writing, problem.scene, result, about(problem.source, **known), tell, Making(self.asked))
        writing.finish()
        return result

    def _by_factors(self, path: Path, patches: Patches) -> Solution:
        factors = factors_of_patches(path, patches)
        if self.solver is None and factors.exchange_weights is None:
            self.solver = "gauss-seidel"  # conjugate-gradient is for reciprocal factors
        return solve(patches, factors, self.chosen_solver)  # type: ignore[arg-type]

    def _parts(self, source: PatchSource, problem: PatchProblem) -> SubScene | None:
        if self.sub_scenes is None:
            return None
        if self.sub_scenes != BOXES:
            return sub_scenes(problem.patches, source.objects_of(problem.patches).of_patch)
        assert isinstance(source, PartSource)
        scene = sub_scenes_of(source.boxes(problem.patches))
        if not scene.parts:
            logger.warning("no object or group is worth a box: light spreads in the whole scene at once")
        return scene
