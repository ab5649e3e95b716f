"""Methods whose camera paths may end in a map of irradiance on the surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, setting
from etendue.scene import Problem
from etendue.surfaces import SurfaceMap, read_map
from etendue.transport import CameraPath, EndingGuidedWalk, EndingWalker, GuidedWalk, MapEnd, Walker, light_of_map

from .base import CameraSettings, ImageMethod, W, total

#: The walks that end in a map, for those that do not.
_ENDING: dict[type[Walker], type[Walker]] = {Walker: EndingWalker, GuidedWalk: EndingGuidedWalk}
#: Largest share of the paths that may end where a map has no surface, before it is of another scene.
_UNMAPPED = 0.5


@dataclass(frozen=True)
class EndingSettings(CameraSettings):
    """Settings of methods that may end in a map."""

    map: str = setting(
        "",
        "file of a map of irradiance on the surfaces (etendue particles map, or a radiosity solution) in which paths "
        "end; biased as the map is; empty: none",
    )
    map_after: int = setting(
        0,
        "with map: surface points of a path before it ends at the next diffuse one; 0: the map as the camera sees it, "
        "1: final gather from the map",
        minimum=0,
    )


class EndsInMap(ImageMethod):
    """Base of methods with :class:`EndingSettings`."""

    settings: Any
    #: The map; set it before :meth:`prepare` to use one that is in no file.
    map: SurfaceMap | None = None

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. Reads the map."""
        super().prepare(problem, seed)
        name = getattr(self.settings, "map", "")
        if name:
            self.map = read_map(name, problem)
        elif self.map is not None and self.map.space != problem.space:
            raise OptionError("the map was made for this scene in other coordinates: make it with the loaded scene")
        self._after = dr.opaque(mi.UInt32, getattr(self.settings, "map_after", 0))

    def walker(self, kind: type[W], **own: Any) -> W:
        """See :class:`ImageMethod`; of paths that end in the map."""
        if self.map is None or kind not in _ENDING:
            return super().walker(kind, **own)
        walker: Any = super().walker(_ENDING[kind], after=self._after, **own)
        return walker

    def ending_state(self) -> dict[str, MapEnd]:
        """What the state of a path has in addition."""
        return {} if self.map is None else {"end": MapEnd.none()}

    def light_of_map(self, path: CameraPath) -> mi.Color3f | None:
        """Light of the map at the ends of paths, whose loop is evaluated first; None without a map.

        Raises :class:`OptionError` if the map has no surface at most ends.
        """
        end = path.end
        if self.map is None or end is None:
            return None
        dr.eval(path)
        light, unmapped = light_of_map(self.map, end)
        dr.eval(light, unmapped, end.reached)
        if total(unmapped) > _UNMAPPED * total(end.reached):
            raise OptionError(
                f"the map ({self.map.kind}) has no surface where {total(unmapped):.0f} of {total(end.reached):.0f} "
                "paths end: it is of another scene, or not of these surfaces"
            )
        return light
