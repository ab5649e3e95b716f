"""The picture of chains with the scale of an independent estimator: sums of passes, brightness, weights, error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared
from support.tables import thinned

from etendue.core import RELATIVE_EPSILON
from etendue.methods.metropolis.blend import Blend, Grid, brightness, luminance
from etendue.methods.metropolis.chains import Chains
from etendue.methods.metropolis.states import PassResult

WIDTH, HEIGHT, FACTOR = 48, 24, 0.37
OTHERWISE = np.array([1.0, 1.0])


def image(rng, level, noise):
    """Halves of a picture that is brighter on the right, with noise."""
    mean = level * np.linspace(0.5, 1.5, WIDTH)[None, None, :, None] * np.array([1.0, 0.8, 0.5])
    return mean * (1.0 + noise * rng.standard_normal((2, HEIGHT, WIDTH, 1)))


def made_of(chained, large):
    """The pass of chains whose groups have these pictures, (2, 2, height, width, 3)."""
    pictures = [group.mean(axis=1)[None] for group in (chained, large)]
    contrast = np.stack([0.5 * (light[:, 0] - light[:, 1]) for light in map(luminance, (chained, large))])
    return PassResult(*pictures, contrast, {}, OTHERWISE)


def groups(half):
    """Pictures of the two groups of each half."""
    return np.stack([half(), half()], axis=1)


def blended(passes, chain_noise, path_noise, seed=1, steps=4):
    """Passes of chains whose pictures are too bright by a factor that only the other estimator tells."""
    rng, grid, blend = np.random.default_rng(seed), Grid(WIDTH, HEIGHT), Blend.empty(WIDTH, HEIGHT)
    factors, total = 1.0 + 0.1 * rng.random((HEIGHT, WIDTH)), np.zeros((2, HEIGHT, WIDTH, 3))
    paths = np.zeros_like(total)
    for _ in range(passes):
        chained = groups(lambda: image(rng, 0.7 / FACTOR, 2.0**0.5 * chain_noise))
        large = groups(lambda: image(rng, 0.3, 2.0**0.5 * chain_noise))
        independent = image(rng, 1.0, path_noise)
        weights = blend.weights(grid, steps)
        blend, added = blend.after(made_of(chained, large), independent[None], weights, factors, steps)
        total, paths = total + added[0], paths + independent
    return blend, total, paths, factors


def test_passes_add_up_to_the_picture_with_the_scale_of_all_of_them():
    blend, total, paths, factors = blended(6, 0.2, 0.5)
    np.testing.assert_allclose(brightness(total, factors), brightness(paths, factors), rtol=1e-5)
    np.testing.assert_allclose(blend.scale.scale, FACTOR, rtol=0.05)
    # What is left without the parts that need no scale is the sum of the chains' pictures, with the last scale.
    again = Blend.of(blend.left())
    assert again.shapes == blend.shapes and again.passes == 6
    np.testing.assert_array_equal(again.chained, blend.chained)
    mean, error = blend.scale.luminance()
    assert abs(mean - brightness(paths, np.ones_like(factors)).mean() / 6) < 1e-6 and 0.0 < error < 0.02


def test_the_better_estimator_has_the_larger_weight():
    """In proportion to the inverse variances; and the picture is better than either."""
    for chain_noise, path_noise in ((0.1, 0.4), (0.4, 0.1)):
        blend, total, _, _ = blended(40, chain_noise, path_noise, steps=1)
        share = 1.0 - blend.kept.mean() / 40
        # The chains' picture is the sum of two, with seven and three tenths of the light.
        by_chains, by_paths = (0.7**2 + 0.3**2) * chain_noise**2, path_noise**2
        assert share == pytest.approx(by_chains / (by_chains + by_paths), abs=0.05)
        reference = image(np.random.default_rng(0), 1.0, 0.0)
        error = np.mean((total / 40 - reference) ** 2 / (reference**2 + RELATIVE_EPSILON))
        assert error < 1.2 / (1.0 / by_chains + 1.0 / by_paths) / 40


@pytest.mark.slow
def test_chains_that_stay_where_they_are_lose_no_light():
    """A tenth of the light is in the upper half of the film. Groups of chains are there a tenth of the time, and stay
    long. If weights followed the chains that they are for, they would keep least of what these have not found."""
    rng, side, passes, runs, share = np.random.default_rng(3), 16, 60, 150, 0.1
    grid, factors, found = Grid(2, side), np.ones((side, 2)), []
    is_upper = np.arange(side)[:, None, None] < side // 2
    for _ in range(runs):
        blend, upper = Blend.empty(2, side), 0.0
        left = rng.random((2, 2)) < share  # by half and group
        for _ in range(passes):
            left = np.where(rng.random((2, 2)) < 0.03, rng.random((2, 2)) < share, left)
            there = left[:, :, None, None, None]
            chained = 2.0 * np.where(is_upper, there, ~there) * np.ones((side, 2, 3))
            paths = rng.gamma(0.25, 4.0, (2, 2)) * 2.0 * np.array([share, 1.0 - share])  # of half and side
            paths = np.where(is_upper, paths[:, :1, None, None], paths[:, 1:, None, None]) * np.ones((side, 2, 3))
            weights = blend.weights(grid, 1)
            blend, added = blend.after(made_of(chained, 0.0 * chained), paths[None], weights, factors, 1)
            upper += added[0][:, : side // 2].mean() / (2.0 * share * passes)
        found.append(upper)
    error = np.std(found) / np.sqrt(runs)
    assert error < 0.1 and abs(np.mean(found) - 1.0) < 3.0 * error, (np.mean(found), error)


def test_no_light_of_the_independent_estimator_leaves_the_scale_to_the_large_steps():
    blend, one = Blend.empty(WIDTH, HEIGHT), np.ones((2, 2, HEIGHT, WIDTH, 3))
    factors, half = np.ones((HEIGHT, WIDTH)), np.full((2, HEIGHT, WIDTH), 0.5)
    made = replace(made_of(one, 0.0 * one), factors=np.array([2.0, 3.0]))
    blend, added = blend.after(made, 0.0 * one[None, :, 0], half, factors, 4)
    np.testing.assert_array_equal(blend.scale.scale, [2.0, 3.0])
    np.testing.assert_array_equal(added[0, :, 0, 0, 0], [1.0, 1.5])


@pytest.mark.parametrize("method", thinned(["mmlt", "pssmlt", "film_metropolis"], ["pssmlt"]))
def test_the_scale_is_not_that_of_the_large_steps(method, monkeypatch):
    """Chains that have been told a wrong mean of the target make the same picture, if none begins anew."""
    monkeypatch.setattr(Chains, "renewed", lambda self, carried, *_: carried.states)
    problem = scenes.room("rectangle", scenes.FEW)
    settings = {"samples_per_pass": 32, "bootstrap": 1 << 12}
    pictures = []
    for factor in (1.0, 3.0):
        runner = prepared(problem, method, **settings)
        found = runner.start()["found"] * np.array([1.0, factor, 1.0])
        runner.restore(dict(runner.start()) | {"found": found})
        pictures.append(go(runner, 2).mean)
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-4, atol=1e-6)
