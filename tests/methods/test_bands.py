"""Films of bands of wavelengths (``specfilm``): closed forms, the methods against Mitsuba, and files."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support.running import mitsuba_path, replicas
from support.scenes import rgb, transform
from support.spectral import spectral_variant
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue import film, methods
from etendue.core import OptionError, Result, SceneError, UnsupportedError
from etendue.scene import load, resized

METHODS = ("path", "light", "guided", "vegas", "stratified", "bpt", "bpm", "vcm", "sppm", "ppm", "pm", "auto")


def triangle(low: float, high: float, top: float = 1.0) -> dict[str, Any]:
    return {"type": "irregular", "wavelengths": f"{low}, {(low + high) / 2}, {high}", "values": f"0, {top}, 0"}


#: Five bands, not in alphabetic order: wide and narrow, overlapping, one of hardly any sensitivity, one of no slopes.
BANDS = {
    "violet": triangle(380, 460),
    "middle": triangle(440, 620),
    "line": triangle(545, 555, 1e-3),
    "box": {"type": "regular", "wavelength_min": 600, "wavelength_max": 700, "values": "0.3, 0.3"},
    "far": triangle(700, 780),
}
LED = {
    "type": "irregular",
    "wavelengths": "380, 430, 450, 470, 490, 560, 620, 700, 780",
    "values": "0, 0.5, 9, 2, 0.8, 4, 3, 0.5, 0",
}


@pytest.fixture(autouse=True)
def _spectral() -> Iterator[None]:
    with spectral_variant():
        yield


def banded(scene: dict[str, Any], bands: dict[str, Any] | None = None, size: int = 16) -> dict[str, Any]:
    """The scene with a film of bands."""
    recorded = {"type": "specfilm", "width": size, "height": size, "rfilter": {"type": "box"}, **(bands or BANDS)}
    return scene | {"sensor": scene["sensor"] | {"film": recorded | {"component_format": "float32"}}}


def still_life(ball: dict[str, Any] | None = None) -> dict[str, Any]:
    """A ball on a coloured floor under a lamp with a spectrum."""
    look = transform().look_at([0, 1.2, 4], [0, 0.4, 0], [0, 1, 0])
    paint = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.45, 0.3)}}
    lamp = {"type": "sphere", "center": [1.5, 2.5, 1], "radius": 0.7}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {"type": "perspective", "fov": 40, "to_world": look},
        "floor": {"type": "rectangle", "to_world": transform().rotate([1, 0, 0], -90).scale(3), "bsdf": paint},
        "ball": {"type": "sphere", "center": [0, 0.61, 0], "radius": 0.6, "bsdf": ball or paint},
        "lamp": lamp | {"emitter": {"type": "area", "radiance": LED}},
    }


def sky(radiance: dict[str, Any]) -> dict[str, Any]:
    """A camera that sees nothing but light of one spectrum."""
    away = {"type": "sphere", "center": [0, 0, -50], "bsdf": {"type": "diffuse"}}
    lit = {"type": "constant", "radiance": radiance}
    return {"type": "scene", "sensor": {"type": "perspective"}, "away": away, "sky": lit}


def integrals(*curves: dict[str, Any]) -> np.ndarray:
    """Integrals of the bands times spectra over wavelengths."""
    at = np.arange(360.0, 830.0, 0.01)

    def value(curve: dict[str, Any]) -> np.ndarray:
        if curve["type"] == "regular":
            return np.where((at >= 600) & (at <= 700), 0.3, 0.0)
        nodes, values = ([float(v) for v in curve[key].split(",")] for key in ("wavelengths", "values"))
        return np.interp(at, nodes, values, left=0.0, right=0.0)

    light = np.prod([value(curve) for curve in curves], axis=0)
    return np.array([(value(band) * light).sum() * 0.01 for band in BANDS.values()])


def test_light_of_all_wavelengths_alike_has_the_integral_of_each_band():
    """After few passes: a picture is divided by what they give to such light."""
    made = etendue.render(banded(sky({"type": "spectrum", "value": 2.0})), "path", spp=16, size=(4, 4))
    assert made.metadata["bands"] == list(BANDS)
    assert made.image.shape == (4, 4, 5)
    assert made.image == pytest.approx(np.broadcast_to(2.0 * integrals(), (4, 4, 5)), rel=1e-3)


@pytest.mark.slow
def test_a_spectrum_has_its_integral_over_each_band():
    made = etendue.render(banded(sky(LED)), "path", spp=512, samples_per_pass=1, size=(2, 2))
    assert made.image[0, 0] == pytest.approx(integrals(LED), rel=2e-3)


@lru_cache(maxsize=1)
def _mitsuba(glass: bool) -> tuple[Any, np.ndarray]:
    """A still life, and Mitsuba's pictures of it."""
    ball = {"type": "dispersive", "int_ior": 1.7, "abbe": 8.0} if glass else None
    problem = load(banded(still_life(ball)))
    return problem, mitsuba_path(problem, 8, 4096 if glass else 2048, max_depth=6)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "glass"), [*((m, False) for m in METHODS), ("path", True), ("vcm", True)])
def test_the_methods_agree_with_mitsuba(method, glass):
    problem, theirs = _mitsuba(glass)
    radius = {"radius": 0.02} if method in ("bpm", "vcm", "sppm", "ppm", "pm", "auto") else {}
    ours = replicas(problem, method, 6, 64, 8 if glass else 4, max_depth=6, **radius)
    scale = integrals()  # so that each band is held to the same precision
    assert_agree(ours / scale, theirs / scale, (method, glass), precision=0.03)


