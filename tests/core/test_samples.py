"""The hashed numbers are uniform, unrelated across lanes, dimensions, roles and passes, and a function of their names.

Seeds are fixed, so that a test either always passes or always fails; the bounds are those of a fair generator.
"""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from scipy import stats

from etendue.core.samples import COMPONENTS_PER_VERTEX, IndependentSource, hash_mix, seed_key, to_unit_float

LANES = 1 << 16


def uint32(n):
    import mitsuba as mi

    return dr.arange(mi.UInt32, n)


def draw(vertex=0, component=0, *, seed=0, role="camera", iteration=0, lanes=LANES):
    source = IndependentSource(uint32(lanes), seed, role, iteration)
    return source.next_1d(vertex, component).numpy().astype(np.float64)


def over_dimensions(lane, count):
    """``count`` successive dimensions of one lane, as a path that goes on would draw them."""
    import mitsuba as mi

    source = IndependentSource(dr.full(mi.UInt32, lane, count), 0, "camera", 0)
    return source.next_1d(dr.arange(mi.UInt32, count), 3).numpy().astype(np.float64)


def chi_square(counts):
    """p value of equal expected counts."""
    return stats.chisquare(np.ravel(counts)).pvalue


@pytest.mark.parametrize(
    "names",
    [
        {},
        {"vertex": 1},
        {"vertex": 500, "component": 7},
        {"component": 5},
        {"seed": 1},
        {"seed": 2**40 + 3},
        {"role": "light"},
        {"iteration": 1},
        {"iteration": 10**6},
    ],
)
def test_uniform_over_lanes(names):
    numbers = draw(**names)
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    assert chi_square(np.histogram(numbers, 256, (0, 1))[0]) > 1e-4
    assert stats.kstest(numbers, "uniform").pvalue > 1e-4


def test_the_low_bits_are_uniform_too():
    """A fraction of a number, such as one reused after a discrete choice, is as good as the number."""
    numbers = draw(lanes=1 << 18)
    for scale in (256, 4096):
        assert chi_square(np.histogram(numbers * scale % 1.0, 64, (0, 1))[0]) > 1e-4


@pytest.mark.parametrize("lane", [0, 1, 2, 12345, 2**31])
def test_uniform_over_dimensions(lane):
    numbers = over_dimensions(lane, 1 << 14)
    assert chi_square(np.histogram(numbers, 64, (0, 1))[0]) > 1e-4


def test_every_bit_is_fair_over_every_dimension():
    for component in range(0, COMPONENTS_PER_VERTEX, 9):
        bits = (draw(component=component) * 2**23).astype(np.int64)
        ones = ((bits[:, None] >> np.arange(23)) & 1).sum(axis=0)
        assert np.abs(ones - LANES / 2).max() < 5 * np.sqrt(LANES) / 2


def pair_is_independent(a, b):
    counts = np.histogram2d(a, b, 32, ((0, 1), (0, 1)))[0]
    return chi_square(counts) > 1e-4 and abs(np.corrcoef(a, b)[0, 1]) < 5 / np.sqrt(len(a))


@pytest.mark.parametrize(
    "other",
    [
        {"component": 1},
        {"component": COMPONENTS_PER_VERTEX - 1},
        {"vertex": 1},
        {"seed": 1},
        {"seed": 2**32},
        {"role": "light"},
        {"role": "camerb"},
        {"iteration": 1},
        {"iteration": 2**16},
        {"iteration": 2**32},
    ],
)
def test_pairs_fill_the_square(other):
    assert pair_is_independent(draw(), draw(**other))


@pytest.mark.parametrize("step", [1, 2, 512, 4096])
def test_neighbouring_lanes_are_unrelated(step):
    numbers = draw(lanes=LANES + step)
    assert pair_is_independent(numbers[:-step], numbers[step:])


def test_successive_dimensions_are_unrelated():
    numbers = over_dimensions(7, LANES + 1)
    assert pair_is_independent(numbers[:-1], numbers[1:])


