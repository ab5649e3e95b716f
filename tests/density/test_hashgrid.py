"""The hash grid finds exactly the neighbours that a comparison of all pairs finds, each once."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.density import HashGrid

#: Pairs whose distance is this near to the radius, relative, are left to rounding.
EDGE = 1e-4


def device(points: np.ndarray) -> Any:
    return mi.Point3f(np.ascontiguousarray(points.T, np.float32))


def found(
    points: np.ndarray, queries: np.ndarray, radius: float, box: Any = None, active: Any = True
) -> list[list[int]]:
    """Indices of the points that each query accepts, with repetitions if there are any."""
    lower, upper = box if box is not None else (points.min(0), points.max(0))
    grid = HashGrid(device(points), radius, lower, upper, active)
    mask = np.broadcast_to(np.asarray(active), len(points))
    destination = np.array(grid.destination)[mask]
    assert sorted(destination) == list(range(mask.sum())), "destinations are a permutation"
    original = np.full(len(points), -1)
    original[destination] = np.arange(len(points))[mask]
    by_place = device(points[original])
    pairs = dr.zeros(mi.UInt32, len(points) * len(queries))  # how often each query visits each point
    lane = dr.arange(mi.UInt32, len(queries))

    def visit(place: Any, visits: Any) -> Any:
        dr.scatter_reduce(dr.ReduceOp.Add, pairs, mi.UInt32(1), lane * len(points) + place)
        return visits + 1

    visits = grid.within(
        device(queries),
        lambda place: (dr.gather(mi.Point3f, by_place, place), mi.Bool(True)),
        visit,
        dr.zeros(mi.UInt32, len(queries)),
        mi.Bool(True),
    )
    dr.eval(visits, pairs)
    counts = np.array(pairs).reshape(len(queries), len(points))
    assert (counts.sum(1) == np.array(visits)).all()
    result = [np.repeat(original, row).tolist() for row in counts]
    return result


def assert_exact(points: np.ndarray, queries: np.ndarray, radius: float, box: Any = None, active: Any = True) -> int:
    """Compare with all pairs; returns how many pairs there were."""
    points, queries = points.astype(np.float32), queries.astype(np.float32)
    results = found(points, queries, radius, box, active)
    mask = np.broadcast_to(np.asarray(active), len(points))
    pairs = 0
    for query, indices in zip(queries, results, strict=True):
        assert len(indices) == len(set(indices)), f"a point was found twice from {query}"
        distance = np.linalg.norm(points.astype(np.float64) - query, axis=1)
        surely = set(np.flatnonzero((distance < radius * (1 - EDGE)) & mask))
        perhaps = set(np.flatnonzero((distance < radius * (1 + EDGE) + 1e-30) & mask))
        assert surely <= set(indices) <= perhaps, f"radius {radius} at {query}: {surely} is not {set(indices)}"
        pairs += len(surely)
    return pairs


def cloud(kind: str, random: np.random.Generator, n: int = 600) -> np.ndarray:
    """Points by kind, some thousand times their own size from each other or all in one place."""
    uniform = random.uniform(-1, 1, (n, 3))
    match kind:
        case "uniform":
            return uniform
        case "clusters":
            return random.uniform(-1, 1, (6, 3))[random.integers(6, size=n)] + random.normal(0, 0.02, (n, 3))
        case "plane x":
            return uniform * [0, 1, 1] + [0.3, 0, 0]
        case "plane y":
            return uniform * [1, 0, 1] - [0, 5, 0]
        case "plane z":
            return uniform * [1, 1, 0]
        case "line":
            return uniform * [1, 0, 0] + [10, 20, 30]
        case "one place":
            return np.tile([[0.25, -0.5, 0.75]], (n, 1))
        case "single":
            return np.array([[1.0, 2.0, 3.0]])
        case "far away":
            return uniform + np.array([300.0, -200.0, 100.0])
        case _:
            raise AssertionError(kind)


KINDS = ("uniform", "clusters", "plane x", "plane y", "plane z", "line", "one place", "single", "far away")


@pytest.mark.parametrize("radius", [0.03, 0.11, 0.4])
@pytest.mark.parametrize("kind", KINDS)
def test_the_neighbours_are_exact(kind, radius):
    random = np.random.default_rng(7)
    points = cloud(kind, random)
    near = points[random.integers(len(points), size=40)] + random.normal(0, radius / 2, (40, 3))
    queries = np.clip(np.concatenate([near, points[:10]]), points.min(0), points.max(0))
    assert assert_exact(points, queries, radius) > 0


@pytest.mark.parametrize("radius", [1e-6, 50.0])
def test_a_tiny_and_a_huge_radius(radius):
    random = np.random.default_rng(3)
    points = random.uniform(-1, 1, (300, 3))
    pairs = assert_exact(points, points[:30], radius)
    assert pairs == (30 if radius < 1 else 30 * 300)


def test_points_on_the_borders_of_cells():
    """A lattice whose step is a cell, or half of one: every point lies on a border."""
    radius = 0.125  # cells of 0.25, exact in binary
    axis = np.arange(0, 9) * 0.125
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    off = np.array([0.03, 0.06, 0.09])
    queries = np.concatenate([points[::11], np.clip(points[::13] + off, 0, 1), np.clip(points[::17] - off, 0, 1)])
    assert assert_exact(points, queries, radius * 1.01) > 0
    assert assert_exact(points, queries, radius * 0.99) > 0


def test_queries_at_the_borders_of_the_box():
    random = np.random.default_rng(5)
    points = random.uniform(0, 1, (400, 3))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    assert assert_exact(points, corners, 0.3, (np.zeros(3), np.ones(3))) > 0


def test_hash_collisions_do_not_count_twice():
    """Few points spread over very many cells: the table is small, so rows share buckets all the time."""
    random = np.random.default_rng(11)
    points = random.uniform(-1, 1, (2000, 3)) * [0.002, 1.0, 1.0]
    assert assert_exact(points, points[:200], 0.012) > 200


def test_a_table_of_one_bucket():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.9, 0.0]])
    queries = np.array([[0.0, 0.0, 0.0], [0.0, 0.45, 0.0], [0.0, 0.9, 0.0]])
    assert assert_exact(points, queries, 0.5) == 4


def test_a_long_box_gets_wider_cells():
    """More than four million cells along x would be too many: the cells widen, the radius does not."""
    random = np.random.default_rng(2)
    points = random.uniform(0, 1, (500, 3)) * [1e3, 1e-4, 1e-4]
    assert assert_exact(points, points[:50], 1e-4) >= 50


def test_points_that_are_not_active_are_not_found():
    random = np.random.default_rng(13)
    points = random.uniform(-1, 1, (500, 3))
    assert assert_exact(points, points[:60], 0.3, active=np.arange(500) % 3 > 0) > 0


def test_an_inactive_query_finds_nothing():
    points = np.random.default_rng(1).uniform(-1, 1, (100, 3))
    grid = HashGrid(device(points), 0.5, points.min(0), points.max(0))
    query = grid.query(device(points), mi.Bool(np.arange(100) % 2 == 0))
    total = np.array(query.total)
    assert (total[1::2] == 0).all()
    assert (total[::2] > 0).all()
