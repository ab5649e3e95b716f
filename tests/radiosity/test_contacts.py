"""Exact form factors of faces that lie on each other: contact, shared walls, doors on walls, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, joined, square
from support.tables import thinned

from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, Patches, RadiosityError, exact_form_factors, form_factors, scene_patches

ROOM = box((0, 0, 0), (4, 3, 2.5), 1, inward=True)
FLOOR, CEILING = 4, 5
#: Faces of a box.
BOTTOM, TOP = 4, 5


def matrix_of(*meshes, tolerance=1e-4, **properties):
    factors = exact_form_factors(Patches(*joined(*meshes), **properties), tolerance)
    return factors.matrix.toarray(), factors


def turned(mesh, seed=0, offset=(0.0, 0.0, 0.0)):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return mesh[0] @ (q * np.linalg.det(q)).T + np.array(offset), mesh[1]


def test_the_faces_of_the_helper():
    normals = Patches(*ROOM).normals
    assert normals[FLOOR, 2] == 1 and normals[CEILING, 2] == -1
    body = Patches(*box((0, 0, 0), (1, 1, 1), 1)).normals
    assert body[BOTTOM, 2] == -1 and body[TOP, 2] == 1


@pytest.mark.parametrize(
    "bodies",
    [
        pytest.param([((1, 1, 0), (1.7, 1.6, 1))], marks=pytest.mark.slow),
        pytest.param([((0, 0, 0), (0.7, 1.6, 1))], marks=pytest.mark.slow),  # in a corner: on three walls
        [((1, 1, 0), (1.7, 1.6, 1)), ((1.1, 1.2, 1), (1.9, 1.5, 1.8))],  # the upper one juts out
    ],
)
def test_boxes_on_floors_and_boxes_agree_with_lines(bodies):
    """Every row sums to 1; what is in contact sees each other and nothing else."""
    patches = Patches(*turned(joined(ROOM, *(box(*body, 2) for body in bodies)), 1, (5e5, 5e6, 0)))
    factors = exact_form_factors(patches)
    assert np.abs(factors.row_sums() - 1).max() < 6e-4 and np.abs(factors.sky).max() < 2e-4
    assert factors.reciprocity_error() < 1e-12
    lines = form_factors(ABuffer(patches, OwenSobol(4, seed=2)).cast(4096, warn=False))
    errors = np.hypot(lines.errors.toarray(), factors.errors.toarray())
    off = (lines.matrix - factors.matrix).toarray()
    z = off[errors > 0] / errors[errors > 0]
    assert np.abs(z).max() < 6 and np.mean(z**2) < 1.5
    assert np.abs(off[errors == 0]).max(initial=0) < 1e-8


def test_a_box_covers_its_place_on_the_floor():
    size = 0.7 * 0.6
    matrix, factors = matrix_of(ROOM, box((1, 1, 0), (1.7, 1.6, 1)))
    bottom = 6 + BOTTOM
    assert matrix[FLOOR, bottom] == pytest.approx(size / 12, rel=1e-9)
    np.testing.assert_allclose(matrix[bottom], np.eye(12)[FLOOR], atol=1e-9)
    assert not factors.dark.any() and factors.row_sums()[FLOOR] == pytest.approx(1, abs=1e-4)
    # Without its bottom, the inside of the box is dark.
    vertices, faces = box((1, 1, 0), (1.7, 1.6, 1))
    _, hollow = matrix_of(ROOM, (vertices, np.delete(faces, BOTTOM, axis=0)))
    assert hollow.dark[FLOOR] == pytest.approx(size / 12, rel=1e-3)
    open_air, factors = matrix_of(square((-2, -2, 0), (4, 0, 0), (0, 4, 0)), box((-0.3, -0.4, 0), (0.3, 0.4, 0.7)))
    assert open_air[1 + BOTTOM, 0] == pytest.approx(1) and factors.sky[1 + TOP] == 1


def test_rooms_that_share_walls_do_not_see_each_other():
    rooms = [box((k, 0, 0), (k + 1, 1, 1), 1 + k, inward=True) for k in range(3)]
    matrix, factors = matrix_of(*rooms)
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-7)
    start = 0
    for one in rooms:
        alone, _ = matrix_of(one)
        np.testing.assert_allclose(matrix[start : start + len(alone), start : start + len(alone)], alone, atol=1e-9)
        start += len(alone)
    low, high = rooms[0], box((0, 0, 1), (1, 1, 2.5), 1, inward=True)
    both, _ = matrix_of(low, high)
    np.testing.assert_allclose(both[:6, :6], matrix_of(low)[0], atol=1e-9)
    np.testing.assert_allclose(both[6:, 6:], matrix_of(high)[0], atol=1e-9)


@pytest.mark.parametrize("first", thinned([0, 1], [0]))
def test_three_faces_in_one_place(first):
    """A cupboard at a wall that two rooms share, and a box on the floor of the upper of two rooms: lines find an
    arbitrary order there. Each room is as if it was alone."""
    for other, room, body in (
        (((0, 0, 0), (1, 1, 1)), ((1, 0, 0), (2, 1, 1)), ((1, 0.3, 0), (1.3, 0.7, 0.8))),
        (((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 2.5)), ((0.2, 0.3, 1), (0.6, 0.7, 1.5))),
    ):
        rooms = [box(*other, 1, inward=True), box(*room, 1, inward=True)]
        matrix, factors = matrix_of(*(rooms if first == 0 else rooms[::-1]), box(*body), tolerance=1e-5)
        alone, _ = matrix_of(rooms[1], box(*body), tolerance=1e-5)
        here = np.r_[0:6, 12:18] if first else np.r_[6:18]
        np.testing.assert_allclose(matrix[np.ix_(here, here)], alone, atol=3e-5)
        np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-4)
        there = np.setdiff1d(np.arange(18), here)
        np.testing.assert_allclose(matrix[np.ix_(there, there)], matrix_of(rooms[0])[0], atol=1e-9)


def test_a_cupboard_that_covers_whole_patches_of_a_shared_wall():
    """Nothing but the rest of the walls tells which of them is behind which."""
    rooms, body = [box((k, 0, 0), (k + 1, 1, 1), 4, inward=True) for k in range(2)], box((1, 0.25, 0), (1.5, 0.75, 1))
    matrix, _ = matrix_of(*rooms, body, tolerance=1e-3)
    other = matrix_of(rooms[0])[0]
    np.testing.assert_allclose(matrix[:96, :96], other, atol=1e-7)
    assert matrix[:96, 96:].max() < 1e-8 and matrix[192:, 96:192].sum() > 1


def test_boxes_from_the_floor_to_the_ceiling():
    """By lines, too, of which some meet nothing but faces that lie on each other."""
    bodies = [box((1, 1, k), (2, 2, k + 1)) for k in range(2)]
    patches = Patches(*joined(box((0, 0, 0), (3, 3, 2), 1, inward=True), *bodies))
    engines = ABuffer(patches), ABuffer(patches, backend="drjit")
    for factors in exact_form_factors(patches), *(form_factors(engine.cast(256)) for engine in engines):
        matrix = factors.matrix.toarray()
        np.testing.assert_allclose(matrix[[6 + TOP, 12 + BOTTOM], [12 + BOTTOM, 6 + TOP]], 1, atol=1e-9)
        assert not factors.sky.any() and not factors.dark.any()


def door(gap, away=False):
    """On the wall y = 0 of a cube, seen from inside, or turned to the wall."""
    vertices, faces = square((0.3, gap, 0), (0, 0, 0.5), (0.4, 0, 0))
    return box((0, 0, 0), (1, 1, 1), 1, inward=True), (vertices, faces[:, ::-1] if away else faces)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("door_first", [False, True])
def test_a_door_covers_its_place_on_a_wall(two_sided, door_first, caplog):
    """As with a small gap; where it lies, the wall sees the back of the door."""
    found = []
    for gap in (0.0, 1e-5):
        meshes = door(gap)[:: -1 if door_first else 1]
        of_door = 0 if door_first else 6
        found.append(matrix_of(*meshes, two_sided=two_sided and np.arange(7) == of_door))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-4)
    wall = 2 + door_first
    assert found[0][1].dark[wall] == pytest.approx(0 if two_sided else 0.2, abs=1e-9)
    assert found[0][1].dark[of_door] == 0 and found[0][1].sky.max() == 0
    if two_sided:
        np.testing.assert_allclose(found[0][0][7], np.eye(8)[wall], atol=1e-9)
    else:
        assert "of exact form factors, the smaller" in caplog.text


def test_a_picture_on_a_door_on_a_wall():
    picture = square((0.4, 0, 0.1), (0, 0, 0.2), (0.1, 0, 0))
    matrix, factors = matrix_of(*door(0), picture)
    assert factors.dark[[2, 6, 7]] == pytest.approx([0.2, 0.1, 0])
    np.testing.assert_allclose(matrix.sum(axis=1) + factors.dark, 1, atol=1e-7)


def test_thin_plates_and_faces_given_twice():
    plate = square((1, 1, 1), (1, 0, 0), (0, 1, 0))
    back = square((1.2, 0.9, 1), (0, 1, 0), (1, 0, 0))
    matrix, factors = matrix_of(ROOM, plate, back, tolerance=1e-5)
    np.testing.assert_allclose(factors.row_sums() + factors.dark, 1, atol=1e-4)
    assert matrix[6, 7] == matrix[7, 6] == matrix[6, FLOOR] == matrix[7, CEILING] == 0
    twice, factors = matrix_of(ROOM, (ROOM[0], ROOM[1][::-1]))
    np.testing.assert_allclose(twice[:6, :6], matrix_of(ROOM)[0], atol=1e-9)
    assert not twice[6:].any() and factors.dark[6:] == pytest.approx(1)


def test_what_has_no_order_is_refused():
    sheets = square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0.2, 0.2, 0), (1, 0, 0), (0, 1, 0))
    with pytest.raises(RadiosityError, match="faces 0 and 1 lie on each other and have two sides"):
        matrix_of(*sheets, two_sided=True)
    many = [square((0, 0, 0), (1 + k / 10, 0, 0), (0, 1, 0)) for k in range(8)]
    with pytest.raises(RadiosityError, match="faces 1 and 2 lie on each other with 5 others"):
        matrix_of(*many)


def test_a_floor_that_cuts_a_box_sees_the_inside_of_it():
    """No corner of the floor is in the box; few points of a large triangle of the floor are."""
    vertices, faces = ROOM
    triangles = [half for face in faces for half in ([*face[:3]], [face[0], *face[2:]])]
    body = box((1.1, 1.2, -0.1), (1.7, 1.6, 0.9))
    patches = Patches(np.concatenate([vertices, body[0]]), [*triangles, *(body[1] + len(vertices)).tolist()])
    factors = exact_form_factors(patches)
    floor = np.flatnonzero((patches.normals[:, 2] > 0.9) & (patches.centres[:, 2] < 1e-9))
    assert (factors.dark * patches.areas)[floor].sum() == pytest.approx(0.6 * 0.4, abs=2e-3)
    assert np.abs((factors.row_sums() + factors.dark)[floor] - 1).max() < 1e-3


@pytest.mark.slow
def test_the_cornell_box():
    patches = scene_patches("cornell-box")
    exact, lines = exact_form_factors(patches), form_factors(ABuffer(patches).cast(1024, warn=False))
    for name in ("sky", "dark"):
        assert np.abs(getattr(exact, name) - getattr(lines, name)).max() < 2e-3
    assert np.abs((exact.matrix - lines.matrix).toarray()).max() < 2e-3
