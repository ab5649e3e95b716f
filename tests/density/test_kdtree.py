"""The kd-tree against a comparison of all pairs: the same k-th distances, the same neighbours, each once."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tables import crossed

from etendue.density import KdTree

QUERIES = 48


def device(points: np.ndarray) -> Any:
    return mi.Point3f(*(mi.Float(side) for side in np.reshape(points, (-1, 3)).T.astype(np.float32, order="C")))


def cloud(kind: str, n: int = 700) -> np.ndarray:
    random = np.random.default_rng(7)
    uniform = random.uniform(-1, 1, (n, 3))
    match kind:
        case "uniform":
            points = uniform
        case "clusters":
            scale = 10.0 ** random.integers(-6, 0, size=(6, 1))
            which = random.integers(6, size=n)
            points = uniform[:6][which] + scale[which] * random.normal(size=(n, 3))
        case "sphere":
            points = uniform / np.linalg.norm(uniform, axis=1, keepdims=True)
        case "plane":
            points = uniform * [1, 0, 1] - [0, 5, 0]
        case "walls":
            points = np.where(np.arange(3) == random.integers(3, size=(n, 1)), 1.0, uniform)
        case "line":
            points = uniform * [0, 0, 1] + [10, 20, 30]
        case "lattice":
            points = np.round(uniform * 3)
        case "one place":
            points = np.tile([[0.25, -0.5, 0.75]], (n, 1))
        case "far away":
            points = uniform + np.array([3000.0, -200.0, 100.0])
        case _:
            raise AssertionError(kind)
    return points.astype(np.float32)


KINDS = ("uniform", "clusters", "sphere", "plane", "walls", "line", "lattice", "one place", "far away")


def around(points: np.ndarray) -> np.ndarray:
    """Points themselves, places near them and some far from all."""
    random = np.random.default_rng(5)
    chosen = points[random.integers(len(points), size=QUERIES)]
    chosen[QUERIES // 3 :] += random.normal(0, 0.05, (QUERIES - QUERIES // 3, 3)).astype(np.float32)
    chosen[-4:] += random.normal(0, 5, (4, 3)).astype(np.float32)
    return chosen


def all_distances(tree: KdTree, queries: np.ndarray) -> np.ndarray:
    """Squared, as the tree rounds them: one row a query, one column a place."""
    count = tree.count
    place = np.tile(np.arange(count), len(queries))
    pairs = tree.distance_squared(mi.UInt32(place), device(np.repeat(queries, count, axis=0)))
    return np.array(pairs).reshape(len(queries), count)


def visited(tree: KdTree, queries: np.ndarray, radius_squared: Any, active: Any = True) -> list[list[int]]:
    """Places that each query visits, in the order of the visits."""
    room = max(tree.count, 1)
    places = dr.full(mi.UInt32, 0xFFFFFFFF, room * len(queries))
    lane = dr.arange(mi.UInt32, len(queries))

    def visit(place: Any, distance_squared: Any, number: Any) -> Any:
        dr.scatter(places, place, lane * room + number)
        return number + 1

    dr.eval(places)
    number = tree.within(device(queries), mi.Float(radius_squared), mi.UInt32(0), visit, active)
    dr.eval(number, places)
    rows = np.array(places).reshape(len(queries), room)
    number = np.broadcast_to(np.array(number), len(queries))
    return [row[:n].tolist() for row, n in zip(rows, number, strict=True)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_is_a_permutation_and_distances_are_right(kind):
    points = cloud(kind)
    tree = KdTree(device(points))
    assert tree.count == len(points)
    order = np.array(tree.order)
    assert sorted(order) == list(range(len(points)))
    queries = around(points)
    exact = np.linalg.norm(points[order].astype(np.float64) - queries[:, None].astype(np.float64), axis=2)
    scale = float(np.abs(points).max() + np.abs(queries).max())
    np.testing.assert_allclose(np.sqrt(all_distances(tree, queries)), exact, rtol=1e-5, atol=1e-6 * scale)


@pytest.mark.parametrize("kind", KINDS)
def test_the_neighbours_are_exact(kind):
    """Radii differ from query to query, and some points lie exactly at the radius."""
    points = cloud(kind)
    queries = around(points)
    tree = KdTree(device(points))
    distances = all_distances(tree, queries)
    rank = np.random.default_rng(3).integers(0, 200, size=len(queries))
    radius_squared = np.sort(distances, axis=1)[np.arange(len(queries)), rank]
    for found, row, bound in zip(visited(tree, queries, radius_squared), distances, radius_squared, strict=True):
        assert len(found) == len(set(found)), "a point was found twice"
        assert set(found) == set(np.flatnonzero(row <= bound))


@pytest.mark.parametrize(("kind", "k"), crossed(KINDS, [1, 2, 8, 9, 50, 300, 700], 7))
def test_the_kth_distance_is_exact(kind, k):
    points = cloud(kind)
    queries = around(points)
    tree = KdTree(device(points))
    expected = np.sort(all_distances(tree, queries), axis=1)[:, k - 1]
    assert (np.array(tree.kth_distance_squared(device(queries), k, dr.inf)) == expected).all()
    limit = np.float32(np.median(expected))
    limited = np.array(tree.kth_distance_squared(device(queries), k, float(limit)))
    assert (limited == np.minimum(expected, limit)).all()


def test_clusters_far_below_the_scale_of_the_rest():
    """The guess is off by many powers of ten in both directions. No square is so small that threads which flush
    denormal numbers to zero, as Dr.Jit's own do and the main one does not, round it in another way."""
    random = np.random.default_rng(2)
    tight = random.normal(0, 1e-9, (40, 3))
    points = np.concatenate([tight, random.uniform(100, 1000, (60, 3)), np.zeros((30, 3)), tight * 1e-6])
    tree = KdTree(device(points))
    queries = points[::3].astype(np.float32)
    expected = np.sort(all_distances(tree, queries), axis=1)
    for k in (1, 20, 31, 64, 111, 120):
        assert (np.array(tree.kth_distance_squared(device(queries), k, dr.inf)) == expected[:, k - 1]).all()


