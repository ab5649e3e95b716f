"""Methods whose camera paths may end in a map of irradiance on the surfaces."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from etendue.core import CheckpointError, OptionError, State, UnsupportedError, logger, setting
from etendue.scene import Problem
from etendue.transport import CameraPath, EndingGuidedWalk, EndingWalker, GuidedWalk, MapEnd, Walker, light_of_map

from .base import CameraSettings, ImageMethod, W, total

if TYPE_CHECKING:
    from etendue.surfaces import SurfaceMap

#: For each walk, its variant that ends in a map.
_ENDING: dict[type[Walker], type[Walker]] = {Walker: EndingWalker, GuidedWalk: EndingGuidedWalk}
#: Name of the digest in states.
_DIGEST = "map"
#: Shares of the paths that end where a map has no surface: above the first, the map is of another scene; above the
#: second, there is a warning. Rounding at edges, and curved surfaces that are flat in the map, cause small shares.
_UNMAPPED, _FEW = 0.5, 0.01


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
        "with map: scatterings of a path before it ends at the next diffuse surface, not counting mirrors, glass and "
        "null surfaces; 0: the map as the camera sees it, 1: final gather from the map",
        minimum=0,
    )
    map_glossy: bool = setting(
        False,
        "with a map of the nearest particles (knn), whose directions it has: paths end at glossy surfaces, too; blurs "
        "their reflections; false: paths go on there",
    )


class EndsInMap(ImageMethod):
    """Base of methods with :class:`EndingSettings`."""

    settings: Any
    #: The map; set it before :meth:`prepare` to use a map without a file.
    map: SurfaceMap | None = None
    #: Digest of the file of the map; "" without a file.
    _digest = ""
    _warned = False

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. Reads the map."""
        super().prepare(problem, seed)
        name = getattr(self.settings, "map", "")
        if (name or self.map is not None) and self.visibility.media is not None:
            raise UnsupportedError("paths cannot end in a map in a scene with participating media; leave out map")
        if name:
            from etendue.surfaces import read_map

            self.map = read_map(name, problem)
            with open(name, "rb") as file:
                self._digest = hashlib.file_digest(file, "sha256").hexdigest()
        elif self.map is not None and self.map.space != problem.space:
            raise OptionError("the map was made for this scene in other coordinates: make it with the loaded scene")
        after = getattr(self.settings, "map_after", 0)
        if self.settings.components and self.map is not None and after == 0:
            raise OptionError(
                "a map does not tell direct light from other light; set map_after=1 or more, or leave out components"
            )
        self._by_directions = self.map is not None and bool(getattr(self.settings, "map_glossy", False))
        if self._by_directions:
            from etendue.surfaces import NearestMap

            if not isinstance(self.map, NearestMap):
                raise OptionError(
                    "map_glossy=true is for maps of the nearest particles, which have directions: make one by etendue "
                    "particles map --map knn"
                )
        self._after = dr.opaque(mi.UInt32, after)

    def start(self) -> State:
        """The digest of the map's file."""
        return {_DIGEST: self._digest}

    def enter(self, state: State) -> None:
        """Raises :class:`CheckpointError` for a state with another map."""
        if state.get(_DIGEST, "") != self._digest:
            raise CheckpointError(
                f"the map '{self.settings.map}' is not the one the checkpoint was made with: restore the file, or "
                "start a new render"
            )

    def walker(self, kind: type[W], **own: Any) -> W:
        """See :class:`ImageMethod`; paths end in the map."""
        if self.map is None or kind not in _ENDING:
            return super().walker(kind, **own)
        walker: Any = super().walker(_ENDING[kind], after=self._after, by_directions=self._by_directions, **own)
        return walker

    def path_fields(self) -> dict[str, Any]:
        """See :class:`ImageMethod`."""
        return super().path_fields() | ({} if self.map is None else {"end": MapEnd.none(self._by_directions)})

    def light_of_map(self, path: CameraPath) -> mi.Spectrum | None:
        """Light of the map at the ends of paths, whose loop is evaluated first; None without a map.

        Warns once if the map has no surface at some ends; raises :class:`OptionError` if at more than half of them.
        """
        end = path.end
        if self.map is None or end is None:
            return None
        dr.eval(path)
        light, unmapped = light_of_map(self.map, end, self.visibility)
        dr.eval(light, unmapped, end.reached)
        missed, ends = total(unmapped), total(end.reached)
        if missed > _UNMAPPED * ends:
            raise OptionError(
                f"the map ({self.map.kind}) has no surface where {missed:.0f} of {ends:.0f} paths end: it is of "
                "another scene, or not of these surfaces"
            )
        if missed > _FEW * ends and not self._warned:
            self._warned = True
            logger.warning(
                "the map (%s) has no surface where %.2g %% of the paths end; they are black there: make the map of "
                "all surfaces of this scene",
                self.map.kind,
                100 * missed / ends,
            )
        return light
