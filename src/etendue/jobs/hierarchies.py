"""Options of form factors by lines in a hierarchy of spheres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import OptionError
from etendue.radiosity import GroupSettings, HierarchicalCastingSettings, find_objects

if TYPE_CHECKING:
    from etendue.radiosity import Objects, Patches

    from .wording import Wording

#: Kinds of objects; any other name is that of an array of the mesh file.
GROUPINGS = ("components", "shapes", "labels")
#: Options that need ``hierarchy``.
HIERARCHY_OPTIONS = ("walls", "engine", "point_set", "main_share")


@dataclass(frozen=True, kw_only=True)
class HierarchyOptions:
    """A part of :class:`FormFactorRequest`."""

    #: Cast lines in a hierarchy of spheres: the kind of objects, see :func:`etendue.radiosity.find_objects`, or
    #: ``True`` for shapes of scenes and components of other patches. Any other name is that of an array of the mesh
    #: file, with the number of an object for each face, negative for walls.
    hierarchy: Any = None
    walls: tuple[str, ...] | None = None
    engine: str | None = None
    point_set: str | None = None
    main_share: float | None = None

    @property
    def names_an_array(self) -> bool:
        """Whether ``hierarchy`` is the name of an array of the mesh file."""
        return isinstance(self.hierarchy, str) and self.hierarchy not in GROUPINGS

    @property
    def hierarchy_settings(self) -> dict[str, Any]:
        """The requested values of :class:`etendue.radiosity.HierarchicalCastingSettings`."""
        given = {"engine": self.engine, "points": self.point_set, "main_share": self.main_share}
        return {name: value for name, value in given.items() if value is not None}

    def objects(self, patches: Patches) -> Objects | None:
        """The objects of the hierarchy, ``None`` without one."""
        if self.hierarchy is None:
            return None
        return objects_by(patches, None if self.hierarchy is True else self.hierarchy, self.walls)

    def _check_hierarchy(self, wording: Wording, is_mesh: bool) -> None:
        """Raise :class:`OptionError` for options that do not fit, and convert ``hierarchy`` to plain values."""
        if self.hierarchy is False:
            object.__setattr__(self, "hierarchy", None)
        if self.hierarchy is None:
            for name in HIERARCHY_OPTIONS:
                if getattr(self, name) is not None:
                    option, needed = wording.option(name), wording.option("hierarchy")
                    raise OptionError(f"{option} is for lines in a hierarchy: give {needed}, too")
            return
        HierarchicalCastingSettings.from_mapping(self.hierarchy_settings, owner="a hierarchy")
        if self.names_an_array:
            check_array(self.hierarchy, is_mesh)
        elif not isinstance(self.hierarchy, (str, bool)):
            object.__setattr__(self, "hierarchy", np.asarray(self.hierarchy).tolist())  # plain, for checkpoints


def objects_by(patches: Patches, by: Any = None, walls: Sequence[str | int] | None = None) -> Objects:
    """Objects of patches, see :func:`etendue.radiosity.find_objects`: by one of :data:`GROUPINGS`, by an array, or by
    the name of an array with which the patches were read, which also marks the walls; by default the shapes of scenes,
    else connected surfaces."""
    if by is None:
        by = "components" if patches.shapes is None else "shapes"
    elif isinstance(by, str) and by not in GROUPINGS:
        by, walls = "shapes", () if walls is None else walls
    return find_objects(patches, by, walls=walls)


def check_array(name: str, is_mesh: bool) -> None:
    """Raise :class:`OptionError` for a name outside :data:`GROUPINGS` if there is no mesh file that may have such an
    array."""
    if not is_mesh:
        raise OptionError(
            f"objects are found by {', '.join(GROUPINGS)}, or by an array of a mesh file, not by '{name}'"
        )


def split_settings(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of boxes by name: the fields ``objects`` and ``groups`` of a request, and the settings of hierarchical
    multipath."""
    rest = dict(given)
    fields: dict[str, Any] = {"objects": rest.pop("objects", None)}
    fields["groups"] = {name: rest.pop(name) for name in GroupSettings.names() if name in rest}
    return fields, rest
