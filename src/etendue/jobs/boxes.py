"""Solutions by hierarchical multipath as work: a scene is put into boxes, passes of lines are run, files written."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.core import EtendueError, OptionError, OutputError, SceneError, describe, is_number, is_whole, logger
from etendue.engine import Budget, Checkpoint, Job, Runner, RunResult, remaining
from etendue.radiosity import (
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    part_of,
    scene_part,
)

from .files import Writing, add_to_message, rescued
from .requests import RadiosityRequest
from .solving import about

if TYPE_CHECKING:
    from etendue.core import Array, Result
    from etendue.radiosity import HierarchicalSolution, Lightmap, Solution
    from etendue.scene import Problem

#: Passes, if no budget is given.
DEFAULT_PASSES = 16


@dataclass(frozen=True, kw_only=True)
class HierarchyRequest(RadiosityRequest):
    """A solution by hierarchical multipath. Its ``bundles`` are passes of lines. The source may also be a
    :class:`etendue.radiosity.Part`; a scene with instances becomes one, another source is grouped by its objects."""

    #: What makes an object, see :func:`etendue.radiosity.find_objects`; by default shapes of scenes, components else.
    objects: str | None = None
    #: Of :func:`etendue.radiosity.grouped`, such as the threshold.
    groups: Mapping[str, Any] = field(default_factory=dict)
    #: Of :class:`etendue.radiosity.HierarchicalMultipathSettings`.
    hierarchy: Mapping[str, Any] = field(default_factory=dict)

    work: ClassVar[str] = "radiosity-hierarchy"

    @property
    def settings(self) -> HierarchicalMultipathSettings:
        """Of the method. Raises :class:`OptionError` for unknown ones, and values out of range."""
        given = dict(self.hierarchy) if self.shot else {"shot": 0} | dict(self.hierarchy)
        return HierarchicalMultipathSettings.from_mapping(given, owner="hierarchical multipath")

    @property
    def name(self) -> str:
        """See :class:`LinesRequest`."""
        return "<parts>" if isinstance(self.source, Part) else super().name

    @property
    def stores_lines(self) -> bool:
        """See :class:`LinesRequest`: only those of a pass."""
        return False

    def _check_outputs(self) -> None:
        option = self.wording.option
        for name in ("points", "ambient", "bounces"):
            if getattr(self, name) is not None:
                raise OptionError(f"{option(name)} is not for hierarchical multipath; leave it out")
        if self.solver != "conjugate-gradient" or self.lines:
            raise OptionError("hierarchical multipath solves by itself: leave out the solver and lines of bundles")
        if not self.local_rays:
            raise OptionError(f"hierarchical multipath casts no local rays: leave out {option('local_rays')}")
        super()._check_outputs()

    def _check_options(self) -> None:
        self.settings  # noqa: B018 (checked)
        if not (self.objects is None or isinstance(self.objects, str)):
            raise OptionError("objects are named by components, shapes or labels; give numbers of patches to part_of")
        if unknown := set(self.groups) - {"threshold", "least", "levels"}:
            raise OptionError(f"groups have a threshold, least and levels, no {', '.join(sorted(unknown))}")
        for name, value in self.groups.items():
            is_right = is_number(value) if name == "threshold" else is_whole(value)
            if not (is_right and (value > 0 if name == "threshold" else value >= 1)):
                what = "number above 0" if name == "threshold" else "whole number of at least 1"
                raise OptionError(f"{name} is a {what}, not {value!r}")
        if isinstance(self.source, Part):
            if self.max_area is not None or self.parameters is not None or self._is_grouped:
                raise OptionError(
                    "parts are given: leave out max_area, parameters, objects, threshold, least and levels"
                )
        else:
            super()._check_options()

    @property
    def _is_grouped(self) -> bool:
        """Whether options of the grouping of objects are given."""
        return self.objects is not None or bool(self.groups)

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
        """The scene, if it is one; patches in one mesh, ``None`` where copies have none; and the parts."""
        if isinstance(self.source, Part):
            return None, None, self.source
        problem = self.problem(tell)
        if problem is not None and (root := scene_part(problem, max_area=self.max_area)) is not None:
            if self._is_grouped:
                raise OptionError(
                    "instances of the scene are its parts: leave out objects, threshold, least and levels"
                )
            return problem, None, root
        patches = self._patches(problem)
        by = self.objects or ("components" if problem is None or patches.shapes is None else "shapes")
        return problem, patches, part_of(patches, by, **self.groups)

    def _noted(self) -> tuple[str, ...]:
        return (*super()._noted(), "objects", "groups", "hierarchy")


@dataclass
class HierarchyResult:
    """A solution by hierarchical multipath. ``parts``: of every copy. ``patches`` and ``solution`` in one mesh, and the
    standard error of its irradiance; ``None`` for a scene with copies, unless files of it were asked for."""

    parts: HierarchicalSolution
    patches: Patches | None
    solution: Solution | None
    irradiance_error: Array | None
    passes: int
    #: What ended the run: ``seconds``, ``samples`` (passes), ``error`` or ``cancel``.
    stopped_by: str
    elapsed: float
    picture: Result | None = None
    lightmap: Lightmap | None = None


class HierarchyWork:
    """A request whose source has been read, and passes that work on it; see :class:`Work`."""

    def __init__(
        self,
        request: HierarchyRequest,
        saved: Checkpoint | None = None,
        *,
        is_watched: bool = False,
        tell: Callable[[str], object] = logger.info,
    ) -> None:
        self.request, self._saved = request, saved
        self._budget = request.budget(saved)
        self.problem, self.patches, root = request.load_parts(tell)
        self.parts = PartProblem(root, request.name)
        emits = any(p.patches is not None and (p.patches.emission.any() or p.patches.sky.any()) for p in root.distinct)
        if not emits:
            raise SceneError(request._without_light(self.problem))
        self.method = HierarchicalMultipath(request.settings)
        self._job: Job | None = None

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        request, saved, begin = self.request, self._saved, time.perf_counter()
        earlier = 0.0
        if saved is not None:
            asked = {k: v for k, v in request.settings.to_dict().items() if k != "lines" or v}
            settings: Any = saved.settings_of(HierarchicalMultipath, asked, int(request.seed))
            saved.require_scene(self.parts.fingerprint)
            self.method = HierarchicalMultipath(settings)
            earlier = saved.earlier + saved.elapsed
            options |= {"start": saved.measurement, "state": saved.state}
        self.method.prepare(self.parts, int(request.seed))
        notes = request.notes() or ({} if saved is None else saved.notes)
        known: Any = {
            "seed": int(request.seed),
            "budget": self._budget,
            "place": {},
            "earlier": earlier,
            "notes": notes,
        }
        self._job = Job(self.parts, self.method, **known)  # type: ignore[arg-type]
        if (path := request.checkpoint) is not None and request.save_every is not None:
            options |= {"on_save": lambda run: self._save(run, path), "save_every": request.save_every}
        spent = time.perf_counter() - begin
        return Runner(self.method, seed=int(request.seed), budget=self._budget, spent=spent, **options)

    def keep(self, run: RunResult) -> None:
        """Write the checkpoint, if one is asked for."""
        if self.request.checkpoint is not None:
            self._save(run, self.request.checkpoint)

    def finish(self, run: RunResult, tell: Callable[[str], object] = lambda _: None) -> HierarchyResult:
        """Write the checkpoint and the files. If something fails, the error says where the passes are kept."""
        request, writing = self.request, Writing()
        kept: Path | None = None
        try:
            if (path := request.checkpoint) is not None:
                with writing.attempt(f"write '{path}'"):
                    self._save(run, path)
                    kept = path
            parts = self.method.solution(run.measurement)
            result = HierarchyResult(
                parts, self.patches, None, None, len(run.measurement.iterations), str(run.stopped_by), run.elapsed
            )
            if result.patches is None and request.outputs.written:
                tell("putting all copies into one mesh")
                result.patches = parts.tree.joined()
                request.outputs.check_source(result.patches, self.problem, request.wording)
            if result.patches is not None:
                is_joined = self.patches is None
                result.solution = parts.on(result.patches, is_joined)
                result.irradiance_error = parts.irradiance_on(result.patches, is_joined)[1]
                known = about(request.name, passes=result.passes, seed=request.seed, solver=self.method.name)
                shown = request.outputs.write(
                    *(writing, self.problem, result.solution, result.irradiance_error, known, request.wording, tell)
                )
                result.picture, result.lightmap = shown.picture, shown.lightmap
            writing.finish()
        except Exception as problem:
            known_error = problem if isinstance(problem, EtendueError) else None
            error = known_error or OutputError(f"the passes could not be evaluated: {describe(problem)}")
            if kept is None:
                kept = rescued("passes.checkpoint", ("", lambda place: self._save(run, place)))
            if kept is not None:
                how = request.wording.resume(kept, "bundles", len(run.measurement.iterations))
                add_to_message(error, f"; the passes are kept: {how}")
            raise error from (problem.__cause__ if known_error else problem)
        return result

    def _save(self, run: RunResult, path: Path) -> None:
        assert self._job is not None, "there is no run before there is a runner"
        self._job.checkpoint(run).write(path)


class Passes:
    """The passes of some work alone: files are written in the main thread, where Ctrl-C ends it."""

    def __init__(self, work: HierarchyWork) -> None:
        self.work = work

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        return self.work.runner(**options)

    def keep(self, run: RunResult) -> None:
        """See :class:`Work`."""
        self.work.keep(run)

    def finish(self, run: RunResult) -> RunResult:
        """Save: if that fails, :meth:`HierarchyWork.finish` tries again and says so."""
        with suppress(EtendueError, OSError):
            self.work.keep(run)
        return run
