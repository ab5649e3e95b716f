"""Form factors of random meshes, by lines and by integrals, against a plain Monte Carlo; or the mesh is refused, by a
message that names the face.

Meshes are made twice: as they are, in any place and orientation, and with small gaps between all faces that lie on each
other, for the Monte Carlo.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, Patches, RadiosityError, box, exact_form_factors, form_factors
from etendue.surfaces import PatchError

#: Half the least gap, beside sizes of some tenths and more.
GAP = 2e-5
RAYS = 1500
#: Tolerance of exact form factors, and bundles of lines.
TOLERANCE, BUNDLES = 1e-3, 256
FEW = settings(max_examples=10, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
MORE, MANY = settings(FEW, max_examples=40), settings(FEW, max_examples=250)


def monte_carlo(patches, seed):
    """Shares (n, n + 2) of what patches see: patches, the sky, and backs without a patch."""
    rng, n = np.random.default_rng(seed), len(patches)
    corners = patches.vertices[patches.faces]
    triangles, face = (
        np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]),
        np.tile(np.arange(len(corners)), 2),
    )
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normals = np.cross(u, v)
    areas = np.linalg.norm(normals, axis=1)
    normals, face, a, u, v = (x[areas > 0] for x in (normals, face, a, u, v))
    areas = areas[areas > 0]
    shares = np.zeros((n, n + 2))
    for patch in range(n):
        is_back = patch >= patches.fronts
        ours = np.where((patches.back if is_back else patches.front)[face] == patch, areas, 0.0)
        k = rng.choice(len(a), RAYS, p=ours / ours.sum())
        r, s, phi, sine2 = rng.random((4, RAYS))
        r, s = np.where(r + s > 1, 1 - r, r), np.where(r + s > 1, 1 - s, s)
        x = a[k] + r[:, None] * u[k] + s[:, None] * v[k]
        z = normals[k] / areas[k, None] * (-1 if is_back else 1)
        t = u[k] / np.linalg.norm(u[k], axis=1, keepdims=True)
        phi, sine = 2 * np.pi * phi[:, None], np.sqrt(sine2)[:, None]
        d = sine * (np.cos(phi) * t + np.sin(phi) * np.cross(z, t)) + np.sqrt(1 - sine2)[:, None] * z
        # Every ray against every triangle [Moeller and Trumbore 1997].
        p = np.cross(d[:, None], v)
        determinant = (p * u).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            to = x[:, None] - a
            one = (to * p).sum(axis=2) / determinant
            q = np.cross(to, u)
            two, distance = (q * d[:, None]).sum(axis=2) / determinant, (q * v).sum(axis=2) / determinant
            hit = (one >= 0) & (two >= 0) & (one + two <= 1) & (distance > 0) & (face != face[k][:, None])
        distance = np.where(hit, distance, np.inf)
        nearest = distance.argmin(axis=1)
        met = face[nearest]
        from_front = (patches.face_normals[met] * d).sum(axis=1) < 0
        seen = np.where(from_front, patches.front[met], patches.back[met])
        seen = np.where(np.isinf(distance.min(axis=1)), n, np.where(seen < 0, n + 1, seen))
        shares[patch] = np.bincount(seen, minlength=n + 2) / RAYS
    return shares


class Mesh:
    """Vertices, the same with gaps, and faces."""

    def __init__(self):
        self.vertices, self.apart, self.faces, self.two_sided = [], [], [], []

    def add(self, vertices, apart, faces, two_sided=False):
        start = sum(map(len, self.vertices))
        self.faces += [[start + k for k in face] for face in faces]
        self.two_sided += [two_sided] * len(faces)
        self.vertices.append(np.asarray(vertices, float))
        self.apart.append(np.asarray(apart, float))

    def patches(self, place, apart=False):
        scale, turn, offset = place
        vertices = np.concatenate(self.apart) if apart else scale * np.concatenate(self.vertices) @ turn.T + offset
        return Patches(vertices, self.faces, two_sided=self.two_sided)


@st.composite
def places(draw):
    """A size, a rotation and an offset, as of geo-referenced models."""
    turn = np.eye(3)
    if seed := draw(st.integers(0, 5)):
        q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
        turn = q * np.sign(np.diag(r))
        turn = turn * np.linalg.det(turn)
    offset = draw(st.sampled_from([(0, 0, 0), (5e5, 5e6, 0), (5e5, 5e6, 100)]))
    return draw(st.sampled_from([1.0, 7.3, 300.0])), turn, np.array(offset)


@st.composite
def rooms(draw):
    """One or two rooms with boxes in cells, which touch floors, walls and each other; a single room may lack walls.
    (Through an open wall the back of its neighbour's would be seen, and be in front of what stands at it.)"""
    mesh, cells = Mesh(), [(x, y, z) for x in range(3) for y in range(2) for z in range(2)]
    number_of_rooms = draw(st.integers(1, 2))
    for k in range(number_of_rooms):
        low, high = np.array([3.0 * k, 0, 0]), np.array([3.0 * k + 3, 2, 2])
        vertices, faces = box(low, high, 1, inward=True)
        missing = draw(st.sets(st.integers(0, 5), max_size=2)) if number_of_rooms == 1 else ()
        faces = [face for number, face in enumerate(faces.tolist()) if number not in missing]
        divided = draw(st.integers(0, len(faces) - 1))
        faces[divided : divided + 1] = [faces[divided][:3], [faces[divided][0], *faces[divided][2:]]]
        mesh.add(vertices, np.clip(vertices, low + GAP, high - GAP), faces)
        for cell in draw(st.sets(st.sampled_from(cells), max_size=3)):
            bottom = low + cell
            vertices, faces = box(bottom, bottom + 1, 1)
            mesh.add(vertices, np.clip(vertices, bottom + 2 * GAP, bottom + 1 - 2 * GAP), faces.tolist())
    return mesh


@st.composite
def polygons(draw):
    """Triangles, quadrilaterals that are flat or not, plates, faces given twice, and smaller ones on larger ones."""
    mesh = Mesh()
    for k in range(draw(st.integers(2, 7))):
        rng = np.random.default_rng([k, draw(st.integers(0, 10**6))])
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        angles = np.sort(rng.random(4)) * 1.2 + np.arange(4) * np.pi / 2
        count = draw(st.integers(3, 4))
        ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])[:count] @ q * rng.uniform(0.3, 1.5)
        ring += rng.uniform(-1, 1, 3)
        normal = np.cross(ring[1] - ring[0], ring[2] - ring[0])
        normal /= np.linalg.norm(normal)
        kind = draw(
            st.sampled_from(["alone", "alone", "two-sided", "bent", "plate", "door", "away", "twice", "no area"])
        )
        face, middle = list(range(count)), ring.mean(axis=0)
        small = middle + rng.uniform(0.3, 0.7) * (ring - middle)
        if kind == "bent":
            ring[-1] += 0.3 * normal
        if kind == "no area":
            ring[1:] = ring[0] + np.outer(np.arange(1, count), ring[1] - ring[0])
        mesh.add(ring, ring, [face], kind == "two-sided")
        if kind == "plate":
            mesh.add(ring, ring - GAP * normal, [face[::-1]])
        if kind == "twice":
            mesh.add(ring, ring - GAP * normal, [face])
        if kind in ("door", "away"):
            mesh.add(small, small + (GAP if kind == "door" else -GAP) * normal, [face[:: 1 if kind == "door" else -1]])
    return mesh


