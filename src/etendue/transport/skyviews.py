"""What meters see of the sky, by any number of reflections: paths from the meters to the patches of the sky.

A path of throughput T that leaves the scene towards a patch adds T / N to the coefficient of this patch, for N paths.
Directions are sampled by materials alone, since every patch is a light of its own.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, on_device
from etendue.lighting import SkyPatches
from etendue.points import OwenSobolSource
from etendue.scene import Problem, refuse_media, require_rgb

from .camera import CameraSampler
from .visibility import Visibility
from .walk import CameraPath, Walker

#: Depth at which Russian roulette may end a path.
_ROULETTE = 5


class SkyViews:
    """Paths from the meters of a problem (:func:`etendue.scene.with_meters`) to sky patches.

    ``frame``: (3, 3), rows east, north and up in the coordinates of the scene. ``max_depth``: edges of a path, -1 for
    any number.
    """

    def __init__(self, problem: Problem, patches: SkyPatches, frame: ArrayLike, max_depth: int = -1) -> None:
        require_rgb("daylight coefficients")
        refuse_media(problem.scene, "daylight coefficients")
        self._camera, self._patches = CameraSampler(problem), patches
        self._frame = [mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in row)) for row in np.asarray(frame)]
        no_lights: Any = None  # the sky is the only light
        self._walker = Walker(
            visibility=Visibility(problem.scene, problem.sensor),
            lights=no_lights,
            max_edges=dr.opaque(mi.UInt32, max_depth if max_depth >= 0 else 1 << 30),
            rr_depth=_ROULETTE,
        )
        self._count = dr.opaque(mi.UInt32, patches.count)
        self._first, self._in_row = (on_device(mi.UInt32, rows) for rows in (patches.first, patches.in_row))

    def trace(self, first: int, paths: int, seed: int) -> tuple[Array, int]:
        """(sums (meters, patches, 3) of the throughputs of ``paths`` paths of each meter from number ``first`` on,
        rays)."""
        meters, count = self._camera.pixels, self._patches.count
        lanes = dr.arange(mi.UInt32, meters * paths)
        meter = lanes // dr.opaque(mi.UInt32, paths)
        number = lanes - meter * dr.opaque(mi.UInt32, paths) + dr.opaque(mi.UInt32, first)
        source = OwenSobolSource(meter, number, seed, "sky")
        ray, importance, _ = self._camera.primary(meter, source)
        sums = dr.zeros(mi.Float, 4 * meters * count)
        walker = self._walker

        def edge(s: CameraPath) -> CameraPath:
            vertex = walker.arrive(s, source)
            leaves = s.active & ~vertex.valid
            patch = meter * self._count + self._number_of(vertex.incoming)
            light = s.throughput * importance
            dr.scatter_reduce(dr.ReduceOp.Add, sums, mi.Vector4f(light.x, light.y, light.z, 0.0), patch, leaves)
            s.active &= vertex.valid & walker.goes_on(s, vertex)
            scattered, _ = vertex.sample(source, s.active)
            walker.advance(s, vertex, scattered, source)
            return s

        path = walker.walk(CameraPath.start(ray, walker.max_edges), edge, "sky views")
        dr.eval(sums, path.rays)
        return np.array(sums, np.float64).reshape(meters, count, 4)[..., :3], int(np.array(path.rays, np.uint64).sum())

    def _number_of(self, direction: mi.Vector3f) -> mi.UInt32:
        """:meth:`SkyPatches.number_of` of directions in the scene."""
        east, north, up = (dr.dot(direction, axis) for axis in self._frame)
        altitude = dr.safe_asin(up)
        rows = len(self._patches.in_row)
        row = dr.minimum(mi.UInt32(dr.maximum(altitude, 0.0) / float(self._patches.row_height)), rows - 1)
        in_row = dr.gather(mi.UInt32, self._in_row, row)
        turn = dr.atan2(east, north) * (0.5 / dr.pi)
        column = mi.UInt32(dr.floor((turn + 1.0) * mi.Float(in_row) + 0.5))  # half a turn to one and a half
        column = dr.select(column >= in_row, column - in_row, column)
        return dr.select(up > 0.0, dr.gather(mi.UInt32, self._first, row) + column, 0)
