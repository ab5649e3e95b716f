"""Light through a window, and of a sun on glass, by light paths and next event that look for it: the same picture, with
a fraction of the noise."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, mitsuba_path, prepared, run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue import methods
from etendue.methods import openings
from etendue.methods.auto.method import FIXED
from etendue.transport import emission

METHODS = ("light", "bpt", "bpm", "vcm", "sppm", "pm", "auto")
#: Methods whose next event looks for windows.
BY_NEXT_EVENT = ("path", "guided", "bpt", "vcm", "auto")
#: Suns and skies, and methods: without weights, and with all techniques; the fast ones first.
ROWS = [
    ("directional constant", "light"),
    ("directional constant", "bpt"),
    ("sunsky", "bpt"),
    *(("constant", method) for method in ("light", "bpt")),
    *(("envmap", method) for method in ("light", "bpt")),
    ("sunsky", "light"),
    ("sunsky", "path"),
    ("envmap", "path"),
    ("directional constant", "guided"),
    ("envmap", "vcm"),
]


def planned(problem: Any, method: str, **settings: Any) -> Any:
    """A method made ready for a run without limits."""
    made = prepared(problem, method, **settings)
    made.plan(None, None, None)
    return made


@pytest.mark.parametrize(
    "row", [*ROWS[:2], *(pytest.param(row, marks=pytest.mark.slow) for row in ROWS[2:])], ids=" ".join
)
def test_it_is_the_same_picture(row):
    suns, method = row[0].split(), row[1]
    settings = {"light": {"light_paths": 16.0}, "vcm": {"radius": 0.002}}.get(method, {})
    made = planned(scenes.hut(*suns), method, samples_per_pass=128, **settings)
    assert ("windows" in made.notes) == (method in BY_NEXT_EVENT)
    found = go(made, passes=8)
    reference = mitsuba_path(scenes.hut(*suns), passes=8, samples=1024)
    assert_agree(found.images, reference, (suns, method), precision=0.03)


def noise(method: str, openings: bool, sun: str = "directional") -> float:
    """Mean relative variance of the pixels of a pass."""
    images = go(planned(scenes.hut(sun), method, samples_per_pass=32, openings=openings), passes=16).images
    mean = images.mean(axis=0)
    return float((images.var(axis=0, ddof=1) / (mean**2 + 1e-3 * mean.mean() ** 2)).mean())


@pytest.mark.parametrize(("method", "most"), thinned([("light", 0.3), ("bpt", 0.6)], [("light", 0.3)]))
def test_it_has_less_noise(method, most):
    assert noise(method, True) < most * noise(method, False)


@pytest.mark.parametrize(("method", "most"), thinned([("path", 0.5), ("bpt", 0.5), ("guided", 0.5)], [("path", 0.5)]))
def test_next_event_has_less_noise(method, most):
    assert noise(method, True, "constant") < most * noise(method, False, "constant")


@pytest.mark.parametrize("method", thinned([name for name in METHODS if name != "auto"], ("light", "sppm")))
def test_every_method_says_what_it_has_found(method):
    made = prepared(scenes.hut("directional", "constant"), method)
    assert made.notes["openings"] > 3.0
    assert made.lights.lines is not None
    assert prepared(scenes.hut("directional", "constant"), method, openings=False).lights.lines is None


@pytest.mark.parametrize(
    ("method", "found"), thinned([("bpt", False), ("auto", False), ("sppm", True)], [("bpt", False)])
)
def test_light_of_an_even_sky_is_left_to_next_event(method, found):
    """If the method has it, and sees some of the sky."""
    made = prepared(scenes.hut("constant"), method)
    if method == "auto":
        assert made.method._through_openings().lines is None
    assert (made.lights.lines is not None) == found


def test_a_small_window():
    """Few paths find the sky, and more are traced."""
    found = prepared(scenes.hut("constant", window=0.2), "bpt")
    assert found.notes["openings"] > 10.0


@pytest.mark.slow
def test_a_window_with_a_pane():
    """Next event never passes glass: paths that leave through it find the window."""
    assert prepared(scenes.hut("sunsky", pane=True), "bpt").notes["openings"] > 3.0


@pytest.mark.parametrize(("suns", "chosen"), [("directional constant", "bpt"), ("constant", "path")])
def test_a_short_run_of_auto_uses_light_paths_for_a_sun(suns, chosen):
    made = prepared(scenes.hut(*suns.split()), "auto")
    made.method.plan(1.0, None, None)
    assert made._brief == FIXED[chosen]
    assert (made.notes.get("openings", 0.0) > 3.0) == (chosen != "path")
    closed = prepared(scenes.hut(*suns.split()), "auto", openings=False)
    closed.method.plan(1.0, None, None)
    assert closed._brief == FIXED["path"]


def test_a_short_run_of_auto_merges_behind_panes():
    made = prepared(scenes.hut("constant", pane=True), "auto")
    made.lights.has_sun = True
    made.method.plan(1.0, None, None)
    assert made._brief == FIXED["vcm"]


@pytest.mark.slow
def test_a_run_of_auto_that_learns_finds_them():
    made = prepared(scenes.hut("directional", "constant"), "auto")
    made.step(0, 1)
    assert made.notes["openings"] > 3.0


@pytest.mark.parametrize("method", thinned(["bpt", "sppm"], ["sppm"]))
def test_open_scenes_are_as_they_were(method):
    """Nothing is learned where the sky is seen, and nothing without a sky."""
    for problem in (scenes.field(0.5, 1.0), scenes.furnace("cube", 1.0, 0.5)):
        made = prepared(problem, method)
        assert made.lights.lines is None
        assert "openings" not in made.notes


@pytest.mark.parametrize("method", ["bpt", pytest.param("vcm", marks=pytest.mark.slow)])
def test_the_caustic_of_a_sun_is_the_same(method):
    settings = {"radius": 0.002} if method == "vcm" else {}
    found = run(scenes.terrace("sunsky"), method, passes=8, samples=256, **settings)
    reference = mitsuba_path(scenes.terrace("sunsky"), passes=8, samples=2048)
    assert_agree(found.images, reference, method, precision=0.03)


def test_the_caustic_of_a_sun_has_less_noise():
    problem = scenes.terrace("directional")
    images = [run(problem, "bpt", passes=16, samples=64, openings=openings).images for openings in (True, False)]
    aimed, even = (image.var(axis=0, ddof=1).sum() for image in images)
    assert aimed < 0.1 * even


@pytest.mark.parametrize("material", ["dielectric", "conductor", "roughconductor", "diffuse", "plastic"])
def test_what_mirrors_and_refracts_only_is_aimed_at(material):
    problem = scenes.terrace("directional", ball=scenes.MATERIALS[material]())
    assert ("openings" in prepared(problem, "bpt").notes) == (material not in ("diffuse", "plastic"))


def test_glass_that_many_rays_meet_is_not_aimed_at():
    assert prepared(scenes.terrace("directional", side=0.3), "bpt").lights.lines is None


def test_methods_without_next_event_do_not_aim():
    assert prepared(scenes.terrace("directional"), "sppm").lights.lines is None


def test_methods_without_light_paths_or_next_event_do_not_look_for_them():
    assert [name for name in methods.table() if "openings" in methods.get(name).Settings.names()] == [
        name for name in methods.table() if name in {*METHODS, *BY_NEXT_EVENT, "ppm", "ambient_light"}
    ]


@pytest.mark.parametrize("method", thinned(BY_NEXT_EVENT, ["path", "auto"]))
def test_next_event_looks_through_windows(method):
    """Of a hut, not in an open scene, behind a pane, for the one direction of a sun, or if one does not want it."""

    def looks(problem: Any, **settings: Any) -> bool:
        made = planned(problem, method, **settings)
        lights = made.method._through_openings() if method == "auto" else made.lights
        assert (lights.windows is not None) == ("windows" in made.notes)
        return lights.windows is not None

    assert looks(scenes.hut("constant"))
    assert not looks(scenes.hut("constant"), openings=False)
    assert not looks(scenes.hut("directional"))
    assert not looks(scenes.hut("constant", pane=True))
    assert not looks(scenes.field(0.5, 1.0))


def test_each_light_point_has_its_own_direction():
    """The variance of next event falls with the number of its samples."""
    variances = []
    for number in (1, 8):
        made = planned(scenes.hut("constant"), "bpt", samples_per_pass=32, next_events=number, max_depth=2)
        assert "windows" in made.notes
        variances.append(go(made, passes=16).images.var(axis=0, ddof=1).mean())
    assert variances[1] < 0.4 * variances[0]


@pytest.mark.parametrize(("method", "settings"), [("path", {}), ("auto", {}), ("auto", {"choice": "path"})])
def test_short_runs_do_not_look_through_windows(method, settings):
    for plan in ((1.0, None, None), (None, 2, None)):
        made = prepared(scenes.hut("constant"), method, samples_per_pass=8, **settings)
        made.plan(*plan)
        made.step(0, 1)
        assert "windows" not in made.notes
    made.plan(60.0, None, None)
    made.step(1, 1)
    assert "windows" in made.notes


def test_windows_of_a_scene_before_are_forgotten():
    made = planned(scenes.hut("constant"), "path")
    made.prepare(scenes.field(0.5, 1.0), 1)
    made.plan(None, None, None)
    assert "windows" not in made.notes


@pytest.mark.parametrize(
    ("method", "samples"), [("path", 8192), *thinned([("bpt", 4), ("guided", 8192), ("auto", 8192)], [])]
)
def test_a_run_can_be_continued(method, samples, tmp_path):
    """What was found is found again, also if what is left would be a short run."""
    file, made = tmp_path / "hut.checkpoint", {"samples_per_pass": samples // 4}
    whole = etendue.render(scenes.hut("directional", "constant").scene, method, spp=samples, **made)
    etendue.render(scenes.hut("directional", "constant").scene, method, spp=3 * samples // 4, checkpoint=file, **made)
    rest = etendue.resume(file, scene=scenes.hut("directional", "constant").scene, spp=samples)
    names = [name for name in ("openings", "windows") if name in whole.metadata]
    assert names and all(rest.metadata[name] == whole.metadata[name] for name in names)
    np.testing.assert_allclose(rest.image, whole.image, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("power", [0.0, 2000.0])
def test_the_factor_is_that_of_the_densities(power):
    """Also where next event rarely picks the sky."""
    places = itertools.product((-0.7, -0.2, 0.3, 0.8), (-0.5, 0.5))
    lamps = {f"lamp{i}": scenes.lamp((x, 0.8, z), 0.03, power) for i, (x, z) in enumerate(places) if power}
    made = planned(scenes.hut("constant", **lamps), "path")
    lines = openings._lines(made.method, 2)
    o, d = (mi.Point3f(line.T.astype(np.float32)) for line in (lines.o, lines.d))
    lights, sky = made.lights.at(o), mi.UInt32(made.lights.sky)
    light, own = lights.row(sky), dr.full(mi.Float, 1.0 / (4.0 * np.pi), len(lines))
    with_windows = emission.seen_through(lights, light, o, mi.Vector3f(d), own, mi.Bool(True))
    gain = np.log((np.array(with_windows) + lines.scattered) / (np.array(light.pick * own) + lines.scattered))
    assert made.notes["windows"] == pytest.approx(np.exp(np.average(gain, weights=lines.value)), rel=0.1)


def test_the_window_of_a_room_in_a_wide_plain():
    """It is looked for where surfaces in the picture are."""
    assert planned(scenes.hut("constant", plain=2e4), "path").notes["windows"] > 5.0


def test_black_skies_are_black():
    problem = scenes.hut("constant")
    mi.traverse(problem.scene)["constant-light.radiance.value"] = [0.0, 0.0, 0.0]
    assert prepared(problem, "bpt").lights.lines is None
