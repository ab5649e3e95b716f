"""Codes of strata."""

import numpy as np
import pytest

from etendue.points import MixedRadix


def test_codes_round_trip():
    radix = MixedRadix((3, 1, 4, 2))
    assert len(radix) == 24
    codes = np.arange(24)
    np.testing.assert_array_equal(radix.code(radix.digits(codes)), codes)
    assert radix.digits(1 + 3 * (2 + 4 * 1)) == [1, 0, 2, 1]
    assert all(radix.code(radix.digits(code)) == code for code in range(24))


def test_strata_are_a_partition_of_the_cube():
    radix = MixedRadix((3, 2))
    for point in np.random.default_rng(1).random((200, 2)):
        boxes = (radix.box(code) for code in range(6))
        assert sum((lower <= point).all() and (point < upper).all() for lower, upper in boxes) == 1
    assert sum(np.prod(np.diff(radix.box(code), axis=0)) for code in range(6)) == pytest.approx(1)
    with pytest.raises(ValueError, match="at least one segment"):
        MixedRadix((2, 0))
