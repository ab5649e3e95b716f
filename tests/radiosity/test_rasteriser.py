"""The rasteriser by Dr.Jit, against the compiled loops; and sums over segments on a device."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from support.patches import box, cube, joined, room, square

from etendue.points import Independent, OwenSobol
from etendue.radiosity import ABuffer, Patches, RadiosityError, Segments
from etendue.radiosity.lines import abuffer, segments
from etendue.radiosity.lines.replay import DeviceSegments

WALLS, FINE_WALLS = (box((0, 0, 0), (1, 1, 1), cells, inward=True) for cells in (1, 3))


def sheets(count):
    """Two-sided squares above each other in a room: lines meet many."""
    pile = [square((0.1, 0.1, 0.1 + 0.8 * k / count), (0.8, 0, 0.02), (0, 0.8, 0)) for k in range(count)]
    return Patches(*joined(WALLS, *pile), two_sided=np.arange(6 + count) >= 6)


def open_scene():
    walls = WALLS[0], WALLS[1][:5]
    sheet = square((0.1, 0.2, 0.6), (0.7, 0.1, 0), (0, 0.5, 0.2))
    return Patches(*joined(walls, box((0.3, 0.3, 0.1), (0.6, 0.8, 0.4), 1), sheet), two_sided=np.arange(12) == 11)


def triangles():
    """Of very unequal size: a room of two triangles a wall around a finely cut box."""
    vertices, faces = WALLS
    halves = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    inner = box((0.4, 0.4, 0.3), (0.5, 0.6, 0.6), 12)
    cut = np.concatenate([inner[1][:, [0, 1, 2]], inner[1][:, [0, 2, 3]]])
    return Patches(*joined((vertices, halves), (inner[0], cut)))


SCENES = {
    "room": (lambda: room(6), 3000, 0),
    "large faces": (lambda: room(1), 20_000, 0),
    "triangles": (triangles, 8000, 0),
    "cut differently": (lambda: room(3).subdivided(0.02), 3000, 1e-5),
    "box on the floor": (
        lambda: Patches(
            *joined(box((0, 0, 0), (1, 1, 1), 3, inward=True), box((1 / 3, 1 / 3, 0), (2 / 3, 2 / 3, 0.5), 1))
        ),
        2000,
        0,
    ),
    "back to back": (
        lambda: Patches(
            *joined(
                WALLS,
                square((0.2, 0.2, 0.4), (0.6, 0, 0.1), (0, 0.5, 0.2)),
                square((0.2, 0.2, 0.4), (0, 0.5, 0.2), (0.6, 0, 0.1)),
            )
        ),
        2000,
        0,
    ),
    "far away": (lambda: Patches(room(4).vertices * 1e-3 + 1000, room(4).faces), 2000, 1e-5),
    "open": (open_scene, 2000, None),
    "deep": (lambda: sheets(60), 2000, 0),
}


def found(patches, backend, lines, points=40, seed=1):
    return np.concatenate(list(ABuffer(patches, OwenSobol(4, seed=seed), lines, backend).stream(points)))


def differing(ours, theirs):
    """How many segments of either are not in the other."""
    pairs, counts = (np.concatenate(x) for x in ((ours, theirs), (np.ones(len(ours)), -np.ones(len(theirs)))))
    _, which = np.unique(pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1], return_inverse=True)
    return np.abs(np.bincount(which, counts)).sum()


@pytest.mark.parametrize("name", SCENES)
def test_both_backends_find_the_same_segments(name):
    make, lines, leaks = SCENES[name]
    patches = make()
    ours, theirs = (found(patches, backend, lines) for backend in ("drjit", "compiled"))
    assert len(ours) > 5000
    assert differing(ours, theirs) <= 1e-4 * len(ours)
    if leaks is not None:
        assert np.count_nonzero(ours >= len(patches)) <= leaks * len(ours)


def test_form_factors_do_not_depend_on_the_backend():
    patches = room(5)
    radiosity = np.exp(patches.centres)
    irradiance = [ABuffer(patches, OwenSobol(4), 4000, b).cast(64).gather(radiosity) for b in ("drjit", "compiled")]
    np.testing.assert_allclose(*irradiance, rtol=1e-3)
    assert np.mean(~np.isclose(*irradiance, rtol=1e-12)) < 0.01


def test_no_line_passes_through_a_closed_mesh():
    segments = ABuffer(room(7), Independent(4, seed=2), 12_000, "drjit").cast(256)
    assert len(segments) > 1_000_000
    assert segments.to_dark.sum() + segments.to_sky.sum() <= 1e-6 * len(segments)


def test_pieces_and_repetition_do_not_change_the_segments():
    engine = ABuffer(sheets(12), OwenSobol(4, seed=3), 500, "drjit")
    whole = engine.cast(40)
    assert len(whole.chunks) > 8 and whole.batch_count > 8
    parts = [engine.cast(13), engine.cast(27, first=13)]
    np.testing.assert_array_equal(np.concatenate(whole.chunks), np.concatenate(parts[0].chunks + parts[1].chunks))


def test_bundles_that_miss_everything_have_no_segments():
    tiny = Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    pairs = list(ABuffer(tiny, OwenSobol(4), 1, "drjit").stream(64))
    assert len(pairs) >= 16 and min(map(len, pairs)) == 0 < sum(map(len, pairs))


def test_a_gpu_is_used_by_itself(monkeypatch):
    patches = cube(1)
    with pytest.raises(RadiosityError, match="one of auto, compiled, drjit, not 'numba'"):
        ABuffer(patches, backend="numba")
    for cuda, backend in ((True, "drjit"), (False, "compiled")):
        monkeypatch.setattr(abuffer, "uses_cuda", lambda cuda=cuda: cuda)
        assert ABuffer(patches).backend == backend
        assert ABuffer(patches, backend="compiled").backend == "compiled"


def test_sums_on_the_device_are_those_of_the_compiled_loops(monkeypatch):
    patches = open_scene()
    stored = ABuffer(patches, OwenSobol(4, seed=2), 500).cast(64)
    values = np.exp(patches.centres)
    monkeypatch.setattr(segments, "uses_cuda", lambda: True)
    on_device = Segments(patches, [*stored.chunks, np.empty((0, 2), np.uint32)], [*stored.batches, 7], stored.expected)
    monkeypatch.setattr(Segments, "_sum", None)
    for name in ("counted", "to_sky", "to_dark"):
        np.testing.assert_array_equal(getattr(on_device, name), getattr(stored, name))
    ours = on_device.gather(values, 2.0), on_device.gather(values[:, 0]), on_device.gather_error(values)
    monkeypatch.undo()
    theirs = stored.gather(values, 2.0), stored.gather(values[:, 0]), stored.gather_error(values)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_sums_over_many_segments_take_several_kernels(monkeypatch):
    monkeypatch.setattr("etendue.radiosity.lines.replay._BLOCK", 10)
    chunks = [np.random.default_rng(k).integers(0, 5, (k, 2), dtype=np.uint32) for k in (3, 9, 0, 4, 12)]
    values = np.arange(1.0, 6.0)[:, None]
    i, j = np.concatenate(chunks).T
    expected = np.bincount(i, values[j, 0], 5) + np.bincount(j, values[i, 0], 5)
    np.testing.assert_allclose(DeviceSegments(chunks).gather(values)[:, 0], expected)


def run(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.split()


def test_numba_is_not_needed():
    code = """
