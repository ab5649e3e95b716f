"""Rays that start where faces lie on each other: what they meet is the other face."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from support.patches import box, joined, square

import etendue
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    LocalRays,
    Patches,
    RadiosityError,
    RayScene,
    area_form_factors,
    exact_form_factors,
    first_shot,
    form_factors,
    local_form_factors,
    with_local_rays,
)

FLOOR = square((-2, -2, 0), (4, 0, 0), (0, 4, 0))
#: Faces of a box.
BOTTOM, TOP = 4, 5


def turned(mesh, seed=0):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return mesh[0] @ (q * np.linalg.det(q)).T, mesh[1]


def rays(patches, count=1 << 12, **options):
    return local_form_factors(RayScene(patches), count, points=Independent(4, seed=3), **options)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_box_and_the_floor_under_it_see_each_other(seed):
    patches = Patches(*turned(joined(FLOOR, box((-1, -1, 0), (1, 1, 1))), seed))
    for estimator in ("cosine", "angles"):
        factors = rays(patches, estimator=estimator)
        matrix, errors = factors.matrix.toarray(), factors.errors.toarray()
        assert abs(matrix[0, 1 + BOTTOM] - 0.25) < 5 * errors[0, 1 + BOTTOM] < 0.06
        assert np.flatnonzero(matrix[1 + BOTTOM]).tolist() == [0] and factors.dark.max() == 0
        assert abs(matrix[1 + BOTTOM, 0] - 1) <= 5 * errors[1 + BOTTOM, 0]
        if estimator == "cosine":
            assert matrix[1 + BOTTOM, 0] == pytest.approx(1, abs=1e-12) and factors.sky[1 + TOP] == 1


@pytest.mark.parametrize(
    "bodies",
    [
        [((1, 1, 0), (1.7, 1.6, 2.5))],  # from the floor to the ceiling
        [((0, 0, 0), (0.7, 1.6, 1))],  # in a corner: on three walls
        [((1, 1, 0), (1.7, 1.6, 1)), ((1.1, 1.2, 1), (1.9, 1.5, 1.8))],  # the upper one juts out
    ],
)
def test_rays_agree_with_exact_factors(bodies):
    room = box((0, 0, 0), (4, 3, 2.5), 2, inward=True)
    patches = Patches(*turned(joined(room, *(box(*body, 1 + k) for k, body in enumerate(bodies)))))
    exact, found = exact_form_factors(patches), rays(patches, 1 << 11)
    # Faces are set apart by a millionth of the radius: some rays in a million pass an edge.
    assert (found.sky + found.dark).max() <= 2 / (1 << 11)
    p, off = np.clip(exact.matrix.toarray(), 0, 1), (found.matrix - exact.matrix).toarray()
    errors = np.sqrt(p * (1 - p) / (1 << 11) + 1e-8)
    many = p > 0.005
    assert np.abs(off[many] / errors[many]).max() < 5 and np.mean((off[many] / errors[many]) ** 2) < 1.3
    assert np.abs(off[~many]).max() < 6 * np.sqrt(0.005 / (1 << 11))


@pytest.mark.parametrize("two_sided", [False, True])
def test_a_wall_sees_the_back_of_a_door_on_it(two_sided):
    door = square((0.3, 0, 0), (0, 0, 0.5), (0.4, 0, 0))
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), door), two_sided=two_sided & (np.arange(7) == 6))
    factors = rays(patches)
    behind = factors.matrix.toarray()[2, 7] if two_sided else factors.dark[2]
    assert abs(behind - 0.2) < 5 * np.sqrt(0.2 * 0.8 / (1 << 12))
    assert factors.dark[6] == 0
    if two_sided:
        assert factors.matrix[7, 2] == pytest.approx(1, abs=1e-12)
    else:
        # Lines see both, and so must rays among them.
        assert LocalRays(RayScene(patches)).cast(1 << 14).dark.max() < 0.2 / 6


def test_rooms_that_share_a_wall_and_thin_plates_do_not_see_each_other():
    rooms = [box((k, 0, 0), (k + 1, 1, 1), 1, inward=True) for k in range(2)]
    plate = square((0.2, 0.2, 0.5), (0.5, 0, 0), (0, 0.5, 0)), square((0.2, 0.2, 0.5), (0, 0.5, 0), (0.5, 0, 0))
    factors = rays(Patches(*joined(*rooms, *plate)))
    matrix = factors.matrix.toarray()
    first, second = [*range(6), 12, 13], list(range(6, 12))
    assert not matrix[np.ix_(first, second)].any() and not matrix[np.ix_(second, first)].any()
    assert matrix[12, 13] == matrix[13, 12] == factors.sky.max() == factors.dark.max() == 0


def small_box(**properties):
    """On the floor of a cube, whose floor is patch 4; the last six patches."""
    body = box((0.3, 0.3, 0), (0.32, 0.32, 0.02))
    return Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), body), **properties)


def test_local_rays_of_small_boxes_on_a_floor():
    """Lines alone know what touches; rays that complete them must not change it."""
    patches = small_box()
    lines = ABuffer(patches, OwenSobol(4), 400).cast(64, warn=False)
    mixed = with_local_rays(lines)
    assert mixed.extra[6 + BOTTOM] > 0
    for factors in form_factors(mixed), form_factors(LocalRays(RayScene(patches)).cast(1 << 17)):
        matrix = factors.matrix.toarray()
        assert matrix[6 + BOTTOM, 4] == pytest.approx(1, abs=1e-12)
        assert factors.sky.max() == factors.dark.max() == 0


def test_where_no_face_is_known_to_be_in_front(caplog):
    sheets = square((0.3, 0.3, 0.5), (0.02, 0, 0), (0, 0.02, 0)), square((0.31, 0.31, 0.5), (0.02, 0, 0), (0, 0.02, 0))
    body = box((0.3, 0.3, 0), (0.32, 0.32, 0.02))
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), body, *sheets), two_sided=np.arange(14) > 11)
    with pytest.raises(RadiosityError, match="faces 12 and 13 lie on each other and have two sides"):
        rays(patches)
    assert rays(patches, rows=[0, 1]).row_sums()[:2] == pytest.approx(1)  # none of these rows
    lines = ABuffer(patches, OwenSobol(4), 400).cast(64, warn=False)
    with caplog.at_level(logging.WARNING, logger="etendue"):
        mixed = with_local_rays(lines)
    assert "get no local rays: faces 12 and 13" in caplog.text
    assert mixed.extra[6 + BOTTOM] == 0 and mixed.extra[6 + TOP] > 0


def test_rays_warn_of_backs(caplog):
    with caplog.at_level(logging.WARNING, logger="etendue"):
        rays(Patches(*box((0, 0, 0), (1, 1, 1), inward=True)), 64)
        assert not caplog.records
        vertices, faces = box((0, 0, 0), (1, 1, 1), inward=True)
        rays(Patches(vertices, np.concatenate([faces[:5], faces[5:, ::-1]])), 64)
    assert "of what patches see is backs of faces" in caplog.text


def test_pairs_in_a_period_are_refused():
    patches = Patches(*FLOOR, periodic=(4, 4))
    with pytest.raises(RadiosityError, match="form factors of pairs cannot repeat a periodic domain"):
        area_form_factors(RayScene(patches), [[0, 0]], 8)


def test_light_between_solids_that_touch_is_not_lost():
    """All light of a bottom reaches the floor: in one shot, and in a solution."""
    patches = small_box(reflectance=0.5, emission=np.arange(12) == 6 + BOTTOM)
    area = 0.02**2
    shot = first_shot(RayScene(patches), OwenSobol(4).block(256))
    assert shot.irradiance[4, 0] == pytest.approx(area) and shot.to_sky[0] == 0
    solution = etendue.solve_radiosity(patches, bundles=16).solution
    # By exact factors, of which a few bundles leave an error below a thousandth for the floor.
    leaving = np.linalg.solve(np.eye(12) - 0.5 * exact_form_factors(patches).matrix.toarray(), patches.emission)
    assert solution.irradiance[4, 0] == pytest.approx(leaving[4, 0] / 0.5, rel=0.01)
