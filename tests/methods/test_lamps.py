"""Lamps whose points are not drawn uniformly: every method against paths that know lamps by hits alone, or Mitsuba."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_path, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "path": ("path", {}),
    "path power": ("path", {"heuristic": "power"}),
    "bpt": ("bpt", {}),
    "bpt power": ("bpt", {"light_source": "path", "heuristic": "power", "next_events": 2}),
    "light": ("light", {"light_paths": 4.0}),
    "guided": ("guided", {"cell_samples": 500}),
    "pm": ("pm", {}),
    "vcm": ("vcm", {}),
}

LAMPS = (
    *("rectangle", "focused", "cylinder", "sphere", "cube", "attribute"),
    *("ball", "ball veiled", "bent", "bent focused", "spot"),
)


def _texture() -> dict[str, Any]:
    """One bright corner, one dim one, the rest nearly black."""
    pixels = np.full((4, 4, 3), 0.1)
    pixels[0, 3], pixels[2, 1] = [60.0, 40.0, 30.0], [5.0, 10.0, 10.0]
    return scenes.bitmap(pixels)


def lamp(name: str) -> Any:
    place = scenes.transform().translate([0.5, 1.4, -0.1]).rotate([1, 0, 0], 110).rotate([0, 1, 0], 20)
    light: dict[str, Any] = {"emitter": {"type": "area", "radiance": _texture()}}
    match name:
        case "rectangle":
            return {"type": "rectangle", "to_world": place.scale([0.5, 0.4, 1.0])} | light
        case "focused":
            light = {"emitter": {"type": "focusarea", "radiance": _texture(), "exponent": 2.0}}
            return {"type": "disk", "to_world": place.scale(0.45)} | light
        case "cylinder":
            return {"type": "cylinder", "to_world": place, "p1": [0, 0.5, 0], "radius": 0.25} | light
        case "attribute":
            corners = np.array([[0.0, 1.5, -0.5], [1.0, 1.4, -0.5], [1.0, 1.5, 0.4], [0.0, 1.6, 0.4]])
            colours = np.array([[0.1, 0.1, 0.1], [40.0, 30.0, 20.0], [0.1, 0.1, 0.1], [0.1, 0.5, 0.1]])
            emitter = {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_color"}}
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            return scenes.mesh(corners, faces, scenes.diffuse(0, 0, 0), colours=colours, emitter=emitter)
        case "bent" | "bent focused":  # normals that differ from those of the faces by up to 60 degrees
            corners = np.array([[0.0, 1.5, -0.5], [1.0, 1.4, -0.5], [1.0, 1.5, 0.4], [0.0, 1.6, 0.4]])
            normals = np.array([[-0.8, -0.5, -0.8], [1.0, -1.0, 0.0], [0.9, -0.6, 0.5], [-0.5, -1.0, 0.9]])
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            emitter = scenes._area(6, 4, 2)
            if name == "bent focused":
                emitter |= {"type": "focusarea", "exponent": 2.0}
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            return scenes.mesh(corners, faces, scenes.diffuse(0.3, 0.3, 0.3), normals=normals, emitter=emitter)
        case "spot":  # with a texture of which Mitsuba samples no spectrum
            towards = scenes.transform().look_at([0.5, 1.9, 0.3], [0.0, 0.0, 0.0], [0, 0, 1])
            return {"type": "spot", "to_world": towards, "cutoff_angle": 40.0, "texture": {"type": "checkerboard"}}
        case "ball":
            return {"type": "sphere", "to_world": place.scale(0.35), "emitter": scenes._area(3, 2, 1)}
    return {"type": name, "to_world": place.scale(0.3)} | light


def room(name: str) -> Any:
    """A floor, a wall and a shiny ball; the lamp is out of sight."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera((0.0, 1.0, 2.6), (0.1, 0.2, 0.0), 30.0)}
    scene["lamp"] = lamp(name.removesuffix(" veiled"))
    if name.endswith("veiled"):  # light crosses it unbent on its first edge
        veil = {"type": "mask", "opacity": 0.4, "nested": {"type": "twosided", "inner": scenes.diffuse(0.5, 0.3, 0.2)}}
        place = scenes.transform().translate([0.2, 0.9, 0.0]).rotate([1, 0, 0], 90).scale(0.7)
        scene["veil"] = {"type": "rectangle", "to_world": place, "bsdf": veil}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 1.5, True)
    back = scenes.transform().translate([0.0, 1.0, -0.7]).scale(1.5)
    scene["wall"] = {"type": "rectangle", "to_world": back, "bsdf": scenes.diffuse(0.4, 0.5, 0.6)}
    shiny = {"type": "roughconductor", "material": "Al", "alpha": 0.2}
    scene["ball"] = {"type": "sphere", "center": [0.1, 0.25, 0.1], "radius": 0.25, "bsdf": shiny}
    return scenes.load(scene)


@lru_cache(maxsize=1)
def _scene(name: str) -> tuple[Any, np.ndarray]:
    """A room, and its picture by hits alone."""
    problem = room(name)
    if name in ("rectangle", "spot"):
        # On other shapes Mitsuba draws points by a texture that it does not look up again.
        return problem, mitsuba_path(problem, passes=6, samples=256)
    return problem, run(problem, "path", passes=6, samples=512, seed=77, mode="naive").images


def compare(name: str, method: str) -> None:
    problem, reference = _scene(name)
    kind, settings = METHODS[method]
    if kind == "guided":
        images = replicas(problem, kind, runs=6, passes=2, samples=128, **settings)
    else:
        images = run(problem, kind, passes=6, samples=128, **settings).images
    assert_agree(images, reference, (name, method), precision=0.03)


@pytest.mark.parametrize(
    ("name", "method"),
    thinned(
        [("rectangle", "bpt"), ("sphere", "bpt power"), ("cube", "vcm"), ("attribute", "light")],
        [("sphere", "bpt power"), ("attribute", "light")],
    ),
)
def test_lamps_with_a_texture(name, method):
    compare(name, method)


@pytest.mark.parametrize(("name", "method"), [("ball", "path power"), ("ball", "vcm"), ("ball veiled", "bpt power")])
def test_spherical_lamps(name, method):
    """Next event draws their points by the point that is lit."""
    compare(name, method)


@pytest.mark.parametrize(
    ("name", "method"),
    thinned([("bent", "bpt power"), ("bent focused", "vcm"), ("bent", "light")], [("bent", "bpt power")]),
)
def test_mesh_lamps_with_vertex_normals(name, method):
    compare(name, method)


@pytest.mark.parametrize("method", thinned(["bpt", "light"], ["light"]))
def test_a_spot_light_with_a_procedural_texture(method):
    compare("spot", method)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", LAMPS)
def test_every_lamp_by_every_method(name, method):
    compare(name, method)
