"""Requests for form factors and solutions. Their constructors check all that can be checked before files are read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

from etendue.core import (
    CheckpointError,
    OptionError,
    SceneError,
    describe,
    is_whole,
    logger,
    suggest,
)
from etendue.engine import Checkpoint
from etendue.radiosity import (
    AMBIENT_TERMS,
    ESTIMATORS,
    FORM_FACTOR_FILES,
    LINE_POINTS,
    SINGLE_LINES,
    SOLVERS,
    GroupSettings,
    Part,
    Patches,
    SubScene,
    check_absorption,
    check_direct,
    check_file,
    check_text_size,
    entry_bytes,
    grouped,
    sub_scenes,
    sub_scenes_of,
)
from etendue.scene import Problem, emits

from .files import PathLike, listed
from .hierarchies import GROUPINGS, HIERARCHY_OPTIONS, HierarchyOptions, check_array, objects_by
from .linesrequest import NOTE, LinesRequest
from .pages.solution import Making
from .results import DEFAULT_POINTS
from .solutions import SolutionOutputs

#: The solver that needs neither stored segments nor a matrix.
MULTIPATH = "multipath"
#: Sub-scenes that are boxes around groups of objects.
BOXES = "boxes"
#: Solvers that work on segments; the others, except multipath, need the matrix.
ON_SEGMENTS = ("jacobi", "conjugate-gradient")


@dataclass(frozen=True, kw_only=True)
class FormFactorRequest(HierarchyOptions, LinesRequest):
    """Form factors of patches."""

    #: ``None`` for F1, or F4 with a hierarchy.
    estimator: str | None = None
    outputs: tuple[Path, ...] = ()

    work: ClassVar[str] = "form-factors"

    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """See :class:`LinesRequest`."""
        return self._loaded(tell)

    @property
    def keeps_groups(self) -> bool:
        """See :class:`LinesRequest`: form factors are those of the groups that an array of the mesh file numbers."""
        return self.mesh.get("ids") is not None

    @property
    def chosen_estimator(self) -> str:
        """The requested estimator, or the default."""
        return self.estimator or ("F1" if self.hierarchy is None else "F4")

    def _check_options(self) -> None:
        super()._check_options()
        self._check_hierarchy(self.wording, self.is_mesh)
        if self.names_an_array:
            object.__setattr__(self, "mesh", {**self.mesh, "objects": self.hierarchy})

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`LinesRequest`."""
        return self.outputs

    @property
    def entry_bytes(self) -> float:
        """See :class:`LinesRequest`."""
        return entry_bytes(self.chosen_estimator)

    def _check_outputs(self) -> None:
        _check_name("estimator", self.chosen_estimator, ESTIMATORS)
        for path in self.outputs:
            check_file(path, FORM_FACTOR_FILES)

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`."""
        for path in self.outputs:
            if path.suffix.lower() == ".vf":
                check_text_size(path, len(patches), 0)

    def _noted(self) -> tuple[str, ...]:
        own = ("estimator", "hierarchy", *HIERARCHY_OPTIONS)
        return (*super()._noted(), *(name for name in own if getattr(self, name) is not None))

    def _noted_outputs(self) -> dict[str, Any]:
        return {"parameters": self._plain_parameters, "outputs": [str(path.absolute()) for path in self.outputs]}


@dataclass(frozen=True, kw_only=True)
class RadiosityRequest(LinesRequest):
    """A solution, and the files made from it. ``points`` limits multipath as ``bundles`` limits other solvers."""

    #: ``None`` for conjugate-gradient, or jacobi with ``bounces``: one of its iterations is a bounce.
    solver: str | None = None
    points: int | None = None
    shot: bool = True  #: send the light of small emitters by local rays first
    #: What draws the lines of multipath, and how a line is made of a point; ``None`` for the default.
    point_set: str | None = None
    generator: str | None = None
    #: Ambient term for all light, without lines; or for the light left after ``bounces`` iterations.
    ambient: str | None = None
    bounces: int | None = None
    #: With an ambient term for all light: parts of the scene in which light stays for longer: a kind of objects (see
    #: :func:`etendue.radiosity.find_objects`), or ``"boxes"`` around groups of objects.
    sub_scenes: str | None = None
    #: For the grouping to boxes: the kind of objects, by default shapes of scenes, else components; and options of
    #: :func:`etendue.radiosity.grouped`, such as the threshold.
    objects: str | None = None
    groups: Mapping[str, Any] = field(default_factory=dict)
    outputs: SolutionOutputs = field(default_factory=SolutionOutputs)

    work: ClassVar[str] = "radiosity"
    #: Whether the work groups objects to boxes in any case.
    is_grouping: ClassVar[bool] = False

    @property
    def is_mesh(self) -> bool:
        """See :class:`LinesRequest`. A model whose materials emit is a scene, unless values of its faces are given."""
        if not super().is_mesh:
            return False
        return any(value not in (None, False) for value in self.mesh.values()) or not emits(Path(str(self.source)))

    @property
    def is_watched(self) -> bool:
        """See :class:`LinesRequest`: for the convergence plot of a page."""
        return bool(self.outputs.pages)

    def making(self, history: Sequence[tuple[float, float]] = ()) -> Making:
        """The facts of a page about the run; ``history``: standard errors by number of lines or bundles."""
        return Making(_listed(self.asked), history, self._unit)

    @property
    def asked(self) -> dict[str, Any]:
        """The fields without the source and the outputs that differ from their defaults."""
        return {
            field.name: value
            for field in fields(self)
            if field.name not in _NOT_SETTINGS and (value := getattr(self, field.name)) != _default(field)
        }

    @property
    def _unit(self) -> str:
        """What the progress of a run counts."""
        return "lines" if self.chosen_solver == MULTIPATH else "bundles"

    @property
    def _counted(self) -> str:
        """What a budget counts of which the standard error needs two."""
        return self._samples()[0]

    @property
    def chosen_solver(self) -> str:
        """The requested solver, or the default."""
        return self.solver or ("conjugate-gradient" if self.bounces is None else "jacobi")

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`LinesRequest`."""
        return self.outputs.written

    @property
    def needs_matrix(self) -> bool:
        """Whether form factors are computed for the solver."""
        return self.chosen_solver not in (*ON_SEGMENTS, MULTIPATH)

    @property
    def entry_bytes(self) -> float:
        """See :class:`LinesRequest`."""
        return entry_bytes("F1") if self.needs_matrix else 0.0

    @property
    def stores_lines(self) -> bool:
        """See :class:`LinesRequest`."""
        return self.solver != MULTIPATH

    def _check_numbers(self) -> None:
        super()._check_numbers()
        self._check_count("points", self.points)

    def _samples(self) -> tuple[str, int | None, int]:
        return ("points", self.points, DEFAULT_POINTS) if self.solver == MULTIPATH else super()._samples()

    def _check_outputs(self) -> None:
        _check_name("solver", self.chosen_solver, (*SOLVERS, MULTIPATH))
        self._check_ambient()
        self._check_groups()
        self._check_limits()
        self._check_lines()
        self.outputs.check(self.wording)
        if 1 in (self.bundles, self.points):
            self.outputs.check_errors(None, self.wording, f"at least two {self._counted} to estimate the error")

    def _check_limits(self) -> None:
        """Refuse options that the solver does not have."""
        option = self.wording.option
        if self.solver != MULTIPATH:
            if self.points is not None:
                raise OptionError(
                    f"{option('points')} is for multipath; limit {self.chosen_solver} by {option('bundles')}"
                )
            return
        if self.bundles is not None:
            raise OptionError(f"multipath casts single lines, not bundles: give {option('points')}")
        if self.lines:
            raise OptionError(f"multipath casts single lines: leave out {option('lines')}, the lines of a bundle")
        if not self.local_rays:
            raise OptionError(f"multipath casts no local rays: leave out {option('local_rays')}")

    @property
    def line_settings(self) -> dict[str, str]:
        """The requested ``points`` and ``generator`` of the settings of multipath."""
        asked = {"points": self.point_set, "generator": self.generator}
        return {name: value for name, value in asked.items() if value is not None}

    def _check_lines(self) -> None:
        """Refuse line settings that do not exist, or that the solver does not have."""
        for name, known in (("point_set", LINE_POINTS), ("generator", SINGLE_LINES)):
            if (value := getattr(self, name)) is None:
                continue
            if self._unit != "lines":
                hierarchy, solver = map(self.wording.option, ("hierarchy", "solver"))
                raise OptionError(
                    f"{self.wording.option(name)} is for multipath: give {solver} multipath, or {hierarchy}"
                )
            _check_name(name.replace("_", " "), value, tuple(known))

    @property
    def is_instant(self) -> bool:
        """Whether all light is ambient, so that no lines are cast."""
        return self.ambient is not None and self.bounces is None

    def _check_ambient(self) -> None:
        option = self.wording.option
        if self.solver == MULTIPATH and (self.ambient, self.bounces) != (None, None):
            given = option("bounces" if self.ambient is None else "ambient")
            raise OptionError(f"multipath makes no iterations and leaves little light: leave out {given}")
        if self.bounces is not None:
            if not is_whole(self.bounces) or self.bounces < 1:
                raise OptionError(f"{option('bounces')} is a whole number of at least 1, not {self.bounces!r}")
            if self.ambient is None:
                raise OptionError(f"{option('bounces')} leaves light over: say by {option('ambient')} how to spread it")
            if self.solver == "conjugate-gradient" and self.bounces > 1:
                logger.warning(
                    "an iteration of conjugate-gradient is no bounce, and after two an ambient term gains nothing: "
                    "leave out %s for jacobi, whose iterations are bounces",
                    option("solver"),
                )
        if self.ambient is not None:
            _check_name("ambient term", self.ambient, AMBIENT_TERMS)
        if not self.is_instant:
            return
        asked: dict[str, Any] = {
            name: getattr(self, name) for name in ("seconds", "bundles", "points", "error", "checkpoint")
        }
        asked |= {name: None if getattr(self, name) else False for name in ("shot", "local_rays")}
        asked["lines"] = self.lines or None
        asked["solver"] = None if self.solver == "conjugate-gradient" else self.solver
        for name in (name for name, value in asked.items() if value is not None):
            raise OptionError(
                f"an ambient solution needs no lines: leave out {option(name)}, or give {option('bounces')} for a "
                "solution by lines that ends in an ambient term"
            )
        self.outputs.check_errors(None, self.wording, "lines to estimate the error; leave it out")

    @property
    def _is_grouped(self) -> bool:
        """Whether options of the grouping to boxes are given."""
        return self.objects is not None or bool(self.groups)

    def _grouping_options(self) -> str:
        """The given options of the grouping, for messages."""
        given = [] if self.objects is None else [f"what makes objects ('{self.objects}')"]
        return ", ".join([*given, *map(self.wording.option, self.groups)])

    def _check_groups(self) -> None:
        """Raise :class:`OptionError` for sub-scenes and groups that are impossible."""
        option = self.wording.option
        if self.sub_scenes is not None and not self.is_instant:
            raise OptionError(
                f"{option('sub_scenes')} is for an ambient solution at once: give {option('ambient')}, without "
                f"{option('bounces')}"
            )
        if self._is_grouped and not (self.is_grouping or self.sub_scenes == BOXES):
            raise OptionError(
                f"{option('objects' if self.objects else next(iter(self.groups)))} is for boxes around groups of "
                f"objects: give {option('hierarchy')}, or {option('sub_scenes')} boxes"
            )
        for name in ("objects", "sub_scenes"):
            if (value := getattr(self, name)) is not None and not isinstance(value, str):
                raise OptionError(f"{option(name)} is a name, not {value!r}; give numbers of patches to part_of")
        self._group_settings  # noqa: B018 (checked)

    @property
    def _group_settings(self) -> GroupSettings:
        return GroupSettings.from_mapping(self.groups, owner="the grouping to boxes")

    def _check_options(self) -> None:
        super()._check_options()
        by = self.objects if self.sub_scenes in (None, BOXES) else self.sub_scenes
        if by is not None and by not in GROUPINGS:
            check_array(by, self.is_mesh)
            object.__setattr__(self, "mesh", {**self.mesh, "objects": by})

    def boxes(self, patches: Patches) -> Part:
        """The patches as a scene of boxes."""
        return grouped(patches, objects_by(patches, self.objects).of_patch, **self._group_settings.to_dict())

    def scene_in_parts(self, patches: Patches) -> SubScene | None:
        """Sub-scenes of an ambient solution; ``None`` if there are none."""
        if self.sub_scenes is None:
            return None
        if self.sub_scenes == BOXES:
            scene = sub_scenes_of(self.boxes(patches))
            if not scene.parts:
                logger.warning("no object or group is worth a box: light spreads in the whole scene at once")
            return scene
        return sub_scenes(patches, objects_by(patches, self.sub_scenes).of_patch)

    def check_patches(self, patches: Patches, problem: Problem | None) -> None:
        """See :class:`LinesRequest`; raises an error if there is no light, and if nothing absorbs it."""
        if not (patches.emission.any() or patches.sky.any()):
            raise SceneError(self._without_light(problem))
        check_absorption(patches)
        if self.solver == "direct":
            check_direct(len(patches))
        self.outputs.check_source(patches, problem, self.wording)

    def problem(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """See :class:`LinesRequest`; loaded with the sensor and the size of the pictures."""
        return self._loaded(tell, size=self.outputs.size, sensor=self.outputs.sensor)

    def _without_light(self, problem: Problem | None) -> str:
        if problem is not None:
            return f"'{self.name}' has no light for radiosity; give it an emitter of type 'area' or 'constant'"
        how = self.wording.mesh_light if self.is_mesh else "give them emission or a sky"
        return f"'{self.name}' has no light; {how}"

    def _noted(self) -> tuple[str, ...]:
        return (
            *super()._noted(),
            "solver",
            "shot",
            "point_set",
            "generator",
            "ambient",
            "bounces",
            "objects",
            "groups",
        )

    def _noted_outputs(self) -> dict[str, Any]:
        return {"parameters": self._plain_parameters, "outputs": self.outputs.to_dict()}


#: Fields of a request that are no settings.
_NOT_SETTINGS = ("source", "outputs", "checkpoint", "save_every", "wording")


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _listed(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with the entries of mappings at the same level, without those that are ``None`` or ``False``."""
    flat: dict[str, Any] = {}
    for name, value in settings.items():
        flat |= value if isinstance(value, Mapping) else {name: value}
    return {name: value for name, value in flat.items() if value is not None and value is not False}


def asked_before(
    saved: Checkpoint,
    *,
    source: Any = None,
    output: PathLike | Sequence[PathLike] = (),
    kinds: Sequence[type[LinesRequest]] = (),
    **changes: Any,
) -> LinesRequest:
    """The request of a checkpoint of lines, with another ``source`` and ``output`` files if they are given.

    Raises :class:`CheckpointError` if the checkpoint has no request, and the errors of a request.
    """
    known_kinds: dict[str, Any] = {kind.work: kind for kind in kinds or (FormFactorRequest, RadiosityRequest)}
    try:
        known = dict(saved.notes[NOTE])
        kind, outputs = known_kinds[known.pop("work")], listed(output)
        if kind is FormFactorRequest:
            known["outputs"] = tuple(outputs or map(Path, known["outputs"]))
        else:
            before = SolutionOutputs.from_dict(known["outputs"])
            known["outputs"] = before.renamed(outputs) if outputs else before
        if source is not None:
            known["source"] = source
        return kind(**known, **changes)
    except (KeyError, TypeError) as error:
        raise CheckpointError(
            f"the checkpoint does not contain its request ({describe(error)}); cast the lines again"
        ) from None


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise OptionError(f"there is no {what} '{name}'; {suggest(name, known)}")