def test_no_shifted_copy_between_passes():
    """Lane l of one pass must not repeat lane l + d of another: that would correlate pixels across passes."""
    a, b = draw(iteration=0, lanes=1 << 14), draw(iteration=1, lanes=1 << 14)
    spectrum = np.fft.ifft(np.fft.fft(a - a.mean()) * np.conj(np.fft.fft(b - b.mean()))).real
    correlation = spectrum / (len(a) * a.std() * b.std())
    assert np.abs(correlation).max() < 6 / np.sqrt(len(a))


def test_a_mean_converges_as_fast_as_it_should():
    """Means over 64 dimensions of a lane, over many lanes: variance 1/12/64, no more and no less."""
    source = IndependentSource(uint32(1 << 14), 3, "camera", 5)
    means = np.mean([source.next_1d(v, c).numpy() for v in range(16) for c in range(4)], axis=0)
    assert np.var(means) == pytest.approx(1 / 12 / 64, rel=0.05)


def test_the_same_names_give_the_same_numbers():
    np.testing.assert_array_equal(draw(2, 3, seed=4, iteration=5), draw(2, 3, seed=4, iteration=5))


def test_a_lane_does_not_depend_on_how_many_there_are():
    np.testing.assert_array_equal(draw(lanes=100), draw(lanes=LANES)[:100])


def test_a_vertex_number_on_the_device_is_the_same_as_one_in_python():
    import mitsuba as mi

    source = IndependentSource(uint32(1000), 1, "camera", 0)
    for vertex in (0, 1, 77, 10**6):
        a = source.next_1d(vertex, 5).numpy()
        np.testing.assert_array_equal(a, source.next_1d(mi.UInt32(vertex), 5).numpy())


def test_next_2d_is_two_components():
    source = IndependentSource(uint32(1000), 1, "camera", 0)
    x, y = source.next_2d(3, 8)
    np.testing.assert_array_equal(x.numpy(), source.next_1d(3, 8).numpy())
    np.testing.assert_array_equal(y.numpy(), source.next_1d(3, 9).numpy())


@pytest.mark.parametrize("component", [-1, COMPONENTS_PER_VERTEX])
def test_a_component_beyond_the_vertex_is_refused(component):
    """It would silently be a number of the next vertex."""
    with pytest.raises(ValueError, match="component"):
        draw(component=component, lanes=10)


def test_seed_keys_do_not_collide():
    keys = {
        seed_key(seed, role, iteration)
        for seed in (0, 1, 2, 2**32, 2**63)
        for role in ("camera", "light", "pilot", "connect")
        for iteration in range(2000)
    }
    assert len(keys) == 5 * 4 * 2000


def test_hash_mix_is_a_bijection_on_a_range():
    import mitsuba as mi

    mixed = hash_mix(dr.arange(mi.UInt32, 1 << 20)).numpy()
    assert len(np.unique(mixed)) == 1 << 20


def test_unit_floats_are_below_one():
    import mitsuba as mi

    bits = mi.UInt32([0, 1 << 9, 0xFFFFFFFF])
    np.testing.assert_array_equal(to_unit_float(bits).numpy(), np.float32([0.0, 2.0**-23, 1.0 - 2.0**-23]))


def test_another_pass_runs_the_same_kernel():
    """Seed, role and iteration are data: were one of them a literal, every pass would compile a kernel."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        for seed, role, iteration in ((0, "camera", 0), (0, "camera", 1), (9, "light", 2)):
            lane = uint32(3000)
            source = IndependentSource(lane, seed, role, iteration)
            dr.eval(source.next_1d(1, 0) + source.next_1d(lane % 7, 2))
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and k["size"] == 3000]
    assert len(kernels) == 3
    assert len({k["hash"] for k in kernels}) == 1
    assert [k["cache_hit"] for k in kernels[1:]] == [True, True]
