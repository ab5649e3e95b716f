"""Options of form factors by lines in a hierarchy of spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import OptionError
from etendue.radiosity import HierarchicalCastingSettings, find_objects

if TYPE_CHECKING:
    from etendue.radiosity import Objects, Patches

    from .wording import Wording

#: What makes an object; any other name is an array of the mesh file.
GROUPINGS = ("components", "shapes", "labels")
#: Options that need ``hierarchy``.
HIERARCHY_OPTIONS = ("walls", "engine", "point_set", "main_share")


@dataclass(frozen=True, kw_only=True)
class HierarchyOptions:
    """A part of :class:`FormFactorRequest`."""

    #: Cast lines in a hierarchy of spheres: what makes objects, see :func:`etendue.radiosity.find_objects`. Any other
    #: name is that of an array of the mesh file, with the number of an object for each face, negative for walls.
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
        if not self.names_an_array:
            return find_objects(patches, self.hierarchy, walls=self.walls)
        # The array says itself what walls are.
        return find_objects(patches, "shapes", walls=() if self.walls is None else self.walls)

    def _check_hierarchy(self, wording: Wording, is_mesh: bool) -> None:
        """Raise :class:`OptionError` for options that do not fit."""
        if self.hierarchy is None:
            for name in HIERARCHY_OPTIONS:
                if getattr(self, name) is not None:
                    option, needed = wording.option(name), wording.option("hierarchy")
                    raise OptionError(f"{option} is for lines in a hierarchy: give {needed}, too")
            return
        HierarchicalCastingSettings.from_mapping(self.hierarchy_settings, owner="a hierarchy")
        if not isinstance(self.hierarchy, str):
            object.__setattr__(self, "hierarchy", np.asarray(self.hierarchy).tolist())  # plain, for checkpoints
        elif self.names_an_array and not is_mesh:
            raise OptionError(f"objects are found by {', '.join(GROUPINGS)} or an array, not by '{self.hierarchy}'")
