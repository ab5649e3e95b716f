"""Switches that must not matter, sums that must hold, and what a run is a function of."""

from __future__ import annotations

import gc
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, mitsuba_images, mitsuba_path, prepared, run
from support.statistics import assert_agree, blocks, z_scores
from support.tables import thinned

from etendue.transport import Techniques

#: Of the magnitude that scattered float additions in another order change a pixel.
SAME = {"rtol": 1e-5, "atol": 1e-7}
METHODS = {
    "path": ("path", {}),
    "guided": ("guided", {"cell_samples": 100}),
    "vegas": ("vegas", {}),
    "stratified": ("stratified", {}),
    "light": ("light", {}),
    "bpt cache": ("bpt", {}),
    "bpt path": ("bpt", {"light_source": "path"}),
    "bpm": ("bpm", {"radius": 0.02}),
    "vcm": ("vcm", {"radius": 0.02}),
    "vcm path": ("vcm", {"radius": 0.02, "light_source": "path"}),
    "pm": ("pm", {"photons": 20_000}),
    "ppm": ("ppm", {"radius": 0.05}),
    "sppm": ("sppm", {"radius": 0.05}),
}
#: Techniques in layers; the others have one layer.
LAYERED = [name for name in METHODS if name not in ("path", "guided", "vegas", "stratified", "pm", "ppm", "sppm")]
#: Each pass is a function of its number alone; a progressive or learning one of those before it too.
INDEPENDENT = [name for name in METHODS if name not in ("guided", "vegas", "ppm", "sppm")]


def problem() -> Any:
    """Every family of techniques has something to do here, delta and null scattering included; an anisotropic material
    has the store of vertices keep hits instead of frames."""
    return scenes.room("mixed", ("anisotropic", "dielectric", "mask"), rfilter="gaussian")


@pytest.mark.parametrize(
    "settings",
    [pytest.param({"light_source": "path", "heuristic": "power"}, marks=pytest.mark.slow), {"connections": 2}],
    ids=str,
)
def test_vcm_tends_to_bpt_with_the_radius(settings):
    """The same paths with and without merging: what its weights take from the other techniques falls with the area
    of its disc (under the power heuristic with the area's square), to nothing."""
    settings = settings | {"samples_per_pass": 4, "light_paths": 1.0, "split_layers": True, "shadow_roulette": 0.0}
    scene = scenes.room("mixed", ("diffuse", "roughconductor", "dielectric"))
    bpt = prepared(scene, "bpt", **settings)
    without = go(bpt, 2).mean
    settings = {"connections": bpt.settings.connections} | settings  # the defaults of the two differ
    settings |= {"radius_unit": "absolute", "alpha": 1.0, "eta_discount": 1.0}
    taken = {}
    for radius in (0.01, 0.005, 0.00005):
        runner = prepared(scene, "vcm", radius=radius, **settings)
        measurement = go(runner, 2).measurement
        taken[radius] = without - (measurement.mean() - measurement.mean("merge"))
        assert taken[radius].min() > -1e-5 * without.mean()
    assert measurement.mean("merge").max() < SAME["atol"]
    falls = 4.0**runner.techniques.beta
    assert taken[0.01].sum() / taken[0.005].sum() == pytest.approx(falls, rel=0.05)
    np.testing.assert_allclose(taken[0.00005], 0.0, atol=1e-5 * without.mean())


@pytest.mark.slow
def test_hits_and_next_event_alone_are_path():
    """The bidirectional estimator with path tracing's two techniques, against ``path``: the same mean."""
    scene = scenes.room("sphere", scenes.FEW)
    runner = prepared(scene, "bpt", samples_per_pass=128, connections=0)
    runner.techniques = Techniques(emission=1, next_event=1, connection=0, splat=False, merge=False)
    assert_agree(go(runner, 6).images, run(scene, "path", passes=6, seed=9).images, "hits and next event")


def test_splats_alone_are_light():
    """With nothing but splats, against ``light`` less the lights seen directly."""
    scene = scenes.room("sphere", scenes.FEW)
    runner = prepared(scene, "bpt", samples_per_pass=256, connections=0, light_paths=2.0, split_layers=True)
    runner.techniques = Techniques(emission=0, next_event=0, connection=0, splat=True, merge=False)
    splats = np.stack([runner.step(i, 1).mean("splat") for i in range(6)])
    light = prepared(scene, "light", samples_per_pass=256, light_paths=2.0)
    assert_agree(splats, np.stack([light.step(i, 5).mean("splat") for i in range(6)]), "splats", precision=0.03)


