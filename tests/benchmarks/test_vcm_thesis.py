"""The experiments of the thesis: their scenes, their bookkeeping, and every command at a tiny size."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from support.experiments import call, is_number, tables_of

from etendue import film, methods
from etendue.core import OptionError, Replica

NAMES = ("mirror-balls", "living-room", "bathroom", "diffuse")


def module(name):
    return importlib.import_module(f"benchmarks.vcm_thesis.{name}")


# ---------------------------------------------------------------------- scenes


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scenes_are_lit_and_their_caustics_are_reflected(name):
    """Finite light everywhere in sight. With a small radius merging is left what nothing else finds: caustics that are
    seen in mirrors or through glass."""
    entrants = module("entrants")
    settings = entrants.merging("vcm", 0.002, merge_first=False, split_layers=True)
    replica = Replica(entrants.Entrant("vcm", "vcm", settings).prepared(entrants.open_scene(name, (64, 48)), 0), 0)
    total = replica.step(0) + replica.step(1)
    assert total.counters["nonfinite"] == 0
    image, merge = total.mean("image"), total.mean("merge")
    assert np.mean(image.sum(axis=2) > 0.0) > 0.99
    share = merge.mean() / image.mean()
    # Measured: 0.005 in the diffuse room; 0.044, 0.095 and 0.037 in the others.
    assert (share < 0.015) == (name == "diffuse") and share > 0.0


# ---------------------------------------------------------------------- what takes part, and against what


def test_settings_are_those_of_the_methods():
    entrants = module("entrants")
    for entrant in entrants.the_four():
        methods.get(entrant.method).Settings(**entrant.settings)
    vcm = entrants.merging("vcm", 0.005)
    assert (vcm["radius"], vcm["radius_unit"], vcm["eta_discount"]) == (0.005, "absolute", 1.0)


def test_a_reference_is_kept(tmp_path):
    """The halves differ by noise; the file is read back; pixels that see a lamp count for nothing."""
    recipe, white = module("references").recipe("diffuse"), importlib.import_module("benchmarks.references").WHITE
    made = recipe.make((32, 24), tmp_path, 0.4)
    again = recipe.find((32, 24), tmp_path, 1e9)
    assert np.array_equal(made.image, again.image, equal_nan=True) and made.note == again.note
    assert 0.0 < made.noise < 1.0
    stored = film.read_exr(tmp_path / "reference-diffuse-32x24.exr").image @ np.array(film.LUMINANCE)
    lamps = np.isnan(made.image).all(axis=2)
    assert np.array_equal(lamps, stored > white * stored.mean())


def test_references_of_several_kinds_lie_apart(tmp_path):
    """Methods and radii have a file each; a method that makes none is named."""
    recipe = module("references").recipe
    kinds = [("vcm", 5.0), ("vcm", 1.0), ("bpt", 5.0), ("path", 5.0)]
    files = {recipe("bathroom", *kind)._path((8, 6), tmp_path) for kind in kinds}
    assert len(files) == len(kinds)
    assert recipe("bathroom", "vcm", 1.0).settings == {"radius": 0.001, "radius_unit": "absolute"}
    assert not recipe("bathroom", "bpt").settings
    assert {recipe("diffuse", *kind).method for kind in kinds} == {"path"}
    with pytest.raises(OptionError, match="references are made by vcm, bpt, path, not by 'sppm'"):
        recipe("bathroom", "sppm")


def test_blocks_tell_noise_from_structure():
    """Noise that blocks share, as light paths bring it about, and the same with a bias of 0.7 of its error."""
    correctness = module("correctness")
    rng = np.random.default_rng(2)
    seeds, passes, side, noise, bias = 6, 50, 20, 0.1, 0.01
    shared = rng.normal(0.0, noise, (seeds, passes, side // 2, side)).repeat(2, 2)
    pattern = np.where(np.arange(side) < side // 2, bias, -bias)
    record = correctness._residual("a scene", {"clean": shared, "odd": shared + pattern}, 16, 1.0)
    clean, odd = record.rows
    # The mean of z^2 over 6 runs of 200 independent blocks has a standard deviation of sqrt(2 / 1200) (49 / 47).
    assert float(clean[1].split()[0]) == pytest.approx(49 / 47, abs=4 * 0.043)
    assert float(clean[2]) > 0.01 > float(odd[2])
    # That of the square of the bias: noise^2 / passes over the root of 200 blocks and of 15 pairs of runs, 3.7e-6; with
    # a bias, twice it times the standard error of the mean of all, 0.1 / sqrt(60 000), 8.2e-6.
    assert (float(odd[6].split()[0]) / 100.0) ** 2 == pytest.approx(bias**2, abs=4 * 9e-6)
    assert (float(clean[6].split()[0]) / 100.0) ** 2 < 4 * 3.7e-6


@pytest.mark.slow
def test_lengths_add_up():
    """Twice the light paths cast once more the rays of the light walks; what is left are the camera walks."""
    entrants, profile = module("entrants"), module("profile")
    problem = entrants.open_scene("living-room", (96, 72))
    rays = {}
    for paths in (1.0, 2.0):
        settings = entrants.merging("bpm", samples_per_pass=1) | {"light_paths": paths}
        merger = entrants.Entrant("bpm", "bpm", settings).prepared(problem, 0)
        rays[paths] = Replica(merger, 0).step(0).counters["rays"]
    light, camera, ends = profile._lengths(problem, (96, 72), {})
    pixels = 96 * 72
    # Path lengths vary by about their mean: the difference of two sets of 7000 paths is good to 3 %.
    assert (rays[2.0] - rays[1.0]) / pixels == pytest.approx(light, rel=0.08)
    assert rays[1.0] / pixels - light == pytest.approx(camera, rel=1e-3)
    assert 0.0 < ends <= camera


# ---------------------------------------------------------------------- commands

_TINY = ["--size", "24x18"]
_QUICK = [*_TINY, "--time", "0.2", "--reference-time", "0.4"]
COMMANDS = {
    "reference": [*_TINY, "--scene", "diffuse", "--time", "0.4"],
    "correctness": [*_TINY, "--passes", "4", "--seeds", "2"],
    "convergence": [*_QUICK, "--scene", "diffuse", "--seeds", "2"],
    "profile": [*_TINY, "--scene", "diffuse", "--rounds", "1", "--warm-up", "1"],
    "radius": [*_QUICK, "--scene", "diffuse", "--seeds", "1"],
    "photons": [*_QUICK, "--scene", "diffuse", "--seeds", "1"],
    "radii": [*_TINY, "--scene", "diffuse", "--rounds", "1", "--warm-up", "1"],
    "parts": [*_TINY, "--scene", "diffuse", "--passes", "3"],
    "combined": [*_TINY, "--scene", "diffuse", "--passes", "2", "--seeds", "2", "--reference-time", "0.4"],
}
PLOTS = {"correctness", "convergence", "radius", "photons"}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_make_tables_of_numbers(command, tmp_path, monkeypatch):
    words = [command, *COMMANDS[command]]
    words += [] if command in ("profile", "radii") else ["--out", str(tmp_path)]
    words += [] if command == "reference" else ["--record"]
    for table in tables_of("vcm_thesis", words, tmp_path, monkeypatch):
        for row in table.rows:
            assert all(map(is_number, row[1:2] if command == "reference" else row[1:])), (table.title, row)
    assert (tmp_path / "RESULTS.md").exists() == (command != "reference")
    plots = list(tmp_path.glob("*.svg"))
    assert len(plots) == (command in PLOTS)
    for plot in plots:
        assert plot.read_text("utf-8").startswith('<svg xmlns="http://www.w3.org/2000/svg"')


@pytest.mark.parametrize("text", ["", "x", "1,0", "-1", "inf"])
def test_radii_are_lengths(text):
    error = call("vcm_thesis", ["correctness", "--radius", text]).exception
    assert isinstance(error, OptionError) and "option '--radius' takes millimetres" in str(error)


def test_an_unknown_scene_is_named():
    error = call("vcm_thesis", ["radii", "--scene", "diffuse,bathrom"]).exception
    assert isinstance(error, OptionError) and str(error) == "unknown scene 'bathrom'; did you mean 'bathroom'?"
