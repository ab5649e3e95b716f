"""What every point set promises: one set of numbers on the device and in NumPy, prefixes, seeds, clear errors."""

from __future__ import annotations

import re

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from etendue.core import EtendueError, OptionError
from etendue.points import (
    ExactPiPowers,
    Halton,
    Hammersley,
    LatinHypercube,
    OwenSobol,
    PointSetError,
    RandomShift,
    Sobol,
    Weyl,
    has_size,
    point_set,
    point_sets,
)

NAMES = sorted(point_sets())
#: Those that are random, by themselves or shifted.
RANDOM = [name if kind.is_random else f"{name}+shift" for name, kind in sorted(point_sets().items())]
SIZE = 5000


def indices(size: int | None) -> np.ndarray:
    """The first ones, the last ones, those around powers of small bases, and some at random."""
    top = size or 1 << 32
    powers = [b**k - 1 + j for b in (2, 3, 5, 7, 11) for k in range(1, 32) for j in (0, 1)]
    wanted = [*range(3000), *range(top - 500, top), *powers, *np.random.default_rng(1).integers(0, top, 4000)]
    return np.array([i for i in wanted if i < top], np.uint32)


@pytest.mark.parametrize("shift", ["", "+shift"])
@pytest.mark.parametrize("name", NAMES)
def test_the_device_has_the_numbers_of_numpy(name, shift):
    highest = 200 if name == "pi-powers-exact" else 1500
    points = point_set(name + shift, highest, SIZE, seed=3)
    lanes = indices(points.size)
    on_device = mi.UInt32(lanes)
    for dimension in (*range(6), 10, 17, highest - 1):
        host = points.coordinate(lanes, dimension)
        device = np.asarray(points.coordinate(on_device, dimension))
        assert host.dtype == np.float64 and device.dtype == np.float32
        gap = np.abs(host - device)
        assert (np.minimum(gap, 1 - gap) if shift else gap).max() < 2.0**-23
        for values in (host, device):
            assert values.min() >= 0 and values.max() < 1


@pytest.mark.parametrize("name", [*NAMES, "halton+shift"])
def test_a_value_a_block_and_a_coordinate_are_the_same_points(name):
    points = point_set(name, 5, SIZE, seed=1)
    block = points.block(40, first=7)
    assert block.shape == (40, 5)
    assert points.block(0).shape == (0, 5)
    np.testing.assert_array_equal(points.block(10, first=12), block[5:15])
    np.testing.assert_array_equal(points.value(20), block[13])
    for d in range(5):
        np.testing.assert_array_equal(points.coordinate(np.arange(7, 47).reshape(8, 5), d).ravel(), block[:, d])
        assert points.coordinate(9, d) == block[2, d]


@pytest.mark.parametrize("name", NAMES)
def test_a_sequence_has_no_size_and_a_point_set_has_one(name):
    points = point_set(name, 3, SIZE)
    assert points.size == (SIZE if has_size(type(points)) else None)
    if points.size is None:
        assert points.block(3, first=2**32 - 3).shape == (3, 3)


@pytest.mark.parametrize("name", [*NAMES, "halton+shift"])
def test_a_loop_on_the_device_can_ask(name):
    """Inside a symbolic loop, which has another index each time; and what it made there is good outside."""
    points = point_set(name, 4, SIZE, seed=2)
    start = dr.arange(mi.UInt32, 64)

    def body(i, total):
        return i + 64, total + points.coordinate(i, 2) * points.coordinate(i, 3)

    _, total = dr.while_loop((start, dr.zeros(mi.Float, 64)), lambda i, _: i < 256, body)
    block = points.block(256)
    np.testing.assert_allclose(np.asarray(total), (block[:, 2] * block[:, 3]).reshape(4, 64).sum(0), atol=1e-6)
    np.testing.assert_allclose(np.asarray(points.coordinate(start, 3)), block[:64, 3], atol=2.0**-23)


@pytest.mark.parametrize("name", RANDOM)
def test_each_point_is_uniform_over_the_seeds(name):
    """In each dimension, and jointly."""
    values = np.array([point_set(name, 3, 50, seed=seed).value(13) for seed in range(600)])
    for d in range(3):
        assert stats.kstest(values[:, d], "uniform").pvalue > 1e-4
    counts, _ = np.histogramdd(values, bins=3, range=[(0, 1)] * 3)
    assert stats.chisquare(counts.ravel()).pvalue > 1e-4


@pytest.mark.parametrize("name", NAMES)
def test_randomised_copies(name):
    """The same seed gives the same points; another one gives points that are independent of them."""
    points = point_set(name, 2, 50)
    first, again, second = points.randomised(5), points.randomised(5), points.randomised(6)
    assert (first.dimension, first.size, first.is_random) == (2, points.size, True)
    np.testing.assert_array_equal(first.block(50), again.block(50))
    assert not np.array_equal(first.block(50), second.block(50))
    pairs = np.array(
        [[points.randomised(s).value(3)[0], points.randomised(s + 1).value(3)[0]] for s in range(0, 800, 2)]
    )
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 4.5 / np.sqrt(len(pairs))


