"""The emitter ``sky``: its radiance and illuminance against :mod:`etendue.lighting`, its samplers, and every method."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.statistics import assert_mean
from support.tables import crossed

import etendue
from etendue import conformance
from etendue.core import OptionError, SceneError
from etendue.lighting import EFFICACY, SUN_DIAMETER, Sky, cie_sky, perez_sky, sun_direction
from etendue.scene import load, portable, restored

SUN = [0.5, 0.3, 0.6]
CIE = {"kind": 12, "sun_direction": SUN, "diffuse_illuminance": 10_000.0}
PEREZ = {"kind": "perez", "sun_direction": SUN, "direct_normal": 700.0, "diffuse_horizontal": 110.0}
ALBEDO = 0.5


def stage(turn: Any = None, **sky: Any) -> dict[str, Any]:
    """A floor seen from above, z up or as ``turn`` makes it."""
    turn = turn or scenes.transform()
    look = turn @ scenes.transform().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    return {
        "type": "scene",
        "sky": {"type": "sky", "to_world": turn} | sky,
        "floor": {
            "type": "rectangle",
            "to_world": turn @ scenes.transform().scale(2.0),
            "bsdf": scenes.diffuse(*[ALBEDO] * 3),
        },
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "to_world": look,
            "film": {"type": "hdrfilm", "rfilter": {"type": "box"}},
        },
    }


def emitter_of(**sky: Any) -> tuple[Any, Any]:
    built = mi.load_dict(stage(**sky))
    return built, built.emitters()[0]


def luminance(emitter: Any, directions: np.ndarray) -> np.ndarray:
    si = dr.zeros(mi.SurfaceInteraction3f, len(directions))
    si.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(-c, np.float32)) for c in directions.T))
    return EFFICACY * np.array(emitter.eval(si)[0], np.float64)


def sphere(n: int, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", [*range(1, 17), "perez", "clear and low"])
def test_radiance_and_illuminance(kind):
    """The radiance is the luminance over 683; the horizontal illuminance of the radiance is the sky's within 1e-4."""
    given: dict[str, Any] = {"ground_reflectance": 0.3}
    if isinstance(kind, int):
        sky = cie_sky(kind, SUN, diffuse_illuminance=10_000.0, ground=0.3)
        given |= CIE | {"kind": kind}
    else:
        sun = SUN if kind == "perez" else [0.5, 0.3, 0.06]
        sky = perez_sky(sun, 700.0, 110.0, ground=0.3)
        given |= PEREZ | {"sun_direction": sun}
    _, emitter = emitter_of(**given)
    towards = np.asarray(sky.sun)
    d = sphere(20_000)
    d = d[np.linalg.norm(np.cross(d, towards), axis=1) > np.deg2rad(SUN_DIAMETER)]
    np.testing.assert_allclose(luminance(emitter, d), sky.luminance(d), rtol=2e-4, atol=1e-4 * sky.zenith_luminance)
    if kind == "clear and low":
        return
    zenith, turn = 0.5 * np.pi * (np.arange(400) + 0.5) / 400, 2.0 * np.pi * (np.arange(500) + 0.5) / 500
    across, up = np.sin(zenith), np.cos(zenith)
    parts = np.outer(across, np.sin(turn)), np.outer(across, np.cos(turn)), np.repeat(up, 500)
    d = np.stack([part.ravel() for part in parts], -1)
    inside = np.linalg.norm(np.cross(d, towards), axis=1) < np.deg2rad(SUN_DIAMETER)
    seen = np.where(inside, sky.luminance(d), luminance(emitter, d))  # the sun is smaller than a cell
    assert (seen * np.repeat(across * up, 500)).sum() * np.pi**2 / 200_000 == pytest.approx(
        sky.diffuse_illuminance, rel=1e-4
    )


def test_the_sun():
    """Its disc has the luminance and the radius of the sun, and it is black at night."""
    sky = perez_sky(SUN, 700.0, 110.0)
    _, emitter = emitter_of(**PEREZ)
    towards = np.asarray(sky.sun)
    side = np.cross(towards, [0, 0, 1])
    side /= np.linalg.norm(side)
    angle = np.deg2rad(0.5 * SUN_DIAMETER) * np.array([0.0, 0.5, 0.99, 1.01])
    d = np.cos(angle)[:, None] * towards + np.sin(angle)[:, None] * side
    expected = sky.luminance(d) + sky.sun_luminance * np.array([1, 1, 1, 0])
    np.testing.assert_allclose(luminance(emitter, d), expected, rtol=1e-3)
    _, without = emitter_of(**PEREZ, sun=False)
    dark = Sky(sky.gradation, sky.indicatrix, sky.scale, sky.sun)
    below = np.vstack([d, [[0.0, 0.0, -1.0]]])
    np.testing.assert_allclose(luminance(without, below), dark.luminance(below), rtol=1e-3)


