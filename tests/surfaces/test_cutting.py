"""Polygons with holes, cut into convex pieces."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.surfaces import PatchError
from etendue.surfaces.readers.cutting import cut_out
from etendue.surfaces.readers.polygons import cut_polygons

SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]


def placed(corners, turn, size=1.0, at=(0.0, 0.0)):
    """Corners of the plane in space: scaled, moved, and then turned about x."""
    x, y = (np.array(corners, float) * size + at).T
    return np.stack([x, y * np.cos(turn), y * np.sin(turn)], axis=1)


def vectors(pieces):
    """Area times normal."""
    return [np.cross(p - p[0], np.roll(p, -1, axis=0) - p[0]).sum(axis=0) / 2 for p in pieces]


@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi / 2])
def test_a_facade_of_windows(turn):
    """Of an L, with a window in each of its squares, alternately clockwise: the pieces face one way, do not overlap and
    are a fourth smaller."""
    ell = placed([(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)], turn)
    places = [(i, j) for i in range(6) for j in range(6) if i < 3 or j < 3]
    holes = [placed(SQUARE[:: (-1) ** k], turn, 0.5, np.add(at, 0.2)) for k, at in enumerate(places)]
    areas = np.array(vectors(cut_out("wall", ell, [(f"window {k}", hole) for k, hole in enumerate(holes)])))
    normal = np.array([0, -np.sin(turn), np.cos(turn)])
    np.testing.assert_allclose(areas, (areas @ normal)[:, None] * normal, atol=1e-12)
    assert (areas @ normal).min() > 0
    assert (areas @ normal).sum() == pytest.approx(27 - 27 / 4)


@pytest.mark.parametrize("step", [1e-3, 1e-2])
def test_walls_of_cities_are_rounded(step):
    """A wall of 10 by 6 m with a door on its lower edge and windows, in any position: what is left has the area that it
    should have within half a step along the outlines of all, 42 m."""
    random = np.random.default_rng(1)
    for _ in range(20):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        wall, *holes = (
            np.round((placed(SQUARE, 0, size, at) @ turn + [448000, 5411000, 30]) / step) * step
            for size, at in (([10, 6], (0, 0)), ([1, 2.1], (3, 0)), ([1.5, 1.2], (6, 1)), ([0.4, 0.4], (8, 4)))
        )
        areas = vectors(cut_out("wall", wall, [("hole", hole) for hole in holes]))
        assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(60 - 2.1 - 1.8 - 0.16, abs=42 * step / 2)


@pytest.mark.parametrize(
    ("holes", "message"),
    [
        ([placed(SQUARE, 0, 0.5, (0.7, 0.2))], "hole 0 is not inside, or overlaps another one in it"),
        ([placed(SQUARE, 0, 0.5, (2, 2))], "hole 0 is not inside"),
        ([placed(SQUARE, 0, 0.5, at) for at in ((0.1, 0.1), (0.4, 0.4))], "hole 1 is not inside, or overlaps another"),
        ([placed(SQUARE, 0.1, 0.5, (0.2, 0.2))], "hole 0 lies in another plane"),
        ([placed([(0, 0), (1, 1), (1, 0), (0, 2)], 0, 0.3, (0.2, 0.2))], "hole 0 crosses itself"),
    ],
)
def test_holes_that_are_no_holes(holes, message):
    with pytest.raises(PatchError, match=message):
        cut_out("square", placed(SQUARE, 0), [(f"hole {k}", hole) for k, hole in enumerate(holes)])


def test_an_outline_that_crosses_itself():
    with pytest.raises(PatchError, match="square crosses itself"):
        cut_out("square", placed([(0, 0), (2, 2), (2, 0), (0, 1)], 0), [("hole", placed(SQUARE, 0, 0.1))])


def test_holes_by_seams():
    """As Radiance writes holes: the outline goes to a hole, around it, and back on the same line."""
    outer = [(0, 0), (6, 0), (6, 3), (0, 3), (0, 0)]
    inner = [(1, 1), (1, 2), (2, 2), (2, 1), (4, 1), (4, 2), (5, 2), (5, 1), (4, 1), (2, 1), (1, 1)]
    points = placed(outer + inner, 0)
    faces, _ = cut_polygons(points, [list(range(len(points)))])
    areas = np.array(vectors(points[faces[:, :3]]))[:, 2]
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(16)
