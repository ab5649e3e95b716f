"""Pictures by chains: their means, what they tell about themselves, and what stops them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run

from etendue.core import SceneError
from etendue.methods.metropolis.chains import CAP
from etendue.methods.metropolis.film import BrightnessMap

SMALL = {"samples_per_pass": 32, "bootstrap": 1 << 13}


def test_no_light_is_one_line():
    """A lamp that shines away from everything that the camera sees."""
    scene = {"type": "scene", "sensor": scenes.camera()}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)
    scene["lamp"] = scenes.lamp((0.0, -1.0, 0.0), 0.3, 5.0)
    with pytest.raises(SceneError, match=r"the bootstrap found no light: .* raise bootstrap$"):
        prepared(scenes.load(scene), "pssmlt", **SMALL)


#: Method and settings, the fast ones first.
OTHERWISE = [
    ("pssmlt", {"equalise": False, "vertices": 1}),
    ("mmlt", {}),
    ("pssmlt", {"large_steps": 0.1, "step_size": 0.02}),
    ("pssmlt", {"chains": 128}),
    ("pssmlt", {"sampler": "owen"}),
    ("pssmlt", {"estimator": "bidirectional"}),
    ("pssmlt", {"estimator": "bidirectional", "vertices": 2}),
    ("mmlt", {"vertices": 2, "equalise": False}),
]


@pytest.mark.parametrize("row", [*OTHERWISE[:2], *(pytest.param(r, marks=pytest.mark.slow) for r in OTHERWISE[2:])])
def test_the_mean_is_that_of_path(row):
    """Whatever the factor by brightness, the numbers that a chain keeps, and the steps."""
    method, settings = row
    problem = scenes.room("rectangle", scenes.FEW)
    path = run(problem, "path", passes=6, samples=256).images.mean(axis=(1, 2, 3))
    means = [go(prepared(problem, method, seed, **(SMALL | settings)), 2, seed).mean.mean() for seed in range(1, 9)]
    error = np.hypot(np.std(means, ddof=1) / np.sqrt(8), path.std(ddof=1) / np.sqrt(6))
    assert error < 0.02 * path.mean()
    assert abs(np.mean(means) - path.mean()) < 4.5 * error


def test_facts():
    problem = scenes.room("rectangle", scenes.FEW)
    runner = prepared(problem, "pssmlt", **SMALL)
    result = runner.develop(go(runner, 6).measurement)
    assert list(result.layers) == ["image"]
    facts = result.metadata["chains"]
    luminance = np.asarray(mi.luminance(mi.Color3f(result.image.reshape(-1, 3).T.copy()))).mean()
    assert abs(luminance - facts["mean_luminance"]) < 6.0 * facts["mean_luminance_error"] + 0.02 * luminance
    assert facts["mean_luminance_error"] < 0.02 * facts["mean_luminance"]
    assert 0.1 < facts["accepted_small"] < 1.0 and 0.1 < facts["accepted_large"] < 1.0
    assert 0 < facts["longest_stay"] < facts["steps"] and facts["startup_bias"] < 0.01


def test_the_factor_by_brightness():
    """Of a picture whose right half is ten times as bright: the least of the error measure, and the same function on
    host and device."""
    rng = np.random.default_rng(1)
    x, y = (rng.random((1, 1 << 16)) * side for side in (32.0, 16.0))
    luminance = np.where(x < 16.0, 0.1, 1.0)
    factors = BrightnessMap.measured(*(a.astype(np.float32) for a in (x, y, luminance)), (32, 16))
    for place, level in ((4.0, 0.1), (28.0, 1.0)):
        found = factors.on_host(np.array([place]), np.array([8.0]))[0]
        assert found == pytest.approx(1.0 / np.sqrt(level**2 + 0.01), rel=0.1)
    device = np.array(factors.at(mi.Point2f(mi.Float(x[0]), mi.Float(y[0]))))
    np.testing.assert_allclose(device, factors.on_host(x, y)[0], rtol=1e-4)


def test_no_chain_stays_at_a_bright_path():
    """A target is at most CAP times its mean, so a large step leaves it with a probability of about 1 / CAP."""
    runner = prepared(scenes.room("point", scenes.FEW), "pssmlt", **SMALL)
    carried = runner._carried
    assert carried.cap == pytest.approx(CAP * carried.unit, rel=0.2)
    assert dr.max(carried.states.target)[0] <= carried.cap * (1.0 + 1e-6)