@pytest.mark.parametrize("sky", [CIE | {"sun_illuminance": 40_000.0}, PEREZ], ids=["cie", "perez"])
def test_samples(sky):
    """The mean weight of next event against a horizontal and a tilted plane is the illuminance of sky, ground, sun."""
    _, emitter = emitter_of(**sky)
    expected = (
        cie_sky(12, SUN, diffuse_illuminance=1e4, sun_illuminance=4e4)
        if sky["kind"] == 12
        else perez_sky(SUN, 700, 110)
    )
    n = 400_000
    it = dr.zeros(mi.Interaction3f, n)
    u = np.random.default_rng(2).random((2, n)).astype(np.float32)
    ds, weight = emitter.sample_direction(it, mi.Point2f(u))
    weights, d = EFFICACY * np.array(weight[0], np.float64), np.array(ds.d, np.float64).T
    assert_mean(weights * np.maximum(d[:, 2], 0.0), expected.illuminance)
    normal = np.array([0.6, 0.0, -0.8])  # sees the ground, and a part of the sky
    many = sphere(2_000_000)
    around = 4.0 * np.pi * expected.luminance(many) * np.maximum(many @ normal, 0.0)
    sun = expected.sun_illuminance * max(float(np.dot(expected.sun, normal)), 0.0)
    found = weights * np.maximum(d @ normal, 0.0)
    error = np.hypot(found.std() / np.sqrt(n), around.std() / np.sqrt(len(many)))
    assert abs(found.mean() - around.mean() - sun) < 4.5 * error


def test_the_sun_at_the_horizon():
    """Half of its disc shines; the samples of the other half belong to the ground."""
    sun = [1.0, 0.0, 0.0]
    sky = perez_sky(sun, 200.0, 60.0)
    _, emitter = emitter_of(**PEREZ | {"sun_direction": sun, "direct_normal": 200.0, "diffuse_horizontal": 60.0})
    n = 400_000
    u = np.random.default_rng(2).random((2, n)).astype(np.float32)
    ds, weight = emitter.sample_direction(dr.zeros(mi.Interaction3f, n), mi.Point2f(u))
    weights, d = EFFICACY * np.array(weight[0], np.float64), np.array(ds.d, np.float64).T
    assert_mean(weights * (d[:, 2] < 0.0), 2.0 * np.pi * sky.ground_luminance)
    near = d @ np.array(sun) > np.cos(np.deg2rad(0.5 * SUN_DIAMETER))
    assert_mean(weights * near * (d[:, 2] > 0.0), 0.5 * sky.sun_illuminance, sigmas=6.0)


@pytest.mark.parametrize(
    "sky", [CIE, PEREZ | {"sun": False}, {"kind": 5, "zenith_luminance": 500.0, "ground_reflectance": 0.0}]
)
def test_conformance(sky):
    scene = load(stage(**sky)).scene
    findings = conformance.check_emitter(scene.emitters()[0], scene)
    assert {f.test for f in findings} >= {"range", "radiance", "density", "integral", "sampler", "power"}
    assert [f for f in findings if f.verdict == "fail"] == []


@pytest.mark.parametrize(("method", "up"), crossed(["path", "bpt", "vcm", "auto", "guided", "sppm"], ["z", "y"], 3))
def test_methods(method, up):
    """A floor under an open sky with sun: radiance = albedo E / (pi 683)."""
    turn = scenes.transform().rotate([1, 0, 0], -90) if up == "y" else None
    image = etendue.render(stage(turn, **PEREZ), method=method, spp=64, size=(12, 12), seed=4).image
    expected = perez_sky(SUN, 700.0, 110.0).illuminance
    assert_mean(np.asarray(image, np.float64)[..., :3].mean(-1).ravel() * np.pi * EFFICACY / ALBEDO, expected)


def test_light_paths():
    """Rays of the sky, over the disc of the scene."""
    image = etendue.render(stage(**CIE), method="light", spp=256, size=(12, 12), seed=4).image
    values = np.asarray(image, np.float64)[..., :3].mean(-1) * np.pi * EFFICACY / ALBEDO
    assert_mean(values.reshape(6, 2, 6, 2).mean((1, 3)).ravel(), 10_000.0)


