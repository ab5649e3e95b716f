"""The examples of the framework, small: each agrees with the method path, or with what is known in closed form."""

from __future__ import annotations

import ast
import csv
import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from support import scenes
from support.statistics import assert_agree

import etendue
from etendue.methods import registry

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)  # where its dataclasses look for it
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested_and_described():
    """By a test here, and in the page of the manual that walks through them."""
    page = (EXAMPLES.parent / "docs" / "framework.md").read_text("utf-8")
    for name in NAMES:
        assert f"examples/{name}.py" in page
        assert f'example("{name}")' in Path(__file__).read_text("utf-8")


def test_composed_brdf():
    found = example("composed_brdf").run(size=24, samples=64, passes=8)
    # The cosine-weighted mean of a lobe at normal incidence is k_s, whatever its exponent.
    assert found["albedo_error"] < 0.01
    assert_agree(found["composed"], found["rendered"].astype(float), "composed BRDF")


def test_composed_brdf_is_reciprocal():
    f = example("composed_brdf").brdf()
    v = np.random.default_rng(0).normal(size=(2, 3, 1000))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    uv = np.random.default_rng(1).random((2, 1000))
    there, back = (np.array(f.evaluate([*uv, *v[a], *v[b]])) for a, b in ((0, 1), (1, 0)))
    assert there == pytest.approx(back, abs=1e-9) and there.min() >= 0


@pytest.mark.parametrize("reach", [0.0, 0.4])
def test_occlusion(reach, monkeypatch):
    """Of a white floor under a white sky it is the picture by path, two edges long; a plate half a unit above hides a
    part of the sky, but nothing within a smaller reach."""
    monkeypatch.setattr(registry, "_methods", dict(registry._methods))
    module, turn = example("occlusion"), scenes.transform()
    white = scenes.diffuse(1.0, 1.0, 1.0)
    floor = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 0.4, 1.2), (0.5, 0.0, 0.0), 15.0, size=(12, 12)),
        "sky": {"type": "constant", "radiance": scenes.rgb(1.0, 1.0, 1.0)},
        "ground": {"type": "rectangle", "to_world": turn.rotate([1, 0, 0], -90).scale(5), "bsdf": white},
    }
    place = turn.translate([0.5, 0.5, 0.0]).rotate([1, 0, 0], 90).scale(0.5)
    plated = floor | {"plate": {"type": "rectangle", "to_world": place, "bsdf": white}}
    options, by_path, found = {"size": (12, 12), "spp": 64}, [], []
    for seed in range(6):
        found.append(module.run(plated, seed=seed, reach=reach, **options))
        seen = plated if reach == 0.0 else floor
        by_path.append(etendue.render(seen, "path", seed=50 + seed, max_depth=2, **options).image)
    assert_agree(np.stack(found).astype(float), np.stack(by_path).astype(float), reach)
    assert (np.mean(found) < 0.8) == (reach == 0.0)


@pytest.mark.slow
def test_ray_tracers():
    module = example("ray_tracers")
    found = module.run(size=24, samples=80, learning=100_000)
    for name in ("recursive", "expanded", "vegas"):
        assert_agree(found[name], found["path"].astype(float), name)
    uniform, learned = found["estimates"]
    assert abs(uniform.value - learned.value) < 4.5 * math.hypot(uniform.standard_error, learned.standard_error)
    # Of five lights four are weak: 3.3 times less variance was measured with what VEGAS learns from a million paths.
    assert 2 * module.noise(found["vegas"]) < module.noise(found["expanded"])


@pytest.mark.slow
def test_photon_tracer():
    found = example("photon_tracer").run(size=24, photons=1 << 16, squares=8, samples=256)
    assert_agree(found["photons"][..., None], found["path"][..., None], "irradiance of the floor", block=1)
    # The picture is a little blurred, and no more than that.
    assert found["mapped"].mean() == pytest.approx(found["picture"].mean(), rel=0.03)


@pytest.mark.slow
def test_irradiance_cache():
    module = example("irradiance_cache")
    found = module.run(size=48, samples=64)
    figures = module.summary(found)
    assert figures["error"] < 0.08 and abs(figures["bias"]) < 0.03
    assert figures["error"] < 0.8 * figures["without"]
    assert figures["paths"] > figures["rays"]  # 29 times as many at the size of the example


def test_radiosity():
    module = example("radiosity")
    found = module.run(size=48, divisions=(3, 6), samples=64)
    for sums in found["sums"]:  # in a closed room all that leaves a patch arrives somewhere
        assert sums == pytest.approx(np.ones(len(sums)), abs=0.02)
    coarse, fine = (module.difference(picture, found["path"]) for picture in found["pictures"])
    assert fine < 0.75 * coarse and fine < 0.2  # most of it is that patches are flat
    dark = found["path"].max(axis=2) < 0.1 * module.LAMP / math.pi
    assert found["pictures"][1][dark].mean() == pytest.approx(found["path"][dark].mean(), rel=0.05)


