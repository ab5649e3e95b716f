"""Scenes made of parts: a part has patches in its own coordinates, and placed copies of other parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array
from etendue.surfaces import Patches

from ..errors import RadiosityError

Index = NDArray[np.int64]

#: Smallest thickness of a box, in units of its diagonal: flat parts get this thickness.
_THICKNESS = 1e-3
#: Accepted deviation of a transform from a similarity, relative to its scale.
_SIMILAR = 1e-5
#: Depth to which boxes may overlap because of rounding, in diagonals of the smaller box.
_TOUCH = 1e-5


@dataclass(frozen=True, eq=False)
class Copies:
    """Placed copies of one part. ``transforms``: (k, 4, 4), from coordinates of the part to those of the part that
    contains the copies; rotations, reflections, translations and uniform scaling."""

    part: Part
    transforms: Array


class Part:
    """Patches, and copies of other parts in boxes among them. The root of such a tree is a whole scene.

    patches: in coordinates of the part; ``None`` for a part that has copies only.
    copies: pairs of a part and the transforms (k, 4, 4) or (4, 4) of its copies.
        Empty patches are left out.
    numbers: (n,) indices of the patches in the mesh that the parts were made of, by default their own indices.
    objects: number of objects of the part, by which lines are distributed over parts.

    The box of a part is its bounding box along the axes of its own coordinates. Boxes of copies in one part must not
    overlap, and none of its own patches may reach into them; they may touch. Only then does light inside a box meet
    nothing but the contents of the box.

    Raises :class:`RadiosityError` for a transform that is no similarity, different numbers of channels, a sky in an
    inner part, boxes that overlap, own patches that reach into a box, and a part without patches and copies.
    """

    def __init__(
        self,
        patches: Patches | None,
        copies: Sequence[tuple[Part, ArrayLike]] = (),
        *,
        numbers: ArrayLike | None = None,
        objects: int = 1,
    ) -> None:
        given = np.arange(0 if patches is None else len(patches)) if numbers is None else numbers
        self.numbers: Index = np.asarray(given, dtype=np.int64)
        if patches is not None and patches.empty.any():
            patches, kept = patches.only(~patches.empty)
            self.numbers = self.numbers[kept]
        self.patches = patches
        self.copies = tuple(Copies(part, _similarities(transforms)) for part, transforms in copies)
        if patches is None and not self.copies:
            raise RadiosityError("a part needs patches, or copies of other parts")
        self.objects = objects
        channels = {part.channels for part in (copy.part for copy in self.copies)}
        channels |= set() if patches is None else {patches.channels}
        if len(channels) > 1:
            raise RadiosityError(f"parts have {' and '.join(map(str, sorted(channels)))} channels: give all the same")
        self.channels: int = channels.pop()
        for copy in self.copies:
            if (inner := copy.part.patches) is not None and inner.sky.any():
                raise RadiosityError("the sky is around the whole scene: give it to the root, not to a part inside")
        self._check_boxes()

    def __len__(self) -> int:
        return 0 if self.patches is None else len(self.patches)

    def __repr__(self) -> str:
        return f"Part({len(self)} patches, {len(self.children)} copies inside, {self.total} patches in all)"

    @cached_property
    def children(self) -> list[tuple[Part, Array]]:
        """Every copy: its part and its transform (4, 4)."""
        return [(copy.part, transform) for copy in self.copies for transform in copy.transforms]

    @cached_property
    def total(self) -> int:
        """Number of patches, including those of all copies."""
        return len(self) + sum(len(copy.transforms) * copy.part.total for copy in self.copies)

    @cached_property
    def distinct(self) -> list[Part]:
        """This part and all parts inside, each once, inner parts first."""
        found: dict[int, Part] = {}
        for copy in self.copies:
            found |= {id(part): part for part in copy.part.distinct}
        return [*found.values(), self]

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Corners of the box, in coordinates of the part."""
        corners = [] if self.patches is None else [np.stack(self.patches.bounds)]
        corners += [_placed(_corners(*part.bounds), transform) for part, transform in self.children]
        points = np.concatenate(corners)
        low, high = points.min(axis=0), points.max(axis=0)
        thin = np.maximum(_THICKNESS * np.linalg.norm(high - low) - (high - low), 0) / 2
        return low - thin, high + thin

    @cached_property
    def box_area(self) -> float:
        """Surface of the box."""
        return box_area(*self.bounds)

    def joined(self) -> Patches:
        """All patches of all copies in one mesh, see :meth:`Tree.joined`: for small scenes, and for comparisons."""
        return Tree(self).joined()

    def _check_boxes(self) -> None:
        boxes = [_oriented(part, transform) for part, transform in self.children]
        if not boxes:
            return
        reach = np.array([np.abs(axes).sum(axis=0) for _, axes in boxes])
        centres = np.array([centre for centre, _ in boxes])
        for i in range(len(boxes)):
            near = (np.abs(centres[i] - centres[:i]) < reach[i] + reach[:i]).all(axis=1)
            for j in np.flatnonzero(near):
                if _overlap(*boxes[i], *boxes[j]):
                    raise RadiosityError(
                        f"the boxes of copies {j} and {i} overlap: put both into one part, or move them apart"
                    )
        if self.patches is None:
            return
        corners = self.patches.vertices[self.patches.faces]
        low, high = corners.min(axis=1), corners.max(axis=1)
        for i, (centre, axes) in enumerate(boxes):
            near = ((low < centre + reach[i]) & (high > centre - reach[i])).all(axis=1)
            face = faces_in_box(corners[near], centre, axes)
            if face.any():
                patch = self.patches.front[np.flatnonzero(near)[np.argmax(face)]]
                raise RadiosityError(
                    f"patch {patch} reaches into the box of copy {i}: make it a patch of that part, or move the copy"
                )


