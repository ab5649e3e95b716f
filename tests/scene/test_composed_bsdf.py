"""A material made of a function: its values, its sampler, and life inside Mitsuba."""

from __future__ import annotations

import math
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue.conformance import check_bsdf
from etendue.core import OptionError
from etendue.integration import Box, Integrand, array_namespace, constant
from etendue.scene import bundled_scene, composed_bsdf

BOX = Box.of([(0, 1)] * 2 + [(-1, 1)] * 6)
WHITE = constant(0.6 / math.pi, BOX)


def waves():
    """A texture in the place of the reflectance."""
    colour = Integrand(lambda x: [0.5 + 0.3 * x[0], 0.4 * x[1], 0.2 + 0 * x[0]], 2, (0, 0.8), "either", values=3)
    lobe = Integrand(
        lambda x: array_namespace(x[0]).maximum(x[2] * x[5] - x[0] * x[3] - x[1] * x[4], 0) ** 3 * (5 / (2 * math.pi)),
        [(-1, 1)] * 6,
        on="either",
    )
    return colour.of([0, 1], BOX) * (1 / math.pi) + 0.15 * lobe.of(range(2, 8), BOX)


def test_it_has_the_values_of_the_function():
    bsdf, rng = composed_bsdf(waves()), np.random.default_rng(1)
    v = rng.normal(size=(2, 3, 500))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v[:, 2] = np.abs(v[:, 2])
    si = mi.SurfaceInteraction3f()
    si.uv, si.wi = mi.Point2f(np.float32(rng.random((2, 500)))), mi.Vector3f(np.float32(v[0]))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(np.float32(v[1])))
    expected = np.array(waves().evaluate([*np.array(si.uv, dtype=float), *v[1], *v[0]])) * v[1, 2]
    assert np.array(value) == pytest.approx(expected, abs=1e-5)
    assert np.array(pdf) == pytest.approx(v[1, 2] / math.pi, abs=1e-6)
    below = mi.Vector3f(np.float32(v[1] * [[1], [1], [-1]]))
    assert not np.array(bsdf.eval(mi.BSDFContext(), si, below)).any()


def test_it_is_a_plausible_material():
    findings = check_bsdf(composed_bsdf(waves()), quick=True)
    assert findings and not [f for f in findings if f.verdict == "fail"], "\n".join(map(str, findings))


@pytest.mark.parametrize("method", thinned(["path", "vcm"], ["path"]))
def test_a_constant_is_a_diffuse_material(method):
    """In a Cornell box, by a method of each kind."""

    def pictures(white):
        description = bundled_scene("cornell-box").build()
        description["white"] = white
        scene = mi.load_dict(description)
        return np.array(
            [etendue.render(scene, method, spp=16, size=(24, 24), seed=n, max_depth=4).image for n in range(6)],
            dtype=float,
        )

    mine = pictures({"type": "twosided", "bsdf": composed_bsdf(WHITE)})
    theirs = pictures({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.6, 0.6]}})
    assert_agree(mine, theirs, method)


def test_a_function_that_turns_with_the_surface():
    """A brushed plate, turned about its normal, throws light on a wall: the connections from the wall to the plate must
    see the direction of the brush."""
    brushed = Integrand(lambda x: 0.01 / (0.01 + (x[2] + x[5]) * (x[2] + x[5])), BOX, on="device")
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera((0.0, 0.7, 1.5), (0.0, 0.7, -0.8), 40.0)}
    scene["light"] = scenes.lamp([0.4, 0.15, 0.2], 0.1, 100.0)  # too low to reach what the camera sees
    place = scenes.transform().rotate([1, 0, 0], -90).rotate([0, 0, 1], 60)
    scene["plate"] = {"type": "rectangle", "to_world": place, "bsdf": composed_bsdf(brushed)}
    wall = scenes.transform().translate([0.0, 1.0, -0.8])
    scene["wall"] = {"type": "rectangle", "to_world": wall, "bsdf": scenes.diffuse(0.7, 0.7, 0.7)}
    problem = scenes.load(scene)
    mine = run(problem, "bpt", passes=8, samples=128, next_events=0).images
    # Light tracing stores no vertex.
    assert_agree(mine, run(problem, "light", passes=8, samples=256).images)


@pytest.mark.parametrize(
    "f",
    [
        constant(1.0, 7),
        Integrand(lambda x: [x[0], x[1]], BOX, on="device", values=2),
        Integrand(lambda x: np.exp(x[0]), BOX),
    ],
)
def test_functions_that_are_no_materials(f):
    with pytest.raises(OptionError, match="a material is a function of 8 parameters"):
        composed_bsdf(f)
