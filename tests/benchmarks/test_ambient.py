"""The experiments on ambient terms: their scenes, every command, tiny."""

from __future__ import annotations

import importlib
import re

import numpy as np
import pytest
from support.experiments import is_number, tables_of

from etendue.radiosity import Patches, RayScene, box, diagnose, sub_scenes

SIZES = {"bleed-box": 1062, "curved": 1988, "curved-colour": 1988, "three-lamps": 2154}


@pytest.mark.slow
def test_scenes_are_closed_and_as_large_as_stated():
    scenes = importlib.import_module("benchmarks.radiosity.ambient_scenes")
    assert set(scenes.AMBIENT_SCENES) == {"interior", *SIZES}
    for name, size in SIZES.items():
        patches = scenes.AMBIENT_SCENES[name](1.0).patches
        assert (len(patches), patches.channels) == (size, 3)
        assert re.search(rf"^{name} .* {size} 3$", scenes.__doc__, re.MULTILINE)
        assert str(diagnose(patches)).startswith("closed")
        lamp = patches.emission.any(axis=1)
        assert lamp.any() and (patches.normals[lamp] @ [0, 0, -1] > 0.999).all()


def test_booths_are_sub_scenes():
    shown = importlib.import_module("benchmarks.radiosity.ambient_scenes").AMBIENT_SCENES["three-lamps"](1.0)
    scene = sub_scenes(shown.patches, shown.parts)
    assert len(scene.parts) == 3
    lit = [shown.patches.emission[part.patches].max() for part in scene.parts]
    assert lit == [200.0, 50.0, 12.0]
    assert (scene.parts[0].high[0] < scene.parts[1].low[0]) and (scene.parts[1].high[0] < scene.parts[2].low[0])


@pytest.mark.slow
def test_ambient(tmp_path, monkeypatch):
    words = ["ambient", "--scene", "three-lamps", "--detail", "0.3", "--bundles", "16", "--rounds", "1"]
    module = importlib.import_module("benchmarks.radiosity.ambient")
    monkeypatch.setattr(module, "_RAYS", 1 << 12)
    monkeypatch.setattr(module, "DETAILS", (0.5,))
    words += ["--out", str(tmp_path), "--size", "12x10"]
    errors, speed = tables_of("radiosity", words, tmp_path, monkeypatch)
    assert [row[2] for row in errors.rows] == ["classic", "crisp", "fuzzy", "fuzzy, sub-scenes"]
    assert float(errors.rows[3][3]) < float(errors.rows[2][3])
    assert all(is_number(cell) for cell in speed.rows[0])
    assert (tmp_path / "ambient-three-lamps.png").is_file()


@pytest.mark.slow
def test_finishing(tmp_path, monkeypatch):
    words = ["finishing", "--scene", "nine-cubes", "--bundles", "64", "--seeds", "2"]
    monkeypatch.setattr(importlib.import_module("benchmarks.radiosity.ambient"), "_RAYS", 1 << 12)
    (table,) = tables_of("radiosity", words, tmp_path, monkeypatch)
    rows = {(row[0], row[1]): row for row in table.rows}
    assert float(rows["jacobi", "1 iteration"][-1]) > 2
    assert float(rows["southwell", "1 iteration"][-1]) > 2
    assert all(is_number(cell) for row in table.rows for cell in row[2:])


@pytest.mark.slow
def test_pictures(tmp_path, monkeypatch):
    words = ["ambient", "--scenes", "cornell-box", "--pixels", "256", "--time", "0.2", "--seeds", "1"]
    words += ["--reference-time", "1", "--out", str(tmp_path), "--albedo-samples", "4"]
    (table,) = tables_of("", words, tmp_path, monkeypatch)
    assert [row[0] for row in table.rows][:3] == ["path", "direct light", "direct light, constant ambient"]
    assert all(is_number(cell) for row in table.rows for cell in row[1:])


def test_the_best_constant():
    """A picture that lacks just a colour times the albedo."""
    fit = importlib.import_module("benchmarks.ambient").fit
    rng = np.random.default_rng(0)
    image, albedo = rng.random((2, 6, 5, 3)).astype(np.float32)
    colour = np.array([0.1, 0.2, 0.3], np.float32)
    reference = image + colour * albedo
    reference[0, 0] = np.nan
    np.testing.assert_allclose(fit(image, albedo, reference), colour, rtol=1e-5)


def test_hemicube():
    """Form factors of its pixels sum to 1; that of the opposite wall of a cube from the centre of another is known."""
    hemicube = importlib.import_module("benchmarks.radiosity.hemicube")
    rays, delta = hemicube.hemicube_rays(64)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, rtol=1e-12)
    assert len(rays) == 3 * 64 * 64
    np.testing.assert_allclose(delta.sum(), 1.0, rtol=1e-3)
    matrix = hemicube.hemicube_form_factors(RayScene(Patches(*box((0, 0, 0), (1, 1, 1), 1, inward=True))), 64)
    # From the centre, at distance 1, a quarter of the opposite wall is a square of 1/2 x 1/2.
    quarter = 0.5 / np.sqrt(1.25) * np.arctan(0.5 / np.sqrt(1.25)) / np.pi
    np.testing.assert_allclose(matrix[4, 5], 4 * quarter, rtol=5e-3)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-3)
    assert np.abs(np.diag(matrix)).max() == 0
