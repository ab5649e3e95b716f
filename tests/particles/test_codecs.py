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


def there_and_back(rows: Rows, codec: str) -> tuple[Rows, int]:
    """(what comes back, bytes)."""
    grid = Grid(surfaces())
    chunks = [make() for make in encode(rows, Codec.parse(codec), grid)]
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
    floats[:4, 6:9] = [[-1.0, 2.0, 0.0], [1e-42, 0.0, 0.0], [3e38, 1.0, 0.0], [0.0, 0.0, 0.0]]
    rows[rows[:, 9] == 1, 9] = 0  # all in one chunk
    back, _ = there_and_back(rows, "packed")
    np.testing.assert_array_equal(by_path(back).power, by_path(rows).power)


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