@pytest.mark.parametrize("name", thinned(LAYERED, ("light",)))
def test_layers_sum_to_the_image(name):
    method, settings = METHODS[name]
    if method != "light":
        settings = settings | {"split_layers": True}
    measurement = run(problem(), method, passes=2, samples=4, **settings).measurement
    layers = [layer for layer in measurement.sums if layer != "image"]
    assert len(layers) >= 2
    total = sum(measurement.mean(layer) for layer in layers)
    np.testing.assert_allclose(total, measurement.mean(), **SAME)


@pytest.mark.slow
@pytest.mark.parametrize("name", ("bpt cache", "vcm", "bpm"))
@pytest.mark.parametrize("clamp", [0.0, 0.3])
def test_layers_may_be_left_unsplit(name, clamp):
    method, settings = METHODS[name]
    settings = settings | {"clamp": clamp}
    settings = settings | {"shadow_roulette": 0.0}  # its threshold is measured, and differs a little
    split = run(problem(), method, passes=2, samples=4, split_layers=True, **settings).mean
    whole = run(problem(), method, passes=2, samples=4, split_layers=False, **settings)
    assert list(whole.measurement.sums) == ["image"]
    np.testing.assert_allclose(whole.mean, split, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", thinned(INDEPENDENT, ("vcm",)))
def test_two_halves_add_to_one_run_in_any_order(name):
    method, settings = METHODS[name]
    runner = prepared(problem(), method, samples_per_pass=4, **settings)
    whole = go(runner, 4).measurement
    other = prepared(problem(), method, samples_per_pass=4, **settings)
    last = other.step(3, 1) + other.step(2, 1)
    halves = last + (other.step(1, 1) + other.step(0, 1))
    assert set(halves.iterations) == set(whole.iterations)
    for layer in whole.sums:
        np.testing.assert_allclose(halves.mean(layer), whole.mean(layer), **SAME)
    np.testing.assert_allclose(halves.variance_of_mean(), whole.variance_of_mean(), rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("name", thinned(METHODS, ("path", "guided", "ppm", "vcm")))
def test_a_seed_gives_one_picture(name):
    method, settings = METHODS[name]
    run_of_seed = run(problem(), method, passes=2, samples=4, seed=3, **settings)
    assert np.abs(run_of_seed.images[0] - run_of_seed.images[1]).max() > 1e-3
    first = run_of_seed.mean
    again = run(problem(), method, passes=2, samples=4, seed=3, **settings).mean
    other = run(problem(), method, passes=2, samples=4, seed=4, **settings).mean
    if method == "path":
        np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(first, again, **SAME)
    assert np.abs(first - other).max() > 1e-3


@pytest.mark.parametrize("depth", thinned(range(5), (0, 1, 3)))
def test_max_depth_counts_edges_as_mitsuba_does(depth):
    """0 is black, 1 shows lights, 2 adds direct light, and so on."""
    scene = scenes.room("sphere", scenes.FEW)
    reference = mitsuba_path(scene, passes=6, samples=256, max_depth=depth)
    for method, settings in (("path", {}), ("light", {"light_paths": 3.0}), ("bpt", {})):
        images = run(scene, method, passes=6, max_depth=depth, **settings).images
        if depth == 0:
            assert not images.any()
            assert not reference.any()
        elif depth == 1 and method != "light":
            np.testing.assert_allclose(images.mean(), reference.mean(), rtol=0.05)
        else:
            assert_agree(images, reference, (method, depth), precision=0.05)


@pytest.mark.parametrize("depth", [pytest.param(1, marks=pytest.mark.slow), 2, pytest.param(3, marks=pytest.mark.slow)])
def test_max_depth_of_merging(depth):
    scene = scenes.room("sphere", scenes.FEW)
    settings = {"radius": 0.02, "radius_unit": "absolute", "alpha": 1.0, "max_depth": depth}
    bpm = run(scene, "bpm", passes=6, samples=64, **settings).images
    vcm = run(scene, "vcm", passes=6, samples=64, **settings).images
    reference = run(scene, "path", passes=6, samples=256, max_depth=depth).images
    for images in (bpm, vcm):
        np.testing.assert_allclose(images.mean(), reference.mean(), rtol=0.05)


def test_first_hit_layers_are_those_of_mitsuba():
    scene = scenes.room("rectangle", scenes.FEW)
    layers = "albedo:albedo,n:sh_normal,d:depth"
    reference = mitsuba_images(scene, mi.load_dict({"type": "aov", "aovs": layers}), passes=6, samples=128, seed=50)
    for method in ("path", "bpt"):
        runner = prepared(scene, method, samples_per_pass=64, aovs=True)
        passes = [runner.step(i, 1) for i in range(6)]
        for name, channels in (("albedo", slice(0, 3)), ("normal", slice(3, 6)), ("depth", slice(6, 7))):
            images = np.stack([m.mean(name) for m in passes])
            assert np.isfinite(images).all()
            assert images.shape[1:] == (12, 16, channels.stop - channels.start)
            # Signed values have means near zero: compare after a shift that keeps them away from it.
            assert_agree(images + 2.0, reference[..., channels] + 2.0, (method, name))


@pytest.mark.parametrize(
    "name",
    thinned(("bpt cache", "vcm", "bpt path", "bpm"), ("vcm",)),
)
def test_light_paths_in_groups_have_the_same_mean(name):
    """A memory bound splits the light paths of a pass into groups; the estimate stays."""
    method, settings = METHODS[name]
    grouped, whole = scenes.room("sphere", scenes.FEW), scenes.room("sphere", scenes.FEW)
    grouped.memory = 2_000_000
    settings = settings | {"radius": 0.02, "radius_unit": "absolute", "alpha": 1.0, "light_paths": 1.0}
    runner = prepared(grouped, method, samples_per_pass=64, **settings)
    assert runner.state()["groups"] > 1
    assert_agree(go(runner, 6).images, run(whole, method, passes=6, samples=64, seed=2, **settings).images, name)


def test_delta_lights_and_mirrors_alone_leave_black():
    """A point light and a mirror: nothing to store, nothing to connect; black, without a NaN."""
    scene = scenes.load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "light": scenes.EMITTERS["point"]()["light"],
            "ball": {"type": "sphere", "center": [0, 0.5, 0], "radius": 0.4, "bsdf": scenes.MATERIALS["conductor"]()},
        }
    )
    for method in ("light", "bpt", "vcm"):
        result = run(scene, method, passes=1, samples=4)
        assert not result.mean.any()
        assert result.measurement.counters["nonfinite"] == 0


