"""Rendering for denoising: one switch turns on what denoisers need, and with it all of them give a better picture."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.denoisers import needs
from support.tables import thinned

import etendue
from etendue.cli.main import main
from etendue.core import OptionError, Result
from etendue.display import DENOISERS, develop
from etendue.film import COMPONENTS, read_exr, relative_mse, variance_of
from etendue.methods import get, table
from etendue.scene import bundled_scene

SIZE = (64, 64)


def test_the_switch_turns_on_what_is_needed():
    for name in table():
        if name == "film_metropolis":
            continue
        settings = get(name).Settings.from_mapping({"for_denoising": "true"})
        assert (settings.aovs, settings.components, settings.reconstruction) == (True, True, "independent")
        assert type(settings).from_json(settings.to_json()) == settings
        assert not get(name).Settings().for_denoising
    split = get("bpt").Settings.from_mapping({"for_denoising": True, "split_layers": True})
    assert split.aovs and not split.components


@pytest.mark.parametrize(
    ("method", "values", "message"),
    [
        ("path", {"reconstruction": "neighbours"}, "for_denoising turns on reconstruction=independent; leave out"),
        ("bpt", {"components": "no"}, "for_denoising turns on components=true; leave out components"),
        ("vcm", {"aovs": False}, "for_denoising turns on aovs=true; leave out aovs"),
        ("film_metropolis", {}, "keeps whole paths, not components, which for_denoising turns on; use pssmlt"),
    ],
)
def test_what_contradicts_the_switch_is_an_error(method, values, message):
    with pytest.raises(OptionError, match=message):
        get(method).Settings.from_mapping({"for_denoising": True, **values})


@pytest.mark.parametrize(("method", "samples", "passes"), [("path", 16, 8), ("bpt", 3, 3), ("guided", 16, 16)])
def test_several_passes_tell_the_variance(method, samples, passes):
    """One pass could have all of the samples of so small a picture."""
    made = etendue.render("cornell-box", method, spp=samples, size=(24, 18), max_depth=3, for_denoising=True)
    assert (made.metadata["passes"], made.metadata["samples"]) == (passes, samples)
    wanted = {"albedo", "normal", "depth", *COMPONENTS, *(variance_of(name) for name in ("image", *COMPONENTS))}
    assert wanted <= made.layers.keys()


def room() -> dict[str, Any]:
    """The Cornell box with a tall mirror and a checkered floor."""
    scene = bundled_scene("cornell-box").build()
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    checkers = {"type": "checkerboard", "color0": scenes.rgb(0.35, 0.33, 0.3), "color1": scenes.rgb(0.6, 0.57, 0.5)}
    checkers["to_uv"] = mi.ScalarTransform4f().scale([8, 8, 1])
    scene["floor"]["bsdf"] = {"type": "diffuse", "reflectance": checkers}
    scene["large-box"]["bsdf"] = {"type": "conductor", "material": "Ag"}
    return scene


@lru_cache(maxsize=2)
def pictures(mirror: bool, samples: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """(layers after 16 samples, a picture of many)."""
    scene, common = room() if mirror else "cornell-box", {"size": SIZE, "max_depth": 6}
    made = etendue.render(scene, "path", spp=16, seed=1, for_denoising=True, **common)
    truth = etendue.render(scene, "path", spp=samples, seed=2, reconstruction="independent", **common)
    return made.layers, truth.image


@pytest.mark.parametrize("name", DENOISERS)
@pytest.mark.parametrize("mirror", thinned([False, True], [True]))
def test_every_denoiser_makes_a_better_picture(name, mirror):
    """Without further options. Ratios of relMSE for three seeds: 0.03 to 0.68."""
    needs(name)
    layers, truth = pictures(mirror, 512)
    assert relative_mse(develop(layers, name), truth) < 0.8 * relative_mse(layers["image"], truth)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bilateral", "guided", "oidn"])
def test_a_mirror_keeps_what_it_shows(name):
    """Better than with the features of the mirror: ratios of relMSE for three seeds, 0.60 to 0.84."""
    needs(name)
    layers, truth = pictures(True, 2048)
    flat = {layer: values for layer, values in layers.items() if not layer.startswith("seen_")}
    mirror = np.abs(layers["seen_albedo"] - layers["albedo"]).max(axis=2) > 0.02
    assert 200 < mirror.sum() < 300
    after, before = (relative_mse(develop(some, name)[mirror][None], truth[mirror][None]) for some in (layers, flat))
    assert after < 0.9 * before


def test_command(tmp_path, capsys):
    """Render, then develop by any denoiser, by itself or with others."""
    picture = tmp_path / "a.exr"
    words = ["render", "cornell-box", "-m", "path", "--spp", "16", "--size", "48x48", "--for-denoising"]
    assert main([*words, "--no-checkpoint", "-o", str(picture)]) == 0
    read: Result = read_exr(picture)
    assert read.metadata["settings"]["for_denoising"] is True and read.metadata["passes"] == 8
    capsys.readouterr()
    for denoise in ("bilateral", "guided", "gaussian", "nlm", "indirect=gaussian,direct=none", "direct=nlm,bilateral"):
        out = tmp_path / "b.exr"
        assert main(["develop", str(picture), "--denoise", denoise, "-o", str(out)]) == 0
        assert capsys.readouterr().err == ""  # nothing is missing
        np.testing.assert_allclose(read_exr(out).image, develop(read.layers, denoise), rtol=1e-5, atol=1e-6)
