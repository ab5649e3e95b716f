"""Exact form factors: closed forms, closure, horizons, agreement with lines, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import (
    adjacent,
    box,
    cube,
    discs,
    joined,
    opposite,
    parallel_squares,
    perpendicular_squares,
    room,
    square,
)
from support.tables import thinned

from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    area_form_factors,
    exact_form_factors,
    form_factors,
)
from etendue.radiosity.compiling import compiled
from etendue.radiosity.factors.occluders import occluders


def rotated(vertices):
    turn = np.array([[0.36, 0.48, 0.8], [-0.8, 0.6, 0], [-0.48, -0.64, 0.6]])
    return 7.0 * vertices @ turn + np.array([30.0, -20.0, 5.0])


@pytest.mark.parametrize("mesh", [parallel_squares, perpendicular_squares])
@pytest.mark.parametrize("place", [lambda v: v, rotated])
def test_squares(mesh, place):
    (vertices, faces), exact = mesh()
    factors = exact_form_factors(Patches(place(vertices), faces))
    np.testing.assert_allclose(factors.matrix.todense(), [[0, exact], [exact, 0]], atol=1e-8)
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-12)


@pytest.mark.parametrize("h, w", [(1e-3, 1.0), (0.1, 10.0), (3.0, 0.02)])
def test_slender_rectangles(h, w):
    """Rectangles at a right angle and rectangles that face each other closely."""
    low, high = square((0, 0, 0), (0, w, 0), (-1, 0, 0)), square((0, 0, 0), (-1, 0, 0), (0, 0, h))
    low = (low[0], low[1][:, ::-1])
    factors = exact_form_factors(Patches(*joined((low[0], low[1][:, ::-1]), high)))
    assert factors.matrix.todense()[0, 1] == pytest.approx(adjacent(h, w), abs=1e-7)
    plates = joined(square((0, 0, 0), (1, 0, 0), (0, h, 0)), square((0, 0, w), (0, h, 0), (1, 0, 0)))
    assert exact_form_factors(Patches(*plates)).matrix.todense()[0, 1] == pytest.approx(
        opposite(1 / w, h / w), abs=1e-8
    )


def test_discs():
    """Fans of triangles. A polygon is no circle: with 64 and 128 corners and the same area, errors are as 16 to 1."""
    off = []
    for sides in (64, 128):
        (vertices, faces), exact = discs(sides)
        factors = exact_form_factors(Patches(vertices, faces, ids=np.repeat([0, 1], sides)))
        matrix = factors.matrix.todense()
        assert matrix[0, 1] == pytest.approx(matrix[1, 0], rel=1e-12) and matrix[0, 0] == 0
        off.append(matrix[0, 1] - exact)
    assert abs(off[1]) < 1e-7 and 8 < off[0] / off[1] < 32


def test_a_closed_room_of_triangles_and_quadrilaterals():
    vertices, faces = box((0, 0, 0), (1, 2, 3), (3, 2, 4), inward=True)
    mixed = [list(f) for f in faces[10:]] + [f for q in faces[:10] for f in ([*q[:3]], [q[0], q[2], q[3]])]
    patches = Patches(rotated(vertices), mixed)
    factors = exact_form_factors(patches)
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-7)
    assert not factors.sky.any() and factors.reciprocity_error() < 1e-12
    assert factors.errors.nnz == factors.matrix.nnz and not factors.errors.data.any()
    single = exact_form_factors(Patches(patches.vertices.astype(np.float32), mixed))
    np.testing.assert_allclose(single.row_sums(), 1, atol=3e-6)


def test_subdivision_does_not_change_what_walls_exchange():
    fine = exact_form_factors(cube(4))
    coarse = np.add.reduceat(fine.matrix.todense(), np.arange(0, 96, 16), axis=1)
    coarse = np.add.reduceat(coarse, np.arange(0, 96, 16), axis=0) / 16
    np.testing.assert_allclose(coarse, exact_form_factors(cube(1)).matrix.todense(), atol=1e-8)


def test_what_is_behind_the_horizon_does_not_count():
    """A plate that reaches below the floor is, to the floor, what is above of it."""
    floor = square((0, 0, 0), (1, 0, 0), (0, 1, 0))
    through = exact_form_factors(Patches(*joined(floor, square((0, 0, -3), (0, 1, 0), (0, 0, 4)))))
    assert through.matrix.todense()[0, 1] == pytest.approx(adjacent(1, 1), abs=1e-8)
    assert through.matrix.todense()[1, 0] == pytest.approx(adjacent(1, 1) / 4, abs=1e-8)


def test_a_body_on_the_floor_agrees_with_lines():
    """A box beside two plates, open to the sky: nothing of it hides one thing from another."""
    body = box((-0.4, -0.3, 0), (0.3, 0.5, 0.8), 2)
    floor = square((-2, -2, 0), (1.6, 0, 0), (0, 4, 0)), square((0.3, -2, 0), (1.7, 0, 0), (0, 4, 0))
    patches = Patches(*joined(body, *floor))
    exact = exact_form_factors(patches)
    lines = form_factors(ABuffer(patches, OwenSobol(4, seed=2), 4096).cast(1024))
    assert np.abs((exact.matrix - lines.matrix).todense()).max() < 4e-3
    np.testing.assert_allclose(exact.sky, lines.sky, atol=4e-3)
    assert exact.sky.max() > 0.9 > 0.6 > exact.sky.min()


def test_a_funnel_sees_itself():
    """As one patch: what leaves it does so through its opening."""
    angle = 2 * np.pi * np.arange(12) / 12
    vertices = np.vstack([[0, 0, -1], np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)])])
    k = np.arange(12)
    patches = Patches(vertices, np.column_stack([0 * k, k + 1, (k + 1) % 12 + 1]), ids=0 * k)
    opening = 6 * np.sin(2 * np.pi / 12)
    factors = exact_form_factors(patches)
    assert factors.sky[0] == pytest.approx(opening / patches.areas[0], abs=1e-8)
    assert factors.matrix.todense()[0, 0] == pytest.approx(1 - opening / patches.areas[0], abs=1e-8)


def test_sheets_have_two_sides():
    walls = box((0, 0, 0), (1, 1, 1), 1, inward=True)
    sheet = square((0, 0, 0.5), (1, 0, 0), (0, 1, 0))
    # The sheet hides the floor from the ceiling; above and below there is half a room each.
    halves = exact_form_factors(Patches(*joined(walls, sheet), two_sided=np.arange(7) == 6), 1e-6)
    np.testing.assert_allclose(halves.row_sums(), 1, atol=1e-5)
    level = np.flatnonzero(Patches(*walls).centres[:, 2] % 1 == 0)
    assert halves.matrix.todense()[level[0], level[1]] == 0
    for side in (6, 7):
        seen = halves.matrix.todense()[side, level]
        np.testing.assert_allclose(np.sort(seen), [0, opposite(2, 2)], atol=1e-6)
    apart = Patches(*joined(sheet, square((0, 0, 1), (0, 1, 0), (1, 0, 0))), two_sided=True)
    factors = exact_form_factors(apart).matrix.todense()
    np.testing.assert_allclose(factors[0], [0, opposite(2, 2), 0, 0], atol=1e-8)
    assert not factors[2:].any()


def test_backs_are_dark():
    """A plate that turns its back takes the light, and is not the sky."""
    (vertices, faces), exact = parallel_squares()
    faces[1] = faces[1][::-1]
    factors = exact_form_factors(Patches(vertices, faces))
    assert factors.matrix.nnz == 0
    np.testing.assert_allclose(factors.sky, [1 - exact, 1], atol=1e-8)


def plates(screen, place, **named):
    """Two unit squares face to face, and a square screen between them."""
    low, high = square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))
    return Patches(*joined(low, high, square((*place, 0.5), (screen, 0, 0), (0, screen, 0))), **named)


def test_a_screen_between_plates():
    """What a screen half way hides is a form factor, too: rays between the plates through it are those between its
    opposite images. In the corner of a screen as large as the plates, nothing is left."""
    free = opposite(1, 1)
    assert exact_form_factors(plates(0.5, (1.001, 0.9))).matrix.todense()[0, 1] == pytest.approx(free, abs=1e-8)
    assert exact_form_factors(plates(1.0, (0, 0))).matrix.todense()[0, 1] == 0
    # Of F(low, screen) A, all that arrives at the screen from below left for the upper plate, or for outside of it.
    for screen, place in ((0.4, (0.3, 0.3)), (0.5, (0.9, 0.9)), (0.8, (0.1, 0.3))):
        patches = plates(screen, place)
        fine = exact_form_factors(patches, 1e-6).matrix.todense()[0, 1]
        for tolerance in (1e-2, 1e-3, 1e-4, 1e-5):
            found = exact_form_factors(patches, tolerance)
            off, estimate = abs(found.matrix.todense()[0, 1] - fine), found.errors.todense()[0, 1]
            assert off <= max(estimate, 1e-6) and off <= 4 * tolerance, (screen, tolerance)
            np.testing.assert_allclose(found.reciprocity_error(), 0, atol=1e-12)
        drawn = np.random.default_rng(1).random((2, 400_000, 2))
        a, b = (np.column_stack([points, np.full(len(points), float(z))]) for z, points in enumerate(drawn))
        d = b - a
        middle, r2 = (a + b)[:, :2] / 2, (d**2).sum(axis=1)
        blocked = ((middle > place) & (middle < np.array(place) + screen)).all(axis=1)
        values = np.where(blocked, 0, d[:, 2] ** 2 / (np.pi * r2**2))
        assert abs(values.mean() - fine) < 4.5 * values.std() / np.sqrt(len(values))


def test_rooms_with_boxes_are_closed():
    walls = box((0, 0, 0), (2, 2, 2), 2, inward=True)
    inner = [box((0.2, 0.3, 0.1), (0.7, 0.9, 1.1), 1), box((1.1, 1.2, 0.3), (1.6, 1.7, 0.8), 1)]
    patches = Patches(*joined(walls, *inner))
    for tolerance in (1e-2, 1e-3, 1e-5):
        factors = exact_form_factors(patches, tolerance)
        off = factors.row_sums() - 1
        assert np.sqrt(np.mean(off**2)) <= tolerance
        assert np.mean(off**2) <= 1.5 * np.mean(factors.row_errors() ** 2)
    lines = form_factors(ABuffer(patches, OwenSobol(4, seed=2)).cast(1024))
    errors = lines.errors.todense()
    z = (lines.matrix.todense() - factors.matrix.todense())[errors > 0] / errors[errors > 0]
    assert np.abs(z).max() < 5 and np.mean(z**2) < 1.3


def test_what_is_sampled_has_no_bias():
    """Pairs hidden in part, from one point to some, against the same integrals to a tolerance; over pairs, the errors
    sum to less than three of their standard errors."""
    patches = room(5)
    fine = exact_form_factors(patches, 3e-4).matrix.todense()
    for tolerance in (3e-2, 1e-2):
        coarse = exact_form_factors(patches, tolerance)
        off, errors = (np.triu(a) for a in (coarse.matrix.todense() - fine, coarse.errors.todense()))
        is_sampled = errors > 1e-6
        exchanged = off[is_sampled] * np.broadcast_to(patches.areas[:, None], off.shape)[is_sampled]
        assert is_sampled.sum() > 1000
        assert abs(exchanged.sum()) < 3 * np.sqrt((exchanged**2).sum())
        assert 0.3 < np.mean(off[is_sampled] ** 2) / np.mean(errors[is_sampled] ** 2) < 1.5


def test_a_chequered_screen_between_plates():
    """Half of the light between two plates is left, as a quarter turn exchanges the squares and the gaps; close to a
    plate it sees more pieces between 578 squares than there is room for."""
    low, high = square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))
    z = []
    for n, height in [(12, k / 20) for k in range(4, 17)] + [(34, 0.05)]:
        cells = [(i / n, j / n, height) for i in range(n) for j in range(n) if (i + j) % 2 == 0]
        patches = Patches(*joined(low, high, *(square(cell, (1 / n, 0, 0), (0, 1 / n, 0)) for cell in cells)))
        found = exact_form_factors(patches, 1e-2)
        z.append((found.matrix[0, 1] - opposite(1, 1) / 2) / found.errors[0, 1])
    assert 3 < np.sum(np.square(z)) < 36  # chi-square of 14 values, 0.001 to either side


@pytest.mark.slow
def test_distant_pairs_by_points():
    """Triangles, against Gauss's rule of 12 x 12 points, within the error for which their distance is asked."""
    rules, random = compiled("factors.distant"), np.random.default_rng(3)
    x, w = np.polynomial.legendre.leggauss(12)
    u, v = (a.ravel() for a in np.meshgrid((x + 1) / 2, (x + 1) / 2))
    weights = np.outer(w, w).ravel() / 4 * u  # of a triangle: (u, v) to a + u ((1 - v) b + v c)

    def triangle():
        corners = random.normal(size=(3, 3))
        corners -= corners.mean(axis=0)
        corners /= np.linalg.norm(corners[:, None] - corners, axis=2).max()
        return corners

    for error in (1e-3, 1e-5, 1e-7):
        worst = np.zeros(3)
        for k in range(300):
            rule, (p, q) = k % 3, (triangle(), triangle())
            distance, way = np.sqrt(rules.least_distances(error)[rule]), random.normal(size=3)
            q += distance * way / np.linalg.norm(way)
            n, m = (np.cross(a[1] - a[0], a[2] - a[0]) for a in (p, q))
            sides = np.stack([a[[0, 1, 2, 2]] for a in (p, q)])
            grid = [a[0] + u[:, None] * ((1 - v)[:, None] * (a[1] - a[0]) + v[:, None] * (a[2] - a[0])) for a in (p, q)]
            r = grid[1][None] - grid[0][:, None]
            exact = -(weights[:, None] * weights * (r @ n) * (r @ m) / (r**2).sum(axis=2) ** 2).sum() / np.pi
            of = [np.append(a, 0.0) / np.linalg.norm(a) for a in (n, m)]
            nodes = rules.nodes_of(sides)
            sizes = nodes[:, :4, 3].sum(axis=1)
            np.testing.assert_allclose(sizes, [np.linalg.norm(a) / 2 for a in (n, m)], rtol=1e-12)
            sign = -1.0 if exact < 0 else 1.0  # as if both faced each other
            found = rules.of_nodes(nodes[0], of[0], nodes[1], sign * of[1], rule)
            worst[rule] = max(worst[rule], abs(found - abs(exact)) / (sizes.prod() / (np.pi * distance**2)))
        assert (worst > error / 100).all() and (worst <= error).all(), (error, worst)


