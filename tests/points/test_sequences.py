"""Each sequence against published values, scipy, and what defines it."""

from __future__ import annotations

import itertools
from collections import Counter
from decimal import Decimal, getcontext
from math import isqrt

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from etendue.points import (
    ExactPiPowers,
    FaureBlockHalton,
    FaureHalton,
    Halton,
    Hammersley,
    Independent,
    LatinHypercube,
    OwenSobol,
    PiPowers,
    PointSetError,
    Sobol,
    Weyl,
    direction_numbers,
    faure_permutation,
    net_parameter,
    radical_inverse,
)


def test_van_der_corput():
    """19 is 10011 in base 2, so 0.11001 [Castro 2002]."""
    assert Halton(1).value(19) == [0.78125]
    np.testing.assert_array_equal(Halton(1).block(8)[:, 0] * 8, [0, 4, 2, 6, 1, 5, 3, 7])


def test_halton():
    first = [(1 / 2, 1 / 3, 1 / 5), (1 / 4, 2 / 3, 2 / 5), (3 / 4, 1 / 9, 3 / 5), (1 / 8, 4 / 9, 4 / 5)]
    np.testing.assert_allclose(Halton(3).block(5)[1:], first, rtol=1e-15)
    theirs = qmc.Halton(40, scramble=False).random(5000)
    np.testing.assert_allclose(Halton(40).block(5000), theirs, atol=1e-15)


def test_hammersley():
    points = Hammersley(3, 10).block(10)
    np.testing.assert_array_equal(points[:, 0], np.arange(10) / 10)
    np.testing.assert_array_equal(points[:, 1:], Halton(2).block(10))
    assert net_parameter(Hammersley(2, 256).block(256)) == 0


@pytest.mark.parametrize(
    ("base", "digits"),
    [(2, "01"), (3, "012"), (4, "0213"), (5, "03214"), (6, "024135"), (7, "0253146"), (8, "04261537")],
)
def test_faure_permutations(base, digits):
    assert "".join(map(str, faure_permutation(base))) == digits


@pytest.mark.parametrize("base", [2, 11, 97, 100, 541])
def test_faure_permutations_permute_and_keep_0(base):
    permutation = faure_permutation(base)
    assert sorted(permutation) == list(range(base)) and permutation[0] == 0


def test_every_digit_is_permuted():
    """By the definition, digit by digit."""
    points = FaureHalton(5)
    for i in (1, 6, 24, 25, 124, 3000, 2**32 - 1):
        for d, base in enumerate((2, 3, 5, 7, 11)):
            rest, expected, weight = i, 0.0, 1.0
            while rest:
                weight /= base
                expected += faure_permutation(base)[rest % base] * weight
                rest //= base
            assert points.value(i)[d] == pytest.approx(expected, abs=1e-14)


def test_the_other_reading_permutes_inside_each_block():
    """Blocks of b points change places: x0, x3, x2, x1, x4, x5, x8, ... in base 5."""
    halton, scrambled = Halton(3).block(50)[:, 2], FaureBlockHalton(3).block(50)[:, 2]
    places = [5 * block + digit for block in range(10) for digit in (0, 3, 2, 1, 4)]
    np.testing.assert_allclose(scrambled, halton[places], atol=1e-15)
    standard = FaureHalton(3).block(50)[:, 2]
    np.testing.assert_allclose(scrambled[:5], standard[:5], atol=1e-15)
    assert abs(scrambled[5:10] - standard[5:10]).min() > 0.05


def test_the_printed_example_of_the_other_reading():
    """x1, x3, x2, x4, x5, x7, x6, x8 in base 4 [Castro 2002, sec. 2.2.13]."""
    points = FaureBlockHalton(1)
    points._bases = [4]
    printed = np.array([1, 3, 2, 4, 5, 7, 6, 8])
    np.testing.assert_allclose(points.block(8)[:, 0], radical_inverse(printed - 1, 4), atol=1e-15)


@pytest.mark.parametrize("base", [0, 1, 65536])
def test_a_base_that_is_none(base):
    for call in (lambda: faure_permutation(base), lambda: radical_inverse(np.arange(3), base)):
        with pytest.raises(PointSetError, match=f"a base must be from 2 to 65535, not {base}"):
            call()


def test_odd_bases_on_the_device():
    """Also such as are no primes; an even one is refused."""
    index = np.random.default_rng(3).integers(0, 2**32, 3000, dtype=np.uint32)
    for base in (9, 15, 21, 255, 645, 65535):
        device = np.asarray(radical_inverse(mi.UInt32(index), base))
        assert np.abs(device - radical_inverse(index, base)).max() < 2.0**-23
    with pytest.raises(PointSetError, match="must be 2 or odd, not 4"):
        radical_inverse(mi.UInt32(0), 4)


@pytest.mark.parametrize("base", [4, 10, 36])
def test_numpy_has_radical_inverses_in_any_base(base):
    assert radical_inverse(np.array([base + 2]), base)[0] == pytest.approx(2 / base + 1 / base**2)


def gray(n: int) -> np.ndarray:
    """scipy's order of Sobol's points."""
    i = np.arange(n)
    return i ^ (i >> 1)


def test_sobol_in_every_dimension():
    ours = Sobol(2048).block(2048)
    theirs = qmc.Sobol(2048, scramble=False, bits=32).random(2048)
    np.testing.assert_array_equal(ours[gray(2048)], theirs)


def test_sobol_far_out():
    engine = qmc.Sobol(300, scramble=False, bits=32)
    engine.fast_forward(2**20 + 12345)
    place = (2**20 + 12345) ^ ((2**20 + 12345) >> 1)
    np.testing.assert_array_equal(Sobol(300).value(place), engine.random(1)[0])


