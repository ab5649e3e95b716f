"""Objects: groups of patches, such as a chair, and the walls around them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, library, short_repr, suggest

from .errors import PatchError
from .patches import Patches
from .spheres import bounding_sphere

Index = NDArray[np.int64]

#: Vertices this close to each other are one, in radii of the scene: the error of single precision.
_SAME = 1e-6
#: A wall is this close to the side of a box, in radii: things on a floor may reach a little below it.
_NEAR = 0.02
#: Share of a side of the scene's box that a flat wall covers, and share of the box that a closed one fills, at least.
_COVERS = 0.5


@short_repr
@dataclass(frozen=True)
class Objects:
    """The object of each patch; see :func:`find_objects`.

    Objects may overlap or enclose each other, and the parts of one may be far from each other.

    Attributes
    ----------
    patches: the grouped patches.
    of_patch: (n,) the object of each patch, -1 for walls, which belong to no object. The two sides of a sheet belong to
        the same object.
    names: one for each object.
    areas: (k,) the area of all patches of each object; both sides of a sheet count.
    lower, upper: (k, 3) corners of the axis-aligned box of each object.
    """

    patches: Patches
    of_patch: Index
    names: tuple[str, ...]
    areas: Array
    lower: Array
    upper: Array

    @property
    def count(self) -> int:
        """Number of objects."""
        return len(self.names)

    @property
    def walls(self) -> Index:
        """Patches that belong to no object."""
        return np.flatnonzero(self.of_patch < 0)

    @cached_property
    def spheres(self) -> tuple[Array, Array]:
        """Centres (k, 3) and radii (k,) of the smallest spheres around the objects."""
        centres, radii = np.empty((self.count, 3)), np.empty(self.count)
        of_face = np.append(self.of_patch, -1)[self.patches.front]  # -1 for obstacles
        order = np.argsort(of_face, kind="stable")
        ends = np.searchsorted(of_face[order], np.arange(self.count + 1))
        for k in range(self.count):
            used = np.unique(self.patches.faces[order[ends[k] : ends[k + 1]]])
            centres[k], radii[k] = bounding_sphere(self.patches.vertices[used])
        return centres, radii

    def overlapping(self) -> Index:
        """(p, 2) pairs of objects, in ascending order, whose boxes have a common interior."""
        gap = _SAME * self.patches.sphere[1]
        found = []
        for k in range(self.count - 1):
            after = slice(k + 1, None)
            apart = (self.lower[after] >= self.upper[k] - gap) | (self.upper[after] <= self.lower[k] + gap)
            met = k + 1 + np.flatnonzero(~apart.any(axis=1))
            found.append(np.column_stack([np.full(len(met), k), met]))
        return np.concatenate(found) if found else np.empty((0, 2), np.int64)


def find_objects(
    patches: Patches,
    by: Literal["components", "shapes", "labels"] | ArrayLike = "components",
    *,
    walls: Sequence[str | int] | None = None,
) -> Objects:
    """Group patches to objects and walls.

    by: what makes an object:

        ============== ==============================================================================================
        ``components`` surfaces that are connected: faces with a common vertex, by position, or of the same patch
        ``shapes``     a shape of the scene that :func:`scene_patches` has read
        ``labels``     patches of equal ``labels``, such as the faces that :meth:`Patches.subdivided` has made of one
        an array       whole numbers (n,), or one for each patch that is not the back of a sheet; negative for walls
        ============== ==============================================================================================

    walls: names of the groups that are walls, ``()`` for none. By default, with an array, the patches of negative
        numbers are walls; otherwise groups that lie flat in a side of the scene's box and cover half of that side, and
        groups whose box contains all remaining groups and fills half of the scene's box. If all groups would be walls,
        there are no walls.

    Objects are in the order of their first patches, or of their numbers. Raises :class:`PatchError` for an array that
    does not fit, for ``shapes`` of patches without shapes, for unknown walls, and if there is no object.
    """
    group, names = _groups(patches, by)
    if patches.empty.any():
        group = np.where(patches.empty, -1, group)
        used = np.unique(group[group >= 0])
        group, names = np.where(group < 0, -1, np.searchsorted(used, group)), [names[k] for k in used]
    fronts = patches.fronts
    lower, upper = _boxes(patches, group, len(names))
    areas, one_side = (_areas(patches, group, sides, len(names)) for sides in (len(patches), fronts))
    if walls is not None:
        is_wall = _named(names, walls)
    elif isinstance(by, str):
        is_wall = _recognised(patches, lower, upper, one_side)
    else:
        is_wall = np.zeros(len(names), dtype=bool)
    kept = np.flatnonzero(~is_wall)
    if len(kept) == 0:
        raise PatchError(f"all {len(patches)} patches are walls: there is no object; name fewer walls")
    number = np.full(len(names) + 1, -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    of_patch = number[group]
    return Objects(patches, of_patch, tuple(names[k] for k in kept), areas[kept], lower[kept], upper[kept])


def _groups(patches: Patches, by: str | ArrayLike) -> tuple[Index, list[str]]:
    """The group of each patch, -1 for none, and the names of the groups."""
    if isinstance(by, str):
        ways: dict[str, Callable[[Patches], tuple[Index, list[str]]]] = {
            "components": _components,
            "shapes": _shapes,
            "labels": lambda patches: _numbered(patches.labels),
        }
        if by not in ways:
            raise PatchError(f"objects are found by components, shapes, labels or an array, not by '{by}'")
        return ways[by](patches)
    numbers = np.asarray(by)
    other = patches.other_side
    fronts = patches.fronts
    if numbers.shape not in ((len(patches),), (fronts,)) or numbers.dtype.kind not in "iu":
        also = f" (or of {fronts} without backs)" if fronts < len(patches) else ""
        raise PatchError(
            f"objects are whole numbers, one for each of {len(patches)} patches{also}, not {numbers.dtype} of shape "
            f"{numbers.shape}"
        )
    numbers = numbers.astype(np.int64)
    if len(numbers) == fronts:
        numbers = np.concatenate([numbers, numbers[other[fronts:]]])
    torn = np.flatnonzero((other >= 0) & (numbers != numbers[other]))
    if len(torn):
        raise PatchError(
            f"patch {torn[0]} and its back, patch {other[torn[0]]}, are one sheet but have the objects "
            f"{numbers[torn[0]]} and {numbers[other[torn[0]]]}: give them the same"
        )
    return _numbered(numbers)


def _numbered(numbers: Index) -> tuple[Index, list[str]]:
    """Groups of equal numbers; negative numbers belong to no group."""
    values, group = np.unique(numbers, return_inverse=True)
    skipped = int(np.searchsorted(values, 0))
    return np.maximum(group.reshape(-1) - skipped, -1), [str(value) for value in values[skipped:]]


def _shapes(patches: Patches) -> tuple[Index, list[str]]:
    if patches.shapes is None:
        raise PatchError("these patches are not of a scene's shapes: find objects by components, labels or an array")
    return patches.shapes, list(patches.shape_names)


def _components(patches: Patches) -> tuple[Index, list[str]]:
    """Connected surfaces: a graph of patches and of positions."""
    purpose = "finding the connected parts of a mesh"
    sparse, graphs = (library(f"scipy.{name}", purpose) for name in ("sparse", "sparse.csgraph"))
    place, near = _positions(patches.vertices, _SAME * patches.sphere[1])
    n, sheets = len(patches), patches.back >= 0
    corners, seen = place[patches.faces], patches.front >= 0
    patch = np.concatenate([np.repeat(patches.front[seen], 4), np.repeat(patches.back[sheets], 4), n + near[:, 0]])
    end = n + np.concatenate([corners[seen].ravel(), corners[sheets].ravel(), near[:, 1]])
    size = n + int(place.max()) + 1
    graph = sparse.coo_array((np.ones(len(end), np.int8), (patch, end)), shape=(size, size))
    part = graphs.connected_components(graph.tocsr(), directed=False)[1][:n]
    _, first, inverse = np.unique(part, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.reshape(-1)], [str(k) for k in range(len(first))]


def _positions(vertices: Array, gap: float) -> tuple[Index, Index]:
    """The cell of each vertex in a grid, and pairs of cells with vertices that are closer than ``gap``.

    Four grids are shifted against each other by ``gap`` along the diagonal. At most one of them separates two such
    vertices in each coordinate, so at least one has both in the same cell.
    """
    low = vertices.min(axis=0)
    width = int(np.ptp(vertices, axis=0).max() / (4 * gap)) + 3
    number: list[Index] = []
    pairs = []
    for shift in range(4):
        cell = np.floor((vertices - low) / (4 * gap) + shift / 4).astype(np.int64)
        _, first, inverse = np.unique(
            (cell[:, 0] * width + cell[:, 1]) * width + cell[:, 2], return_index=True, return_inverse=True
        )
        number.append(inverse.reshape(-1))
        pair = np.column_stack([number[0], number[0][first[number[shift]]]])
        pairs.append(np.unique(pair[pair[:, 0] != pair[:, 1]], axis=0))
    return number[0], np.concatenate(pairs)


def _areas(patches: Patches, group: Index, sides: int, count: int) -> Array:
    """Areas (count,) of the groups, of the first ``sides`` patches only."""
    used = np.flatnonzero(group[:sides] >= 0)
    return np.bincount(group[used], patches.areas[used], count).astype(np.float64)


def _boxes(patches: Patches, group: Index, count: int) -> tuple[Array, Array]:
    """Lower and upper corners (count, 3)."""
    lower, upper = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    of_face = np.append(group, -1)[patches.front]
    order = np.argsort(of_face, kind="stable")
    order = order[np.searchsorted(of_face[order], 0) :]
    if len(order):
        begins = np.flatnonzero(np.diff(of_face[order], prepend=-1))
        corners = patches.vertices[patches.faces[order]]
        lower[of_face[order[begins]]] = np.minimum.reduceat(corners.min(axis=1), begins)
        upper[of_face[order[begins]]] = np.maximum.reduceat(corners.max(axis=1), begins)
    return lower, upper


def _named(names: list[str], walls: Sequence[str | int]) -> NDArray[np.bool_]:
    wanted = [walls] if isinstance(walls, str) else [str(wall) for wall in walls]
    for wall in wanted:
        if wall not in names:
            raise PatchError(f"no group of patches is called '{wall}', so it is no wall; {suggest(wall, names)}")
    return np.isin(names, wanted)


def _recognised(patches: Patches, lower: Array, upper: Array, areas: Array) -> NDArray[np.bool_]:
    """Which groups are walls."""
    low, high = patches.bounds
    near, sides = _NEAR * patches.sphere[1], high - low
    is_wall = np.zeros(len(lower), dtype=bool)
    for axis in range(3):
        at_side = (upper[:, axis] <= low[axis] + near) | (lower[:, axis] >= high[axis] - near)
        is_wall |= at_side & (areas >= _COVERS * np.prod(np.delete(sides, axis)))
    large = np.prod(upper - lower, axis=1) >= _COVERS * np.prod(sides)
    while len(rest := np.flatnonzero(~is_wall)) > 1:
        holds = (lower[rest] <= lower[rest].min(axis=0) + near) & (upper[rest] >= upper[rest].max(axis=0) - near)
        found = rest[holds.all(axis=1) & large[rest]]
        if len(found) == 0:
            break
        is_wall[found] = True
    return np.zeros_like(is_wall) if is_wall.all() else is_wall
