"""Records of particles of equal energy: their sizes, counts of repetitions, strips."""

from __future__ import annotations

import numpy as np
import pytest
from support.particles import rows_at_random

from etendue.particles import RECORDS, ParticleError, Particles, merged, of_strips, records, strips


def some(count: int = 1000) -> Particles:
    rng = np.random.default_rng(7)
    return Particles.of_rows(rows_at_random(count, rng.integers(0, 12, count), np.zeros(count, int)))


def test_sizes():
    sizes = {kind: layout.itemsize for kind, layout in RECORDS.items()}
    assert sizes == {"glossy xyz": 17, "glossy uv": 13, "diffuse xyz": 15, "diffuse uv": 11, "film": 10}


@pytest.mark.parametrize("kind", [kind for kind in RECORDS if kind != "film"])
def test_records_have_the_fields(kind):
    particles = some()
    made = records(particles, kind, counts=3, channels=particles.path % 3)
    assert made.nbytes == RECORDS[kind].itemsize * len(particles)
    np.testing.assert_array_equal(made["tag"], particles.shape)
    np.testing.assert_array_equal(made["channel"], particles.path % 3)
    assert (made["count"] == 3).all()
    if "xyz" in kind:
        np.testing.assert_array_equal(np.stack([made["x"], made["y"], made["z"]], 1), particles.position)
    else:
        np.testing.assert_array_equal(np.stack([made["u"], made["v"]], 1), particles.uv)
    if "glossy" in kind:
        theta, phi = np.pi * (made["theta"] + 0.5) / 256, 2 * np.pi * (made["phi"] + 0.5) / 256
        d = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
        assert (d * particles.direction).sum(1).min() > np.cos(0.015)


def test_counts_sum_to_the_length_of_the_chain():
    rng = np.random.default_rng(3)
    repeats = np.where(rng.random(400) < 0.02, rng.integers(200, 700, 400), rng.geometric(0.6, 400))
    chain = some(400)[np.repeat(np.arange(400), repeats)]
    few, counts = merged(chain)
    assert counts.sum() == len(chain) == repeats.sum()
    assert counts.max() == 255 and counts.min() >= 1
    np.testing.assert_array_equal(few[np.repeat(np.arange(len(few)), counts)].position, chain.position)
    assert records(few, "diffuse uv", counts)["count"].sum(dtype=int) == len(chain)
    assert len(merged(Particles.empty())[1]) == 0


def test_strips_are_the_records():
    made = records(some(), "glossy xyz")
    for buffer in (100, 4000, 1 << 20):
        parts = list(strips(made, buffer))
        assert max(map(len, parts)) <= max(buffer, made.itemsize)
        np.testing.assert_array_equal(of_strips(iter(parts), "glossy xyz"), made)


def test_what_a_byte_cannot_hold_is_refused():
    with pytest.raises(ParticleError, match="the count of a record is 0 to 255, not 256"):
        records(some(3), "diffuse uv", 256)
    with pytest.raises(ParticleError, match="not 'film'"):
        records(some(3), "film")