@pytest.mark.parametrize(
    ("by", "tolerance"),
    [
        ("quasimontecarlo", 0.002),
        ("stratified", 0.004),
        ("meansample", 0.025),
        ("vegas", 0.003),
        ("recursivestratified", 0.006),
    ],
)
def test_form_factors_by_any_integrator(by, tolerance):
    """Of the walls of an empty cube of side 1: 0.19982 to the opposite one, 0.20004 to each neighbour."""
    import mitsuba as mi

    module = example("radiosity")
    walls = module.walls()[:6]
    cube = {"corner": 0, "a": 1, "b": 2}
    patches = {name: np.array([wall[k] for wall in walls], dtype=float) for name, k in cube.items()}
    patches |= {"normal": np.cross(patches["a"], patches["b"]), "area": np.ones(6)}
    scene = mi.load_dict({"type": "scene", "far": {"type": "sphere", "center": [9, 9, 9], "radius": 0.1}})
    factors = module.form_factors(module.exchange(patches, scene), patches["area"], module.INTEGRATORS[by], 20_000)
    expected = np.full((6, 6), 0.200044)
    for i, j in ((0, 1), (2, 3), (4, 5)):
        expected[i, j] = expected[j, i] = 0.199825
    np.fill_diagonal(expected, 0)
    # Five times the errors that were measured, which are largest between neighbours.
    assert factors == pytest.approx(expected, rel=tolerance) and factors == pytest.approx(factors.T)


@pytest.mark.slow
def test_luminaires():
    """The gradient of the loss is that of finite differences, and fewer watts light the same desks."""
    module = example("luminaires")
    lighting = module.Lighting(16, (24, 48), seed=3)
    x = np.tile([0.8, 0.2, -0.1], 8) * np.linspace(0.9, 1.1, 24)
    along = np.random.default_rng(1).normal(size=24)
    by_difference = (lighting.loss(x + 1e-4 * along)[0] - lighting.loss(x - 1e-4 * along)[0]) / 2e-4
    assert lighting.loss(x)[1] @ along == pytest.approx(by_difference, rel=1e-5)
    found = module.run(bundles=32, size=(60, 120), iterations=60)
    assert found["least"] == pytest.approx([500, 500], rel=1e-6)
    assert found["watts"][1] < 0.85 * found["watts"][0]


@pytest.mark.slow
def test_office(tmp_path):
    """Its files are written, and bpt, by which it measures, agrees with path on the direct light. (Of all light, path
    rarely finds that of the bodies of the lamps, close to their points, and its error is too small.)"""
    module = example("office")
    module.main(str(tmp_path), "1")
    assert (tmp_path / "office.jpg").stat().st_size > 10_000
    rows = list(csv.DictReader((tmp_path / "desks.csv").open()))
    points = [[float(row[axis]) for axis in "xyz"] for row in rows[50::400]]
    scene = module.office(tmp_path / "lamp.ies")
    one, other = (etendue.measure(scene, points, method=name, spp=2048, max_depth=2) for name in ("bpt", "path"))
    error = np.hypot(one.photometric_error, other.photometric_error)
    assert (np.abs(one.photometric - other.photometric) < 5 * error + 1e-4 * other.photometric).all()


def test_reflectances():
    """From 0.6 each to what the measurements were made with, within three times the deviations of four seeds; what is
    left is the noise of 1 K, by 174 patches known to 5 %, and that of the lines."""
    module = example("reflectances")
    found = module.run(bundles=128)
    assert found["emissivities"] == pytest.approx(module.EMISSIVITIES, abs=0.025)
    assert found["differences"][0] > 20 and found["differences"][1] < 1.3


NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))
#: What makes the notebooks small.
SMALL = {
    "seconds, size = 10, (160, 120)": "seconds, size = 1, (40, 30)",
    "cells, bundles = 6, 1024": "cells, bundles = 3, 256",
    "paths, bundles, iterations = 4096, 128, 300": "paths, bundles, iterations = 256, 16, 3",
    "samples, size = 1 << 14, 48": "samples, size = 1 << 12, 16",
}


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks(notebook, tmp_path, monkeypatch, variant):
    """All cells run, in their order, and what ends a cell has a display."""
    made = json.loads(notebook.read_text("utf-8"))
    cells = ["".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == "code"]
    assert cells and all(not cell.get("outputs") for cell in made["cells"])
    text = "\n".join(cells)
    assert sum(text.count(known) for known in SMALL) == 1
    (tmp_path / "examples").symlink_to(EXAMPLES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    names: dict[str, object] = {"__name__": "__main__"}
    for cell in cells:
        for known, small in SMALL.items():
            cell = cell.replace(known, small)
        *_, last = ast.parse(cell).body
        exec(compile(cell, notebook.name, "exec"), names)
        if isinstance(last, ast.Expr) and isinstance(last.value, ast.Name):
            assert names[last.value.id]._repr_html_()


def test_every_door_has_a_notebook():
    assert [path.stem for path in NOTEBOOKS] == sorted(("rendering", "heat", "lighting", "research"))