class Tree:
    """Every copy in a scene as a node, the root first, the children of a node next to each other.

    ``parts``: the distinct parts, inner parts first. For each node: ``part`` (m,), the index of its part; ``first``
    (m,), its first child; ``world`` (m, 4, 4), its transform to the scene; ``scale`` (m,); ``rank`` (m,), its index
    among the copies of its part. ``nodes``: the nodes of each part; ``levels``: ranges of nodes, from the root down.
    """

    def __init__(self, root: Part) -> None:
        self.root, self.parts = root, root.distinct
        number = {id(part): k for k, part in enumerate(self.parts)}
        kind, world, first = [number[id(root)]], [np.eye(4)], []
        self.levels, at = [range(1)], 0
        while at < len(kind):
            end = len(kind)
            for node in range(at, end):
                first.append(len(kind))
                for part, transform in self.parts[kind[node]].children:
                    kind.append(number[id(part)])
                    world.append(world[node] @ transform)
            if len(kind) > end:
                self.levels.append(range(end, len(kind)))
            at = end
        self.part: Index = np.array(kind)
        self.first: Index = np.array(first)
        self.world: Array = np.array(world)
        self.scale: Array = np.cbrt(np.abs(np.linalg.det(self.world[:, :3, :3])))
        self.nodes = [np.flatnonzero(self.part == k) for k in range(len(self.parts))]
        self.rank: Index = np.empty(len(kind), dtype=np.int64)
        for nodes in self.nodes:
            self.rank[nodes] = np.arange(len(nodes))

    def __len__(self) -> int:
        return len(self.part)

    @cached_property
    def offsets(self) -> Index:
        """(m + 1,) index of the first patch of each node, if patches are counted node by node."""
        sizes = np.array([len(part) for part in self.parts])
        result: Index = np.concatenate([[0], np.cumsum(sizes[self.part])])
        return result

    def areas(self, node: int) -> Array:
        """(n,) areas of the patches of a node, in the scene."""
        patches = self.parts[self.part[node]].patches
        return np.zeros(0) if patches is None else patches.areas * self.scale[node] ** 2

    def joined(self) -> Patches:
        """All patches in one mesh: the fronts node by node, then the backs of sheets, as in :class:`Patches`. See
        ``numbers_in_joined`` for the indices of the patches of a node."""
        meshes, values = [], []
        vertices = 0
        for node in range(len(self)):
            patches = self.parts[self.part[node]].patches
            if patches is None:
                continue
            meshes.append((_placed(patches.vertices, self.world[node]), _turned(patches.faces, self.world[node])))
            values.append(patches)
        faces = []
        for points, corners in meshes:
            faces.append(corners + vertices)
            vertices += len(points)
        ids, start = [], 0
        for patches in values:
            ids.append(patches.front + start)
            start += patches.fronts
        sheets = np.concatenate([patches.other_side[: patches.fronts] >= 0 for patches in values])
        root = self.root.patches

        def all_sides(name: str) -> Array:
            rows = [getattr(patches, name) for patches in values]
            fronts = [x[: patches.fronts] for x, patches in zip(rows, values, strict=True)]
            backs = [x[patches.fronts :] for x, patches in zip(rows, values, strict=True)]
            return np.concatenate([*fronts, *backs])

        return Patches(
            np.concatenate([points for points, _ in meshes]),
            np.concatenate(faces),
            reflectance=all_sides("reflectance"),
            emission=all_sides("emission"),
            ids=np.concatenate(ids),
            two_sided=sheets,
            sky=0.0 if root is None else root.sky,
        )

    @cached_property
    def numbers_in_joined(self) -> Index:
        """For the patches of all nodes, node by node (``offsets``), their indices in :meth:`joined`."""
        sizes = [(0, 0) if p.patches is None else (p.patches.fronts, len(p)) for p in self.parts]
        fronts = np.cumsum([0, *(sizes[k][0] for k in self.part)])
        backs = fronts[-1] + np.cumsum([0, *(sizes[k][1] - sizes[k][0] for k in self.part)])
        rows = []
        for node, k in enumerate(self.part):
            front, count = sizes[k]
            rows += [fronts[node] + np.arange(front), backs[node] + np.arange(count - front)]
        return np.concatenate(rows)


