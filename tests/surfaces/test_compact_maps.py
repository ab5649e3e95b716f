"""The compact photon map: sizes, counts, the tree, what is lost."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.density import left_balanced, nearest
from etendue.surfaces import COMPACT_LAYOUTS, CompactMap, SurfaceError


def test_packed_sizes():
    """Those of the thesis."""
    sizes = {name: layout.itemsize for name, layout in COMPACT_LAYOUTS.items()}
    assert sizes == {"glossy-xyz": 17, "glossy-uv": 13, "diffuse-xyz": 15, "diffuse-uv": 11, "film": 10}


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 8, 20, 200])
def test_the_tree_is_left_balanced_and_sorted(count):
    """Every place from 0 to n is a node, and all points of a subtree lie on their side of each node above it."""
    r = np.random.default_rng(count)
    points = r.random((count, 3))
    order, axes = left_balanced(points)
    assert sorted(order) == list(range(count))
    points = points[order]
    for place in range(count):
        node = place
        while node:
            parent = (node - 1) // 2
            axis = axes[parent]
            is_right = node == 2 * parent + 2
            assert (
                (points[place, axis] >= points[parent, axis])
                if is_right
                else (points[place, axis] <= points[parent, axis])
            )
            node = parent
    for at in r.random((10, 3)):
        k = min(7, count)
        places, squared = nearest(points, axes, at, k)
        distances = ((points - at) ** 2).sum(axis=1)
        np.testing.assert_allclose(squared, np.sort(distances)[:k])
        np.testing.assert_allclose(distances[places], squared)


def test_counts_are_the_states_of_a_chain():
    """A chain that stays with probability 0.7, and once for 600 states: the sum of the counts is its length."""
    r = np.random.default_rng(5)
    moves = r.random(3000) > 0.7
    moves[1000:1600] = False
    state = np.cumsum(moves)
    points, channels = r.random((len(moves) + 1, 3))[state], (state % 3).astype(np.uint8)
    d = r.normal(size=(len(moves) + 1, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    made = CompactMap.packed("glossy-xyz", points, channels, d[state], unit=0.5)
    assert made.states == len(moves)
    assert len(made) == len(np.unique(state)) + 2  # 600 states are 255, 255 and 90 or more
    np.testing.assert_allclose(made.power.sum(axis=0), 0.5 * np.bincount(channels))
    assert made.rows.nbytes == 17 * len(made)
    at = made.rows["position"][11]
    places, squared = made.nearest(at, 1)
    assert squared[0] == 0.0
    np.testing.assert_array_equal(made.rows["position"][places[0]], at)
    true = {tuple(p): v for p, v in zip(np.float32(points), d[state], strict=True)}
    cosine = [made.directions[i] @ true[tuple(made.rows["position"][i])] for i in range(len(made))]
    assert np.arccos(np.clip(cosine, -1, 1)).max() < 0.014


def test_bad_input():
    points, channels = np.zeros((3, 3)), np.zeros(3)
    with pytest.raises(SurfaceError, match="there is no layout 'matt'"):
        CompactMap.packed("matt", points, channels)
    with pytest.raises(SurfaceError, match=r"takes positions \(n, 2\)"):
        CompactMap.packed("diffuse-uv", points, channels)
    with pytest.raises(SurfaceError, match="needs directions"):
        CompactMap.packed("glossy-xyz", points, channels)
    with pytest.raises(SurfaceError, match="in no tree"):
        CompactMap.packed("film", points[:, :2], channels).nearest([0, 0], 1)
    assert CompactMap.packed("diffuse-xyz", np.zeros((0, 3)), np.zeros(0)).states == 0