def test_sobol_is_linear_in_the_bits_of_the_index():
    def bits(i):
        return (Sobol(50).value(i) * 2.0**32).astype(np.uint64)

    for i, j in ((2**31 + 77, 123456789), (2**32 - 1, 1), (0xDEADBEEF, 0x12345678)):
        np.testing.assert_array_equal(bits(i ^ j), bits(i) ^ bits(j))
    np.testing.assert_array_equal(bits(2**31), [direction_numbers(d)[31] for d in range(50)])


def test_published_direction_numbers():
    """The third dimension: x^2 + x + 1, m = 1, 3 and on by the recurrence [Joe 2008]."""
    m = [number >> (31 - k) for k, number in enumerate(direction_numbers(2))]
    assert m[:6] == [1, 3, 3, 9, 29, 23]
    for d in (0, 1, 2, 100, 2047):
        for k, number in enumerate(direction_numbers(d)):
            assert number >> (31 - k) & 1 and number & ((1 << (31 - k)) - 1) == 0


@pytest.mark.parametrize(("first", "t"), [(0, 0), (256, 0), (768, 0)])
def test_two_dimensions_of_sobol_are_a_perfect_net(first, t):
    assert net_parameter(Sobol(2).block(256, first)) == t


@pytest.mark.parametrize("dimension", [3, 4])
@pytest.mark.parametrize("seed", range(3))
def test_scrambling_keeps_the_net(dimension, seed):
    plain = net_parameter(Sobol(dimension).block(256))
    assert 0 < plain <= 3
    assert net_parameter(OwenSobol(dimension, seed).block(256)) == plain
    assert net_parameter(Independent(dimension, seed).block(256)) > 5


def test_scrambling_is_nested():
    """Two numbers share as many leading bits after it as before, in every dimension."""
    plain, scrambled = ((points.block(300) * 2.0**32).astype(np.uint64) for points in (Sobol(7), OwenSobol(7, seed=5)))
    for d in range(7):
        pairs = np.random.default_rng(d).integers(0, 300, (2, 2000))
        before = plain[pairs[0], d] ^ plain[pairs[1], d]
        after = scrambled[pairs[0], d] ^ scrambled[pairs[1], d]
        # Equal highest set bits.
        np.testing.assert_array_equal(np.frexp(before.astype(float))[1], np.frexp(after.astype(float))[1])
    assert not np.array_equal(plain, scrambled)


def test_flips_of_a_bit_are_independent_between_prefixes():
    """Over the seeds, the first four bits of two points of one half and of one of the other are uniform together."""
    bits = []
    for seed in range(4000):
        a, b, c = (OwenSobol(1, seed).block(3)[:, 0] * 4).astype(int)
        bits.append((a, b, c))
    counts = Counter(
        (a, b & 1, c & 1) for a, b, c in bits
    )  # 0 and 1/2 differ in the first bit, 0 and 1/4 in the second
    assert all(a >> 1 != b >> 1 for a, b, _ in bits) and all(a >> 1 == c >> 1 and a & 1 != c & 1 for a, _, c in bits)
    cells = [counts[a, b, 1 - (a & 1)] for a, b in itertools.product(range(4), range(2))]
    assert sum(cells) == 4000 and stats.chisquare(cells).pvalue > 1e-4


def test_weyl():
    first = [(0.41421356, 0.73205081, 0.23606798, 0.64575131), (0.82842712, 0.46410162, 0.47213595, 0.29150262)]
    np.testing.assert_allclose(Weyl(4).block(3)[1:], first, atol=1e-8)
    i, p = 4_000_000_007, 7919  # the 1000th prime
    exact = isqrt((i * i * p) << 200) & (2**100 - 1)
    assert Weyl(1000).value(i)[999] == pytest.approx(exact * 2.0**-100, abs=2.0**-31)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 64, 1000])
def test_a_latin_hypercube_has_one_point_in_each_interval(size):
    for seed in range(3):
        points = LatinHypercube(4, size, seed).block(size)
        np.testing.assert_array_equal(np.sort(np.floor(points * size), axis=0), np.arange(size)[:, None] + np.zeros(4))


def test_orders_of_a_latin_hypercube_are_alike_probable():
    """All orders of three, and the places of the first of 5; and those of two dimensions are independent."""
    orders = Counter(tuple(np.floor(LatinHypercube(1, 3, seed).block(3)[:, 0] * 3)) for seed in range(1000))
    assert len(orders) == 6 and stats.chisquare(list(orders.values())).pvalue > 1e-4
    pairs = Counter(tuple(np.floor(LatinHypercube(2, 5, seed).value(0) * 5)) for seed in range(1000))
    assert len(pairs) == 25 and stats.chisquare(list(pairs.values())).pvalue > 1e-4


#: 110 digits.
PI = Decimal(
    "3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534211706798214808651"
)


def test_powers_of_pi_from_all_their_digits():
    getcontext().prec = 105
    exact = ExactPiPowers(2, 200).block(200)
    for i in (0, 1, 2, 10, 33, 60, 120):
        assert exact[i, 0] == pytest.approx(float(PI**i % 1), abs=1e-15)
    np.testing.assert_array_equal(exact[1:, 0], exact[:-1, 1])


def test_powers_of_pi_in_doubles_run_out_of_digits():
    powers = PiPowers(1).block(60)[:, 0]
    exact = ExactPiPowers(1, 60).block(60)[:, 0]
    np.testing.assert_allclose(powers[:8], exact[:8], atol=1e-11)
    assert (powers[32:] == 0).all() and abs(powers[25:32] - exact[25:32]).max() > 0.1
    assert powers[30] == 5 / 8
