"""What points see: the light of lamps at points, and the adjoint map, which tells where their light helps.

A lamp at p with intensity I(w) sends the power I(w) dw along w. If this meets patch j first, it adds I(w) dw / A_j to
the irradiance of j. So dL = integral I(w) y_j / A_j dw, with y = dL/dH of :class:`Gradient`: a correlation of the
intensity with a spherical picture of the importance y / A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, short_repr
from etendue.points import Independent
from etendue.surfaces import Patches, RayScene

from .errors import RadiosityError
from .gradients import Gradient
from .solvers.shot import FirstShot

Index = NDArray[np.int64]


@short_repr
@dataclass(frozen=True)
class PointViews:
    """The patches that k points see in the directions of a spherical picture.

    Rows of the picture are equal steps of the angle from +z, to -z in the last one; columns are equal steps of the
    azimuth, from +x over +y. ``points``: (k, 3). ``directions``: (rows, columns, 3) of one ray in each cell, uniform by
    solid angle. ``seen``: (k, rows, columns) the patch that it meets, ``n`` for the sky and ``n + 1`` for the back of a
    face. ``solid_angles``: (rows, columns) of the cells, together 4 pi.
    """

    patches: Patches
    points: Array
    seen: Index
    directions: Array
    solid_angles: Array

    def picture(self, values: Array) -> Array:
        """(k, rows, columns, c) values (n, c) of the patches that are seen; zero in the sky and on backs of faces."""
        return np.concatenate([values, np.zeros((2, values.shape[1]))])[self.seen]

    def adjoint_map(self, gradient: Gradient) -> Array:
        """(k, rows, columns, c) derivative of the loss by power that lamps at the points send in each direction; times
        ``solid_angles``, by the intensity of each cell, exactly that of :meth:`shot`.

        Of :func:`gradient_error` it is the standard error. Raises :class:`RadiosityError` for other patches.
        """
        if len(gradient.patches) != len(self.patches):
            raise RadiosityError(f"the gradient is that of {len(gradient.patches)} patches, not of {len(self.patches)}")
        return self.picture(gradient.importance)

    def shot(self, intensity: ArrayLike) -> FirstShot:
        """Direct light of lamps at the points, for :func:`solve`, by one ray for each cell.

        intensity: (k, rows, columns, c) power per solid angle in the ``directions``, or (k, rows, columns) for all
        channels alike. The error of the irradiance is half the difference of the estimates by every second cell, as
        on a chessboard, an upper estimate in quadratic mean. Raises :class:`RadiosityError` for another shape, and for
        negative or infinite intensities.
        """
        x = np.asarray(intensity, dtype=np.float64)
        x = x[..., None] if x.ndim == 3 else x
        if x.shape[:-1] != self.seen.shape or x.shape[-1] not in (1, self.patches.channels):
            raise RadiosityError(
                f"an intensity is given for each point and cell, {self.seen.shape}, in one channel or "
                f"{self.patches.channels}, not in the shape {x.shape}"
            )
        if not (np.isfinite(x).all() and (x >= 0).all()):
            raise RadiosityError("intensities of lamps are finite and not negative")
        n, c = self.patches.emission.shape
        power = np.broadcast_to(x * self.solid_angles[..., None], (*self.seen.shape, c))
        odd = np.indices(self.seen.shape)[1:].sum(axis=0) % 2 == 1
        halves = np.stack([_sums(self.seen[half], power[half], n + 2) for half in (odd, ~odd)])
        received, error = halves.sum(axis=0), np.abs(halves[0] - halves[1])[:n]
        areas = self.patches.divisors[:, None]
        nothing = np.zeros((n, c))
        return FirstShot(
            self.patches, nothing, received[:n] / areas, error / areas, received[n], received[n + 1], self.seen.size
        )


def point_views(scene: RayScene, points: ArrayLike, size: tuple[int, int] = (180, 360), *, seed: int = 0) -> PointViews:
    """What points (k, 3) of a scene see, by one ray for each of ``size`` (rows, columns) cells of a spherical picture,
    the same rays for all points.

    Raises :class:`RadiosityError` for points that are not finite, and for points inside a solid, which see only backs
    of faces.
    """
    try:
        p = np.atleast_2d(np.asarray(points, dtype=np.float64))
    except (TypeError, ValueError):
        p = np.zeros(0)
    if p.ndim != 2 or p.shape[1] != 3 or not len(p) or not np.isfinite(p).all():
        raise RadiosityError(f"points are finite numbers (k, 3), not an array of shape {p.shape} with others")
    rows, columns = size
    if rows < 2 or columns < 2:
        raise RadiosityError(f"a spherical picture has at least 2 rows and 2 columns, not {rows} and {columns}")
    u, v = Independent(2, seed).block(rows * columns).T.reshape(2, rows, columns)
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)[:, None]
    cosine, phi = edges[:-1] + u * np.diff(edges, axis=0), 2 * np.pi * (np.arange(columns) + v) / columns
    sine = np.sqrt(1 - cosine**2)
    directions = np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=-1)
    solid_angles = np.broadcast_to(-np.diff(edges, axis=0) * 2 * np.pi / columns, u.shape)
    ways = directions.reshape(-1, 3)
    origins = np.repeat(scene.local(p), len(ways), axis=0)
    seen = scene.first_patches(origins, np.tile(ways, (len(p), 1))).reshape(len(p), rows, columns)
    inside = np.flatnonzero((seen > len(scene.patches)).all(axis=(1, 2)))
    if len(inside):
        raise RadiosityError(
            f"{len(inside)} of {len(p)} points see only backs of faces, the first is point {inside[0]} at "
            f"{p[inside[0]].tolist()}: it lies inside a solid or outside the room; move it"
        )
    return PointViews(scene.patches, p, seen, directions, solid_angles)


def _sums(seen: Index, power: Array, count: int) -> Array:
    """(count, c) power (m, c) that arrives at each of the ``seen`` (m,)."""
    return np.stack([np.bincount(seen, column, count) for column in power.T], axis=1)
