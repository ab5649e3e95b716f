"""Whole scenes: bundled and public ones pass, faults are found and named, unsupported elements are findings."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support import scenes
from support.media import FLAKES
from support.tables import RGB_SCENES, thinned

import etendue


def plain(**parts):
    floor = {"type": "rectangle", "bsdf": scenes.diffuse(0.5, 0.5, 0.5)}
    light = {"type": "constant"}
    return {"type": "scene", "sensor": scenes.camera(), "light": light, "floor": floor} | parts


@pytest.mark.parametrize("name", thinned(RGB_SCENES, ("cornell-box",)))
def test_bundled_scenes_pass(name):
    report = etendue.check(name)
    assert report.ok, report.failures
    assert not report.warnings, report.warnings
    kinds = {f.component.split()[0] for f in report.findings}
    assert {"scene", "material", "emitter", "sensor"} <= kinds


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cornell-box", "cbox-spheres", "veach-bidir", "water-caustic", "soda-shoppe"])
def test_public_scenes_pass(name, scenes_dir):
    report = etendue.check(scenes_dir / name / "scene.xml")
    assert report.ok, report.failures
    assert not report.warnings, report.warnings


def test_a_fault_is_named_as_the_scene_names_it():
    pixels = np.full((4, 4, 3), 1.3, np.float32)
    wall = {"type": "diffuse", "id": "glowing", "reflectance": scenes.bitmap(pixels)}
    report = etendue.check(plain(wall={"type": "rectangle", "bsdf": wall}), quick=True)
    assert not report.ok
    found = {(f.component, f.test) for f in report.failures}
    assert ("material 'glowing' of type 'diffuse'", "energy") in found
    assert ("material 'glowing' of type 'diffuse'", "texture reflectance") in found


def test_unsupported_elements_are_findings():
    fog = {"type": "cube", "interior": FLAKES}
    report = etendue.check(plain(fog=fog), quick=True)
    (row,) = report.failures
    assert row.test == "supported"
    assert "medium" in row.meaning
    assert any(f.test == "energy" for f in report.findings)


def test_a_broken_scene_is_a_finding_and_its_materials_are_tested():
    scene = plain()
    del scene["light"]
    report = etendue.check(scene, quick=True)
    (row,) = report.failures
    assert (row.test, row.component) == ("broken", "scene")
    assert any(f.test == "energy" for f in report.findings)


def test_what_cannot_be_loaded_raises(tmp_path):
    with pytest.raises(etendue.SceneError):
        etendue.check(tmp_path / "nothing.xml")


def test_a_report_is_plain_json():
    report = etendue.check(plain(), quick=True, seed=2)
    values = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert values["ok"] is True
    assert len(values["findings"]) == len(report.findings)
    assert set(values["findings"][0]) == {"component", "test", "verdict", "figure", "limit", "meaning"}
    assert etendue.check(plain(), quick=True, seed=2).findings == report.findings
