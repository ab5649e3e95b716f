"""Global lines: lines through a scene with the uniform density of integral geometry, and four ways to sample them.

Their density is uniform: the number of lines through a piece of surface does not depend on its position and
orientation. A line through a convex body of surface ``S`` then meets a flat patch of area ``A`` inside the body with
probability ``2 A / S``. Lines leave every patch with cosine density, so that the share of the lines through patch ``i``
that next hit patch ``j`` is the form factor [Sbert 1993].

Each generator maps a point of the four-dimensional unit cube to a line, so any four-dimensional point set can be used
[Castro 2002, sec. 3.4]:

==================== ================================================================================================
:class:`SpherePairs` through two points of a sphere around the scene
:class:`BoxWalls`    from a point on the walls of a box around the scene, by the cosine law; no line misses the box
:class:`GreatCircle` of uniform direction, through a point of the perpendicular disc
:class:`Bundles`     of uniform direction, in a randomly shifted perpendicular square grid: many lines for one point
==================== ================================================================================================
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.surfaces import Patches, across

from ..errors import RadiosityError

#: Distance from the body at which lines begin, in radii, so that lines also meet faces on the surface of the body.
_MARGIN = 0.05
#: Rotation of grids (radians), so that walls along the axes are not aligned with the rows of a grid.
TURN = 0.4


@dataclass(frozen=True)
class Lines:
    """Rays that begin outside the scene: ``origins`` and unit ``directions``, (n, 3)."""

    origins: Array
    directions: Array

    def __len__(self) -> int:
        return len(self.origins)


#: Centre and radius.
Sphere = tuple[Array, float]


class LineGenerator(ABC):
    """Lines through patches, from points of the unit cube of four dimensions.

    sphere: the sphere through which lines are cast, by default one around all patches, which are not needed with it.
    """

    name: ClassVar[str]
    citations: ClassVar[tuple[str, ...]] = ("Sbert1993", "Castro2002")

    def __init__(self, patches: Patches | None = None, sphere: Sphere | None = None) -> None:
        found = patches.sphere if sphere is None and patches is not None else sphere
        assert found is not None, "a generator needs patches or a sphere"
        self.centre, self.radius = found
        #: Surface area of the convex body from which the lines are sampled.
        self.surface = 4 * np.pi * self.radius**2

    @abstractmethod
    def lines(self, u: Array) -> Lines:
        """Lines of the points ``u`` (n, 4)."""

    @property
    def lines_per_point(self) -> float:
        """Mean number of lines through the body per point."""
        return 1.0

    def expected(self, areas: Array, points: int) -> Array:
        """Mean number of lines that hit flat patches of these areas, for ``points`` points: 2 A / S of all lines."""
        return points * self.lines_per_point * 2 * areas / self.surface

    def _outside(self, points: Array, directions: Array) -> Lines:
        return Lines(points - _MARGIN * self.radius * directions, directions)


class SpherePairs(LineGenerator):
    """Through two independent uniform points of the bounding sphere. All four dimensions are equally important."""

    name = "sphere-pairs"

    def lines(self, u: Array) -> Lines:
        """See :class:`LineGenerator`."""
        first, second = _on_sphere(u[:, 0], u[:, 1]), _on_sphere(u[:, 2], u[:, 3])
        way = second - first
        length = np.linalg.norm(way, axis=1, keepdims=True)
        same = length[:, 0] < 1e-9  # two equal points: a tangent, which meets nothing
        way[same], length[same] = across(first[same])[0], 1.0
        return self._outside(self.centre + self.radius * first, way / length)


class BoxWalls(LineGenerator):
    """From a uniform point on the walls of the box around the scene, into it by the cosine law."""

    name = "box-walls"

    def __init__(self, patches: Patches) -> None:
        super().__init__(patches)
        self.lower, upper = patches.bounds
        # Flat scenes get a thickness, so that the box has a volume.
        self.sides = np.maximum(upper - self.lower, 1e-3 * self.radius)
        self.surface = float(2 * (np.prod(self.sides) / self.sides).sum())

    def lines(self, u: Array) -> Lines:
        """See :class:`LineGenerator`."""
        return self._outside(*box_lines(u, self.lower, self.lower + self.sides))


def box_lines(u: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Points on the walls of a box, and directions into it by the cosine law: one for each of the points ``u`` (n, 4)
    of the unit cube."""
    sides = high - low
    walls = np.repeat(np.prod(sides) / sides, 2)
    edges = np.concatenate([[0.0], np.cumsum(walls)]) / walls.sum()
    wall = np.minimum(np.searchsorted(edges, u[:, 0], side="right") - 1, 5)
    first = (u[:, 0] - edges[wall]) / (edges[wall + 1] - edges[wall])
    axis, is_upper = wall // 2, wall % 2
    rows = np.arange(len(u))
    place, way = np.empty((len(u), 3)), np.empty((len(u), 3))
    place[rows, axis] = is_upper
    place[rows, (axis + 1) % 3], place[rows, (axis + 2) % 3] = first, u[:, 1]
    # A point of the unit disc, projected up to the hemisphere, has cosine density.
    r, phi = np.sqrt(u[:, 2]), 2 * np.pi * u[:, 3]
    way[rows, axis] = np.sqrt(1 - u[:, 2]) * (1 - 2 * is_upper)
    way[rows, (axis + 1) % 3], way[rows, (axis + 2) % 3] = r * np.cos(phi), r * np.sin(phi)
    return low + place * sides, way


