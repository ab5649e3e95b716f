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

from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, Patches, RadiosityError, exact_form_factors, form_factors


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
    with pytest.raises(RadiosityError, match="face 6 stands between faces"):
        exact_form_factors(Patches(*joined(walls, sheet), two_sided=np.arange(7) == 6))
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


def test_what_is_hidden_is_refused():
    two, other = square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))
    # A small screen in a corner of the space between two plates; beside it nothing is hidden.
    for x, is_hidden in ((0.9, True), (1.001, False)):
        patches = Patches(*joined(two, other, square((x, 0.9, 0.5), (0.5, 0, 0), (0, 0.5, 0))))
        if is_hidden:
            with pytest.raises(RadiosityError, match=r"face 2 stands between faces 0 and 1.*cast lines"):
                exact_form_factors(patches)
        else:
            assert exact_form_factors(patches).matrix.todense()[0, 1] == pytest.approx(opposite(1, 1), abs=1e-8)
    with pytest.raises(RadiosityError, match="stands between"):
        exact_form_factors(room(1))
    on_the_floor = joined(box((0, 0, 0), (1, 1, 1), 1, inward=True), box((0.2, 0.2, 0), (0.5, 0.5, 0.5)))
    with pytest.raises(RadiosityError, match="faces 4 and 10 lie on each other"):
        exact_form_factors(Patches(*on_the_floor))


def test_more_than_memory_holds(monkeypatch):
    monkeypatch.setattr("etendue.radiosity.factors.exact.free_memory", lambda: 1000.0)
    with pytest.raises(RadiosityError, match="cast lines"):
        exact_form_factors(cube(1))
