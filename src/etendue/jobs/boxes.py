"""Solutions by hierarchical multipath as work: a scene is put into boxes, passes of lines are run, files written."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.core import InNotebooks, OptionError, SceneError, logger, prepared
from etendue.distributed import Correspondence, Rounds
from etendue.engine import Budget, Checkpoint, remaining
from etendue.radiosity import (
    DividedMultipath,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    check_absorption,
    check_divisible,
    is_balanced,
    relative_error,
    scene_part,
)

from .lines import part_recipe, unit_recipes
from .requests import RadiosityRequest
from .solving import RequestedWork

if TYPE_CHECKING:
    from etendue.core import Array, Progress, Result
    from etendue.distributed import Cluster, Recipe
    from etendue.engine import MakeExecutor, Runner, RunResult
    from etendue.radiosity import HierarchicalSolution, Lightmap, Solution
    from etendue.scene import Problem

    from .files import Writing
    from .solving import Counted

#: Passes, if no budget is given.
DEFAULT_PASSES = 16


@dataclass(frozen=True, kw_only=True)
class HierarchyRequest(RadiosityRequest):
    """A solution by hierarchical multipath. Its ``bundles`` are passes of lines. The source may also be a
    :class:`etendue.radiosity.Part`; a scene with instances becomes one, another source is grouped by its objects."""

    #: Of :class:`etendue.radiosity.HierarchicalMultipathSettings`.
    hierarchy: Mapping[str, Any] = field(default_factory=dict)
    #: With workers: each worker has some of the boxes, with their lines; otherwise each makes whole passes.
    divide: bool = False

    work: ClassVar[str] = "radiosity-hierarchy"
    is_grouping: ClassVar[bool] = True

    @property
    def settings(self) -> HierarchicalMultipathSettings:
        """Settings of the method. Raises :class:`OptionError` for unknown names, and for values out of range."""
        given = dict(self.hierarchy) if self.shot else {"shot": 0} | dict(self.hierarchy)
        for name, value in self.line_settings.items():
            if given.setdefault(name, value) != value:
                raise OptionError(f"two {name} of hierarchical multipath, '{given[name]}' and '{value}': give one")
        return HierarchicalMultipathSettings.from_mapping(given, owner="hierarchical multipath")

    @property
    def _unit(self) -> str:
        return "lines"

    @property
    def _counted(self) -> str:
        return "passes"

    @property
    def name(self) -> str:
        """See :class:`LinesRequest`."""
        return "<parts>" if isinstance(self.source, Part) else super().name

    @property
    def stores_lines(self) -> bool:
        """See :class:`LinesRequest`: only the lines of a pass are stored."""
        return False

    def _check_outputs(self) -> None:
        option = self.wording.option
        for name in ("solver", "points", "ambient", "bounces", "sub_scenes"):
            if getattr(self, name) is not None and (name, self.solver) != ("solver", "conjugate-gradient"):
                raise OptionError(
                    f"{option(name)} is not for hierarchical multipath, which solves by itself: leave it out"
                )
        if self.lines:
            raise OptionError(f"{option('lines')} is for bundles: give the lines of a pass as a setting, lines=N")
        if not self.local_rays:
            raise OptionError(f"hierarchical multipath casts no local rays: leave out {option('local_rays')}")
        super()._check_outputs()

    def _check_options(self) -> None:
        self.settings  # noqa: B018 (checked)
        if isinstance(self.source, Part):
            if self.max_area is not None or self.parameters is not None or self._is_grouped:
                raise OptionError(
                    "parts are given: leave out max_area, parameters, objects, threshold, least and levels"
                )
        else:
            super()._check_options()

    def budget(self, saved: Checkpoint | None) -> Budget:
        """See :class:`LinesRequest`."""
        if (self.seconds, self.bundles, self.error) != (None, None, None):
            passes = None if self.bundles is None else int(self.bundles)
            return Budget(self.seconds, None, passes, None if self.error is None else self.error**2)
        if saved is None:
            return Budget(iterations=DEFAULT_PASSES)
        bundles, seconds, error = map(self.wording.option, ("bundles", "seconds", "error"))
        return remaining(saved, f"{bundles}, {seconds} or {error}")

    def load_parts(self, tell: Callable[[str], object]) -> tuple[Problem | None, Patches | None, Part]:
        """The scene, ``None`` if the source is none; patches in one mesh, ``None`` for instances and given parts; and
        the root of the parts."""
        if isinstance(self.source, Part):
            return None, None, self.source
        problem = self.problem(tell)
        if problem is not None and (root := scene_part(problem, max_area=self.max_area)) is not None:
            if self._is_grouped:
                raise OptionError(f"instances of the scene are its parts: leave out {self._grouping_options()}")
            return problem, None, root
        patches = self._patches(problem)
        return problem, patches, self.boxes(patches)

    def _noted(self) -> tuple[str, ...]:
        return (*super()._noted(), "hierarchy", "divide")


@dataclass
class HierarchyResult(InNotebooks):
    """A solution by hierarchical multipath. ``parts``: the solution of every copy. ``patches``, ``solution`` and the
    standard error of its irradiance are those of one mesh; ``None`` for a scene with copies if no files were requested.
    """

    parts: HierarchicalSolution
    patches: Patches | None
    solution: Solution | None
    irradiance_error: Array | None
    passes: int
    #: What ended the run: ``seconds``, ``samples`` (passes), ``error`` or ``cancel``.
    stopped_by: str
    elapsed: float
    #: Whether the power that enters leaves again, up to errors; if not, a warning is given.
    is_balanced: bool = True
    picture: Result | None = None
    lightmap: Lightmap | None = None
    #: For boxes on workers: the messages and bytes sent to each worker.
    correspondence: Correspondence | None = None


class HierarchyWork(RequestedWork[HierarchyRequest, HierarchyResult]):
    """Passes of hierarchical multipath."""

    kept: ClassVar[str] = "passes"

    def __init__(
        self,
        request: HierarchyRequest,
        saved: Checkpoint | None = None,
        *,
        tell: Callable[[str], object] = logger.info,
    ) -> None:
        super().__init__(request, saved)
        self.problem, self.patches, root = request.load_parts(tell)
        self.parts = PartProblem(root, request.name)
        emits = any(p.patches is not None and (p.patches.emission.any() or p.patches.sky.any()) for p in root.distinct)
        if not emits:
            raise SceneError(request._without_light(self.problem))
        if self.patches is not None:
            check_absorption(self.patches)
        if request.divide:
            check_divisible(root)
        self._correspondence: Correspondence | None = None
        self.method = HierarchicalMultipath(request.settings)

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        request, saved, begin = self.request, self.saved, time.perf_counter()
        settings: Any = request.settings
        if saved is not None:
            asked = {k: v for k, v in settings.to_dict().items() if k != "lines" or v}
            settings = saved.settings_of(HierarchicalMultipath, asked, int(request.seed))
            saved.require_scene(self.parts.fingerprint)
        self.method = HierarchicalMultipath(settings)
        if request.divide and self.cluster is not None:
            self.method = DividedMultipath(settings, len(self.cluster.pool.workers()))
        elif request.divide:
            logger.info("without workers, all boxes are in this process")
        prepared(self.method, self.parts, int(request.seed))
        return self._run(self.parts, self.method, part_recipe, spent=time.perf_counter() - begin, **options)

    def _executor(
        self, cluster: Cluster, problem: Any, method: Any, recipe_of: Callable[[Any, Any], Recipe]
    ) -> MakeExecutor:
        """See :class:`RequestedWork`."""
        if not isinstance(method, DividedMultipath):
            return super()._executor(cluster, problem, method, recipe_of)
        recipes, weights = unit_recipes(method), [float(method.weight(unit)) for unit in method.units]
        self._correspondence = told = Correspondence()
        return lambda order: Rounds(cluster.pool, recipes, weights, order, method.talk, correspondence=told)

    def progress_text(self, progress: Progress) -> str:
        """See :class:`RequestedWork`."""
        return f"{progress.samples:.3g} lines"

    def _make(
        self, run: RunResult, writing: Writing, tell: Callable[[str], object], counted: Counted
    ) -> HierarchyResult:
        request, parts = self.request, self.method.solution(run.measurement)
        result = HierarchyResult(
            *(parts, self.patches, None, None, len(run.measurement.iterations), str(run.stopped_by), run.elapsed),
            is_balanced=is_balanced(parts.imbalance, relative_error(parts)),
            correspondence=self._correspondence,
        )
        if result.patches is None and request.outputs.written:
            tell("putting all copies into one mesh")
            result.patches = parts.tree.joined()
            request.outputs.check_source(result.patches, self.problem, request.wording)
        if result.patches is not None:
            is_joined = self.patches is None
            result.solution = parts.on(result.patches, is_joined)
            result.irradiance_error = parts.irradiance_on(result.patches, is_joined)[1]
            known = self._metadata(passes=result.passes, solver=self.method.name, imbalance=result.solution.imbalance)
            if (told := result.correspondence) is not None:
                known |= {
                    "workers": len(told.workers),
                    "bytes_to_workers": told.sent,
                    "bytes_from_workers": told.received,
                    "bytes_of_workers": [shared.kept for shared in told.workers.values()],
                }
            making = request.making(self.history)
            shown = request.outputs.write(
                *(writing, self.problem, result.solution, result.irradiance_error, known, request.wording, tell, making)
            )
            result.picture, result.lightmap = shown.picture, shown.lightmap
        return result

    def _how_to_resume(self, run: RunResult, checkpoint: Path) -> str:
        return self.request.wording.resume(checkpoint, "bundles", len(run.measurement.iterations))