@pytest.mark.parametrize(("loaded", "up"), crossed([True, False], ["y", "z"], 2))
def test_mitsubas_particle_tracer(loaded, up):
    """Rays of the sky itself, from the sphere around the scene that its parameters tell, or étendue."""
    turn = scenes.transform().rotate([1, 0, 0], -90) if up == "y" else scenes.transform()
    described = stage(turn, **PEREZ)
    described["sensor"]["film"] |= {"width": 8, "height": 8}
    lower = turn @ scenes.transform().translate([0, 0, -4]).scale(2.0)  # in the shade; the sphere is not at the origin
    described["lower"] = described["floor"] | {"to_world": lower}
    if loaded:
        scene = load(described).scene
    else:
        described["sky"] |= {"center": [0, -2, 0] if up == "y" else [0, 0, -2], "radius": 4.0}
        scene = mi.load_dict(described)
    tracer = mi.load_dict({"type": "ptracer", "max_depth": 2})
    passes = [np.array(mi.render(scene, integrator=tracer, spp=2048, seed=k), np.float64) for k in range(24)]
    means = np.array([image[..., :3].mean() for image in passes]) * np.pi * EFFICACY / ALBEDO
    assert means.std() < 0.05 * means.mean()
    assert_mean(means, perez_sky(SUN, 700.0, 110.0).illuminance)


def test_rays_without_a_scene():
    """Mitsuba's own scenes do not tell the sky where they are."""
    _, emitter = emitter_of(**CIE)
    with pytest.raises(OptionError, match="give 'center' and 'radius' of a sphere around it"):
        emitter.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))


def test_place_and_time(tmp_path):
    """An XML file with place and time is the dictionary with that direction."""
    text = """<scene version="3.0.0"><emitter type="sky" id="sky"><string name="kind" value="perez"/>
    <float name="latitude" value="46.95"/><float name="longitude" value="7.45"/>
    <string name="time" value="2024-06-21T10:00+02:00"/><float name="direct_normal" value="700"/>
    <float name="diffuse_horizontal" value="110"/></emitter>
    <shape type="rectangle"/><sensor type="perspective"/></scene>"""
    (tmp_path / "scene.xml").write_text(text)
    emitter = load(tmp_path / "scene.xml").scene.emitters()[0]
    sky = perez_sky(sun_direction(46.95, 7.45, "2024-06-21T08:00Z")[0], 700.0, 110.0, day=173.0 + 8.0 / 24.0)
    d = sphere(1000)
    np.testing.assert_allclose(luminance(emitter, d), sky.luminance(d), rtol=2e-4)


def test_workers_and_fingerprints(tmp_path):
    """A scene for another machine is the same scene; another sky is another scene."""
    source, _ = restored(portable(stage(**PEREZ)), tmp_path)
    prints = [load(s).fingerprint for s in (stage(**PEREZ), source, stage(**PEREZ | {"direct_normal": 701.0}))]
    assert prints[0] == prints[1] != prints[2]


def test_changed_values():
    """Luminances that are changed in a loaded scene change the picture and the samples."""
    scene, emitter = emitter_of(**CIE)
    change = mi.traverse(scene)
    values = np.array(change["sky.values"])
    values[8:] *= 2.0
    change["sky.values"] = mi.Float(values)
    change.update()
    d = sphere(1000)
    expected = 2.0 * cie_sky(12, SUN, diffuse_illuminance=10_000.0).luminance(d)
    np.testing.assert_allclose(luminance(emitter, d), expected, rtol=2e-4)
    change["sky.values"] = mi.Float(values * -1.0)
    with pytest.raises(OptionError, match="luminances at least 0"):
        change.update()


def test_bad_skies():
    for message, sky in {
        "has no 'kind'": {"zenith_luminance": 1.0},
        "'kind' is 'blue'": {"kind": "blue"},
        "'kind' is 2.5": {"kind": 2.5},
        "needs 'direct_normal'": {"kind": "perez", "sun_direction": SUN},
        "needs 'sun_direction', or": {"kind": "perez", "direct_normal": 1.0, "diffuse_horizontal": 1.0},
        "below the horizon": PEREZ | {"sun_direction": [0.0, 1.0, -0.2]},
        "no parameter 'turbidity'": CIE | {"turbidity": 3.0},
        "no parameter 'dew_point'": CIE | {"dew_point": 3.0},
        "both 'sun_direction' and 'latitude'": CIE | {"latitude": 3.0},
        "'latitude', 'longitude' and 'time' together": {"kind": 1, "latitude": 3.0},
        "no time zone": {"kind": 1, "latitude": 3.0, "longitude": 3.0, "time": "2024-01-01T10:00"},
        "'diffuse_illuminance' is 'much'": CIE | {"diffuse_illuminance": "much"},
        "'sun' is true or false": CIE | {"sun": 3.0},
        "'radius' is 0": CIE | {"radius": 0.0},
        "'radius' is 'big'": CIE | {"radius": "big"},
        "'center' is": CIE | {"center": "here", "radius": 1.0},
        "gives no light": CIE | {"diffuse_illuminance": 0.0},
        "one colour": CIE | {"color": scenes.bitmap(np.ones((2, 2, 3)))},
    }.items():
        with pytest.raises((SceneError, OptionError), match=message) as caught:
            load(stage(**sky))
        assert "\n" not in str(caught.value)
