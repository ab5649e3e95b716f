"""The setting ``reweight`` in methods of camera paths: what it removes, and that passes still add up."""

import dataclasses

import numpy as np
import pytest
from support.running import prepared

import etendue
from etendue import methods, scene
from etendue.core import OptionError
from etendue.engine import Checkpoint
from etendue.film import COMPONENTS, read_image, relative_mse
from etendue.methods import CameraSettings

SIZE = (24, 24)


@pytest.fixture(scope="module")
def glass():
    """Caustics of a glass ball and of rough gold: fireflies for ``path``."""
    return scene.load("cornell-glass", size=SIZE)


def passes(problem, name, count=6, samples=4, **settings):
    """(runner, measurements) of some passes with ``reweight``."""
    runner = prepared(problem, name, seed=3, samples_per_pass=samples, reweight=True, **settings)
    return runner, [runner.step(iteration, 3) for iteration in range(count)]


def added(measurements):
    total = measurements[0].copy()
    for measurement in measurements[1:]:
        total += measurement
    return total


def test_the_error_falls_and_the_bias_stays_within_the_noise(glass):
    runner, made = passes(glass, "path", count=16)
    reference = prepared(glass, "vcm", seed=9, samples_per_pass=512).step(0, 9).mean()
    for count, part in ((4, 0.5), (16, 0.8)):
        whole = added(made[:count])
        result = runner.develop(whole)
        assert relative_mse(result.image, reference) < part * relative_mse(whole.mean(), reference)
        removed = whole.mean() - result.image
        assert (abs(removed) <= np.sqrt(whole.variance_of_mean()) * 1.001 + 1e-6).all()
        facts = result.metadata["fireflies"]
        assert facts["pixels"] > 0
        assert facts["light"] == pytest.approx(removed.sum() / whole.mean().sum(), rel=1e-3)


@pytest.mark.parametrize(("name", "settings"), [("bpt", {"components": True}), ("guided", {"components": True})])
def test_layers_still_add_up(glass, name, settings):
    """With passes of different weights (``guided``), too."""
    runner, made = passes(glass, name, count=4, **settings)
    whole = added(made)
    result = runner.develop(whole)
    assert result.metadata["fireflies"]["pixels"] > 0
    total = sum(result.layers[layer] for layer in COMPONENTS)
    np.testing.assert_allclose(total, result.image, rtol=1e-5, atol=1e-6)
    assert all(result.layers[layer].min() >= 0 for layer in COMPONENTS)
    assert (result.image <= whole.mean() * (1 + 1e-5) + 1e-6).all()


def test_passes_add_up_in_any_order_and_few_stay(glass):
    runner, made = passes(glass, "path")
    whole, turned = runner.develop(added(made)), runner.develop(added(made[::-1]))
    np.testing.assert_allclose(whole.image, turned.image, rtol=1e-4, atol=1e-6)
    few = added(made[:3])
    plain = runner.develop(few)
    np.testing.assert_array_equal(plain.image, few.mean().astype(np.float32))
    assert plain.metadata["fireflies"] == {"pixels": 0, "light": 0.0}


def test_a_resumed_run_and_its_plain_picture(tmp_path):
    """The checkpoint keeps the plain sums, so nothing is removed twice; the estimated error is that of these sums."""
    common = {"size": SIZE, "seed": 2, "samples_per_pass": 4}
    first = etendue.render("cornell-glass", "path", spp=16, checkpoint=tmp_path / "a", reweight=True, **common)
    kept = Checkpoint.read(tmp_path / "a").measurement
    resumed = etendue.resume(tmp_path / "a", spp=32)
    at_once = etendue.render("cornell-glass", "path", spp=32, reweight=True, **common)
    np.testing.assert_array_equal(resumed.image, at_once.image)
    assert resumed.metadata["settings"]["reweight"] and resumed.metadata["fireflies"]["pixels"] > 0
    plain = etendue.render("cornell-glass", "path", spp=16, **common)
    assert "fireflies" not in plain.metadata
    assert plain.metadata["error"] == first.metadata["error"]
    np.testing.assert_array_equal(kept.mean().astype(np.float32), plain.image)
    assert not np.array_equal(plain.image, first.image)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_demonstration_has_no_fireflies(seed):
    """A lamp seen through chains of mirrors and glass: without it, relMSE was 77 and 0.066. Most of what is left is the
    noise of merging, so the radius is fixed."""
    bundled = scene.bundled_scene("caustics")
    merging = {"radius": 2.5, "radius_unit": "pixel"}
    made = etendue.render("caustics", "vcm", spp=27, seed=seed, samples_per_pass=1, reweight=True, **merging)
    assert relative_mse(made.image, read_image(bundled.reference)) < 0.03


def test_which_methods_have_it_and_where_it_is_on():
    on = set()
    for name, method in methods.table().items():
        fields = {field.name: field.default for field in dataclasses.fields(method.Settings)}
        assert ("reweight" in fields) == issubclass(method.Settings, CameraSettings)
        on |= {name} if fields.get("reweight") else set()
    assert on == {"auto"}


@pytest.mark.parametrize(("given", "named"), [({"pyramid": True}, "pyramid"), ({"radii": "0.5,2"}, "radii")])
def test_pictures_that_it_would_not_change_are_refused(given, named):
    with pytest.raises(OptionError, match=f"reweight .* the layers of {named}"):
        methods.get("vcm").Settings(reweight=True, **given)
