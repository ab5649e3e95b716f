"""Pictures from samples on the film: kernels of any width against sums over the samples, and memory."""

from __future__ import annotations

import math

import numpy as np
import pytest

from etendue.core import OptionError
from etendue.film import Development, developing

SIZE = (8, 6)


def samples() -> np.ndarray:
    """In the picture and a margin of half its size."""
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.5, 1.5, (2000, 2))
    return np.concatenate([places, rng.random((2000, 3))], axis=1).astype(np.float32)


def summed(rows: np.ndarray, width: float, inset: float) -> np.ndarray:
    """The mean of Gaussians over each pixel."""
    shares = []
    for axis, size in enumerate(SIZE):
        centres = (rows[:, axis] - inset) / (1.0 - 2.0 * inset) * size
        centres = np.floor(2.0 * centres) / 2.0 + 0.25  # samples are added to cells of half a pixel
        edges = (np.arange(size + 1) - centres[:, None]) / (width * math.sqrt(2.0))
        shares.append(0.5 * np.diff(np.vectorize(math.erf)(edges), axis=1))
    scale = SIZE[0] * SIZE[1] / (1.0 - 2.0 * inset) ** 2 / len(rows)
    return scale * np.einsum("ny,nx,nc->yxc", shares[1], shares[0], rows[:, 2:])


@pytest.mark.parametrize("inset", [0.0, 0.3])
@pytest.mark.parametrize("width", [1.0, 4.0, 20.0, 1000.0])
def test_kernels_of_any_width(width, inset):
    """Also of those wider than the picture and its margin: their grid is no larger for that."""
    picture = Development(SIZE, "kernel", bandwidth=width, inset=inset).picture([samples()], 2000)
    exact = summed(samples().astype(float), width, inset)
    assert np.abs(picture - exact).max() < 0.02 * exact.max()


@pytest.mark.parametrize("estimator", ["histogram", "kernel", "variable", "nearest"])
def test_light_is_where_samples_are(estimator):
    """Coloured spots in two corners: rows are y, and every colour stays with its samples."""
    rng = np.random.default_rng(1)
    spots = []
    for place, colour in (([0.81, 0.25], [1, 0, 0]), ([0.31, 0.75], [0, 1, 0])):
        spots.append(np.hstack([rng.normal(place, 0.03, (4000, 2)), np.tile(colour, (4000, 1))]))
    picture = Development(SIZE, estimator).picture([np.concatenate(spots).astype(np.float32)], 8000)
    assert np.unravel_index(picture[..., 0].argmax(), SIZE[::-1]) == (1, 6)
    assert np.unravel_index(picture[..., 1].argmax(), SIZE[::-1]) == (4, 2)
    assert picture[:3, :, 1].sum() < 0.05 * picture[..., 1].sum()


@pytest.mark.parametrize(("estimator", "free"), [("kernel", 1e4), ("variable", 1e4), ("nearest", 1e3)])
def test_what_does_not_fit_into_memory(estimator, free, monkeypatch):
    monkeypatch.setattr(developing, "free_memory", lambda: int(free))
    with pytest.raises(OptionError, match="more than is free"):
        Development(SIZE, estimator).picture([samples()], 2000)
    assert Development(SIZE).picture([samples()], 2000).any()