class GreatCircle(LineGenerator):
    """Of uniform direction, through a uniform point of the perpendicular disc through the centre of the bounding
    sphere."""

    name = "great-circle"

    def lines(self, u: Array) -> Lines:
        """See :class:`LineGenerator`."""
        way = direction(u)
        a, b = across(way)
        r, phi = np.sqrt(u[:, 2:3]), 2 * np.pi * u[:, 3:4]
        point = r * np.cos(phi) * a + r * np.sin(phi) * b - np.sqrt(1 - r**2) * way
        return self._outside(self.centre + self.radius * point, way)


class Bundles(LineGenerator):
    """Parallel lines of uniform direction, in a square grid with a uniform shift.

    lines: mean number of lines of a bundle through the bounding sphere. The grid is rotated relative to the axes of the
        scene. Bundles of similar direction have similar rotations, so that their errors cancel.

    Raises :class:`RadiosityError` for less than one line.
    """

    name = "bundles"

    def __init__(self, patches: Patches, lines: float = 4096, sphere: Sphere | None = None) -> None:
        super().__init__(patches, sphere)
        if not np.isfinite(lines) or lines < 1:
            raise RadiosityError(f"a bundle has one line at least, not {lines!r}")
        #: Distance of neighbouring lines.
        self.spacing = float(self.radius * np.sqrt(np.pi / lines))

    @property
    def lines_per_point(self) -> float:
        """See :class:`LineGenerator`."""
        return float(np.pi * self.radius**2 / self.spacing**2)

    def most(self, patches: Patches) -> Array:
        """(n,) upper bound of the lines of a bundle through each patch, for any direction and shift.

        A convex figure of area A and perimeter P holds at most ``A + P / 2 + 1`` points of the square grid of spacing 1
        [Nosarzewska 1948]; area and perimeter of a projected face are at most those of the face.
        """
        corners = patches.vertices[patches.faces] / self.spacing
        perimeters = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum(axis=1)
        hits = patches.face_areas / self.spacing**2 + perimeters / 2 + 1
        most = np.zeros(len(patches) + 2)
        np.add.at(most, patches.sides, hits[:, None])
        return most[:-2]

    def frames(self, u: Array) -> Array:
        """(n, 3, 3) frames; the rows are two axes of the grid, and the direction."""
        return self.frames_along(direction(u))

    def frames_along(self, way: Array) -> Array:
        """The frames of given directions (n, 3)."""
        a, b = across(way)
        cosine, sine = np.cos(TURN), np.sin(TURN)
        return np.stack([cosine * a + sine * b, cosine * b - sine * a, way], axis=1)

    def directions(self, frames: Array) -> Array:
        """(n, 3) directions of the lines of frames."""
        return frames[:, 2]

    def wraps(self, frames: Array) -> NDArray[np.int64]:
        """(n, 3) for grids that repeat: the columns and the rows after which they do, and the columns by which they are
        shifted after so many rows; zeros for others."""
        return np.zeros((len(frames), 3), np.int64)

    def density(self, frames: Array) -> Array:
        """(n,) lines per area across them."""
        return np.linalg.norm(np.cross(frames[:, 0], frames[:, 1]), axis=1) / self.spacing**2

    def lines(self, u: Array) -> Lines:
        """See :class:`LineGenerator`: bundle by bundle, row by row."""
        reach = int(np.ceil(self.radius / self.spacing)) + 1
        j, i = (x.ravel() for x in np.meshgrid(*[np.arange(-reach, reach + 1)] * 2, indexing="ij"))
        frames, grid = self.frames(u), np.column_stack([i, j])
        place = (grid + u[:, None, 2:]) * self.spacing
        square = (place**2).sum(axis=2)
        bundle, line = np.nonzero(square < self.radius**2)
        depth = -np.sqrt(self.radius**2 - square[bundle, line])
        local = np.column_stack([place[bundle, line], depth])
        origins = self.centre + (local[:, None] @ frames[bundle])[:, 0]
        return self._outside(origins, frames[bundle, 2])


def direction(u: Array) -> Array:
    """Uniform directions (n, 3) of a hemisphere, from two columns; a line has no orientation."""
    z, phi = u[:, 0], 2 * np.pi * u[:, 1]
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)


def _on_sphere(u: Array, v: Array) -> Array:
    z, phi = 1 - 2 * u, 2 * np.pi * v
    r = np.sqrt(np.maximum(1 - z**2, 0))
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)


GENERATORS: dict[str, type[LineGenerator]] = {kind.name: kind for kind in (SpherePairs, BoxWalls, GreatCircle, Bundles)}
#: Names of the generators whose successive lines are not parallel.
SINGLE_LINES = tuple(name for name, kind in GENERATORS.items() if kind is not Bundles)
