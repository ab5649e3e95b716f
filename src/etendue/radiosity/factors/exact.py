"""Exact form factors: closed forms, and quadratures where surfaces hide each other in part."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, in_order, sparse, threads
from etendue.points import OwenSobol
from etendue.surfaces import Patches, diagnose, face_vectors, surfaces_of

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.abuffer import ABuffer
from .formfactors import FormFactors, numbers_of

Index = NDArray[np.int64]

#: A vertex is behind a face if it is further behind than this, in radii of the scene.
_BEHIND = 1e-6
#: Tolerance of form factors between patches that others hide in part, by default.
EXACT_TOLERANCE = 1e-4
#: Bytes for each pair of patches.
_BYTES = 64
#: Bundles of lines that look for backs in sight: their share is then zero, or below one in some hundred thousand.
_LOOK = 64
#: Most faces of a leaf of the tree of occluders.
_LEAF = 4
#: Tolerance of row sums of closed scenes; a larger deficit is the share of the sky.
_CLOSED = 1e-6


def exact_form_factors(patches: Patches, tolerance: float = EXACT_TOLERANCE) -> FormFactors:
    """Form factors by contour integrals [Sparrow 1963]. Time and memory grow with the square of the number of patches.

    Pairs that see all of each other have errors of about 1e-8 (1e-6 from meshes in single precision), and those with
    nothing in sight of each other are zero. Of the others, the contour of what is seen is integrated in closed form
    from points of the smaller patch, which is divided until the estimated error of the form factor is below
    ``tolerance``; for a form factor of a few of these, one point is enough. ``errors`` has the estimates. Faces that
    are partly behind each other's plane are clipped. The deficit of a row sum is the share of the sky and of backs of
    faces; deficits below 1e-6, or below the errors of the row, are left.

    Raises :class:`RadiosityError` if a face lies on another, if more pieces of a face are seen between others than
    there is room for, and for more patches than fit into memory: use lines (:class:`ABuffer`) then.
    :class:`etendue.core.BackendError` without Numba.
    """
    if not 0 < tolerance < 1:
        raise RadiosityError(f"the tolerance of form factors is above 0 and below 1, not {tolerance!r}")
    n, loops = len(patches), compiled("factors.contours")
    need, free = _BYTES * (n + 1) ** 2, free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"form factors of {n} patches need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: cast lines (ABuffer, "
            "or without --exact)"
        )
    centre, radius = patches.sphere
    corners = (patches.vertices[patches.faces] - centre) / radius
    planes = np.column_stack([patches.face_normals, (patches.face_normals * corners.mean(axis=1)).sum(axis=1)])
    if len(patches.coincident.pairs):
        upper, lower = patches.coincident.pairs[0]
        raise RadiosityError(
            f"faces {upper} and {lower} lie on each other, which exact form factors cannot tell apart: remove one, or "
            "cast lines (ABuffer, or without --exact)"
        )
    faces, patch, turned = _sides(patches, _backs_are_seen(patches))
    sides, of = corners[faces], planes[faces]
    sides[turned], of[turned] = sides[turned, ::-1], -of[turned]
    blockers, boxes, nodes = _tree(corners[_may_block(corners, planes)])
    exchange, errors = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))

    def task(rows: Index) -> tuple[int, int, int]:
        limits = int(rows[0]), int(rows[-1]) + 1, tolerance
        return loops.exchange_rows(sides, of, patch, blockers, boxes, nodes, *limits, exchange, errors)

    for _, a, b in in_order(partial(task, rows) for rows in _tasks(patch[patch < n])):
        if a >= 0:
            raise RadiosityError(
                f"faces {faces[a]} and {faces[b]} see each other between too many others: cast lines (ABuffer, or "
                "without --exact)"
            )
    exchange *= radius**2
    errors *= radius**2
    dark = exchange[:n, n] / patches.divisors
    both, off = exchange + exchange.T, errors + errors.T
    matrix = sparse().csr_array(both[:n, :n] / patches.divisors[:, None])
    estimates = matrix.copy()
    rows = np.repeat(np.arange(n), np.diff(matrix.indptr))
    estimates.data = off[rows, matrix.indices] / patches.divisors[rows]
    sky = 1 - np.asarray(matrix.sum(axis=1)).ravel() - dark
    allowed = np.maximum(_CLOSED, off[:n].sum(axis=1) / patches.divisors)
    sky[(sky < allowed) | patches.empty] = 0.0
    numbers = numbers_of(patches)
    return FormFactors(matrix, estimates, sky, patches.areas, np.zeros(n, np.int64), dark, **numbers)


def _tree(faces: Array) -> tuple[Array, Array, Index]:
    """Faces (b, 4, 3) in the order of a tree of boxes, the boxes (t, 2, 3), and for each of these the first face of a
    leaf and the one behind its last, or zeros, and the node behind those below it."""
    boxes: list[Array] = []
    nodes: list[list[int]] = []
    order: list[Index] = []
    middle = faces.mean(axis=1)

    def add(some: Index) -> None:
        low, high = faces[some].min(axis=(0, 1)), faces[some].max(axis=(0, 1))
        number = len(nodes)
        boxes.append(np.stack([low, high]))
        nodes.append([0, 0, 0])
        if len(some) <= _LEAF:
            first = sum(map(len, order))
            nodes[number][:2] = [first, first + len(some)]
            order.append(some)
        else:
            axis = np.ptp(middle[some], axis=0).argmax()
            sorted_ = some[np.argsort(middle[some, axis], kind="stable")]
            for part in np.array_split(sorted_, 2):
                add(part)
        nodes[number][2] = len(nodes)

    if len(faces):
        add(np.arange(len(faces)))
    chosen = np.concatenate([np.zeros(0, np.int64), *order])
    shapes = np.array(boxes).reshape(-1, 2, 3), np.array(nodes, np.int64).reshape(-1, 3)
    return np.ascontiguousarray(faces[chosen]), *shapes


def _backs_are_seen(patches: Patches) -> bool:
    """Whether any back without a patch is seen, by a cast of few lines."""
    return bool(ABuffer(patches, OwenSobol(4, seed=0)).cast(_LOOK).dark.any())


def _sides(patches: Patches, with_backs: bool) -> tuple[Index, Index, NDArray[np.bool_]]:
    """Face and patch of every side in ascending order of patches, and whether the side is a back. Backs without a patch
    come last, as patch ``n``, if ``with_backs``; those that cannot be seen are left out."""
    count, n = len(patches.faces), len(patches)
    dark = (patches.back < 0) & ~_hidden_backs(patches) if with_backs else np.zeros(count, bool)
    back = np.where(dark, n, patches.back)
    patch = np.concatenate([np.where(patches.front < 0, n, patches.front), back])
    order = np.argsort(patch, kind="stable")
    order = order[patch[order] >= 0]
    return order % count, patch[order], order >= count


def _hidden_backs(patches: Patches) -> NDArray[np.bool_]:
    """(f,) whether a face belongs to a closed surface with everything else on its front."""
    part, found = surfaces_of(patches), diagnose(patches)
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    corners = place[patches.faces]
    faulty = place[np.concatenate([found.open_edges, found.crowded_edges, found.flipped_edges]).ravel()]
    hidden = np.zeros(len(corners), dtype=bool)
    points = patches.vertices[patches.faces]
    for k in np.unique(part):
        ours = part == k
        if np.isin(corners[ours], faulty).any() or (patches.back[ours] >= 0).any():
            continue
        surface, others = points[ours], points[~ours].reshape(-1, 3)
        vectors, _ = face_vectors(patches.vertices, patches.faces[ours])
        outward = (vectors * surface.mean(axis=1)).sum() > 0
        low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
        inside = ((others > low) & (others < high)).all(axis=1)
        hidden[ours] = not inside.any() if outward else inside.all()
    return hidden


def _may_block(corners: Array, planes: Array) -> NDArray[np.bool_]:
    """(f,) whether a face has vertices on both sides of its plane."""
    vertices = np.unique(corners.reshape(-1, 3), axis=0)
    both = np.empty(len(corners), dtype=bool)
    for start in range(0, len(corners), 256):
        some = slice(start, start + 256)
        height = vertices @ planes[some, :3].T - planes[some, 3]
        both[some] = (height < -_BEHIND).any(axis=0) & (height > _BEHIND).any(axis=0)
    return both


def _tasks(patch: Index) -> list[Index]:
    """Ranges of sides, each of whole patches and about equal work; more ranges than threads."""
    starts = np.flatnonzero(np.diff(patch, prepend=-1))
    remaining = len(patch) - starts
    number = (1 - (remaining / len(patch)) ** 2) * 16 * threads()
    first = starts[np.flatnonzero(np.diff(number.astype(np.int64), prepend=-1))]
    return np.split(np.arange(len(patch)), first[1:])