def test_k_and_limit_per_lane():
    points = cloud("walls")
    queries = around(points)
    tree = KdTree(device(points))
    expected = np.sort(all_distances(tree, queries), axis=1)
    k = np.arange(1, QUERIES + 1) * 15  # some are more than there are points
    limit = np.where(np.arange(QUERIES) % 3 == 0, np.float32(0.01), np.float32(1e6))
    kth = np.where(k <= 700, expected[np.arange(QUERIES), np.minimum(k, 700) - 1], np.float32(np.inf))
    result = tree.kth_distance_squared(device(queries), mi.UInt32(k), mi.Float(limit))
    assert (np.array(result) == np.minimum(kth, limit)).all()


@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 17, 33])
def test_few_points(count):
    points = cloud("uniform")[:count]
    tree = KdTree(device(points))
    assert tree.count == count == dr.width(tree.order)
    queries = cloud("uniform")[10:20]
    distances = np.sort(all_distances(tree, queries), axis=1) if count else np.zeros((10, 0), np.float32)
    for k in (1, 2, 16, 40):
        expected = distances[:, k - 1] if k <= count else np.full(10, 4.0, np.float32)
        assert (np.array(tree.kth_distance_squared(device(queries), k, 4.0)) == np.minimum(expected, 4.0)).all()
    assert [len(found) for found in visited(tree, queries, np.inf)] == [count] * 10


def test_no_lanes_at_all():
    tree = KdTree(mi.Point3f(mi.Float([]), mi.Float([]), mi.Float([])), mi.Bool([]))
    assert tree.count == 0
    assert np.array(tree.kth_distance_squared(mi.Point3f(1, 2, 3), 1, 9.0)) == [9.0]


def test_points_that_are_masked_or_not_finite_are_left_out():
    points = cloud("clusters")
    points[5] = np.nan
    points[7, 1] = np.inf
    mask = np.arange(len(points)) % 3 > 0
    kept = np.flatnonzero(mask & np.isfinite(points).all(axis=1))
    tree = KdTree(device(points), mi.Bool(mask))
    assert sorted(np.array(tree.order)) == kept.tolist()
    assert all(len(found) == len(kept) for found in visited(tree, points[:4], np.inf))


