"""Particles as arrays."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.particles import LAYOUT, RAW_BYTES, ParticleError, Particles


def some(count: int) -> Particles:
    rng = np.random.default_rng(count)
    arrays = [(1000 * rng.random((count, *row))).astype(kind) for kind, row in LAYOUT.values()]
    return Particles(*arrays)


def test_a_particle_has_sixty_bytes():
    particles = some(5)
    assert RAW_BYTES == 60 == sum(getattr(particles, name).nbytes for name in LAYOUT) // 5


def test_parts_joined_are_the_whole():
    particles = some(7)
    joined = Particles.joined([particles[:3], particles[3:3], particles[np.arange(3, 7)]])
    for name in LAYOUT:
        np.testing.assert_array_equal(getattr(joined, name), getattr(particles, name))
    assert len(Particles.joined([])) == 0


def test_arrays_of_other_lengths_are_refused():
    arrays = [getattr(some(4), name) for name in LAYOUT]
    arrays[3] = arrays[3][:2]
    with pytest.raises(ParticleError, match=r"'shape' of 4 particles has the shape \(4,\), not \(2,\)"):
        Particles(*arrays)
