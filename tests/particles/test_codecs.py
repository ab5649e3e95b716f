"""Codecs: nothing is lost by exact ones, and no more than the bounds by packed ones."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest
from support.particles import rows_at_random, sorted_rows

from etendue.core import BackendError
from etendue.particles import Codec, Grid, ParticleError, Particles, Rows, Surfaces, coder_names, decode, encode
from etendue.particles.packing.coders import CODERS, coder, of_run_lengths, run_lengths
from etendue.particles.packing.ordering import rice, sorted_by, unrice
from etendue.particles.packing.strips import Chunk

LIBRARIES = {"zstd": "zstandard", "lz4": "lz4", "blosc2": "blosc2"}
INSTALLED = [name for name in coder_names() if name not in LIBRARIES or find_spec(LIBRARIES[name])]


def surfaces() -> Surfaces:
    """A rectangle, a curved shape, and a mesh of 500 triangles of different sizes."""
    rng = np.random.default_rng(5)
    mesh = rng.normal(size=(500, 9)) * rng.uniform(0.01, 1.0, (500, 1))
    frames = np.concatenate([[[-5, 0, -5, 10, 0, 0, 0, 0, 10]], mesh]).astype("f4")
    return Surfaces(
        ["floor", "ball", "stone"],
        np.array([100.0, 3.0, 4.0]),
        np.array([1, 1, 500]),
        np.array([1, 0, 1], bool),
        frames,
        np.array([[-5, 0, -5, 5, 0, 5], [0, 0, 0, 1, 1, 1], [-9, -9, -9, 9, 9, 9]], float),
    )


def some(count: int = 70_000) -> Rows:
    """Particles at the points of their parameters; on the curved shape anywhere."""
    rng, known = np.random.default_rng(count), surfaces()
    shapes = rng.choice(3, count, p=[0.6, 0.15, 0.25])
    primitives = np.where(shapes == 2, rng.integers(0, 500, count), 0)
    rows = rows_at_random(count, shapes, primitives)
    floats = rows.view("f4")
    framed = known.framed[shapes]
    frame = known.frames[(known.first[shapes] + primitives)[framed]].astype(float)
    u, v = floats[framed, 11, None], floats[framed, 12, None]
    floats[framed, :3] = frame[:, :3] + u * frame[:, 3:6] + v * frame[:, 6:]
    floats[:, 6:9] = rng.choice(np.array([[1.0, 0.5, 0.25], [3e-9, 7e3, 0.0], [0.1, 0.1, 0.1]], "f4"), count)
    floats[: count // 2, 6:9] = rng.lognormal(0.0, 4.0, (count // 2, 3))
    return rows


def packed(rows: Rows, codec: str, known: Surfaces) -> list[Chunk]:
    return [make() for make in encode(rows, Codec.parse(codec), Grid(known))]


def there_and_back(rows: Rows, codec: str, known: Surfaces | None = None) -> tuple[Rows, int]:
    """(what comes back, bytes)."""
    grid = Grid(known or surfaces())
    chunks = packed(rows, codec, grid.surfaces)
    back = [decode(chunk.head, b"".join(chunk.strips), grid) for chunk in chunks]
    return np.concatenate(back), sum(len(strip) for chunk in chunks for strip in chunk.strips)


@pytest.mark.parametrize("coder_name", INSTALLED)
def test_exact_codecs_lose_nothing(coder_name):
    rows = some(5000)
    for layout in ("raw", "exact"):
        back, size = there_and_back(rows, f"{layout}+{coder_name}")
        np.testing.assert_array_equal(sorted_rows(back), sorted_rows(rows))
        assert size <= 1.01 * rows.nbytes
    np.testing.assert_array_equal(there_and_back(rows, "raw")[0], rows)


def by_path(rows: Rows) -> Particles:
    return Particles.of_rows(rows[np.argsort(rows[:, 13])])


@pytest.mark.parametrize("coder_name", ["fast", "bz2"])
def test_packed_particles_are_within_the_bounds(coder_name):
    rows = some()
    back, size = there_and_back(rows, f"packed+{coder_name}")
    before, after, bounds = by_path(rows), by_path(back), Grid(surfaces()).bounds
    for name in ("shape", "primitive", "path", "bounce"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    away = np.linalg.norm(after.position.astype(float) - before.position, axis=1)
    assert 0.3 * bounds["position"] < away.max() <= bounds["position"]
    angle = np.linalg.norm(np.cross(after.direction.astype(float), before.direction.astype(float)), axis=1)
    assert 0.3 * bounds["direction"] < angle.max() <= bounds["direction"]
    power = np.abs(after.power.astype(float) - before.power) / before.power.max(1, keepdims=True)
    assert 0.3 * bounds["power"] < power.max() <= bounds["power"]
    assert size < 16 * len(rows)


def test_path_numbers_may_be_left_out():
    rows = some()
    back, size = there_and_back(rows, "packed-no-paths")
    assert not back[:, 13].any()
    with_paths, more = there_and_back(rows, "packed")
    np.testing.assert_array_equal(back[:, :13], with_paths[:, :13])
    assert 2 * len(rows) < more - size <= 4 * len(rows)


def test_powers_without_a_code_come_back_as_they_are():
    rows = some(3000)
    floats = rows.view("f4")
    floats[:, 6:9] = np.random.default_rng(1).random((3000, 3))
    floats[:4, 6:9] = [[-1.0, 2.0, 0.0], [1e-42, 0.0, 0.0], [3e38, 1.0, 0.0], [0.0, 0.0, 0.0]]
    rows[rows[:, 9] == 1, 9] = 0  # all in one chunk
    back, _ = there_and_back(rows, "packed")
    np.testing.assert_array_equal(by_path(back).power, by_path(rows).power)


def meshes(frames, boxes=None, others: int = 0) -> Surfaces:
    """One mesh of triangles or rectangles, and a shape of ``others`` primitives without frames."""
    frames = np.array(frames, "f4")
    if boxes is None:
        ends = frames[:, :3, None] + np.stack([0 * frames[:, 3:6], frames[:, 3:6], frames[:, 6:]], -1)
        boxes = [[*ends.min((0, 2)), *ends.max((0, 2))]]
    names, counts = ["mesh", "tree"][: len(boxes)], [len(frames), others][: len(boxes)]
    framed = np.array([True, False])[: len(boxes)]
    return Surfaces(names, np.full(len(boxes), np.nan), np.array(counts), framed, frames, np.array(boxes, float))


def on(known: Surfaces, count: int, triangles: bool = True) -> Rows:
    """Particles on the frames of the first shape."""
    rng = np.random.default_rng(count)
    primitives = rng.integers(0, len(known.frames), count)
    rows = rows_at_random(count, np.zeros(count, int), primitives)
    floats, frame = rows.view("f4"), known.frames[primitives].astype(float)
    if triangles:
        outside = floats[:, 11] + floats[:, 12] > 1
        floats[outside, 11:13] = 1 - floats[outside, 11:13]
    floats[:, :3] = frame[:, :3] + floats[:, 11, None] * frame[:, 3:6] + floats[:, 12, None] * frame[:, 6:]
    return rows


def off(rows: Rows, back: Rows) -> np.ndarray:
    """Distances between the same particles."""
    return np.linalg.norm(by_path(back).position.astype(float) - by_path(rows).position, axis=1)


def equilateral() -> list[list[float]]:
    rng = np.random.default_rng(8)
    sides, places = rng.uniform(0.05, 1.0, 300), rng.uniform(-5, 5, (300, 2))
    return [[x, 0, z, a, 0, 0, a / 2, 0, a * 0.75**0.5] for a, (x, z) in zip(sides, places, strict=True)]


FRAMES = {
    "rectangle": [[-5, 0, -5, 10, 0, 0, 0, 0, 10]],
    "right corners": [[0, 0, 0, 10, 0, 0, 0, 0, 10], [10, 0, 10, -10, 0, 0, 0, 0, -10]],
    "acute corners": [[0, 0, 0, 10, 0, 0, 10, 0, 10], [0, 0, 0, 10, 0, 10, 0, 0, 10]],
    "obtuse corner": [[0, 0, 0, 10, 0, 0, -9, 0, 1]],
    "equilateral": equilateral(),
    "far away": [[1e5, 0, -1e5, 10, 0, 0, 0, 0, 10]],
}


@pytest.mark.parametrize("name", FRAMES)
def test_positions_follow_from_frames_within_the_bound(name):
    known = meshes(FRAMES[name])
    rows = on(known, 20_000, name != "rectangle")
    (chunk,) = packed(rows, "packed", known)
    assert chunk.head["positions"] == "frames"
    back, _ = there_and_back(rows, "packed", known)
    bound = Grid(known).bounds["position"]
    assert 0.5 * bound * (name != "far away") < off(rows, back).max() <= bound
    step = float(np.sqrt((known.frames[:, 3:].astype(float) ** 2).sum(1)).max()) / (1 << 16)
    assert name == "far away" or bound < 1.7 * step


def test_small_primitives_have_parameters_in_large_scenes():
    poster = meshes([[-5e5, 0, -5e5, 1e6, 0, 0, 0, 0, 1e6], [0, 0, 0, 5, 0, 0, 0, 5, 0]])
    rows = on(poster, 20_000, False)
    rows = rows[rows[:, 10] == 1]
    back, _ = there_and_back(rows, "packed", poster)
    assert np.abs(by_path(back).uv - by_path(rows).uv).max() <= 0.5001 / (1 << 8)
    assert off(rows, back).max() <= 5 / (1 << 8)


@pytest.mark.parametrize("half", [0.01, 100.0, 1e5, 1e9])
def test_positions_in_instances_stay_within_the_bound(half):
    """Instances have no frames; the lamp, which has one, is much smaller, or larger."""
    known = meshes([[0, 0, 0, 1, 0, 0, 0, 0, 1]], [[0, 0, 0, 1, 0, 1], [-half] * 3 + [half] * 3], 1000)
    rng = np.random.default_rng(3)
    rows = rows_at_random(20_000, np.ones(20_000, int), rng.integers(0, 1000, 20_000))
    rows.view("f4")[:, :3] = rng.uniform(-half, half, (20_000, 3))
    (chunk,) = packed(rows, "packed-no-paths", known)
    assert chunk.head["positions"] == "boxes"
    rows.view("f4")[:, 6:9] = [1.0, 0.5, 0.25]
    back, size = there_and_back(rows, "packed", known)
    assert off(rows, back).max() <= Grid(known).bounds["position"] < max(2e-5 * 2 * half, 2e-5)
    assert size < (12 + 4) * len(rows)
    outside = rows.copy()
    outside.view("f4")[7, 0] = 1e20
    assert off(outside, there_and_back(outside, "packed", known)[0]).max() == 0.0


def test_powers_are_right_on_average():
    """A lamp with saturated colours comes back as it is; powers that are all different, on average."""
    known = meshes(FRAMES["rectangle"])
    rows = on(known, 60_000, False)
    floats = rows.view("f4")
    floats[:, 6:9] = [1.0, 0.01, 1 / 1100]
    back, _ = there_and_back(rows, "packed", known)
    np.testing.assert_array_equal(by_path(back).power, by_path(rows).power)
    rng = np.random.default_rng(4)
    floats[:, 6:9] = rng.uniform(0.98, 1.0, (len(rows), 1)) * [1.0, 0.01, 1 / 1100]
    back, _ = there_and_back(rows, "packed", known)
    before, after = by_path(rows).power.astype(float), by_path(back).power.astype(float)
    error = after - before
    assert np.abs(error).max() <= Grid(known).bounds["power"] * before[:, 0].max()
    assert (error.std(0) > 0).all()
    z = error.mean(0) / error.std(0) * np.sqrt(len(rows))
    assert (np.abs(z) < 4).all()
    again, _ = there_and_back(rows, "packed", known)
    np.testing.assert_array_equal(again, back)


def test_powers_that_differ_by_rounding_are_one():
    known = meshes(FRAMES["rectangle"])
    rows = on(known, 20_000, False)
    powers = rows.view("f4")[:, 6:9]
    few = np.random.default_rng(2).lognormal(size=(50, 3)).astype("f4")
    powers[:] = few[np.arange(len(rows)) % 50]
    before, few_bytes = there_and_back(rows, "packed", known)
    np.testing.assert_array_equal(by_path(before).power, by_path(rows).power)
    rows[:, 6:9] += np.random.default_rng(3).integers(0, 3, (len(rows), 3)).astype(np.uint32)
    back, size = there_and_back(rows, "packed", known)
    np.testing.assert_allclose(by_path(back).power, by_path(rows).power, rtol=2e-6)
    assert size < 1.1 * few_bytes


def test_positions_off_their_frames_stay_within_the_bound():
    rows = some(3000)
    floats = rows.view("f4")
    floats[100:110, :3] += 3.0  # as after a displacement
    away = np.linalg.norm(
        by_path(there_and_back(rows, "packed")[0]).position.astype(float) - by_path(rows).position, axis=1
    )
    assert away.max() <= Grid(surfaces()).bounds["position"]


def test_particles_of_shapes_that_do_not_exist_are_refused():
    rows = some(10)
    rows[3, 10] = 500
    for column, value in ((9, 3), (10, 500)):
        wrong = some(10)
        wrong[3, column] = value
        with pytest.raises(ParticleError, match="a shape or a triangle that the scene does not have"):
            there_and_back(wrong, "packed")


def test_no_particles():
    assert encode(some(10)[:0], Codec(), Grid(surfaces())) == []


def test_rice_codes_of_all_sizes():
    rng = np.random.default_rng(1)
    gaps = np.concatenate([np.zeros(200), 2.0 ** rng.uniform(0, 32, 3000) - 1, [2**32 - 1] * 70, np.ones(65)])
    gaps = gaps.astype(np.uint64)
    out, back = np.zeros(8 * len(gaps), np.uint8), np.empty_like(gaps)
    length = rice(gaps, out)
    assert unrice(out[:length], back)
    np.testing.assert_array_equal(back, gaps)
    assert not unrice(out[: length // 2], back)
    steps = rng.geometric(1 / 300, 100_000).astype(np.uint64)  # entropy of the gaps: log2(300 e) bits
    out = np.zeros(8 * len(steps), np.uint8)
    assert rice(steps, out) * 8 / len(steps) < np.log2(300 * np.e) + 0.25


def test_sorting_is_stable():
    rng = np.random.default_rng(2)
    keys = rng.integers(0, 1 << 40, 50_000, dtype=np.uint64) & np.uint64(0xFF000F00FF)
    expected = np.argsort(keys, kind="stable")
    order = np.empty(len(keys), np.uint32)
    ascending = keys.copy()
    sorted_by(ascending, order)
    np.testing.assert_array_equal(order, expected)
    np.testing.assert_array_equal(ascending, keys[expected])


@pytest.mark.parametrize("data", [b"", b"a", b"aaab", b"x" * 1000 + b"y", bytes(range(256)) * 3])
def test_run_lengths(data):
    assert of_run_lengths(run_lengths(data), len(data)) == data


def test_names_of_codecs():
    assert str(Codec.parse("exact+lzma")) == "exact+lzma"
    with pytest.raises(ParticleError, match="there is no codec 'pack'; did you mean 'packed'"):
        Codec.parse("pack")
    with pytest.raises(ParticleError, match="there is no coder 'zip'"):
        Codec.parse("packed+zip")


@pytest.mark.skipif(not set(LIBRARIES) - set(INSTALLED), reason="all libraries are installed")
def test_a_library_that_is_missing_is_named():
    missing = next(name for name in LIBRARIES if name not in INSTALLED)
    CODERS.pop(missing, None)
    with pytest.raises(BackendError, match=r"pip install 'etendue\[particles\]'"):
        coder(missing)
