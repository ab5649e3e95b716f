"""Curves: every method on those that reflect light; hair, which light crosses one way only, by camera paths."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, prepared, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue import methods
from etendue.core import UnsupportedError
from etendue.scene import load

KINDS = ("bsplinecurve", "linearcurve")


@pytest.fixture(scope="module")
def strands(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A file of 60 bent strands that become thinner."""
    rng, height = np.random.default_rng(3), np.linspace(0.0, 1.0, 6)[:, None]
    text = ""
    for root in rng.uniform(-0.7, 0.7, (60, 2)):
        bend = rng.uniform(-0.3, 0.3, 2)
        points = np.column_stack([root[0] + bend[0] * height**2, height, root[1] + bend[1] * height**2])
        text += "\n".join(" ".join(f"{v:.5f}" for v in row) for row in np.hstack([points, 0.05 - 0.03 * height]))
        text += "\n\n"
    file = tmp_path_factory.mktemp("curves") / "strands.txt"
    file.write_text(text)
    return str(file)


def described(strands: str, kind: str, bsdf: Any) -> dict[str, Any]:
    """Strands on a floor, below a lamp and a dim sky."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera((0.0, 1.6, 3.4), (0.0, 0.45, 0.0), 40.0)}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 1.5, True)
    scene["strands"] = {"type": kind, "filename": strands, "bsdf": bsdf}
    scene["lamp"] = scenes.lamp((0.3, 2.2, 0.4), 0.4, 9.0)
    scene["sky"] = {"type": "constant", "radiance": scenes.rgb(0.1, 0.1, 0.1)}
    return scene


@pytest.mark.parametrize(
    ("kind", "name"), thinned([(kind, name) for kind in KINDS for name in ("path", "bpt", "mmlt")], [(KINDS[0], "bpt")])
)
def test_strands_that_reflect(kind, name, strands):
    problem = load(described(strands, kind, scenes.diffuse(0.7, 0.4, 0.2)))
    expected = mitsuba_images(problem, mi.load_dict({"type": "path"}), 6, 256, seed=1000)
    images = replicas(problem, name, passes=1) if name == "mmlt" else run(problem, name).images
    assert_agree(images, expected, (kind, name), precision=0.03)


HAIR, GLASS = {"type": "hair", "eumelanin": 0.3}, {"type": "roughdielectric", "alpha": 0.2}


@pytest.mark.parametrize("bsdf", [HAIR, pytest.param(GLASS, marks=pytest.mark.slow)], ids=["hair", "glass"])
@pytest.mark.parametrize("name", thinned(("path", "guided", "vegas", "auto"), ("path",)))
def test_light_through_strands(name, bsdf, strands):
    problem = load(described(strands, "bsplinecurve", bsdf))
    expected = mitsuba_images(problem, mi.load_dict({"type": "path"}), 6, 256, seed=1000)
    assert_agree(run(problem, name).images, expected, name, precision=0.03)


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        (methods.get("vegas"), {"maps": 1}),
        (methods.get("auto"), {"choice": "vcm"}),
        (methods.ParticleTracing, {}),
        (methods.MetropolisParticles, {}),
    ],
)
def test_nothing_traces_light_paths_through_hair(method, settings, strands):
    with pytest.raises(UnsupportedError, match="'strands' of type 'bsplinecurve' lets light through one way only"):
        method(method.Settings.from_mapping(settings)).prepare(load(described(strands, "bsplinecurve", HAIR)), 1)


def test_methods_with_light_paths_refuse_hair(strands):
    problem = load(described(strands, "bsplinecurve", HAIR))
    with pytest.raises(
        UnsupportedError, match=r"'strands' of type 'bsplinecurve' lets light through one way only.*'vcm'"
    ):
        prepared(problem, "vcm")


@pytest.mark.parametrize("tip", [0.2, 0.0])
def test_the_end_of_a_curve_can_be_hit(tip, tmp_path):
    """Mitsuba 3.9.1 reads the segment behind the last one there, which is beyond its memory."""
    file = tmp_path / "strand.txt"
    file.write_text("".join(f"0 {y} 0 {0.2 if y < 5 else tip}\n" for y in range(6)))
    scene = described(str(file), "bsplinecurve", scenes.diffuse(0.5, 0.5, 0.5))
    problem = load(scene)
    again = load(problem.scene)
    for made in (problem, again):
        parameters = mi.traverse(made.scene)
        assert len(parameters["strands.segment_indices"]) == 4
    assert etendue.render(scene, "path", spp=1, size=(8, 6)).image.any()
    rays = mi.Ray3f(mi.Point3f(3.0, 4.0 + mi.Float(np.linspace(-1e-5, 1e-5, 2048)), 0.0), mi.Vector3f(-1.0, 0.0, 0.0))
    hits = problem.scene.ray_intersect(rays)
    frames = np.asarray(hits.sh_frame.s)[:, np.asarray(hits.is_valid())]
    assert frames.shape[1] > 100 and np.isfinite(frames).all()
