"""Exact form factors: by integrals of all pairs of patches."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, in_order, sparse, threads
from etendue.points import OwenSobol
from etendue.surfaces import Patches, diagnose, face_vectors, surfaces_of

from ..compiling import compiled
from ..errors import RadiosityError, check_no_period
from ..lines.abuffer import ABuffer
from ..lines.engine import warn_of_backs
from .bodies import Body
from .contacts import Contacts, quadrilaterals, refusal
from .formfactors import FormFactors, numbers_of
from .occluders import Index, Occluders, occluders
from .sections import Section

#: Tolerance of rows, by default.
EXACT_TOLERANCE = 1e-4
#: Bytes for each pair of patches.
_BYTES = 64
#: Bundles of lines that look for backs in sight: their share is then zero, or below one in some hundred thousand.
_LOOK = 64
#: Pairs by which time is estimated, in runs of so many sides: some tenths of a second.
_PILOT, _RUN = 200_000, 8
#: Ranges of pairs that threads take.
_TASKS = 128
#: Error of form factors between distant patches that see all of each other: a share of the tolerance, at least this.
_OF_TOLERANCE, _LEAST = 0.01, 1e-8
#: Vertices are behind a plane if they are further behind than this, in radii of the scene: a rounded one.
_BEHIND = 3e-6
#: Areas in contact are the same if they differ by less, in squares of the radius: slivers are left out.
_SAME_AREA = 1e-4
#: Tolerance of row sums of closed scenes; a larger deficit is the share of the sky.
_CLOSED = 1e-6


def exact_form_factors(
    patches: Patches, tolerance: float = EXACT_TOLERANCE, tell: Callable[[str], object] = lambda text: None
) -> FormFactors:
    """Form factors by contour integrals [Sparrow 1963]. Time and memory grow with the square of the number of patches.

    tolerance: of the sum of a row, root mean square; tell: receives the progress. Pairs that see all of each other have
    errors of a hundredth of it at most, 1e-8 if they are near (1e-6 from meshes in single precision); those that a face
    hides from each other are zero. Of those that are hidden in part, the contour of what is seen is integrated in
    closed form from points of the smaller patch: from some of Sobol's sequence, as many as the tolerance needs for the
    size of the form factor, or from those of triangles that are divided where they differ. Between many faces, rays
    that join points of both patches are faster. ``errors`` has estimates.

    Faces that are partly behind each other's plane are clipped. Where faces lie on each other, what is covered is not
    seen, and sides in contact see each other: a box and the floor, but not rooms that share a wall, nor the sides of a
    thin plate. Of faces that face the same way, such as a door on a wall, the smaller one is in front. The deficit of a
    row sum is the share of the sky and of backs of faces; deficits below 1e-6, or below the errors of the row, are
    left.

    Raises :class:`RadiosityError` for sheets with two sides on each other, for faces in one place that have no order,
    and for more patches than fit into memory: use lines (:class:`ABuffer`) then.
    :class:`etendue.core.BackendError` without Numba.

    Surfaces without end along y, such as those of ``.vs2``, are exact but for rounding: their faces are rectangles from
    one end to the other of a domain that repeats along y only, and the lines that join segments of its section are
    integrated in closed form [Orti 1996], which without occlusion is Hottel's rule of crossed strings [Hottel 1954].
    Other periodic domains are refused.

    Of surfaces of revolution (:meth:`Patches.revolved`), the form factors are those of round rings: in the angle
    between two points, what rings hide is found and the rest integrated in closed form; integrals along the profiles
    are adaptive. The sky is integrated, too, and a warning tells if a row does not sum to 1.
    """
    if (section := Section.of(patches)) is not None:
        return section.form_factors()
    if (body := Body.of(patches)) is not None:
        _check_tolerance(tolerance)
        return body.form_factors(tolerance, tell)
    pairs, n = _pairs(patches, tolerance), len(patches)
    exchange, errors = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    tasks = _tasks(pairs.sides.patch, n)
    for k, _ in enumerate(in_order(partial(pairs.integrate, rows, exchange, errors) for rows in tasks)):
        tell(f"integrating, {100 * k // len(tasks)} %")
    exchange += pairs.touching
    exchange *= pairs.radius**2
    errors *= pairs.radius**2
    dark = exchange[:n, n] / patches.divisors
    both, off = exchange + exchange.T, errors + errors.T
    known = sparse().csr_array((both[:n, :n] > 0) | (off[:n, :n] > 0))  # also where nothing is seen from some points
    rows = np.repeat(np.arange(n), np.diff(known.indptr))
    matrix, estimates = (
        sparse().csr_array((a[rows, known.indices] / patches.divisors[rows], known.indices, known.indptr), (n, n))
        for a in (both, off)
    )
    sky = 1 - np.asarray(matrix.sum(axis=1)).ravel() - dark
    allowed = np.maximum(_CLOSED, off[:n].sum(axis=1) / patches.divisors)
    sky[(sky < allowed) | patches.empty] = 0.0
    numbers = numbers_of(patches)
    warn_of_backs(float(dark @ patches.areas / max(patches.areas.sum(), 1e-300)), "of what patches see is")
    return FormFactors(matrix, estimates, sky, patches.areas, np.zeros(n, np.int64), dark, **numbers)


def exact_seconds(patches: Patches, tolerance: float = EXACT_TOLERANCE) -> float:
    """The time that :func:`exact_form_factors` is going to take, from that of some pairs. Raises as it does."""
    if (section := Section.of(patches)) is not None:
        return section.seconds()
    if (body := Body.of(patches)) is not None:
        _check_tolerance(tolerance)
        return body.seconds(tolerance)
    pairs, n = _pairs(patches, tolerance), len(patches)
    total = len(pairs.sides.patch)
    exchange, errors = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    count = min(max(2 * _PILOT // (_RUN * total), 1), max(total // _RUN, 1))
    some = [np.arange(k, min(k + _RUN, total)) for k in np.linspace(0, total - 1, 2 * count + 1).astype(int)[1::2]]
    pairs.integrate(some[0][:1], exchange, errors)  # loads or compiles
    began = time.perf_counter()
    for rows in some:
        pairs.integrate(rows, exchange, errors)
    spent, share = time.perf_counter() - began, sum(_RUN * (total - rows[0]) for rows in some) / (total**2 / 2)
    return float(spent / min(share, 1.0) / threads())


@dataclass(frozen=True)
class _Pairs:
    """All pairs of the sides of patches, in radii of the scene."""

    loops: Any
    sides: Any
    occluders: Occluders
    touching: Any
    radius: float
    tolerance: float

    def integrate(self, rows: Index, exchange: Array, errors: Array) -> None:
        """Add what sides in a range exchange with later ones."""
        limits = int(rows[0]), int(rows[-1]) + 1
        self.loops.exchange_rows(self.sides, self.occluders, *limits, self.tolerance, exchange, errors)


def _check_tolerance(tolerance: float) -> None:
    if not 0 < tolerance < 1:
        raise RadiosityError(f"the tolerance of form factors is above 0 and below 1, not {tolerance!r}")


def _pairs(patches: Patches, tolerance: float) -> _Pairs:
    """Check what can be checked beforehand. Raises :class:`RadiosityError`."""
    _check_tolerance(tolerance)
    check_no_period(patches, "integrals")
    n, loops, rules = len(patches), compiled("factors.exchange"), compiled("factors.distant")
    need, free = _BYTES * (n + 1) ** 2, free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"form factors of {n} patches need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: cast lines (ABuffer, "
            "or method lines)"
        )
    contacts = Contacts.of(patches)
    corners, planes, radius = contacts.corners, contacts.planes, patches.sphere[1]
    faces, patch, turned = _sides(patches, _backs_are_seen(patches))
    shapes, kept = _uncovered(contacts, faces, turned)
    faces, patch, turned = faces[kept], patch[kept], turned[kept]
    of = planes[faces]
    shapes[turned], of[turned] = shapes[turned, ::-1], -of[turned]
    distances = rules.least_distances(max(_OF_TOLERANCE * tolerance, _LEAST))
    sides = loops.Sides(shapes, of, patch, _balls(shapes), rules.nodes_of(shapes), distances)
    touching = _touching(patches, contacts)
    return _Pairs(loops, sides, occluders(corners, planes), touching, radius, tolerance)


def _uncovered(contacts: Contacts, faces: Index, turned: NDArray[np.bool_]) -> tuple[Array, Index]:
    """Polygons (s, 4, 3) that sides consist of where nothing lies on them, and the side that each belongs to."""
    shapes, count = list(contacts.corners[faces, None]), np.ones(len(faces), np.int64)
    for k in np.flatnonzero(np.isin(faces, list(contacts.partners))):
        face, front = int(faces[k]), not turned[k]
        if contacts.covered(face, front):
            parts = [quad for part in contacts.uncovered(face, front)[0] for quad in quadrilaterals(part)]
            shapes[k], count[k] = np.array(parts).reshape(-1, 4, 3), len(parts)
    return np.concatenate(shapes), np.repeat(np.arange(len(faces)), count)


def _touching(patches: Patches, contacts: Contacts) -> Any:
    """A F (n + 1, n + 1) of sides in contact; those of two patches in two halves, which are added.

    Raises :class:`RadiosityError` if the faces in one place have no order."""
    n, of = len(patches), {True: patches.front, False: patches.back}
    areas = {}
    for face in contacts.partners:
        for front in (True, False):
            if of[front][face] >= 0 and contacts.covered(face, front):
                for cover in contacts.uncovered(face, front)[1]:
                    areas[face, front, cover.face] = cover.area
    rows, columns, values = [], [], []
    for (face, front, other), area in areas.items():
        theirs = contacts.facing_front(face, front, other)
        i, j = of[front][face], of[theirs][other]
        if j >= 0 and abs(areas.get((other, theirs, face), 0.0) - area) > _SAME_AREA:
            raise RadiosityError(refusal(patches, face, other, "and on others, in no order"))
        rows.append(i)
        columns.append(j if j >= 0 else n)
        values.append(area / 2 if j >= 0 else area)
    return sparse().coo_array((values, (rows, columns)), (n + 1, n + 1)).toarray() if values else 0.0


def _backs_are_seen(patches: Patches) -> bool:
    """Whether any back without a patch is seen, by a cast of few lines."""
    return bool(ABuffer(patches, OwenSobol(4, seed=0)).cast(_LOOK, warn=False).dark.any())


def _sides(patches: Patches, with_backs: bool) -> tuple[Index, Index, NDArray[np.bool_]]:
    """Face and patch of every side, and whether the side is a back: near ones that face the same way after each other,
    and those of a patch. Backs without a patch come last, as patch ``n``, if ``with_backs``; those that cannot be seen
    are left out."""
    count, n = len(patches.faces), len(patches)
    dark = (patches.back < 0) & ~_hidden_backs(patches) if with_backs else np.zeros(count, bool)
    back = np.where(dark, n, patches.back)
    patch = np.concatenate([np.where(patches.front < 0, n, patches.front), back])
    order = np.argsort(np.append(_places(patches), n)[patch], kind="stable")
    order = order[patch[order] >= 0]
    return order % count, patch[order], order >= count


def _balls(sides: Array) -> Array:
    """(s, 4) the centre of each side (s, 4, 3), and the square of its diameter."""
    across = sides[:, :, None] - sides[:, None]
    return np.column_stack([sides.mean(axis=1), (across**2).sum(axis=3).max(axis=(1, 2))])


def _places(patches: Patches) -> Index:
    """(n,) the place of each patch by the axis that it faces, and along Morton's curve."""
    centres, normals = np.nan_to_num(patches.centres), patches.normals
    low, size = centres.min(axis=0), max(np.ptp(centres, axis=0).max(), 1e-300)
    cells = ((centres - low) / size * 1023).astype(np.int64)
    code = np.zeros(len(cells), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    axis = np.abs(normals).argmax(axis=1)
    facing = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    return np.argsort(np.argsort(facing << 30 | code, kind="stable"), kind="stable")


def _hidden_backs(patches: Patches) -> NDArray[np.bool_]:
    """(f,) whether a face belongs to a closed surface with everything else on its front."""
    part, found = surfaces_of(patches), diagnose(patches)
    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    corners = place[patches.faces]
    faulty = place[np.concatenate([found.open_edges, found.crowded_edges, found.flipped_edges]).ravel()]
    hidden = np.zeros(len(corners), dtype=bool)
    centre, radius = patches.sphere
    points = (patches.vertices[patches.faces] - centre) / radius
    for k in np.unique(part):
        ours = part == k
        if np.isin(corners[ours], faulty).any() or (patches.back[ours] >= 0).any():
            continue
        surface, others = points[ours], points[~ours]
        vectors, _ = face_vectors(patches.vertices, patches.faces[ours])
        if (vectors * surface.mean(axis=1)).sum() > 0:
            low, high = surface.min(axis=(0, 1)), surface.max(axis=(0, 1))
            is_apart = (others.min(axis=1) >= high) | (others.max(axis=1) <= low)
            hidden[ours] = is_apart.any(axis=1).all()
        else:
            hidden[ours] = not len(others) or _are_before(points.reshape(-1, 3), surface[:, 0], vectors)
    return hidden


def _are_before(vertices: Array, points: Array, vectors: Array) -> bool:
    """Whether no vertex is behind any of the planes through ``points`` (k, 3) along ``vectors`` (k, 3)."""
    normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    heights = (normals * points).sum(axis=1, keepdims=True)
    planes = np.unique(np.round(np.hstack([normals, heights]), 6), axis=0)
    vertices = np.unique(vertices, axis=0)
    return all((vertices @ plane[:3] - plane[3] > -_BEHIND).all() for plane in planes)


def _tasks(patch: Index, n: int) -> list[Index]:
    """Ranges of the sides of ``n`` patches, each of whole patches and about equal work: the same for any number of
    threads, and more."""
    patch = patch[patch < n]
    starts = np.flatnonzero(np.diff(patch, prepend=-1))
    remaining = len(patch) - starts
    number = (1 - (remaining / len(patch)) ** 2) * _TASKS
    first = starts[np.flatnonzero(np.diff(number.astype(np.int64), prepend=-1))]
    return np.split(np.arange(len(patch)), first[1:])
