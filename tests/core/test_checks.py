"""Which values count as numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from etendue.core import is_number, is_whole


@pytest.mark.parametrize("value", [0, -3, 2**70, np.int64(4), np.uint8(1)])
def test_whole_numbers(value):
    assert is_whole(value) and is_number(value)


@pytest.mark.parametrize("value", [0.5, -1e300, 2.0, np.float32(1.5), np.float64(0)])
def test_numbers_that_are_not_whole_by_type(value):
    assert is_number(value) and not is_whole(value)


@pytest.mark.parametrize("value", [True, False, np.bool_(True), None, "1", 1j, math.nan, math.inf, -math.inf, [1]])
def test_no_numbers(value):
    assert not is_number(value) and not is_whole(value)
