"""The interfaces of maps of irradiance, and of the particles from which they are made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device, use_variant
from etendue.scene import RenderSpace

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass
class Irradiance:
    """Answers of a map, one lane each, in W/m^2 of the scene's units: red, green, blue."""

    value: mi.Color3f
    error: mi.Color3f  #: standard error of ``value``; NaN where it is not known
    known: mi.Bool  #: whether the map has a surface there


class SurfaceMap(Protocol):
    """Irradiance on the surfaces of one scene."""

    kind: str  #: a word for files and messages
    space: RenderSpace  #: coordinates of points on the device

    def irradiance(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> Irradiance:
        """Light that arrives at points ``p`` from the side of their unit geometric normals ``n``, both in ``space``.

        Launches kernels of its own, so it must not be called in device loops; a path stores its end point instead.
        """
        ...


class SurfaceParticles(Protocol):
    """Particles: the arrays of :class:`etendue.particles.Particles` that maps read."""

    @property
    def position(self) -> NDArray[np.float32]:
        """(n, 3)"""

    @property
    def direction(self) -> NDArray[np.float32]:
        """(n, 3) of flight."""

    @property
    def power(self) -> NDArray[np.float32]:
        """(n, 3) W."""

    @property
    def path(self) -> NDArray[np.uint32]:
        """(n,)"""

    def __len__(self) -> int:
        """n"""


def irradiance_at(surface_map: SurfaceMap, positions: ArrayLike, normals: ArrayLike) -> tuple[Array, Array]:
    """(irradiance (m, 3), its standard error (m, 3)) at positions (m, 3) in the coordinates of the scene, on the side
    of the normals (m, 3). NaN where the map has no surface, and for errors that are not known."""
    use_variant()
    points, sides = np.asarray(positions, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    if not len(points):
        return np.zeros((0, 3)), np.zeros((0, 3))
    local = surface_map.space.from_scene(points)
    found = surface_map.irradiance(points_on_device(local), normals_on_device(sides))
    dr.eval(found.value, found.error, found.known)
    unknown = ~np.broadcast_to(np.array(found.known), (len(points),))
    value, error = (
        np.broadcast_to(np.array(x, dtype=np.float64), (3, len(points))).T.copy() for x in (found.value, found.error)
    )
    value[unknown], error[unknown] = np.nan, np.nan
    return value, error


def points_on_device(rows: Array) -> mi.Point3f:
    """(m, 3) numbers as points on the device, copied."""
    import mitsuba as mi

    return mi.Point3f(*(copied_to_device(mi.Float, x) for x in np.asarray(rows, np.float32).T))


def normals_on_device(rows: Array) -> mi.Normal3f:
    """(m, 3) numbers as normals on the device, copied."""
    import mitsuba as mi

    return mi.Normal3f(*(copied_to_device(mi.Float, x) for x in np.asarray(rows, np.float32).T))
