"""Passes never share random numbers, however many there were, and however many light paths a pass has."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.scenes import furnace

from etendue import methods
from etendue.core import Replica
from etendue.methods import base, store
from etendue.methods.base import ImageMethod

#: Light paths of a pass whose numbers are looked at, beginning with the first.
LOOKED_AT = 64


def prepared(name: str, **settings: object) -> ImageMethod:
    method = methods.get(name)
    runner = method(method.Settings(max_depth=4, **settings))
    runner.prepare(furnace("cube", 1.0, 0.5), 0)
    return runner


def drawn(source: object) -> np.ndarray:
    """What the lanes draw: (lanes, 4), of points and of decisions."""
    u, v = source.next_2d(mi.UInt32(1), 1)
    return np.stack(
        [np.asarray(x) for x in (u, v, source.next_1d(mi.UInt32(2), 0), source.decide(mi.UInt32(1), 8))], -1
    )


@pytest.mark.parametrize("sampler", ["owen", "independent", "halton", "hammersley"])
@pytest.mark.parametrize("paths", [1 << 22, 3 << 20], ids=["aligned", "straddling"])
def test_light_paths_are_new_after_two_to_the_32(sampler, paths):
    """A pass that crosses 2^32 light paths, and those after it, have other numbers than the first passes."""
    runner = prepared("bpt", sampler=sampler)
    crossing = (1 << 32) // paths  # the first pass that has a path of number 2^32 or above
    border = (1 << 32) - crossing * paths  # its lane
    early = np.concatenate([drawn(runner.light_numbers(base.Lanes(0, LOOKED_AT), paths, 3, i)) for i in range(2)])
    first = min(max(border - LOOKED_AT // 2, 0), paths - LOOKED_AT)
    late = np.concatenate(
        [
            drawn(runner.light_numbers(base.Lanes(first, LOOKED_AT), paths, 3, crossing)),
            drawn(runner.light_numbers(base.Lanes(0, LOOKED_AT), paths, 3, crossing + 1)),
        ]
    )
    for column in range(early.shape[1]):
        shared = np.intersect1d(early[:, column], late[:, column])
        # 128 numbers of 23 bits against as many others: 0.002 agree by chance
        assert len(shared) <= 1, f"{len(shared)} of {len(late)} numbers of column {column} came before"


def test_light_paths_of_one_pass_may_be_more_than_two_to_the_32():
    """Lanes of a late group of a pass, which has 2^34 light paths, differ from those 2^32 before."""
    for sampler in ("owen", "independent", "halton", "hammersley"):
        runner = prepared("bpt", sampler=sampler)
        here, there = (
            drawn(runner.light_numbers(base.Lanes(first, LOOKED_AT), 1 << 34, 3, 0)) for first in (5, (1 << 32) + 5)
        )
        assert not np.any(here == there)


def test_camera_paths_are_new_after_two_to_the_32():
    """4096 samples a pass, 2^20 passes."""
    runner = prepared("path")
    lanes = dr.arange(mi.UInt32, 4096)
    first, late = (drawn(runner.camera_numbers(lanes, 4096, 3, iteration)) for iteration in (0, 1 << 20))
    assert np.mean(first == late) < 1e-3


def test_decisions_of_more_than_two_to_the_32_lanes_differ():
    """Lanes whose first word agrees, as of 2^32 lanes some must, go on with decisions of their own.

    Of the 2^20 lanes here, some hundred would agree with another on a word of 32 bits; three decisions are 69 bits,
    and all differ."""
    runner = prepared("path")
    samples = 16
    lanes = dr.arange(mi.UInt32, samples << 16)
    source = runner.camera_numbers(lanes, samples, 3, 0)
    words = [np.asarray(source.decide(mi.UInt32(v), 3) * 2.0**23).astype(np.int64) for v in (1, 2, 3)]
    streams = np.stack(words, -1)
    assert len(np.unique(streams, axis=0)) == len(streams)


def picture(name: str, **settings: object) -> tuple[np.ndarray, dict[str, float]]:
    measured = Replica(prepared(name, **settings), 5).step(0)
    return measured.mean(), measured.counters


@pytest.mark.parametrize("name", ["light", "bpt"])
def test_light_paths_in_groups_are_the_same_paths(name, monkeypatch):
    whole, counted = picture(name, light_paths=3.0, samples_per_pass=4)
    monkeypatch.setattr(base, "MOST_LIGHT_LANES", 1000)
    parts, counted_in_parts = picture(name, light_paths=3.0, samples_per_pass=4)
    assert counted_in_parts["paths"] == counted["paths"]
    if name == "light":  # of bpt, which camera path meets which light vertices depends on the groups
        np.testing.assert_allclose(parts, whole, rtol=1e-5, atol=1e-6)
    else:
        assert parts.mean() == pytest.approx(whole.mean(), rel=0.05)


def test_photons_of_a_pass_are_no_more_than_fit_a_kernel(monkeypatch):
    monkeypatch.setattr(base, "MOST_LIGHT_LANES", 1000)
    assert prepared("sppm", light_paths=64.0).tracer.fitting(1 << 34) == 1000


def test_light_vertices_stay_below_what_32_bits_can_number():
    """With memory for more, the store still is one array of fewer than 2^32 numbers: more groups are made."""
    room = store.VertexRoom(bytes_per_vertex=172, floats_per_vertex=24, memory=10**12)
    room.per_path = 4.0
    paths = 10**9
    groups = room.groups(paths)
    assert 24 * room.capacity(-(-paths // groups)) < 1 << 32
    assert 24 * room.most < 1 << 32
    # A pass at 3840x2160 of 16 samples and 64 light paths each, by the standard limit.
    room = store.VertexRoom(bytes_per_vertex=172, floats_per_vertex=24, memory=None)
    room.per_path = 4.0
    paths = 3840 * 2160 * 16 * 64
    assert 172 * room.capacity(-(-paths // room.groups(paths))) <= 600e6
