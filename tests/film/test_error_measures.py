"""Closed forms of the error measures."""

import numpy as np
import pytest

from etendue.core import OptionError
from etendue.film import (
    block_average,
    luminance_rmse,
    relative_bias,
    relative_mse,
    relative_squared_error,
)


def test_relative_mse_of_a_constant_factor():
    reference = np.full((6, 5, 3), 2.0)
    assert relative_mse(1.1 * reference, reference) == pytest.approx(0.2**2 / (4.0 + 0.01))
    assert relative_mse(reference, reference) == 0.0


def test_black_reference_is_bounded_by_the_epsilon():
    assert relative_mse(np.full((2, 2, 3), 0.1), np.zeros((2, 2, 3))) == pytest.approx(1.0)


def test_channels_are_averaged():
    image, reference = np.ones((1, 1, 3)), np.ones((1, 1, 3))
    image[0, 0, 1] = 2.0
    assert relative_mse(image, reference) == pytest.approx(1.0 / 1.01 / 3.0)


def test_only_finite_pixels_count():
    image, reference = np.full((10, 10, 3), 1.5), np.ones((10, 10, 3))
    expected = relative_mse(image, reference)
    image[3, 4, 1], reference[7, 7, 0], reference[1, 1] = np.nan, np.inf, np.inf
    image[1, 1] = np.inf
    assert relative_mse(image, reference) == pytest.approx(expected)
    assert relative_bias(image, reference) == pytest.approx(0.5)
    assert np.isnan(relative_squared_error(image, reference)).sum() == 3


def test_nothing_finite_is_nan():
    assert np.isnan(relative_mse(np.full((2, 2, 3), np.nan), np.ones((2, 2, 3))))


def test_trim_leaves_out_the_worst_pixels_only():
    image, reference = np.full((50, 40, 3), 1.1), np.ones((50, 40, 3))
    plain = relative_mse(image, reference)
    image[3, 3] = image[17, 2] = 1000.0  # 2 of 2000 pixels are 0.1 %
    assert relative_mse(image, reference) > 900.0
    assert relative_mse(image, reference, trim=0.001) == pytest.approx(plain)
    image[20, 20] = 1000.0
    assert relative_mse(image, reference, trim=0.001) > 400.0


@pytest.mark.parametrize("trim", [-0.1, 1.0, float("nan")])
def test_trim_out_of_range(trim):
    with pytest.raises(OptionError, match="trim"):
        relative_mse(np.ones((2, 2, 3)), np.ones((2, 2, 3)), trim=trim)


def test_sizes_must_match():
    with pytest.raises(OptionError, match=r"4 x 2 x 3.*3 x 2 x 3"):
        relative_mse(np.ones((2, 4, 3)), np.ones((2, 3, 3)))


def test_bias_has_a_sign():
    reference = np.random.default_rng(1).random((8, 8, 3))
    assert relative_bias(0.9 * reference, reference) == pytest.approx(-0.1)


def test_rms_of_luminance_weighs_channels_before_squaring():
    reference = np.full((2, 2, 3), 0.5)
    image = reference + np.array([1.0, -0.2126 / 0.7152, 0.0])  # another colour of the same luminance
    assert luminance_rmse(image, reference) == pytest.approx(0.0, abs=1e-12)
    image[0, 0] = 0.9
    image[0, 1] = np.nan
    assert luminance_rmse(image, reference) == pytest.approx(0.4 / np.sqrt(3))
    assert np.isnan(luminance_rmse(np.full((2, 2, 3), np.inf), reference))


def test_block_average():
    image = np.arange(2 * 4 * 3, dtype=float).reshape(2, 4, 3)
    small = block_average(image, 2)
    assert small.shape == (1, 2, 3)
    np.testing.assert_allclose(small[0, 0], image[:2, :2].mean(axis=(0, 1)))
    np.testing.assert_allclose(small[0, 1], image[:2, 2:].mean(axis=(0, 1)))
    image[0, 0, 0] = np.inf
    assert np.isinf(block_average(image, 2)[0, 0, 0]) and np.isfinite(block_average(image, 2)[0, 1]).all()
    with pytest.raises(OptionError, match="blocks of 3"):
        block_average(image, 3)
