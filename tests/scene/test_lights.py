"""The light table: how much each emitter is worth, and which ones may be left out."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.statistics import assert_mean

from etendue.core import SceneError
from etendue.scene import LightTable

#: Texels that are lit, of 64 x 64.
LIT = [(40, 9), (41, 9), (7, 50), (60, 62)]


def speckled(bright: float = 500.0, **more: Any) -> dict[str, Any]:
    pixels = np.zeros((64, 64, 3))
    for y, x in LIT:
        pixels[y, x] = bright
    return {"type": "area", "radiance": scenes.bitmap(pixels) | more}


def shape(name: str) -> Any:
    """An emitting shape that shows all of its texture."""
    turned = scenes.transform().translate([0.2, 1.5, 0.0]).rotate([1, 0, 0], 130).rotate([0, 1, 0], 20)
    match name:
        case "rectangle":
            return {"type": "rectangle", "to_world": turned.scale([0.6, 0.3, 1.0])}
        case "mesh":
            return {"type": "cube", "to_world": turned.scale([0.3, 0.2, 0.1])}
        case "cylinder":
            return {"type": "cylinder", "to_world": turned, "p0": [0, 0, 0], "p1": [0, 0.5, 0], "radius": 0.2}
        case _:
            return {"type": name, "to_world": turned.scale(0.3)}


def table(**lights: Any) -> LightTable:
    scene = {"type": "scene", "sensor": scenes.camera(), "floor": scenes.plate((0, 0, 0), 1.0, True)}
    return LightTable(scenes.load(scene | lights).scene)


def point(intensity: float) -> dict[str, Any]:
    return {"type": "point", "position": [0, 1, 0], "intensity": scenes.rgb(intensity, intensity, intensity)}


def test_a_few_bright_texels_are_worth_their_power():
    """12.3 W of four texels beside 12.6 W of a point light."""
    bright = 12.3 / (np.pi * 4.0) * 64 * 64 / len(LIT)  # on a square of side 2
    square = {"type": "rectangle", "to_world": scenes.transform().translate([0, 2, 0]).rotate([1, 0, 0], 90)}
    both = table(a=square | {"emitter": speckled(bright)}, b=point(12.6 / (4.0 * np.pi)))
    np.testing.assert_allclose(both.probabilities, np.array([12.3, 12.6]) / 24.9, rtol=1e-4)
    alone = table(a=square | {"emitter": speckled(bright)})
    assert alone.total_power == pytest.approx(12.3, rel=1e-4)


def test_the_number_of_a_light_picks_it():
    """Also in a table whose lights are picked with learned probabilities, others for emission than for next event."""
    own = table(a=point(1.0), b=point(2.0), c=point(5.0))
    rows = mi.UInt32([0, 1, 2])
    for lights in (own, own.picked_by(np.array([0.2, 0.2, 0.6]), np.array([0.9, 0.05, 0.05]))):
        np.testing.assert_array_equal(lights.pick_emitting(lights.number_of(rows)).row, rows)


@pytest.mark.parametrize("name", ["rectangle", "disk", "sphere", "cylinder", "mesh"])
def test_the_power_of_a_texture_on_a_shape(name):
    """Against points drawn uniformly on the shape."""
    turn = scenes.transform().rotate([0, 0, 1], 30).scale([1.7, 1.2, 1.0])
    for more in ({}, {"to_uv": turn, "filter_type": "nearest"}):
        scene = scenes.load(
            {"type": "scene", "sensor": scenes.camera(), "lamp": shape(name) | {"emitter": speckled(**more)}}
        ).scene
        emitter = scene.emitters()[0]
        u = mi.Point2f(np.random.default_rng(5).random((2, 1 << 19)).astype(np.float32))
        si = mi.SurfaceInteraction3f(emitter.get_shape().sample_position(0.0, u), mi.Color0f())
        si.wi = mi.Vector3f(0, 0, 1)
        area = float(np.asarray(emitter.get_shape().surface_area()).ravel()[0])
        radiance = np.array(emitter.eval(si), np.float64)[0]
        samples = np.pi * area * radiance
        power = LightTable(scene).total_power
        assert_mean(samples, power, (name, more, samples.mean()))


def test_focus_does_not_change_the_power():
    square = {"type": "rectangle", "to_world": scenes.transform().translate([0, 2, 0]).rotate([1, 0, 0], 90)}
    for radiance in (speckled()["radiance"], scenes.rgb(3, 2, 1)):
        lights = ({"type": "area"}, {"type": "focusarea", "exponent": 6.0})
        powers = [table(a=square | {"emitter": kind | {"radiance": radiance}}).total_power for kind in lights]
        assert powers[1] == pytest.approx(powers[0], rel=1e-4)


def test_what_may_emit_is_never_left_out():
    """A spot whose rays are dark but for one texel, too few to be met by chance, and one next to nothing."""
    pixels = np.zeros((512, 512, 3))
    pixels[200, 300] = 1.0
    spot = {"type": "spot", "texture": scenes.bitmap(pixels), "cutoff_angle": 40.0}
    lights = table(a=spot, b=point(1.0), c=point(1e-9), d=point(0.0))
    floor = 0.25 / 3 / 1.25
    np.testing.assert_array_equal(lights.probabilities[[0, 2, 3]] > 0.9 * floor, [True, True, False])
    assert lights.probabilities.sum() == pytest.approx(1.0)
    assert lights.probabilities[3] == 0.0
    assert table(a=spot).probabilities == [1.0]


def test_a_sky_leaves_lamps_their_share():
    """Whatever the size of the ground, which decides the power of a sky through the bounding sphere."""
    sky, sun = (
        {"type": "constant", "radiance": 3.0},
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 9.0},
    )
    for side in (1.0, 1000.0):
        ground = {"ground": scenes.plate((0, -1, 0), side, True)}
        one = table(a=sky, b=point(1.0), **ground)
        np.testing.assert_allclose(one.probabilities, 0.5)
        many = table(a=point(1.0), b=sky, c=point(3.0), d=sun, e=point(1e-6), f=point(0.0), **ground).probabilities
        by_sky = 3.0 * 4.0 / (3.0 * 4.0 + 9.0 / np.pi)
        wanted = np.array([0.25, 2 * by_sky, 0.75, 2 * (1 - by_sky), 0.25 / 5 * 3, 0.0]) / (3 + 0.25 / 5 * 3)
        np.testing.assert_allclose(many[[0, 1, 2, 3, 4, 5]], wanted, rtol=2e-3)


def weighted(kind: str, weight: float) -> dict[str, Any]:
    """A point light, and a light of a kind with a weight."""
    light: dict[str, Any] = {
        "point": point(3.0) | {"position": [0.5, 1, 0.5]},
        "directional": {"type": "directional", "direction": [0, -1, 0.2], "irradiance": 1.0},
        "constant": {"type": "constant", "radiance": 0.5},
        "area": scenes.lamp((0.5, 1.2, 0), 0.5, 3.0),
    }[kind]
    if "emitter" in light:
        return {"a": point(1.0), "b": light | {"emitter": light["emitter"] | {"sampling_weight": weight}}}
    return {"a": point(1.0), "b": light | {"sampling_weight": weight}}


@pytest.mark.parametrize("kind", ["point", "directional", "constant", "area"])
def test_the_weight_of_an_emitter_is_a_factor_on_its_share(kind):
    """A weight of 0 leaves out what no ray can hit; hits find the others, as in Mitsuba, so these keep a share."""
    for weight in (0.5, 0.0):
        lights = table(**weighted(kind, weight))
        row = 1
        if weight:
            powers = lights.powers[row], lights.powers.sum() - lights.powers[row]
            own = 0.5 if kind in ("directional", "constant") else weight * powers[0] / (weight * powers[0] + powers[1])
            assert lights.probabilities[row] == pytest.approx(own, rel=1e-4)
        else:
            assert (lights.probabilities[row] == 0.0) == (kind in ("point", "directional"))
    if kind in ("point", "directional"):
        alone = {key: value for key, value in weighted(kind, 1e-30).items() if key == "b"}
        assert table(**alone).probabilities == [1.0]


@pytest.mark.parametrize(
    "black",
    [
        {"type": "point", "intensity": {"type": "rgb", "value": [0, 0, 0]}},
        {"type": "spot", "texture": "zeros"},
        {"type": "envmap", "bitmap": "zeros"},
        {"type": "rectangle", "emitter": {"type": "area", "radiance": "zeros"}},
    ],
)
def test_emitters_that_are_all_black(black):
    zeros = np.zeros((8, 8, 3), np.float32)
    if "texture" in black:
        black = black | {"texture": scenes.bitmap(zeros)}
    if "bitmap" in black:
        black = black | {"bitmap": mi.Bitmap(zeros)}
    if "emitter" in black:
        black = black | {"emitter": {"type": "area", "radiance": scenes.bitmap(zeros)}}
    described = {"type": "scene", "sensor": scenes.camera(), "floor": scenes.plate((0.0, 0.0, 0.0), 1.0, up=True)}
    with pytest.raises(SceneError, match="emits nothing"):
        scenes.load(described | {"lamp": black})
    lights = LightTable(mi.load_dict(described | {"lamp": black}))  # where lamps may have been switched off
    assert lights.is_black and lights.powers.sum() == 0.0 and lights.probabilities.sum() == 1.0


def sky(name: str) -> dict[str, Any]:
    """An infinite light of that kind: even, or with a spot as bright as the rest, or as a fiftieth of it."""
    pixels = np.ones((64, 128, 3), np.float32)
    match name:
        case "spot" | "faint spot":
            pixels[20, 60:62] = pixels.sum() / 6 / (1.0 if name == "spot" else 50.0)
            return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
        case "map":
            return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
        case "clear":
            return {"type": "sunsky", "sun_direction": [0.5, 0.3, 0.8]}
        case "sky":
            return {"type": "sunsky", "sun_direction": [0.5, 0.3, 0.8], "sun_scale": 0.0}
        case _:
            return {"type": name}


@pytest.mark.parametrize(
    ("name", "has_sun"),
    [
        *(("constant", False), ("map", False), ("faint spot", False), ("sky", False)),
        *(("directional", True), ("spot", True), ("clear", True)),
    ],
)
def test_a_sun_is_a_light_of_few_directions(name, has_sun):
    assert table(lamp=sky(name)).has_sun == has_sun
    assert not table(lamp={"type": "point"}).has_sun
