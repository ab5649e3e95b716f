"""Directions on a spiral: even, random together, and what the rasteriser makes of them by default."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import room

from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, SpiralPoints
from etendue.radiosity.lines.generators import direction
from etendue.radiosity.lines.replicates import Replicates


def projected_area_errors(points, size):
    """Of the mean projected area of flat patches, 1/2, for patches turned in 200 ways."""
    normals = np.random.default_rng(1).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.abs(direction(points.block(size)[:, :2]) @ normals.T).mean(axis=0) - 0.5


@pytest.mark.parametrize("size, share", [(256, 0.9), (1000, 0.6)])
def test_directions_are_more_even_than_those_of_a_sequence(size, share):
    spiral, sobol = (
        np.sqrt(np.mean([projected_area_errors(kind(seed), size) ** 2 for seed in range(4)]))
        for kind in (lambda seed: SpiralPoints(seed, size), lambda seed: OwenSobol(4, seed=seed))
    )
    assert spiral < share * sobol


def test_each_direction_is_even_over_seeds():
    ways = np.array([direction(SpiralPoints(seed).block(1, 2000)[:, :2])[0] for seed in range(400)])
    moments = ways.T @ ways / len(ways)
    np.testing.assert_allclose(moments, np.eye(3) / 3, atol=4 * 0.3 / 20)


def test_parts_are_spread_too():
    """A sixteenth of the points, one after the other, is as good as so many by themselves, or nearly."""
    ways = direction(SpiralPoints(3).block(64, 64 * 5)[:, :2])
    moments = ways.T @ ways / 64
    np.testing.assert_allclose(moments, np.eye(3) / 3, atol=0.03)


def test_points_are_functions_of_their_index():
    points = SpiralPoints(1, directions=1024)
    assert points.size is None and points.block(2048).max() < 1
    np.testing.assert_array_equal(points.block(2048)[1000:1100], points.block(100, 1000))
    # The next spiral is turned otherwise.
    assert not np.allclose(points.block(8), points.block(8, 1024))
    assert not np.allclose(points.block(8), points.randomised(2).block(8))


def test_the_device_has_the_same_numbers(variant):
    import mitsuba as mi

    mi.set_variant(variant)
    points = SpiralPoints(4)
    for d in range(4):
        found = np.array(points.coordinate(mi.UInt32(list(range(1000, 1100))), d))
        np.testing.assert_allclose(found, points.block(100, 1000)[:, d], atol=2.0**-23)


def test_the_rasteriser_takes_them_by_default():
    patches = room(2)
    assert isinstance(ABuffer(patches).points, SpiralPoints)
    engine = ABuffer(patches, SpiralPoints(7), 500)
    first, again, more = engine.cast(64), engine.cast(64), engine.cast(64, 64)
    assert all(np.array_equal(a, b) for a, b in zip(first.chunks, again.chunks, strict=True))
    assert not np.array_equal(first.counted, more.counted)
    assert not np.array_equal(first.counted, ABuffer(patches, SpiralPoints(8), 500).cast(64).counted)
    x = patches.centres[:, 0]
    exact = ABuffer(patches, SpiralPoints(1), 4096).cast(1024).gather(x)
    # The scatter of the batches is an upper estimate.
    errors, stated = first.gather(x) - exact, first.gather_error(x)
    assert np.sqrt(np.mean((errors / stated) ** 2)) < 1.2


@pytest.mark.parametrize("backend", ["compiled", "drjit"])
def test_two_streams_of_one_rasteriser_keep_their_points(backend):
    """Each has a spiral for its own number of bundles."""
    engine = ABuffer(room(1), lines=500, backend=backend)
    alone = list(engine.stream(320, size=8))
    stream = engine.stream(320, size=8)
    found = [next(stream)]
    next(engine.stream(64, size=8))
    engine.shuffled(72)
    for one, other in zip([*found, *stream], alone, strict=True):
        np.testing.assert_array_equal(one, other)


def test_replicates_take_turns():
    """Five points of each of three sequences, then their next five."""
    sequences = [OwenSobol(4, seed=seed) for seed in range(3)]
    points = Replicates(sequences, 5).block(40)
    for k, sequence in enumerate(sequences):
        own = np.concatenate([points[5 * turn : 5 * turn + 5] for turn in range(k, 8, 3)])
        np.testing.assert_array_equal(own, sequence.block(len(own)))
    np.testing.assert_array_equal(Replicates(sequences, 5).block(7, 13), points[13:20])