import sys
sys.modules["numba"] = None
import etendue.core
etendue.core.use_variant("llvm_ad_rgb")
from etendue.radiosity import ABuffer, Patches, box
patches = Patches(*box((0, 0, 0), (1, 1, 1), 2, inward=True))
print(sum(len(pairs) for pairs in ABuffer(patches, lines=500, backend="drjit").stream(16)))
"""
    assert int(run(code)[0]) > 2000


@pytest.mark.gpu
def test_on_a_gpu_the_segments_are_those_of_the_compiled_loops():
    code = """
import etendue.core, numpy as np
etendue.core.use_variant("cuda_ad_rgb")
from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, Patches, Segments, box, joined, solve
patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), 6, inward=True), box((0.3, 0.2, 0.1), (0.6, 0.7, 0.5), 4)))
patches = patches.with_properties(reflectance=0.6, emission=patches.centres[:, 2])
engine = ABuffer(patches, OwenSobol(4, seed=1), 4000)
assert engine.backend == "drjit"
ours = engine.cast(64)
theirs = ABuffer(patches, OwenSobol(4, seed=1), 4000, "compiled").cast(64)
assert ours.to_sky.sum() + ours.to_dark.sum() == 0
print(len(ours), np.abs(ours.counted - theirs.counted).sum())
print(np.abs(solve(patches, ours).radiosity / solve(patches, theirs).radiosity - 1).max())
"""
    total, differing, error = map(float, run(code))
    assert total > 100_000 and differing <= 1e-4 * total and error < 1e-3
