"""FLIP, where its library is installed: 0 for equal pictures, larger for more noise, blind to exposure."""

import numpy as np
import pytest

from etendue.core import BackendError, OptionError
from etendue.film import flip, flip_error, flip_is_installed

needs_library = pytest.mark.skipif(not flip_is_installed(), reason="flip-evaluator is not installed")


def pictures():
    rng = np.random.default_rng(1)
    reference = rng.random((12, 10, 3)).repeat(4, axis=0).repeat(4, axis=1)
    return reference, reference * (1.0 + 0.3 * rng.standard_normal(reference.shape))


@needs_library
def test_flip_orders_pictures_by_their_noise():
    reference, noisy = pictures()
    assert flip(reference, reference) == 0.0
    assert 0.0 < flip(0.5 * (noisy + reference), reference) < flip(noisy, reference) < 1.0


@needs_library
def test_flip_does_not_depend_on_the_unit_of_radiance():
    reference, noisy = pictures()
    assert flip(64.0 * noisy, 64.0 * reference) == pytest.approx(flip(noisy, reference), rel=0.02)


@needs_library
def test_pixels_that_are_not_finite_are_left_out():
    reference, noisy = pictures()
    broken = reference.copy()
    broken[5, 6, 1] = np.nan
    error = flip_error(broken, reference)
    assert np.isnan(error[5, 6]) and np.nanmax(error) == 0.0
    assert np.isnan(flip(np.full_like(noisy, np.nan), reference))
    assert flip(np.zeros_like(noisy), np.zeros_like(noisy)) == 0.0


def test_other_sizes_and_a_missing_library_are_one_error(monkeypatch):
    reference, noisy = pictures()
    with pytest.raises(OptionError, match="of one size"):
        flip(noisy[1:], reference)
    monkeypatch.setitem(__import__("sys").modules, "flip_evaluator", None)
    with pytest.raises(BackendError, match=r"etendue\[flip\]"):
        flip(noisy, reference)
