"""The tasks of form factors and solutions, from what is asked for in Python or on the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from etendue.core import Method, OptionError, Settings, logger
from etendue.engine import Job, Task, silent
from etendue.radiosity import GROUPINGS, SOLVERS, GroupSettings, LineCasting, PartSource, PatchSource
from etendue.surfaces import Patches, may_have_zones, zone_names

from ..registry import FACTORS, SOLUTIONS, budget_of, chosen, current, find
from ..results import FormFactorResult
from ..running import run_job
from .base import PatchProduct
from .choosing import choose
from .factors import FormFactorProduct
from .solution_files import SolutionFiles
from .solutions import BOXES, SolutionProduct

#: Methods without passes.
EXACT, RAYS, AMBIENT, AUTO = "exact", "rays", "ambient", "auto"
#: Rays of a patch; the standard error of a row is then below one over their root.
_RAYS = 4096


@dataclass(frozen=True)
class AtOnce:
    """A product that is made at once, without passes."""

    source: PatchSource
    product: PatchProduct[Any]
    #: Why workers are of no use.
    why: str = ""

    def make(self, tell: Callable[[str], object] = silent, on_patches: Callable[[Any], object] = silent) -> Any:
        """Make it and write its files. ``tell`` receives the current step, ``on_patches`` the patches beforehand."""
        return self.product.at_once(self.source, tell, on_patches)


@dataclass(kw_only=True)
class PatchRun:
    """What runs on patches have in common; see :class:`PatchSource` and :class:`PatchProduct`."""

    source: Any
    method: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    limits: Mapping[str, Any] = field(default_factory=dict)  #: by name, see :func:`budget_of`
    max_area: float | None = None
    seed: int = 0
    mesh: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] | None = None
    objects: Any = None
    checkpoint: Path | None = None
    #: By default a checkpoint is here; of lines, which take much room, only if the run ends early.
    checkpoint_beside: Path | None = None
    save_every: float | None = None
    is_watched: bool = False
    tell: Callable[[str], object] = logger.info

    def check_settings(self, function: Callable[..., Any]) -> None:
        """Raise :class:`OptionError` for settings that the method does not have, which may be misspelt arguments of
        ``function``."""
        name = current(self.method or "lines")
        if name not in (*FACTORS, *SOLUTIONS, EXACT, RAYS, AMBIENT):
            return  # the task refuses it
        known: Any = Settings if name in (EXACT, RAYS, AMBIENT) else find(name).Settings
        known.check_arguments(self.settings, f"method '{name}'", function)

    def _given(self) -> dict[str, Any]:
        """Arguments of the source."""
        names = ("source", "max_area", "mesh", "parameters", "objects")
        return {name: getattr(self, name) for name in names}

    def _common(self, method: str) -> dict[str, Any]:
        """Arguments of the product."""
        common = {name: getattr(self, name) for name in ("checkpoint", "save_every", "is_watched")}
        if self.checkpoint is None and method not in (EXACT, RAYS, AMBIENT):
            stores_lines = method in FACTORS  # also of solutions
            common["if_stopped" if stores_lines else "checkpoint"] = self.checkpoint_beside
        return common

    def _refuse_limits(self, what: str, *but: str) -> None:
        names = [name for name, value in self.limits.items() if value is not None and name not in but]
        names += ["checkpoint"] * (self.checkpoint is not None) + list(self.settings)
        if names:
            raise OptionError(f"{what}: no lines are cast, so leave out {', '.join(names)}")

    def _task(self, source: PatchSource, kind: type[Method], product: PatchProduct[Any]) -> Task:
        task = Task(source, kind, product, self.settings, self.seed, budget_of(kind, self.limits))
        product.check_files(issubclass(kind, LineCasting))
        return task


@dataclass(kw_only=True)
class FactorRun(PatchRun):
    """Form factors; see :func:`etendue.compute_form_factors`."""

    estimator: str | None = None
    walls: Any = None
    row_sums: bool = False
    reciprocal: bool = False
    threshold: float = 0.0
    groups: bool = False
    up: str | None = None
    north: float = 0.0
    sky_patches: int | None = None
    rows: tuple[str, ...] = ()
    outputs: tuple[Path, ...] = ()

    def task(self) -> Task | AtOnce:
        """Check what can be checked before the source is read. Raises :class:`OptionError` for what does not fit."""
        method = current(self.method or "lines")
        if self.rows and method != RAYS:
            raise OptionError(f"rows of some files are those of rays from their patches: give method {RAYS}")
        around = method == "spheres"
        for name in ("objects", "walls"):
            if getattr(self, name) is not None and not around:
                raise OptionError(f"{name} is for method spheres")
        if self.objects is not None and not isinstance(self.objects, str):
            self.objects = np.asarray(self.objects).tolist()  # plain, for checkpoints
        source = PatchSource(**self._given(), walls=self.walls)
        zones = self._zones(source)
        estimator = self.estimator or ("F4" if around else "F1")
        names = ("row_sums", "reciprocal", "threshold", "groups", "up", "north", "sky_patches", "outputs")
        asked = {name: getattr(self, name) for name in names}
        if len(zones) > 1:
            return self._of_zones(source, zones, FormFactorProduct(estimator=estimator, **asked))
        if method == AUTO:
            method = self._chosen(source)
        product = FormFactorProduct(
            **self._common(method), estimator=estimator, **asked, rows=self.rows, tell=self.tell
        )
        if product.up is not None and method != LineCasting.name:
            raise OptionError(f"up and sky_patches are for method {LineCasting.name}, whose lines have directions")
        if method == RAYS:
            self._refuse_limits("method rays", "error")
            if self.estimator is not None:
                raise OptionError("estimators count lines, and method rays casts none: leave it out")
            product.rays, product.seed = _rays(self.limits.get("error")), self.seed
            product.check_files(False)
            return AtOnce(source, product)
        if method == EXACT:
            self._refuse_limits("method exact", "error")
            product.tolerance = self.limits.get("error")
            product.check_files(False)
            return AtOnce(source, product)
        return self._task(source, chosen(method, (*FACTORS, EXACT, RAYS, AUTO), "form factors"), product)

    def _zones(self, source: PatchSource) -> tuple[str, ...]:
        """The zones of patches, or of a file that may have some."""
        if isinstance(source.source, Patches):
            return zone_names(source.source)
        return zone_names(source.problem.patches) if source.is_mesh and may_have_zones(Path(source.source)) else ()

    def _of_zones(self, source: PatchSource, zones: tuple[str, ...], product: FormFactorProduct) -> AtOnce:
        """A run for each zone, whose surfaces see nothing of the others."""
        if self.checkpoint is not None:
            raise OptionError(f"a checkpoint is of one zone: give zone, one of {', '.join(zones)}")
        if self.rows:
            raise OptionError("rows are those of files, and zones are apart anyway: leave out rows, or give zone")
        if self.walls or (self.objects is not None and self.objects not in GROUPINGS):
            raise OptionError(
                f"objects by an array and walls by names are those of one zone: read one of {', '.join(zones)} "
                "(--zone, zone= of read_patches)"
            )
        limits = dict(self.limits)
        if limits.get("seconds") is not None:
            limits["seconds"] /= len(zones)
        own: dict[str, Any] = {"limits": limits, "max_area": None, "mesh": {}, "tell": silent}
        own |= {"groups": False, "outputs": (), "checkpoint_beside": None}

        def of_zone(patches: Patches) -> FormFactorResult:
            task = replace(self, source=patches, **own).task()
            made = task.make() if isinstance(task, AtOnce) else run_job(lambda: Job.open(task, silent))
            return cast("FormFactorResult", made)

        product.check_files(False)
        product.of_zone = of_zone
        return AtOnce(source, product, f"zones are computed one after the other (zone is one of {', '.join(zones)})")

    def _chosen(self, source: PatchSource) -> str:
        """Integrals or lines, by what is asked for and by their time; ``tell`` gets the reason."""
        others = [name for name, value in self.limits.items() if value is not None and name != "error"]
        others += ["up"] * (self.up is not None) + ["sky_patches"] * (self.sky_patches is not None)
        others += ["checkpoint"] * (self.checkpoint is not None) + list(self.settings)
        if others:
            is_exact, why = False, f"{others[0]} is asked for"
        else:
            is_exact, why = choose(source.problem.patches, self.limits.get("error"))
        method = EXACT if is_exact else LineCasting.name
        self.tell(f"method {method}: {why}")
        return method


@dataclass(kw_only=True)
class SolutionRun(PatchRun):
    """A solution; see :func:`etendue.solve_radiosity`."""

    solver: str | None = None
    ambient: str | None = None
    bounces: int | None = None
    sub_scenes: str | None = None
    factors: Path | None = None
    groups: Mapping[str, Any] = field(default_factory=dict)
    divide: bool = False
    outputs: SolutionFiles = field(default_factory=SolutionFiles)

    def task(self) -> Task | AtOnce:
        """Check what can be checked before the source is read. Raises :class:`OptionError` for what does not fit."""
        method = current(self.method)
        if method in SOLVERS:
            raise OptionError(f"'{method}' is a solver of method lines: give solver {method}")
        if self.factors is not None:
            return self._on_factors()
        at_once = self.ambient is not None and self.bounces is None
        method = method or (AMBIENT if at_once else "lines")
        if method == AMBIENT:
            self.ambient, at_once = self.ambient or "fuzzy", True
        elif at_once:
            raise OptionError(
                f"ambient light without bounces needs no method '{method}': leave it out, or give bounces for a "
                "solution by lines that ends in an ambient term"
            )
        self._check(method, at_once)
        product = SolutionProduct(
            **self._common(method),
            solver=self.solver,
            ambient=self.ambient,
            bounces=self.bounces,
            sub_scenes=self.sub_scenes,
            divide=self.divide,
            outputs=self.outputs,
            asked=self.asked(method),
        )
        boxes = method == BOXES or self.sub_scenes == BOXES
        kind: Any = PartSource if boxes else PatchSource
        files: Any = {"size": self.outputs.size, "sensor": self.outputs.sensor}
        groups: Any = {"groups": dict(self.groups)} if boxes else {}
        source = kind(**self._given(), **files, **groups, for_light=True)
        if method == AMBIENT:
            self.outputs.check_errors(None, "lines to estimate the error; leave it out")
            product.check_files(False)
            return AtOnce(source, product)
        kind = chosen(method, (*SOLUTIONS, AMBIENT), "a solution")
        if self.limits.get(count := kind.counts) == 1:
            self.outputs.check_errors(None, f"at least two {count} to estimate the error")
        return self._task(source, kind, product)

    def _on_factors(self) -> AtOnce:
        """Solve given form factors."""
        self._check_light()
        self._refuse_limits("form factors from a file")
        asked, solves = self.asked(self.method), ("solver", "max_area", "mesh", "parameters", "seed")
        if others := [name for name in asked if name not in (*solves, "factors")]:
            raise OptionError(f"form factors are there and only a solver is needed: leave out {', '.join(others)}")
        self.outputs.check_errors(None, "lines to estimate the error; leave it out")
        product = SolutionProduct(
            **self._common(AMBIENT), solver=self.solver, factors=self.factors, outputs=self.outputs, asked=asked
        )
        product.check_files(False)
        source = PatchSource(**self._given(), size=self.outputs.size, sensor=self.outputs.sensor, for_light=True)
        return AtOnce(source, product)

    def source_of_files(self) -> PatchSource:
        """The source, if only files are to be written."""
        self._check_light()
        return PatchSource(**self._given(), size=self.outputs.size, sensor=self.outputs.sensor, for_light=True)

    def asked(self, method: str | None = None) -> dict[str, Any]:
        """What was asked for, by name, without defaults."""
        named: dict[str, Any] = {"method": None if method == "lines" else method, **self.limits}
        names = ("solver", "ambient", "bounces", "sub_scenes", "objects", "max_area", "mesh", "groups", "parameters")
        named |= {name: getattr(self, name) for name in (*names, "divide")} | dict(self.settings)
        named |= {"seed": self.seed or None, "factors": None if self.factors is None else str(self.factors)}
        plain = {name: _given(value) for name, value in named.items()}
        return {name: value for name, value in plain.items() if value not in (None, False, {})}

    def _check_light(self) -> None:
        if self.outputs.photometric and self.mesh.get("temperature") is not None:
            raise OptionError("photometric outputs are of light, and temperature makes heat: leave out one of them")

    def _check(self, method: str, at_once: bool) -> None:
        self._check_light()
        if at_once:
            self._refuse_limits("an ambient solution")
        if self.solver in SOLUTIONS:
            raise OptionError(f"'{self.solver}' is a method, not a solver: give method {self.solver}")
        if self.solver is not None and method != "lines":
            raise OptionError(f"a solver is for method lines; {method} solves by itself")
        if self.bounces is not None and method != "lines":
            raise OptionError(f"bounces is for method lines; {method} makes no iterations to be ended")
        if self.sub_scenes is not None and not at_once:
            raise OptionError("sub_scenes is for an ambient solution at once: give ambient, without bounces")
        if self.sub_scenes not in (None, BOXES, "objects"):
            self.objects, self.sub_scenes = self.sub_scenes, "objects"  # sub-scenes named by their objects
        GroupSettings.from_mapping(self.groups, owner="the grouping to boxes")
        if self.groups and BOXES not in (method, self.sub_scenes):
            raise OptionError(f"{next(iter(self.groups))} is for boxes: give method boxes, or sub_scenes boxes")
        if self.objects is not None and method != BOXES and self.sub_scenes is None:
            raise OptionError("objects is for boxes and sub-scenes: give method boxes, or sub_scenes")
        if self.divide and method != BOXES:
            raise OptionError("divide puts boxes on workers: give method boxes, too")


def _rays(error: float | None) -> int:
    """Rays of a patch, a power of two, that give its row a standard error of at most ``error``."""
    return _RAYS if error is None else max(1 << int(np.ceil(-2 * np.log2(error))), 2)


def _given(value: Any) -> Any:
    """A value, or of a mapping what is given in it."""
    if not isinstance(value, Mapping):
        return value.tolist() if isinstance(value, np.ndarray) else value
    return {name: inner for name, inner in value.items() if inner is not None and inner is not False}


def without_hierarchy(run: FactorRun | SolutionRun, hierarchy: Any) -> None:
    """Translate ``hierarchy``, the argument of version 1 for methods spheres and boxes."""
    if hierarchy is None or hierarchy is False:
        return
    run.method = "spheres" if isinstance(run, FactorRun) else BOXES
    logger.warning("hierarchy is now method %s with its settings, and goes with the next version", run.method)
    if isinstance(run, SolutionRun) and run.limits.get("bundles") is not None:
        run.limits = {**run.limits, "passes": run.limits["bundles"], "bundles": None}
    if isinstance(hierarchy, Mapping) and isinstance(run, SolutionRun):
        rest = dict(hierarchy)
        run.objects = rest.pop("objects", run.objects)
        run.groups = {**run.groups, **{name: rest.pop(name) for name in GroupSettings.names() if name in rest}}
        run.settings = {**run.settings, **rest}
    elif hierarchy is not True:
        run.objects = hierarchy