@pytest.mark.parametrize("name", thinned(METHODS, ("path", "light", "vcm", "sppm")))
def test_a_nan_is_counted_and_not_written(name):
    """A texel of NaN in a reflectance, let in past the check."""
    pixels = np.full((8, 8, 3), 0.5)
    pixels[4, 4] = np.nan
    scene = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), 40.0),
        "floor": {
            "type": "rectangle",
            "to_world": scenes.transform().rotate([1, 0, 0], -90),
            "bsdf": {"type": "diffuse", "reflectance": scenes.bitmap(pixels) | {"filter_type": "nearest"}},
        },
        "lamp": {"type": "point", "position": [0.3, 1.0, 0.2], "intensity": scenes.rgb(3, 3, 3)},
    }
    method, settings = METHODS[name]
    result = run(scenes.load(scene, check=False), method, passes=2, samples=16, **settings)
    assert result.measurement.counters["nonfinite"] > 0
    assert np.isfinite(result.mean).all()
    assert result.mean[:2].mean() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ("path", "light", "bpt cache"))
def test_noise_falls_with_the_root_of_the_passes(name):
    """Means of n passes scatter as n^(-1/2), and so do passes of n samples: no draw is used twice."""
    method, settings = METHODS[name]
    scene = scenes.room("sphere", ("blendbsdf", "roughdielectric"), size=(8, 8))
    images = run(scene, method, passes=64, samples=16, **settings).images
    counts = np.array([1, 2, 4, 8])
    groups = [images.reshape(len(images) // n, n, *images.shape[1:]).mean(1) for n in counts]
    rms = [np.median(np.sqrt(blocks(g.var(axis=0, ddof=1)[None], 2))) for g in groups]
    slope = np.polyfit(np.log(counts), np.log(rms), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.1)
    larger = run(scene, method, passes=16, samples=256, seed=2, **settings).images
    ratio = np.median(images.var(0, ddof=1).mean(-1)) / np.median(larger.var(0, ddof=1).mean(-1))
    assert ratio == pytest.approx(16.0, rel=0.35)
    assert abs(z_scores(blocks(images, 8), blocks(larger, 8))).max() < 4.5


@pytest.mark.parametrize("name", thinned(["bpt cache", "vcm path"], ["vcm path"]))
def test_a_pilot_that_guessed_too_low(name):
    """The store overflows, and the pass is repeated with more room: the same picture."""
    method, settings = METHODS[name]
    runner = prepared(problem(), method, samples_per_pass=16, light_paths=1.0, **settings)
    expected = runner.step(0, 1)
    runner.restore({"groups": 1, "vertices_per_path": 0.1})
    result = runner.step(0, 1)
    assert result.counters["light_vertices"] == expected.counters["light_vertices"]
    np.testing.assert_allclose(result.mean(), expected.mean(), **SAME)


@pytest.mark.parametrize("method", thinned(["vcm", "pm", "sppm"], ["vcm", "sppm"]))
def test_another_seed_compiles_nothing(method):
    scene = problem()
    for _ in range(2):  # Dr.Jit writes the filter's small kernel in another order once it has seen its constants
        prepared(scene, method, seed=1, samples_per_pass=4).step(0, 1)
        gc.collect()  # constants of what is not yet freed would be found again, which changes the order, too
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        prepared(scene, method, seed=2, samples_per_pass=4).step(0, 2)
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


@pytest.mark.parametrize(("method", "sizes"), thinned([("vcm", 3), ("auto", 2)], [("vcm", 3)]))
def test_pilot_and_pass_share_the_large_kernels(method, sizes):
    """Whatever their numbers of paths: of a run of ``auto``, compilation took more time than all the rest. The pilot
    has as many light as camera paths, as have the passes of ``auto`` that learn."""
    scene = problem()
    for _ in range(2):  # see above
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            prepared(scene, method, samples_per_pass=4).step(0, 1)
            kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
        gc.collect()
    large = [kernel for kernel in kernels if kernel["operation_count"] > 1000]
    assert len({kernel["size"] for kernel in large}) == sizes
    assert len({kernel["hash"] for kernel in large}) == 2


@pytest.mark.parametrize(("near", "far"), thinned([(1.0, 20.0), (2.5, 4.9)], [(2.5, 4.9)]))
def test_clipping_planes_do_not_matter(near, far):
    """The same picture whatever the sensor's range, as long as everything seen lies in it."""
    dictionary = {
        "type": "scene",
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "radius": 0.6, "bsdf": scenes.diffuse(0.5, 0.4, 0.3)},
        "sensor": scenes.camera((0.0, 0.0, 3.5), (0.0, 0.0, 0.0)),
    }
    plain = scenes.load(dictionary, size=scenes.SIZE)
    near_and_far = dictionary | {"sensor": dictionary["sensor"] | {"near_clip": near, "far_clip": far}}
    clipped = scenes.load(near_and_far, size=scenes.SIZE)
    for method in ("light", "bpt"):
        expected = run(plain, method, passes=6, samples=512)
        assert_agree(run(clipped, method, passes=6, samples=512, seed=3).images, expected.images, method)


@pytest.mark.parametrize("name", thinned(METHODS, ("light",)))
def test_even_points_have_the_same_mean(name):
    """Owen-scrambled points against independent numbers. A seed each: the passes of one are not independent."""
    method, settings = METHODS[name]
    scene = problem()
    images = []
    for seed in range(6):
        images.append(run(scene, method, 1, 128, seed=seed, sampler="owen", **settings).mean)
    plain = run(scene, method, 6, 128, seed=50, **settings)
    assert_agree(np.stack(images), plain.images, name, precision=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("sampler", "scrambling"), [("halton", "digits"), ("halton", "same"), ("hammersley", "shift")])
def test_halton_and_hammersley_have_the_same_mean(sampler, scrambling):
    """Camera and light paths by radical inverses, over seeds, against independent numbers."""
    scene, method = problem(), "bpt"
    images = [run(scene, method, 2, 64, seed=seed, sampler=sampler, scrambling=scrambling).mean for seed in range(6)]
    plain = run(scene, method, 6, 128, seed=50, sampler="independent")
    assert_agree(np.stack(images), plain.images, f"{sampler} {scrambling}", precision=0.03)


def test_even_points_are_less_noisy():
    """Direct light of a big lamp: half the variance, and less."""
    scene = scenes.room("rectangle", ("diffuse",))

    def variance(sampler):
        images = [run(scene, "path", 1, 16, seed=s, sampler=sampler, max_depth=2).mean for s in range(8)]
        return np.stack(images).var(axis=0, ddof=1).mean()

    plain = variance("independent")
    assert variance("owen") < 0.5 * plain
    assert variance("halton") < 0.8 * plain
    assert variance("hammersley") < 0.8 * plain


def test_the_same_points_in_all_pixels_leave_a_pattern():
    """Errors of near pixels are alike only if all pixels have the same points."""
    scene = scenes.room("rectangle", ("diffuse",))

    def alike(scrambling):
        images = np.stack(
            [
                run(scene, "path", 1, 4, seed=s, sampler="halton", scrambling=scrambling, max_depth=2).mean
                for s in range(16)
            ]
        )
        error = (images - images.mean(axis=0)).mean(axis=-1)
        return (error[:, :, :-3] * error[:, :, 3:]).mean() / (error**2).mean()

    assert alike("same") > 0.3
    assert abs(alike("digits")) < 0.15 and abs(alike("shift")) < 0.15


@pytest.mark.parametrize("name", ["bpt", "vcm", "bpm"])
def test_the_pilot_knows_the_brightness(name):
    """Roulette before shadow rays is relative to the picture's mean, splats included."""
    runner = prepared(problem(), name, samples_per_pass=64, radius=0.02, shadow_roulette=0.5)
    mean = float(go(runner, 2).mean.mean())
    assert runner._dark == pytest.approx(0.5 * mean, rel=0.3)
