"""A forest of quadtrees: densities that integrate to one, samples that follow them, and refinement where mass is."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from etendue.density import Quadtrees, QuadtreeSampler

#: Centre and width of each tree's density; the last is uniform.
PEAKS = ((0.7, 0.3, 0.02), (0.1, 0.9, 0.1), (0.5, 0.5, 0.0))
POINTS = 400_000


def target(tree: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What the trees shall learn, up to a factor."""
    peaks = np.array(PEAKS)[tree]
    width = np.maximum(peaks[:, 2], 1e-3)
    peak = np.exp(-((x - peaks[:, 0]) ** 2 + (y - peaks[:, 1]) ** 2) / (2 * width**2)) / width**2
    return np.where(peaks[:, 2] > 0, 0.2 + peak, 1.0)


def points(count: int = POINTS, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.integers(len(PEAKS), size=count), *random.random((2, count), dtype=np.float32)


def learned(generations: int = 6, share: float = 0.01) -> Quadtrees:
    """Trees that have seen the target at random points."""
    trees = Quadtrees.even(len(PEAKS))
    tree, x, y = points()
    for _ in range(generations):
        trees = trees.refined(np.arange(trees.count), share)
        trees = trees.with_mass(np.bincount(places(trees, tree, x, y), target(tree, x, y), trees.places))
    return trees


def places(trees: Quadtrees, tree: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    _, place = QuadtreeSampler(trees).find(mi.UInt32(tree.astype(np.uint32)), mi.Point2f(x, y))
    return np.asarray(place)


def corners(trees: Quadtrees) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corner and side of the square of every place."""
    x, y = np.zeros(trees.places), np.zeros(trees.places)
    side = np.repeat(0.5 ** (trees.level + 1), 4)
    node_x, node_y = np.zeros(len(trees.tree)), np.zeros(len(trees.tree))
    for node, parent in enumerate(trees.parent):
        if parent >= 0:
            node_x[node], node_y[node] = x[parent], y[parent]
        quadrant = np.arange(4)
        x[4 * node + quadrant] = node_x[node] + (quadrant & 1) * side[4 * node]
        y[4 * node + quadrant] = node_y[node] + (quadrant >> 1) * side[4 * node]
    return x, y, side


def leaves(trees: Quadtrees) -> np.ndarray:
    return np.flatnonzero(trees.child.ravel() < 0)


def test_leaves_tile_the_square_and_densities_integrate_to_one():
    trees = learned()
    _, _, side = corners(trees)
    leaf, tree = leaves(trees), trees.tree_of_place()
    mass = trees.density().ravel() * side**2
    np.testing.assert_allclose(np.bincount(tree[leaf], (side**2)[leaf]), 1.0)
    np.testing.assert_allclose(np.bincount(tree[leaf], mass[leaf]), 1.0)


def test_points_are_found_in_the_leaf_that_holds_them():
    trees = learned()
    x0, y0, side = corners(trees)
    tree, x, y = points(20_000, seed=2)
    density, place = QuadtreeSampler(trees).find(mi.UInt32(tree.astype(np.uint32)), mi.Point2f(x, y))
    place = np.asarray(place)
    assert (trees.tree_of_place()[place] == tree).all()
    assert (trees.child.ravel()[place] < 0).all()
    assert ((x0[place] <= x) & (x < x0[place] + side[place]) & (y0[place] <= y) & (y < y0[place] + side[place])).all()
    np.testing.assert_allclose(np.asarray(density), trees.density().ravel()[place], rtol=1e-6)


def test_samples_follow_the_density():
    """Chi-square of the leaves that samples fall into; in each leaf they lie evenly; density and place as found."""
    trees = learned()
    sampler = QuadtreeSampler(trees)
    x0, y0, side = corners(trees)
    tree, u, v = points(seed=3)
    numbers = mi.UInt32(tree.astype(np.uint32))
    point, density, place = sampler.sample(numbers, mi.Point2f(u, v))
    again, found = sampler.find(numbers, point)
    place, found, x, y = (np.asarray(value) for value in (place, found, point.x, point.y))
    assert np.mean(place != found) < 1e-4  # but for rounding at borders
    same = place == found
    np.testing.assert_allclose(np.asarray(density)[same], np.asarray(again)[same])
    mass = trees.density().ravel() * side**2
    for number in range(trees.count):
        mine = tree == number
        leaf = leaves(trees)[trees.tree_of_place()[leaves(trees)] == number]
        expected = mass[leaf] * mine.sum()
        counts = np.bincount(place[mine], minlength=trees.places)[leaf]
        assert not counts[expected == 0.0].any()
        many = expected >= 5.0
        counts, expected = counts[many], expected[many]
        rest = mine.sum() - np.array([counts.sum(), expected.sum()])
        if rest[1] > 5.0:
            counts, expected = np.append(counts, rest[0]), np.append(expected, rest[1])
        assert stats.chisquare(counts, expected * counts.sum() / expected.sum()).pvalue > 1e-4
        inside = ((x - x0[place]) / side[place])[mine], ((y - y0[place]) / side[place])[mine]
        for coordinate in inside:
            assert stats.kstest(coordinate, "uniform").pvalue > 1e-4


def test_trees_are_fine_where_the_mass_is():
    trees = learned()
    x, y, side = corners(trees)
    leaf, tree = leaves(trees), trees.tree_of_place()
    near = leaf[(tree[leaf] == 0) & (np.hypot(x[leaf] - 0.7, y[leaf] - 0.3) < 0.03)]
    far = leaf[(tree[leaf] == 0) & (np.hypot(x[leaf] - 0.7, y[leaf] - 0.3) > 0.4)]
    assert side[near].max() <= 1 / 16
    assert side[far].min() >= 1 / 8
    share = trees.density().ravel() * side**2
    refined = trees.refined(np.arange(trees.count), 0.01)
    _, _, refined_side = corners(refined)
    assert (refined.density().ravel() * refined_side**2)[leaves(refined)].max() <= 0.01
    assert share.max() <= 1.0


@pytest.mark.parametrize("share", [0.3, 0.01])
def test_refining_does_not_change_a_density(share):
    """Dividing keeps it; what is joined has the mean."""
    trees = learned()
    source = np.array([1, 0, 2, 0])
    refined = trees.refined(source, share)
    tree, x, y = points(50_000, seed=4)
    before, _ = QuadtreeSampler(trees).find(mi.UInt32(source[tree].astype(np.uint32)), mi.Point2f(x, y))
    after, place = QuadtreeSampler(refined).find(mi.UInt32(tree.astype(np.uint32)), mi.Point2f(x, y))
    before, after, place = np.asarray(before, np.float64), np.asarray(after, np.float64), np.asarray(place)
    mean = np.bincount(place, before, refined.places) / np.maximum(np.bincount(place, minlength=refined.places), 1)
    many = np.bincount(place, minlength=refined.places)[place] > 300
    np.testing.assert_allclose(mean[place][many], after[many], rtol=0.35 if share > 0.1 else 0.05)
    assert refined.count == 4


def test_a_tree_that_found_nothing_keeps_its_density():
    trees = learned()
    found = np.zeros(trees.places)
    found[trees.tree_of_place() == 1] = 1.0
    after = trees.with_mass(found)
    mine = trees.tree == 1
    np.testing.assert_array_equal(after.mass[~mine], trees.mass[~mine])
    assert np.abs(after.density()[mine] - trees.density()[mine]).max() > 0.1


def test_arrays_restore_the_forest():
    trees = learned()
    again = Quadtrees.from_arrays(trees.to_arrays())
    for name in ("tree", "level", "parent", "child", "mass"):
        np.testing.assert_array_equal(getattr(again, name), getattr(trees, name))


def test_lanes_that_are_not_active_find_nothing():
    sampler = QuadtreeSampler(learned())
    point, density, _ = sampler.sample(mi.UInt32([0, 1]), mi.Point2f(0.3, 0.4), mi.Bool([True, False]))
    assert density[0] > 0.0
    assert density[1] == 0.0
    assert 0.0 <= point.x[0] < 1.0
    density, _ = sampler.find(mi.UInt32([0, 1]), mi.Point2f(0.3, 0.4), mi.Bool([False, True]))
    assert density[0] == 0.0
    assert density[1] > 0.0
