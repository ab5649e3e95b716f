"""What denoisers take away besides noise."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.display import develop
from etendue.display.denoising import DENOISERS, Picture, restored
from etendue.display.denoising.registry import Denoiser

HEIGHT, WIDTH = 96, 128


def textured() -> Picture:
    """Stripes on the left side, nothing on the right."""
    x = np.arange(WIDTH, dtype=np.float32)
    row = np.where(x < WIDTH // 2, 1.0 + 0.5 * np.sin(x), 1.0)
    return np.broadcast_to(row[None, :, None], (HEIGHT, WIDTH, 3)).astype(np.float32)


def noisy(truth: Picture, sigma: float, seed: int) -> tuple[Picture, Picture]:
    """(picture with noise in proportion to light, variance)."""
    noise = np.random.default_rng(seed).normal(size=truth.shape)
    return (truth * (1.0 + sigma * noise)).astype(np.float32), np.square(sigma * truth)


def rms(difference: Picture) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))


@pytest.mark.parametrize("seed", range(3))
def test_lost_details_and_means_come_back(seed: int) -> None:
    """Stripes that were smoothed, and a picture that is 5 % too dark: they come back with a part of the noise."""
    truth = textured()
    raw, variance = noisy(truth, 0.1, seed)
    clean = np.full_like(truth, 0.95)
    result = restored(clean, raw, variance)
    left, right = (slice(None), slice(WIDTH // 2 - 16)), (slice(None), slice(WIDTH // 2 + 24, None))
    assert rms(result[left] - truth[left]) < 0.4 * rms(clean[left] - truth[left])
    assert rms(result[right] - truth[right]) < 0.02 < rms(raw[right] - truth[right])
    assert abs(float((result - truth)[right].mean())) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_a_clean_picture_stays_clean(seed: int) -> None:
    """Noise is that of the means over the widest Gaussian, a fortieth of that of a pixel."""
    truth = textured()
    raw, variance = noisy(truth, 0.1, seed)
    assert rms(restored(truth, raw, variance) - truth) < 0.03 * rms(raw - truth)


def test_black_pictures_stay_black() -> None:
    black = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    np.testing.assert_array_equal(restored(black, black, black), black)


def test_a_firefly_does_not_come_back_as_a_blotch() -> None:
    raw, variance = noisy(np.ones((HEIGHT, WIDTH, 3), np.float32), 0.1, 1)
    raw[48, 64], variance[48, 64] = 1000.0, 1e6
    assert np.abs(restored(np.ones_like(raw), raw, variance) - 1.0).max() < 0.02


def test_a_spike_of_too_small_a_variance_does_not_come_back_as_a_dot() -> None:
    """Few passes may find a hundredth of its variance. What comes back is within the second band, in which the spike is
    6 % of what it was."""
    raw, variance = noisy(np.ones((HEIGHT, WIDTH, 3), np.float32), 0.1, 1)
    raw[48, 64] = 2.0
    assert np.abs(restored(np.ones_like(raw), raw, variance) - 1.0).max() < 0.06


@pytest.mark.parametrize("huge", [np.inf, np.nan, 1e38])
def test_pixels_of_unusable_variance_stay_clean(huge: float) -> None:
    raw, variance = noisy(np.ones((HEIGHT, WIDTH, 3), np.float32), 0.1, 1)
    raw[48, 64], variance[48, 64] = 1e4, huge
    assert np.abs(restored(np.ones_like(raw), raw, variance) - 1.0).max() < 0.02


def test_a_lamp_leaves_the_wall_beside_it_as_it_is() -> None:
    """The lamp was made too dark; the wall, a thousand times darker, was not."""
    truth = np.full((HEIGHT, WIDTH, 3), 0.1, np.float32)
    truth[:, :40] = 100.0
    clean = truth.copy()
    clean[:, :40] *= 0.95
    raw, variance = noisy(truth, 0.01, 1)
    result = restored(clean, raw, variance)
    assert rms(result[:, :30] / truth[:, :30] - 1.0) < 0.01
    assert (
        np.abs(result[:, 44:] / truth[:, 44:] - 1.0).max() < 0.05 and rms(result[:, 60:] / truth[:, 60:] - 1.0) < 0.01
    )


def test_what_is_black_stays_black() -> None:
    """Beside a square that was made too bright."""
    truth = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    truth[30:60, 40:80] = 1.0
    result = restored(1.05 * truth, truth, np.full_like(truth, 1e-8))
    np.testing.assert_array_equal(result[truth == 0.0], 0.0)
    assert result.min() >= 0.0 and abs(float(result[40:50, 50:70].mean()) - 1.0) < 0.02


def test_pictures_are_restored_where_the_variance_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not those of chosen components, whose variance nobody knows."""
    truth = textured()
    raw, variance = noisy(truth, 0.1, 1)
    flat = Denoiser("flat", "", lambda part, *_: np.full_like(part, part.mean() / 2), restores=True)
    monkeypatch.setitem(DENOISERS, "flat", flat)
    layers = {"image": raw, "direct": raw / 2, "indirect": raw / 2}
    assert np.ptp(develop(layers, "flat")) == 0.0
    assert rms(develop(layers | {"variance": variance}, "flat") - truth) < 0.15
    assert np.ptp(develop(layers | {"variance": variance}, "flat", components=["direct"])) == 0.0