def test_masked_queries_and_queries_that_are_not_finite():
    points = cloud("sphere")
    queries = around(points)
    queries[4] = np.nan
    queries[6, 2] = -np.inf
    mask = np.arange(QUERIES) % 2 == 0
    usable = mask & np.isfinite(queries).all(axis=1)
    tree = KdTree(device(points))
    distances = all_distances(tree, queries)
    result = np.array(tree.kth_distance_squared(device(queries), 20, 7.0, mi.Bool(mask)))
    expected = np.minimum(np.sort(distances, axis=1)[:, 19], 7.0)
    assert (result == np.where(usable, expected, 7.0)).all()
    number = [len(places) for places in visited(tree, queries, 0.3, mi.Bool(mask))]
    assert number == ((distances <= np.float32(0.3)).sum(axis=1) * usable).tolist()


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan])
def test_a_limit_of_nothing(limit):
    points = cloud("uniform")
    result = np.array(KdTree(device(points)).kth_distance_squared(device(points[:5]), 3, mi.Float([limit] * 5)))
    assert np.array_equal(result, np.full(5, limit, np.float32), equal_nan=True)


def test_inside_a_symbolic_loop():
    """Each lane makes another number of queries, one after the other, as the vertices of a path do."""
    points = cloud("walls")
    queries = around(points)
    tree = KdTree(device(points))
    payload = dr.gather(mi.Float, mi.Float(np.arange(len(points), dtype=np.float32)), tree.order)
    flat = mi.Float(queries.ravel())
    dr.eval(payload, flat)
    k, limit = 40, 0.05

    def body(step: Any, total: Any) -> tuple[Any, Any]:
        at = 3 * ((lane + step) % QUERIES)
        point = mi.Point3f(*(dr.gather(mi.Float, flat, at + axis) for axis in range(3)))
        usable = step % 3 != 1
        radius_squared = tree.kth_distance_squared(point, k, limit, usable)

        def visit(place: Any, distance_squared: Any, state: Any) -> Any:
            return state[0] + dr.gather(mi.Float, payload, place), dr.maximum(state[1], distance_squared)

        here = tree.within(point, radius_squared, (mi.Float(0), mi.Float(0)), visit, usable)
        return step + 1, total + here[0] + here[1]

    lane = dr.arange(mi.UInt32, QUERIES)
    _, total = dr.while_loop((mi.UInt32(0), mi.Float(0)), lambda step, _: step < lane % 5, body)

    distances = all_distances(tree, queries)
    values = np.array(payload)
    expected = np.zeros(QUERIES)
    for i in range(QUERIES):
        for step in (s for s in range(i % 5) if s % 3 != 1):
            row = distances[(i + step) % QUERIES]
            near = row <= min(np.sort(row)[k - 1], np.float32(limit))
            expected[i] += values[near].sum() + row[near].max(initial=0.0)
    assert np.array(total) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_points_that_cover_a_query_by_their_own_reach(kind):
    points = cloud(kind)
    queries = around(points)
    random = np.random.default_rng(17)
    reach = (10 ** random.uniform(-3, 1, len(points))).astype(np.float32)
    reach[random.random(len(points)) < 0.2] = 0.0
    tree = KdTree(device(points), reach=mi.Float(reach))
    counts = dr.zeros(mi.UInt32, len(points) * len(queries))
    lane = dr.arange(mi.UInt32, len(queries))

    def visit(place: Any, distance_squared: Any, number: Any) -> Any:
        dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), lane * len(points) + place)
        return number + 1

    number = tree.covering(device(queries), dr.zeros(mi.UInt32, len(queries)), visit, lane % 5 != 2)
    dr.eval(number, counts)
    expected = all_distances(tree, queries) <= np.square(reach[np.array(tree.order)])
    expected[2::5] = False
    assert expected.sum() > 100
    assert (np.array(counts).reshape(expected.shape) == expected).all()
    assert (np.array(number) == expected.sum(axis=1)).all()


def test_another_number_of_points_compiles_nothing_new():
    """A photon map has as many photons as happened to be stored."""

    def kernels(count: int, k: int) -> set[str]:
        random, queries = mi.PCG32(count), mi.PCG32(64)
        points = mi.Point3f(*(random.next_float32() for _ in range(3)))
        point = mi.Point3f(*(queries.next_float32() for _ in range(3)))
        k = dr.opaque(mi.UInt32, k)
        dr.eval(points, point)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(KdTree(points).kth_distance_squared(point, k, 1.0))
            history = dr.kernel_history()
        return {entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT}

    first = kernels(1000, 10)
    assert first
    assert kernels(1010, 20) == first
