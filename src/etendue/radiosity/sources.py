"""Patches, and parts with copies, as sources of runs: from memory, from mesh files and from scenes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

from numpy.typing import NDArray

from etendue.core import (
    Ingredients,
    OptionError,
    SceneError,
    UnsupportedError,
    is_whole,
    logger,
    numbers_for_json,
)
from etendue.scene import Problem, emits, found, graph, load, locate, placed
from etendue.surfaces import Objects, Patches, find_objects, lamps_apart, read_patches

from .hierarchical_multipath.grouping import GroupSettings, grouped
from .hierarchical_multipath.method import PartProblem
from .hierarchical_multipath.parts import Part
from .hierarchical_multipath.reading import instanced_patches, scene_part
from .problem import PatchProblem
from .solvers.absorption import check_absorption
from .solvers.lamps import lamp_light
from .solvers.shot import FirstShot

#: Kinds of objects; any other name is that of an array of the mesh file.
GROUPINGS = ("components", "shapes", "labels")
#: Arrays of the light of lamps that workers get, and what their names begin with.
_SHOT, _LAMPS = ("emission", "irradiance", "error", "to_sky", "lost"), "lamps/"
#: Why a scene does not take arguments of meshes.
_OF_SCENES = "a scene has its own materials and lights"
_NOT_OF_SCENES = {
    "two_sided": "in a scene, materials of type 'twosided' make sheets",
    "periodic": "save the surfaces of the scene as a mesh",
}
#: Suffixes of scenes; all other files are meshes.
_SCENES = (".xml", "")


@dataclass(frozen=True, kw_only=True)
class PatchSource:
    """Patches in memory, of a mesh file, or of a scene.

    source: :class:`Patches`, the path of a mesh file, or a scene in any form that :func:`etendue.scene.load` takes. A
        model whose materials emit is a scene if ``for_light``, unless values of its faces are given by ``mesh``.
    max_area: larger faces are subdivided; the parts of one are one patch if ``mesh`` has ``ids``, except ``for_light``.
    mesh: for a mesh file, further arguments of :func:`read_patches`.
    parameters: for a scene in XML, values of its ``$variables``.
    objects, walls: what makes an object, see :func:`find_objects`: a kind, an array, or the name of an array of the
        mesh file with the number of an object for each face, negative for walls; ``None`` for the shapes of scenes,
        else connected surfaces.
    size, sensor: of pictures of a scene.
    for_light: whether light is to be transported: a source without light is refused, and one that absorbs none.

    Raises :class:`OptionError` for arguments that another kind of source has.
    """

    source: Any
    max_area: float | None = None
    mesh: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] | None = None
    objects: Any = None
    walls: Sequence[str | int] | None = None
    size: tuple[int, int] | None = None
    sensor: int = 0
    for_light: bool = False

    #: What a solution without light should be given, for messages.
    _LIGHT: ClassVar[str] = "give it emission, a temperature or a sky (options of its mesh, or of read_patches)"

    def __post_init__(self) -> None:
        mesh = {name: value for name, value in self.mesh.items() if value is not None and value is not False}
        parameters = {name: str(value) for name, value in (self.parameters or {}).items()} or None
        object.__setattr__(self, "mesh", mesh)
        object.__setattr__(self, "parameters", parameters)
        if not is_whole(self.sensor) or self.sensor < 0:
            raise OptionError(f"a sensor is a whole number of at least 0, not {self.sensor!r}")
        if isinstance(self.source, (Patches, Part)):
            for name in ("max_area", "parameters"):
                if getattr(self, name) is not None:
                    raise OptionError(f"{name} is for scenes and mesh files, not for patches; leave it out")
        elif self.is_mesh:
            if parameters:
                raise OptionError("parameters are for scenes in XML; a mesh file has none")
        else:
            for name in mesh:
                raise OptionError(f"{name} is for mesh files; {_NOT_OF_SCENES.get(name, _OF_SCENES)}")
        if isinstance(self.objects, str) and self.objects not in GROUPINGS:
            if not self.is_mesh:
                known = ", ".join(GROUPINGS)
                raise OptionError(
                    f"objects are found by {known}, or by an array of a mesh file, not by '{self.objects}'"
                )
            object.__setattr__(self, "mesh", mesh | {"objects": self.objects})

    @property
    def is_mesh(self) -> bool:
        """Whether the source is a mesh file."""
        if not isinstance(self.source, (str, os.PathLike)):
            return False
        path = Path(self.source)
        if path.suffix.lower() in _SCENES or path.is_dir():
            return False
        return not self.for_light or bool(self.mesh) or not emits(path)

    @property
    def name(self) -> str:
        """The source, for messages."""
        if isinstance(self.source, (Patches, Part)):
            return "<patches>" if isinstance(self.source, Patches) else "<parts>"
        return str(self.source) if isinstance(self.source, (str, os.PathLike)) else "<scene>"

    def open(self, tell: Callable[[str], object] = logger.info) -> PatchProblem:
        """Read the patches, unless that is done. Raises :class:`SceneError` for a source without light, if light is to
        be transported, and the errors of reading."""
        return self.__dict__["problem"] if "problem" in self.__dict__ else self._read(tell)

    @cached_property
    def problem(self) -> PatchProblem:
        """What is read, for a choice before the run."""
        return self._read(lambda _: None)

    def _read(self, tell: Callable[[str], object]) -> PatchProblem:
        scene = self.scene(tell)
        return self._checked(self.patches(scene), scene)

    def scene(self, tell: Callable[[str], object] = logger.info) -> Problem | None:
        """The scene; ``None`` if the source is not a scene."""
        if isinstance(self.source, (Patches, Part)) or self.is_mesh:
            return None
        scene = locate(self.source, tell) if isinstance(self.source, (str, os.PathLike)) else self.source
        options: Any = {"sensor": self.sensor or None}  # a scene without a camera has patches, too
        if self.for_light:
            options["size"] = self.size
        return load(scene, parameters=self.parameters, **options)

    def patches(self, scene: Problem | None) -> Patches:
        """The patches of the source, or of ``scene`` if the source is a scene."""
        if isinstance(self.source, Patches):
            return self.source
        if scene is not None:
            return instanced_patches(scene, max_area=self.max_area, lamps_apart=True)
        patches = read_patches(self.source, **self.mesh)
        if self.max_area is None:
            return patches
        return patches.subdivided(self.max_area, grouped=not self.for_light and "ids" in self.mesh)

    def _checked(self, patches: Patches, scene: Problem | None) -> PatchProblem:
        lamps = None
        if self.for_light:
            lamps = None if scene is None else lamp_light(scene, patches)
            is_lit = lamps is not None and lamps.irradiance.any()
            if not (is_lit or patches.emission.any() or patches.sky.any()):
                raise SceneError(self._dark(scene))
            check_absorption(patches)
        return PatchProblem(patches, self.name if scene is None else scene.source, scene, lamps)

    def _dark(self, scene: Problem | None) -> str:
        how = "give it an emitter" if scene is not None else self._LIGHT
        return f"'{self.name}' has no light for radiosity; {how}"

    def objects_of(self, patches: Patches) -> Objects:
        """The objects of the patches of this source."""
        by, walls = self.objects, self.walls
        if by is None:
            by = "components" if patches.shapes is None or self.is_mesh else "shapes"
        elif isinstance(by, str) and by not in GROUPINGS:  # read_patches has made shapes of the array, and marked walls
            by, walls = "shapes", () if walls is None else walls
        return find_objects(patches, by, walls=walls)

    def place(self) -> dict[str, Any]:
        """Plain values for :meth:`at`, without the place of what is in memory."""
        place: dict[str, Any] = {}
        for known in fields(self):
            value = getattr(self, known.name)
            if known.name != "source" and value is not None and value != {} and value is not False:
                place[known.name] = value
        if self.is_mesh:
            place["source"] = str(Path(self.source).absolute())
        elif not isinstance(self.source, (Patches, Part)):
            place |= placed(self.source)
        plain: dict[str, Any] = json.loads(json.dumps(place, default=numbers_for_json))
        return plain

    @classmethod
    def at(cls, place: Mapping[str, Any], source: Any = None) -> Self:
        """The source of a checkpoint; ``source``: its new place. Raises :class:`CheckpointError` for one in memory."""
        known = {name: value for name, value in place.items() if name not in ("source", "bundled")}
        if known.get("size") is not None:
            known["size"] = tuple(known["size"])
        return cls(source=found(place) if source is None else source, **known)

    def ingredients(self, problem: PatchProblem) -> Ingredients:
        """What a worker makes the problem from."""
        arrays = problem.patches.arrays()
        if (lamps := problem.lamps) is not None:
            arrays |= {_LAMPS + name: getattr(lamps, name) for name in _SHOT}
        return Ingredients(f"{__name__}:open_patches", {}, arrays)


@dataclass(frozen=True, kw_only=True)
class PartSource(PatchSource):
    """A scene of parts with copies: a :class:`Part`, a scene with instances, or the patches of another source, grouped
    by their objects; see :func:`grouped` for the ``groups``."""

    groups: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._settings  # noqa: B018 (checked)
        if isinstance(self.source, Part) and self._is_grouped:
            raise OptionError("parts are given: leave out objects, threshold, least and levels")

    @property
    def _is_grouped(self) -> bool:
        return self.objects is not None or bool(self.groups)

    @property
    def _settings(self) -> GroupSettings:
        return GroupSettings.from_mapping(self.groups, owner="the grouping to boxes")

    def open(self, tell: Callable[[str], object] = logger.info) -> PartProblem:  # type: ignore[override]
        """Read the parts. Errors as :meth:`PatchSource.open`."""
        if isinstance(self.source, Part):
            return self._lit(PartProblem(self.source, self.name))
        scene = self.scene(tell)
        if scene is not None and (others := lamps_apart(scene.scene)):
            raise UnsupportedError(
                f"method 'boxes' has no light of {graph.describe(others[0], 'emitter')}, which has no surface; use "
                "method lines or multipath"
            )
        if scene is not None and (root := scene_part(scene, max_area=self.max_area)) is not None:
            if self._is_grouped:
                raise OptionError(
                    "instances of the scene are its parts: leave out objects, threshold, least and levels"
                )
            return self._lit(PartProblem(root, scene.source, scene=scene))
        problem = self._checked(self.patches(scene), scene)
        return PartProblem(self.boxes(problem.patches), problem.source, problem.patches, scene)

    def boxes(self, patches: Patches) -> Part:
        """The patches as a scene of boxes."""
        return grouped(patches, self.objects_of(patches).of_patch, **self._settings.to_dict())

    def _lit(self, problem: PartProblem) -> PartProblem:
        if not any(p.patches is not None and (p.patches.emission.any() or p.patches.sky.any()) for p in problem.parts):
            raise SceneError(self._dark(problem.scene))
        return problem

    def ingredients(self, problem: PartProblem) -> Ingredients:  # type: ignore[override]
        """See :class:`PatchSource`."""
        return part_ingredients(problem)


def part_ingredients(problem: PartProblem) -> Ingredients:
    """What a worker makes a problem of parts from."""
    parts = problem.parts
    number = {id(part): k for k, part in enumerate(parts)}
    arrays: dict[str, NDArray[Any]] = {}
    rows = []
    for k, part in enumerate(parts):
        if part.patches is not None:
            arrays |= {f"{k}/{name}": array for name, array in part.patches.arrays().items()}
        arrays[f"{k}:numbers"] = part.numbers
        for c, copy in enumerate(part.copies):
            arrays[f"{k}:copies{c}"] = copy.transforms
        copies = [number[id(copy.part)] for copy in part.copies]
        rows.append({"has_patches": part.patches is not None, "objects": part.objects, "copies": copies})
    return Ingredients(f"{__name__}:open_parts", {"parts": rows}, arrays)


def open_patches(ingredients: Ingredients, folder: Path) -> PatchProblem:
    """The problem of :meth:`PatchSource.ingredients` in a worker."""
    patches = Patches.of_arrays({k: v for k, v in ingredients.arrays.items() if not k.startswith(_LAMPS)})
    lamps = {name: ingredients.arrays[_LAMPS + name] for name in _SHOT if _LAMPS + name in ingredients.arrays}
    return PatchProblem(patches, lamps=FirstShot(patches, rays=0, **lamps) if lamps else None)


def open_parts(ingredients: Ingredients, folder: Path) -> PartProblem:
    """The problem of :func:`part_ingredients` in a worker."""
    arrays = ingredients.arrays
    parts: list[Part] = []
    for k, row in enumerate(ingredients.values["parts"]):
        own = {name.removeprefix(f"{k}/"): array for name, array in arrays.items() if name.startswith(f"{k}/")}
        copies = [(parts[inner], arrays[f"{k}:copies{c}"]) for c, inner in enumerate(row["copies"])]
        patches = Patches.of_arrays(own) if row["has_patches"] else None
        parts.append(Part(patches, copies, numbers=arrays[f"{k}:numbers"], objects=row["objects"]))
    return PartProblem(parts[-1])
