"""Pixels by the film's filter: over neighbours and by themselves, in every layer."""

from __future__ import annotations

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run
from support.statistics import assert_agree
from support.tables import thinned

from etendue.film import LONGER, Technique

FILTERS = ("tent", "gaussian", "mitchell", "lanczos")
METHODS = {
    "path": {},
    "light": {"light_paths": 2.0},
    "bpt": {},
    "vcm": {"radius": 0.02, "radius_unit": "absolute"},
    "sppm": {"radius": 0.05, "radius_unit": "absolute"},
    "vegas": {"groups": "light; bounce1"},
    "vegas film": {"groups": "film; light"},
}


@pytest.mark.parametrize("rfilter", thinned(FILTERS, ("gaussian",)))
@pytest.mark.parametrize("name", thinned(METHODS, ("light", "vegas film")))
def test_both_ways_have_the_same_mean(name, rfilter):
    problem = scenes.room("sphere", scenes.FEW, rfilter=rfilter)
    images = [
        run(problem, name.split()[0], seed=seed, reconstruction=how, **METHODS[name]).images
        for seed, how in ((1, "neighbours"), (2, "independent"))
    ]
    assert_agree(*images, (name, rfilter), precision=0.1 if rfilter in ("mitchell", "lanczos") else 0.05)


@pytest.mark.slow
def test_neighbours_have_less_noise():
    """By the integral of the squared filter: 4 / 9 for a tent, 1 / (4 pi 0.25) = 0.32 for an endless Gaussian; at edges
    by more, as places in the pixel are even within a pass."""
    variance = {}
    for rfilter in ("box", "tent", "gaussian"):
        problem = scenes.room("sphere", scenes.FEW, rfilter=rfilter)
        for how in ("neighbours", "independent"):
            images = run(problem, "path", passes=24, samples=16, clamp=0.5, reconstruction=how).images
            variance[rfilter, how] = images.var(axis=0, ddof=1).mean()
    box = variance["box", "neighbours"]
    assert box == variance["box", "independent"]
    for rfilter, share in (("tent", 4 / 9), ("gaussian", 0.32)):
        assert 0.6 * share * box < variance[rfilter, "neighbours"] < 1.1 * share * box
        assert variance[rfilter, "neighbours"] < variance[rfilter, "independent"] / 2


def test_pixels_alone_share_no_noise():
    """Correlation of neighbours over passes: the Gaussian's with itself, exp(-1 / (4 sigma^2)) = 1 / e; and none."""
    problem = scenes.room("sphere", scenes.FEW, rfilter="gaussian")
    for how, expected in (("neighbours", np.exp(-1.0)), ("independent", 0.0)):
        images = run(problem, "path", passes=40, samples=16, reconstruction=how).images
        z = (images - images.mean(0)) / np.maximum(images.std(0), 1e-9)
        found = np.nanmedian((z[:, :, 1:] * z[:, :, :-1]).mean(axis=0))
        assert found == pytest.approx(expected, abs=0.06), how


def test_a_sky_is_even_from_the_first_sample():
    behind = {"type": "rectangle", "to_world": scenes.transform().translate([0, 0, 9])}
    camera = scenes.camera((0, 0, 3), (0, 0, 0), rfilter="gaussian")
    problem = scenes.load(
        {"type": "scene", "sensor": camera, "sky": {"type": "constant", "radiance": 0.7}, "wall": behind}
    )
    np.testing.assert_allclose(run(problem, "path", passes=1, samples=1).mean, 0.7, rtol=1e-5)


@pytest.mark.parametrize("method", thinned(["bpt", "vcm"], ["vcm"]))
def test_layers_are_filtered_as_the_picture_is(method):
    """Families of techniques, the pyramid and first hits: the former add up to the picture."""
    problem = scenes.room("sphere", scenes.FEW, rfilter="gaussian")
    common = {"samples_per_pass": 4, "aovs": True}
    split = go(prepared(problem, method, split_layers=True, **common), 2).measurement
    names = split.sums.keys() - {"image", "albedo", "normal", "depth", "emitted"}
    np.testing.assert_allclose(sum(split.mean(n) for n in names), split.mean(), rtol=1e-4, atol=1e-6)
    pyramid = go(prepared(problem, method, pyramid=True, pyramid_depth=3, **common), 2).measurement
    weighted = [n for n in pyramid.sums if n == LONGER or (Technique.of_layer(n) or (None, False))[1]]
    assert len(weighted) > 6
    np.testing.assert_allclose(sum(pyramid.mean(n) for n in weighted), pyramid.mean(), rtol=1e-4, atol=1e-6)
    hits = go(prepared(problem, "path", aovs=True, samples_per_pass=256), 1).measurement
    np.testing.assert_allclose(split.mean("albedo").mean(), hits.mean("albedo").mean(), rtol=0.02)


def test_the_variance_of_the_mean_is_a_layer():
    """With first hits, from the second pass on: the scatter of the passes over their number."""
    problem = scenes.room("sphere", scenes.FEW, rfilter="gaussian")
    runner = prepared(problem, "path", aovs=True, samples_per_pass=4)
    passes = [runner.step(i, 1) for i in range(4)]
    assert "variance" not in runner.develop(passes[0]).layers
    layers = runner.develop(sum(passes[1:], passes[0])).layers
    expected = np.var([p.mean() for p in passes], axis=0, ddof=1) / 4
    np.testing.assert_allclose(layers["variance"], expected, rtol=1e-4, atol=1e-9)
    assert "variance" not in prepared(problem, "path").develop(sum(passes[1:], passes[0])).layers


def test_passes_in_any_order_give_the_same_bits():
    """No sum of a pass depends on an order: nothing is scattered."""
    problem = scenes.room("sphere", scenes.FEW, rfilter="mitchell")
    runner = prepared(problem, "path", sampler="owen", samples_per_pass=4)
    forth = [runner.step(i, 1).sums["image"] for i in range(3)]
    back = [runner.step(i, 1).sums["image"] for i in reversed(range(3))]
    np.testing.assert_array_equal(np.array(forth), np.array(back)[::-1])


@pytest.mark.parametrize("samples", [1, 4, 8])
def test_the_numbers_of_a_sample_do_not_depend_on_the_pass_it_is_in(samples):
    """Even numbers go on from pass to pass, places in the pixel included. Near the border a pass divides by its own."""
    problem = scenes.room("sphere", scenes.FEW, rfilter="tent")
    image = run(problem, "path", passes=8 // samples, samples=samples, sampler="owen").mean
    whole = run(problem, "path", passes=4, samples=2, sampler="owen").mean
    np.testing.assert_allclose(image[1:-1, 1:-1], whole[1:-1, 1:-1], rtol=1e-4, atol=1e-6)


def test_a_narrow_filter_gives_a_picture():
    """Places that no pixel reaches would divide by zero, were they shared."""
    narrow = scenes.camera(rfilter="gaussian")
    narrow["film"]["rfilter"]["stddev"] = 0.1
    scene = scenes.load({"type": "scene", "sensor": narrow, "wall": {"type": "rectangle"}, "sky": {"type": "constant"}})
    assert np.isfinite(run(scene, "path", passes=2, samples=1).mean).all()