def part_boxes(root: Part) -> tuple[Index, Array]:
    """(level, corners) of the box of every copy, the root first: (m,), (m, 8, 3) in the scene. Corner k is at the upper
    end of the axes whose bits are set in k."""
    tree = Tree(root)
    level = np.concatenate([np.full(len(nodes), k) for k, nodes in enumerate(tree.levels)])
    bounds = [_corners(*tree.parts[kind].bounds) for kind in tree.part]
    return level, np.array([_placed(corners, world) for corners, world in zip(bounds, tree.world, strict=True)])


def box_area(low: Array, high: Array) -> float:
    """Surface of a box."""
    x, y, z = high - low
    return float(2 * (x * y + y * z + z * x))


def faces_in_box(corners: Array, centre: Array, axes: Array) -> NDArray[np.bool_]:
    """(f,) whether faces (f, 4, 3) reach into a box, by separating axes; faces that only touch it do not. The box is
    given by its centre and its half edges, the rows of ``axes``."""
    if len(corners) == 0:
        return np.zeros(0, dtype=bool)
    edges = corners - np.roll(corners, 1, axis=1)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    ways = [np.broadcast_to(axis, normal.shape) for axis in axes] + [normal]
    ways += [np.cross(edges[:, k], axis) for k in range(4) for axis in axes]
    inside = np.ones(len(corners), dtype=bool)
    slack = _TOUCH * 2 * np.sqrt((axes**2).sum())
    for way in ways:
        length = np.linalg.norm(way, axis=1)
        seen = ((corners - centre) * way[:, None]).sum(axis=2)
        reach = np.abs(way @ axes.T).sum(axis=1) - slack * length
        apart = (seen.min(axis=1) >= reach) | (seen.max(axis=1) <= -reach)
        inside &= ~(apart & (length > 1e-12 * np.abs(axes).max() ** 2))
    return inside


def _similarities(transforms: ArrayLike) -> Array:
    matrices = np.asarray(transforms, dtype=np.float64)
    matrices = matrices[None] if matrices.ndim == 2 else matrices
    if matrices.ndim != 3 or matrices.shape[1:] != (4, 4) or not np.isfinite(matrices).all():
        raise RadiosityError(f"transforms of copies are finite matrices (k, 4, 4), not {matrices.shape}")
    linear = matrices[:, :3, :3]
    square = np.einsum("kij,kil->kjl", linear, linear)
    scale = np.trace(square, axis1=1, axis2=2) / 3
    off = np.abs(square - scale[:, None, None] * np.eye(3)).max(axis=(1, 2), initial=0)
    affine = (matrices[:, 3] == [0, 0, 0, 1]).all(axis=1)
    bad = np.flatnonzero(~(affine & (scale > 0) & (off <= _SIMILAR * scale)))
    if len(bad):
        raise RadiosityError(
            f"transform {bad[0]} shears, or scales axes differently: copies share their light only if they are "
            "rotated, shifted, and scaled alike along all axes; make it a part of its own"
        )
    return matrices


def _corners(low: Array, high: Array) -> Array:
    return np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])


def _placed(points: Array, transform: Array) -> Array:
    return points @ transform[:3, :3].T + transform[:3, 3]


def _turned(faces: Index, transform: Array) -> Index:
    """Faces with corners reordered after a reflection, so that their fronts stay fronts."""
    if np.linalg.det(transform[:3, :3]) > 0:
        return faces
    triangle = faces[:, 2] == faces[:, 3]
    return np.where(triangle[:, None], faces[:, [1, 0, 2, 2]], faces[:, ::-1])


def _oriented(part: Part, transform: Array) -> tuple[Array, Array]:
    """Centre of the box of a copy, and its half edges as rows."""
    low, high = part.bounds
    return _placed((low + high) / 2, transform), (transform[:3, :3] * (high - low) / 2).T


def _overlap(centre: Array, axes: Array, other_centre: Array, other_axes: Array) -> bool:
    """Whether boxes overlap by more than rounding, by separating axes."""
    way = other_centre - centre
    ways = [*axes, *other_axes, *(np.cross(a, b) for a in axes for b in other_axes)]
    slack = _TOUCH * 2 * min(np.sqrt((axes**2).sum()), np.sqrt((other_axes**2).sum()))
    size = np.abs(axes).max() * np.abs(other_axes).max()
    for axis in ways:
        length = np.linalg.norm(axis)
        if length <= 1e-9 * min(size, np.sqrt(size)):
            continue
        reach = np.abs(axes @ axis).sum() + np.abs(other_axes @ axis).sum()
        if abs(way @ axis) >= reach - slack * length:
            return False
    return True