def test_what_a_set_becomes_best():
    assert isinstance(Sobol(2).randomised(1), OwenSobol)
    shifted = Weyl(2).randomised(1)
    assert isinstance(shifted, RandomShift) and shifted.name == "weyl+shift"
    assert isinstance(shifted.randomised(2), RandomShift) and shifted.randomised(2).base is shifted.base


@pytest.mark.parametrize("name", RANDOM)
def test_another_seed_compiles_no_other_kernel(name):
    def kernels(seed):
        points = point_set(name, 3, 50, seed=seed)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            total = sum((points.coordinate(dr.arange(mi.UInt32, 37), d) for d in range(3)), mi.Float(0))
            dr.eval(total)
            return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["size"] == 37}

    assert len(kernels(1)) == 1
    assert kernels(1) == kernels(2)


def test_a_shift_moves_all_points_alike():
    moved = (RandomShift(Halton(3), 4).block(100) - Halton(3).block(100)) % 1
    assert np.ptp(moved, axis=0).max() < 1e-12
    assert len(np.unique(np.round(moved[0], 9))) == 3


def slope(name: str) -> float:
    """Of the root mean squared error over the number of points, for a smooth function of two numbers."""
    numbers, seeds = 2 ** np.arange(5, 13), 40
    errors = np.zeros(len(numbers))
    for seed in range(seeds):
        points = point_set(name, 2, int(numbers[-1]), seed=seed).block(int(numbers[-1]))
        means = np.cumsum(np.exp(points[:, 0]) * np.sin(np.pi * points[:, 1]))[numbers - 1] / numbers
        errors += (means - (np.e - 1) * 2 / np.pi) ** 2 / seeds
    return float(np.polyfit(np.log(numbers), np.log(errors) / 2, 1)[0])


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("independent", -0.6, -0.4),
        ("halton+shift", -1.15, -0.8),
        ("faure-halton+shift", -1.15, -0.8),
        ("sobol+shift", -1.15, -0.8),
        ("weyl+shift", -1.15, -0.8),
        ("owen-sobol", -1.65, -1.3),
    ],
)
def test_errors_fall_as_theory_has_it(name, low, high):
    """n^-1/2 for independent points, about n^-1 for low discrepancy, n^-3/2 for scrambled nets."""
    assert low < slope(name) < high


BAD = [
    (lambda: point_set("hallton", 2), "did you mean 'halton'"),
    (lambda: point_set("hammersley", 2), "needs a number of points; give a size"),
    (lambda: Halton(0), "dimension must be a whole number from 1, not 0"),
    (lambda: Halton(2.5), "not 2.5"),
    (lambda: Halton(6543), "at most 6542 dimensions, not 6543"),
    (lambda: Sobol(2049), "at most 2048 dimensions, not 2049"),
    (lambda: Halton(2).coordinate(0, 2), "has the dimensions 0 to 1, not 2"),
    (lambda: Halton(2).coordinate(mi.UInt32(0), -1), "has the dimensions 0 to 1, not -1"),
    (lambda: Halton(2).coordinate(-1, 0), "an index is at least 0, not -1"),
    (lambda: Halton(2).coordinate(0.5, 0), "an index is a whole number, not 0.5"),
    (lambda: Halton(2).coordinate(2**32, 0), "an index is below 2^32, not 4294967296"),
    (lambda: Halton(2).coordinate(mi.Float(1), 0), "an index on the device is a UInt32, not a Float"),
    (lambda: Halton(2).coordinate(mi.UInt64(1), 0), "an index on the device is a UInt32, not a UInt64"),
    (lambda: Halton(2).block(10, 2**32 - 5), "an index is below 2^32"),
    (lambda: Halton(2).block(-1), "number of points must be a whole number from 0, not -1"),
    (lambda: Halton(2).block(1, 0.5), "an index is a whole number"),
    (lambda: Hammersley(2, 0), "number of points must be from 1 to 2^32, not 0"),
    (lambda: Hammersley(2, 8).block(9), "made for 8 points and has no point 8"),
    (lambda: Hammersley(2, 8).value(8), "use a larger size, or a sequence"),
    (lambda: LatinHypercube(2, 8).randomised(1).block(9), "made for 8 points"),
    (lambda: RandomShift(Hammersley(2, 8)).block(9), "hammersley+shift was made for 8 points"),
    (lambda: ExactPiPowers(2, 9000), "the limit is 8192"),
]


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input(call, message):
    with pytest.raises(PointSetError, match=re.escape(message)) as raised:
        call()
    assert isinstance(raised.value, OptionError) and isinstance(raised.value, EtendueError)
    assert "\n" not in str(raised.value)
