"""Spectral variants: the methods against Mitsuba, dispersion, colours after few passes, and what a run keeps.

Mitsuba's own spectral references, with media, are in ``test_mitsuba_references.py``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support.running import mitsuba_path, prepared, replicas
from support.scenes import rgb, transform
from support.spectral import spectral_variant
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue import methods
from etendue.core import UnsupportedError
from etendue.film import LONGER, Technique
from etendue.scene import load

CHAINS = ("pssmlt", "mmlt", "film_metropolis")
METHODS = ("path", "light", "guided", "vegas", "stratified", "bpt", "bpm", "vcm", "sppm", "ppm", "auto", *CHAINS)
GLASSES = {
    "smooth": {"type": "dispersive", "int_ior": 1.7, "abbe": 8.0},
    "rough": {"type": "roughdispersive", "int_ior": 1.7, "abbe": 8.0, "alpha": 0.25},
}


@pytest.fixture(autouse=True)
def _spectral() -> Iterator[None]:
    with spectral_variant():
        yield


def still_life(ball: dict[str, Any], radiance: dict[str, Any] | None = None, size: int = 16) -> dict[str, Any]:
    """A ball on a coloured floor under a lamp."""
    radiance = radiance or {"type": "blackbody", "temperature": 2800}
    look = transform().look_at([0, 1.2, 4], [0, 0.4, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    paint = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.45, 0.3)}}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 8},
        "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film},
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(3), "bsdf": paint},
        "ball": {"type": "sphere", "center": [0, 0.61, 0], "radius": 0.6, "bsdf": ball},
        "lamp": {
            "type": "sphere",
            "center": [1.5, 2.5, 1],
            "radius": 0.7,
            "emitter": {"type": "area", "radiance": radiance},
        },
    }


def coloured(radiance: dict[str, Any] | None = None) -> dict[str, Any]:
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.3}
    return still_life({"type": "twosided", "bsdf": gold}, radiance)


def pictures(problem: Any, method: str, runs: int = 6, samples: int = 16, **settings: Any) -> np.ndarray:
    radius = {"radius": 0.02} if method in ("bpm", "vcm", "sppm", "ppm", "auto") else {}
    runs = 12 if method in CHAINS else runs  # chains of few steps differ more than their variance says
    return replicas(problem, method, runs, 16, samples, max_depth=8, **radius, **settings)


@pytest.mark.parametrize("method", thinned(METHODS, ("bpt",)))
def test_the_methods_agree_with_mitsuba(method):
    problem = load(coloured())
    theirs = mitsuba_path(problem, 8, 2048, max_depth=8)
    assert_agree(pictures(problem, method), theirs, method, precision=0.03)


#: Radiance by wavelength: an LED, lines of a fluorescent tube, and a number.
LAMPS = {
    "led": {
        "type": "irregular",
        "wavelengths": "380, 430, 450, 470, 490, 560, 620, 700, 780",
        "values": "0, 0.5, 9, 2, 0.8, 4, 3, 0.5, 0",
    },
    "lines": {
        "type": "irregular",
        "wavelengths": "360, 430, 437, 444, 538, 546, 554, 604, 612, 620, 830",
        "values": "0.3, 0.3, 9, 0.3, 0.3, 16, 0.3, 0.3, 14, 0.3, 0.3",
    },
    "even": {"type": "spectrum", "value": 4.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("lamp", LAMPS)
def test_lamps_with_spectra_are_those_of_mitsuba(lamp):
    problem = load(coloured(LAMPS[lamp]))
    theirs = mitsuba_path(problem, 8, 2048, max_depth=8)
    # Lines are narrower than the distance of the wavelengths of 16 passes.
    ours = replicas(problem, "bpt", 6, 128 if lamp == "lines" else 16, 4, max_depth=8)
    assert_agree(ours, theirs, lamp, precision=0.03)


@pytest.mark.parametrize(
    ("glass", "method"),
    thinned(
        [(glass, method) for glass in GLASSES for method in METHODS if method not in ("light", "pssmlt")],
        (("smooth", "vcm"),),
    ),
)
def test_dispersed_light_is_that_of_mitsuba_s_integrator(glass, method):
    """Mitsuba chooses a wavelength at random at each refraction; here the hero of the packet goes on."""
    problem = load(still_life(GLASSES[glass]))
    theirs = mitsuba_path(problem, 8, 4096, max_depth=8)
    assert_agree(pictures(problem, method, samples=32), theirs, f"{glass} {method}", precision=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["light", "bpt", "vcm", "sppm"])
def test_connections_and_merges_of_dispersed_paths(method):
    """A rough ball in a rough shell: both ends of a connection or a merge may carry the hero alone."""
    scene = still_life(GLASSES["rough"])
    scene["shell"] = {"type": "sphere", "center": [0, 0.7, 0], "radius": 0.75, "bsdf": GLASSES["rough"]}
    problem = load(scene)
    path = pictures(problem, "path", samples=64)
    assert_agree(pictures(problem, method, samples=64), path, method, precision=0.05)


def test_a_white_furnace_is_white_and_a_coloured_one_has_its_colour_after_16_passes():
    for colour in ((1.0, 1.0, 1.0), (0.8, 0.3, 0.1)):
        ball = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(0.5, 0.5, 0.5)}}
        scene = still_life(ball)
        scene["floor"]["bsdf"] = ball
        del scene["lamp"]
        scene["sky"] = {"type": "constant", "radiance": rgb(*colour)}
        sky = etendue.render(scene, "path", spp=16, max_depth=1, seed=3).image[0, 0]
        assert np.abs(sky / np.array(colour) - 1.0).max() < (1e-5 if colour[0] == colour[2] else 6e-3), sky


@pytest.mark.slow
def test_the_noise_estimate_does_not_count_the_colours_of_passes():
    """Between passes the blue of white light changes by half. What is estimated from one run is the error among
    runs."""
    problem = load(coloured({"type": "d65"}))
    runs = [prepared(problem, "path", seed, samples_per_pass=16, max_depth=8) for seed in range(24)]
    measured, estimated = [], []
    for seed, runner in enumerate(runs):
        total = sum((runner.step(i, seed) for i in range(1, 32)), start=runner.step(0, seed))
        measured.append(total.mean())
        estimated.append(total.variance_of_mean())
    lit = np.mean(measured, axis=0) > 1e-3
    between = np.var(measured, axis=0, ddof=1)[lit].sum()
    assert np.mean(estimated, axis=0)[lit].sum() == pytest.approx(between, rel=0.25)


@pytest.mark.slow
def test_a_run_goes_on_from_its_checkpoint(tmp_path):
    scene, file = still_life(GLASSES["smooth"]), tmp_path / "part.checkpoint"
    whole = etendue.render(scene, "vcm", spp=32, seed=2)
    etendue.render(scene, "vcm", spp=16, samples_per_pass=2, seed=2, checkpoint=str(file))
    resumed = etendue.resume(str(file), scene=scene, spp=32)
    np.testing.assert_allclose(resumed.image, whole.image, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_layers():
    result = etendue.render(
        coloured(), "vcm", spp=32, components=True, aovs=True, pyramid=True, pyramid_depth=3, seed=1
    )
    layers = result.layers
    parts = sum(layers[name] for name in ("emission", "direct", "caustic", "indirect"))
    np.testing.assert_allclose(parts, layers["image"], rtol=1e-4, atol=1e-6)
    floor = layers["albedo"][-1].mean(axis=0)
    np.testing.assert_allclose(floor, (0.7, 0.45, 0.3), rtol=0.02)
    weighted = [n for n in layers if n == LONGER or ((found := Technique.of_layer(n)) and found[1])]
    assert len(weighted) > 4
    whole = sum(layers[name] for name in weighted)
    np.testing.assert_allclose(whole.mean((0, 1)), layers["image"].mean((0, 1)), rtol=1e-4)


def test_alpha_of_coloured_fog_hardly_depends_on_the_seed():
    """With the same four wavelengths for all rays, the standard deviation is 0.03."""
    fog = {"type": "homogeneous", "sigma_t": rgb(0.05, 0.2, 0.9), "scale": 2.0, "albedo": 0.5}
    camera = {"type": "perspective", "fov": 20, "to_world": transform().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])}
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": fog}
    problem = load({"type": "scene", "sensor": camera, "ball": ball, "sky": {"type": "constant"}}, size=(4, 4))
    seeds = [prepared(problem, "path", seed, coverage=True, hide_emitters=True) for seed in range(6)]
    alpha = [one.develop(one.step(0, 1)).layers["alpha"].mean() for one in seeds]
    assert np.std(alpha) < 0.003 and 0.4 < np.mean(alpha) < 0.8


@pytest.mark.parametrize("method", [name for name in methods.table() if not methods.get(name).spectral])
def test_methods_that_render_in_rgb_only_say_so(method):
    with pytest.raises(UnsupportedError, match=rf"method '{method}' renders in RGB only, not under \w+_ad_spectral"):
        etendue.render(coloured(), method, spp=1)


def test_pssmlt_refuses_dispersed_light():
    with pytest.raises(UnsupportedError, match="disperse light; use mmlt"):
        etendue.render(still_life(GLASSES["smooth"]), "pssmlt", spp=1)


def test_patches_and_particles_are_asked_for_in_rgb():
    for made in (lambda: etendue.solve_radiosity(coloured()), lambda: etendue.trace_particles(coloured())):
        with pytest.raises(UnsupportedError, match="are computed in RGB"):
            made()


def test_monochrome_variants():
    backend, _, _ = mi.variant().partition("_")
    with mi.variant_context(f"{backend}_ad_mono"):
        problem = load(still_life({"type": "diffuse", "reflectance": 0.4}, rgb(5.0, 5.0, 5.0)))
        theirs = mitsuba_path(problem, 8, 512, max_depth=8)
        for method in ("path", "vcm"):
            found = replicas(problem, method, 6, 4, 32, max_depth=8)
            assert (found == found[..., :1]).all()
            assert_agree(found[..., :1], theirs[..., :1], method, precision=0.03)