def check(mesh, place):
    try:
        patches, apart = mesh.patches(place), mesh.patches(place, apart=True)
    except PatchError as error:
        assert re.search(r"the first is face \d+|face \d+ crosses itself", str(error))
        return
    wanted = monte_carlo(apart, 1)
    try:
        n, found = len(patches), [exact_form_factors(patches, TOLERANCE)]
    except RadiosityError as error:
        assert re.search(r"faces \d+ and \d+", str(error))
        return
    if not len(patches.coincident.clashing):  # else a warning says that it is arbitrary
        found.append(form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(BUNDLES, warn=False)))
    for factors in found:
        shares = np.column_stack([factors.matrix.toarray(), factors.sky, factors.dark])
        spread = np.sqrt(
            np.maximum.reduce([wanted * (1 - wanted), shares * (1 - shares), 0 * shares + 2 / RAYS]) / RAYS
        )
        errors = np.zeros((n, n + 2))
        errors[:, :n] = factors.errors.toarray()
        errors[:, n:] = factors.row_errors()[:, None]
        off = np.abs(shares - wanted) / np.hypot(spread, errors)
        i, j = np.unravel_index(off.argmax(), off.shape)
        assert off[i, j] < 5.5, (i, j, n, shares[i, j], wanted[i, j], errors[i, j])


@pytest.mark.slow
@given(mesh=rooms(), place=places())
@FEW
def test_rooms_with_boxes(mesh, place):
    check(mesh, place)


@given(mesh=polygons(), place=places())
@MORE
def test_polygons(mesh, place):
    check(mesh, place)


@pytest.mark.slow
@given(mesh=st.one_of(rooms(), polygons()), place=places())
@MANY
def test_many_meshes(mesh, place):
    check(mesh, place)
