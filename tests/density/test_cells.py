"""Cells of a box by place and facing: each point has one, and there are many where samples are."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from etendue.density import FACINGS, Cells

LOWER, UPPER = (-2.0, 0.0, 1.0), (6.0, 1.0, 3.0)
AXES = np.vstack([[axis, -axis] for axis in np.eye(3)])


def around(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points in the box, half of them in a corner of it, and normals."""
    random = np.random.default_rng(seed)
    place = random.random((count, 3))
    place[::2] *= 0.1
    normal = random.normal(size=(count, 3))
    return np.array(LOWER) + place * (np.array(UPPER) - LOWER), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def find(cells: Cells, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    p, n = (mi.Point3f(*a.T.astype(np.float32)) for a in (points, normals))
    return np.array(cells.find(p, mi.Vector3f(n)))


def grown(most: float = 500, rounds: int = 10) -> tuple[Cells, np.ndarray, np.ndarray]:
    cells = Cells(LOWER, UPPER)
    points, normals = around(100_000)
    for _ in range(rounds):
        cells.split(np.bincount(find(cells, points, normals), minlength=cells.count), most)
    return cells, points, normals


def test_at_first_there_is_a_cell_for_each_facing():
    cells = Cells(LOWER, UPPER)
    points, _ = around(600)
    for number, axis in enumerate(AXES):
        assert (find(cells, points, np.tile(axis, (600, 1))) == number).all()


def test_cells_are_many_where_samples_are():
    cells, points, normals = grown()
    counts = np.bincount(find(cells, points, normals), minlength=cells.count)
    assert cells.count > 200
    assert counts.max() <= 1.5 * 500  # halves are only taken to hold half of the samples
    corner = np.array(LOWER) + 0.05 * (np.array(UPPER) - LOWER)
    far = np.array(UPPER) - 0.05 * (np.array(UPPER) - LOWER)
    at_corner, at_far = find(cells, np.array([corner, far]), np.array([[0, 1, 0.0]] * 2))
    assert cells.level[at_corner] > cells.level[at_far] + 3


def test_the_origins_of_new_cells_hold_them():
    cells = Cells(LOWER, UPPER)
    points, normals = around(20_000)
    before = find(cells, points, normals)
    origin = cells.split(np.bincount(before, minlength=cells.count), 100)
    after = find(cells, points, normals)
    assert len(origin) == cells.count > 100
    np.testing.assert_array_equal(origin[after], before)
    np.testing.assert_array_equal(origin[:FACINGS], np.arange(FACINGS))


def test_a_cell_holds_what_lies_in_its_box():
    cells, points, normals = grown()
    number = find(cells, points, normals)
    low = cells.corner[number]
    size = cells._sizes[cells.level[number]]
    finest = (points - LOWER) / (np.array(UPPER) - LOWER) * cells._sizes[0]
    assert ((low - 1e-3 <= finest) & (finest <= low + size + 1e-3)).all()


def test_points_outside_and_in_a_flat_box_have_a_cell():
    cells, _, _ = grown()
    outside = np.array([[-100.0, 0.5, 2.0], [1e30, 1e30, -1e30], [6.0, 1.0, 3.0]])
    assert (find(cells, outside, np.array([[0, 0, 1.0]] * 3)) < cells.count).all()
    flat = Cells((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    flat.split(np.full(FACINGS, 1000), 100)
    points = np.random.default_rng(3).random((100, 3)) * [1, 0, 1]
    assert len(np.unique(find(flat, points, np.tile([0, 1.0, 0], (100, 1))))) == 16


@pytest.mark.parametrize("samples", [0, 1 << 40])
def test_cells_are_not_divided_for_nothing_nor_for_ever(samples):
    cells = Cells((0, 0, 0), (1, 1, 1))
    counts = np.zeros(FACINGS, np.int64)
    counts[2] = samples
    cells.split(counts, 1 << 24)
    assert cells.count == FACINGS - 1 + (1 << 16 if samples else 1)


def test_arrays_restore_the_cells():
    cells, points, normals = grown()
    again = Cells(LOWER, UPPER)
    again.set_arrays(cells.to_arrays())
    np.testing.assert_array_equal(find(again, points, normals), find(cells, points, normals))