def test_coplanar_occluders_are_joined():
    """The faces of a divided box, quadrilaterals or triangles, are its six sides."""
    vertices, quads = box((0.2, 0.3, 0.1), (0.7, 0.9, 1.1), (3, 4, 5))
    triangles = np.concatenate([quads[:, [0, 1, 2, 2]], quads[:, [0, 2, 3, 3]]])
    walls = box((-1, -1, -1), (2, 2, 2), 1, inward=True)
    for faces in (quads, triangles):
        corners = np.concatenate([vertices[faces], walls[0][walls[1]]])
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        planes = np.column_stack([normals, (normals * corners[:, 0]).sum(axis=1)])
        np.testing.assert_allclose(np.sort(occluders(corners, planes).areas), [0.3, 0.3, 0.5, 0.5, 0.6, 0.6])


@pytest.mark.parametrize("is_crossing", [False, True])
@pytest.mark.parametrize("seed", thinned(range(3), [0]))
def test_random_triangles(seed, is_crossing):
    """Triangles that hide each other in any way, against rays between points of two, whose variance is finite if they
    do not touch; and those that cross each other, against lines."""
    random = np.random.default_rng(seed)
    cells = np.array([(x, y, z) for x in range(2) for y in range(2) for z in range(3)], float)
    away = random.normal(size=(12, 3, 3))
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    corners = cells[:, None] * 0.5 + 0.6 * away if is_crossing else cells[:, None] + 0.48 * away
    patches = Patches(corners.reshape(-1, 3), np.arange(36).reshape(12, 3), two_sided=True)
    factors = exact_form_factors(patches, 1e-5).matrix.todense()
    if is_crossing:
        lines = form_factors(ABuffer(patches, OwenSobol(4, seed=seed)).cast(2048))
        errors = lines.errors.todense()
        z = (lines.matrix.todense() - factors)[errors > 0] / (errors[errors > 0] + 2e-5)
        assert np.mean(z**2) < 1.5 and np.abs(z).max() < 6
        return
    pairs = np.array([(i, j) for i in range(24) for j in range(24) if i != j])
    values, errors = area_form_factors(RayScene(patches), pairs, 1 << 14, OwenSobol(4, seed=seed))
    z = (values - factors[tuple(pairs.T)]) / np.maximum(errors, 1e-5)
    assert np.abs(z).max() < 5 and (factors > 1e-4).sum() > 100


def test_what_is_refused():
    with pytest.raises(RadiosityError, match="tolerance of form factors is above 0"):
        exact_form_factors(room(1), 0)


def test_more_than_memory_holds(monkeypatch):
    monkeypatch.setattr("etendue.radiosity.factors.exact.free_memory", lambda: 1000.0)
    with pytest.raises(RadiosityError, match="cast lines"):
        exact_form_factors(cube(1))