@pytest.mark.parametrize("setting", thinned(["components", "pyramid", "split_layers"], ["pyramid"]))
def test_parts_of_a_picture_have_the_bands_and_add_up(setting):
    made = etendue.render(banded(still_life()), "bpt", spp=8, max_depth=4, **{setting: True})
    parts = {name: layer for name, layer in made.layers.items() if name != "image"}
    known = {name: film.Technique.of_layer(name) for name in parts}
    parts = {name: part for name, part in parts.items() if known[name] is None or known[name][1]}  # the weighted ones
    assert all(part.shape == (16, 16, 5) for part in parts.values())
    assert sum(parts.values()) == pytest.approx(made.image, rel=1e-3, abs=1e-4 * float(made.image.max()))


@pytest.mark.usefixtures("mitsuba_files")
def test_a_file_has_the_bands_by_name_and_in_order(tmp_path):
    made = etendue.render(banded(still_life()), "path", spp=8, components=True, save=tmp_path / "a.exr")
    channels = dict(mi.Bitmap(str(tmp_path / "a.exr")).split())
    assert len(channels) > 1
    read = film.read_exr(tmp_path / "a.exr")
    assert read.metadata["bands"] == list(BANDS)
    for name in ("image", "direct"):
        assert np.array_equal(read.layers[name], made.layers[name])


def test_a_run_goes_on_from_its_checkpoint(tmp_path):
    whole = etendue.render(banded(still_life()), "vcm", spp=8, samples_per_pass=1, radius=0.02)
    half = etendue.render(banded(still_life()), "vcm", spp=4, samples_per_pass=1, radius=0.02)
    half.save_checkpoint(tmp_path / "a.checkpoint")
    resumed = etendue.resume(tmp_path / "a.checkpoint", scene=banded(still_life()), spp=8)
    assert resumed.image == pytest.approx(whole.image, rel=1e-5)
    with pytest.raises(etendue.core.CheckpointError, match="scene"):
        etendue.resume(
            tmp_path / "a.checkpoint", scene=banded(still_life(), BANDS | {"far": triangle(690, 780)}), spp=8
        )


def test_the_plugin_fills_the_film():
    etendue.plugins.register()
    scene = mi.load_dict(banded(still_life()) | {"integrator": {"type": "bpt", "components": True, "max_depth": 4}})
    picture = np.array(mi.render(scene, spp=64))
    assert picture.shape == (16, 16, 5 * (1 + len(film.COMPONENTS)))
    theirs = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 4}), spp=1024))
    assert picture[..., :5].mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.05)
    assert sum(np.split(picture[..., 5:], len(film.COMPONENTS), axis=2)) == pytest.approx(picture[..., :5], rel=1e-2)
    names = scene.integrator().aov_names()
    assert names[:5] == [f"{film.COMPONENTS[0]}.{band}" for band in BANDS]


def test_another_size_keeps_the_bands():
    problem = resized(load(mi.load_dict(banded(still_life()))), (8, 8))
    made = etendue.render(mi.load_dict(banded(still_life())), "path", spp=4, size=(8, 8))
    assert made.image.shape == (8, 8, 5)
    assert problem.size == (8, 8)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"method": "mmlt"}, UnsupportedError, "no bands"),
        ({"method": "path", "aovs": True}, OptionError, "aovs"),
        ({"method": "path", "for_denoising": True}, OptionError, "for_denoising"),
        ({"method": "path", "cryptomatte": True}, OptionError, "cryptomatte"),
        ({"method": "path", "save": "a.png"}, OptionError, "bands of wavelengths"),
    ],
)
def test_what_needs_colours_says_so_before_the_first_pass(arguments, error, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=text) as caught:
        etendue.render(banded(still_life()), spp=1, **arguments)
    assert "\n" not in str(caught.value)


def test_coverage_is_a_layer_beside_bands(tmp_path):
    made = etendue.render(banded(still_life()), "path", spp=4, coverage=True)
    film.write_exr(tmp_path / "a.exr", Result(made.layers, made.metadata))
    film.write_layers(tmp_path / "b.exr", Result(made.layers, made.metadata))
    alone = film.read_exr(tmp_path / "b-alpha.exr").image
    for alpha in (film.read_exr(tmp_path / "a.exr").layers["alpha"], alone):
        assert np.array_equal(alpha, made.layers["alpha"]) and 0.0 < alpha.mean() < 1.0
    with pytest.raises(OptionError, match="rename the band"):
        etendue.render(banded(still_life(), {"A": BANDS["box"]}), "path", spp=4, coverage=True)


def test_a_picture_of_bands_is_not_read_as_one_of_colours(tmp_path):
    three = {name: BANDS[name] for name in ("violet", "middle", "box")}
    made = etendue.render(banded(still_life(), three), "path", spp=1, save=tmp_path / "a.exr")
    assert "<img" not in made._repr_html_()
    with pytest.raises(OptionError, match="violet, middle, box"):
        film.read_image(tmp_path / "a.exr")


def test_bands_without_a_wavelength_are_named(caplog):
    many = {f"b{k:02d}": triangle(400 + 5 * k, 405 + 5 * k) for k in range(40)}
    etendue.render(banded(still_life(), many, size=4), "path", spp=1)
    assert "b0" in caplog.text
    caplog.clear()
    etendue.render(banded(still_life(), many, size=4), "path", spp=16)
    assert "no wavelength" not in caplog.text


def test_a_band_without_sensitivity_is_an_error():
    dark = {"type": "regular", "wavelength_min": 500, "wavelength_max": 600, "values": "0, 0"}
    with pytest.raises(SceneError, match="dark"):
        etendue.render(banded(still_life(), BANDS | {"dark": dark}), "path", spp=1)


def test_every_method_that_renders_wavelengths_renders_bands_but_the_chains():
    spectral = {name for name in methods.names() if getattr(methods.get(name), "spectral", False)}
    assert {name for name in spectral if methods.get(name).renders_bands} == set(METHODS)
