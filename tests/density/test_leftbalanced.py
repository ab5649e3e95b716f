"""The order of a left-balanced kd-tree, alone and as that of packed records of particles with counts."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.density import left_balanced, nearest
from etendue.particles import RECORDS, Particles, merged, records


@pytest.mark.parametrize("count", [0, 1, 2, 3, 6, 7, 8, 20, 200])
@pytest.mark.parametrize("axes", [2, 3])
def test_a_subtree_lies_on_its_side_of_every_node_above(count, axes):
    r = np.random.default_rng(count)
    points = r.random((count, axes))
    order = left_balanced(points)
    assert sorted(order) == list(range(count))
    points = points[order]
    for place in range(count):
        node = place
        while node:
            parent = (node - 1) // 2
            axis = ((parent + 1).bit_length() - 1) % axes
            offset = points[place, axis] - points[parent, axis]
            assert offset >= 0 if node == 2 * parent + 2 else offset <= 0
            node = parent
    for at in r.random((10, axes)):
        k = min(7, count)
        places, squared = nearest(points, at, k)
        distances = ((points - at) ** 2).sum(axis=1)
        np.testing.assert_allclose(squared, np.sort(distances)[:k])
        np.testing.assert_allclose(distances[places], squared)


def test_a_photon_map_of_packed_records():
    """A chain that repeats its states: the map has one record for each, whose counts are the states, in a tree."""
    r = np.random.default_rng(3)
    repeats = r.geometric(0.4, 500)
    zero = np.zeros(500, np.uint32)
    position, d = r.random((500, 3), np.float32), np.tile([0.0, 0.0, -1.0], (500, 1))
    chain = Particles(position, d, np.ones((500, 3)), zero, zero, np.zeros((500, 2)), zero, zero)
    few, counts = merged(chain[np.repeat(np.arange(500), repeats)])
    packed = records(few, "glossy xyz", counts)[left_balanced(few.position)]
    assert packed.nbytes == 17 * len(few) == RECORDS["glossy xyz"].itemsize * 500
    assert packed["count"].sum(dtype=int) == repeats.sum()
    points = np.stack([packed[name] for name in "xyz"], axis=1)
    at = np.array([0.3, 0.6, 0.5])
    places, squared = nearest(points, at, 20)
    truth = ((position - at) ** 2).sum(axis=1)
    np.testing.assert_allclose(squared, np.sort(truth)[:20], rtol=1e-5)
    assert packed["count"][places].sum() == repeats[np.argsort(truth)[:20]].sum()
