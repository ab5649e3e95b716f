"""The scenes of the theses: sound solids, glass that encloses water, patches for radiosity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.tables import thinned

from etendue.radiosity import Patches, diagnose, scene_patches
from etendue.scene import bundled_scene
from etendue.scene.builtin import solids as parts, theses
from etendue.scene.meshes import MeshDescription

BLOCKS = {row[0]: row[-1] for row in theses._ROWS if row[2] == "Castro 2002"}


def volume(part):
    """Enclosed volume; positive if the faces look out."""
    points, faces, _ = part
    a, b, c = (points[faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def solids():
    steps = np.linspace(0.0, 1.0, 40)
    corners = [(r, 0.0) for r in steps] + [(1.0, y) for y in steps[1:]] + [(r, 1.0) for r in steps[-2::-1]]
    line = np.stack([np.zeros(20), np.linspace(0.0, 2.0, 20), np.zeros(20)], -1)
    return {
        "box": (parts.box((1.0, 2.0, 3.0)), 6.0, 1e-9),
        "round box": (parts.box((1.0, 2.0, 3.0), 0.01), 6.0, 0.01),
        "cells": (parts.box((1.0, 2.0, 3.0), 0.01, 3, 7), 6.0, 0.01),
        "cushion": (parts.cushion((1.0, 0.2, 1.0), 0.02, 0.0), 0.2, 0.02),
        "ball": (parts.ball(0.5, 128, 64), np.pi / 6.0, 0.005),
        "tube": (parts.tube(line, 0.1, 64), 0.02 * np.pi, 0.005),
        "turned": (parts.turned(corners, 96, 2), np.pi, 0.005),
        "ring": (parts.ring([(r + 1.0, y) for r, y in corners[1:-1]], 96, 2), 3.0 * np.pi, 0.1),
    }


@pytest.mark.parametrize("name", ["box", "round box", "cells", "cushion", "ball", "tube", "turned", "ring"])
def test_solids_are_closed_and_look_out(name):
    part, expected, tolerance = solids()[name]
    points, faces, normals = part
    assert volume(part) == pytest.approx(expected, rel=tolerance)
    _, same = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    corners = same.ravel()[faces]
    corners = corners[(corners != np.roll(corners, 1, 1)).all(axis=1)]  # without the triangles that have no area
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    forth, back = (set(map(tuple, pairs)) for pairs in (edges, edges[:, ::-1]))
    assert len(forth) == len(edges) and forth == back, "an edge is not shared by two faces of one sense"
    a, b, c = (points[faces[:, i]] for i in range(3))
    face = np.cross(b - a, c - a)
    smooth = normals[faces].sum(axis=1)
    solid = np.linalg.norm(face, axis=1) > 1e-9
    assert np.mean((face * smooth).sum(axis=1)[solid] > 0.0) > 0.999
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, abs=1e-6)


def test_a_solid_is_stretched_and_turned_inside_out():
    ball = parts.stretched(parts.ball(1.0, 128, 64), 1.0, 2.0, 0.5)
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=0.005) == -volume(parts.inside_out(ball))
    across = ball[2] * [1.0, 2.0, 0.5]  # the gradient of an ellipsoid is its point over the squares of its axes
    np.testing.assert_allclose(across / np.linalg.norm(across, axis=1)[:, None], ball[0] / [1.0, 2.0, 0.5], atol=1e-9)


def test_the_water_fills_the_glass():
    """Glass has one closed surface, its dry and its wet part; so has water, its top and the wet part from inside."""
    found = bundled_scene("glass-of-water").describe()
    dry, wet, top = ((found[name].points, found[name].faces) for name in ("glass", "wet", "water"))
    for pieces in ((dry, wet), (top, (wet[0], wet[1][:, ::-1]))):
        points, faces = parts.joined([(*piece, np.zeros_like(piece[0])) for piece in pieces])[:2]
        _, same = np.unique(np.round(points, 7), axis=0, return_inverse=True)
        edges = np.concatenate([same.ravel()[faces][:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        forth, back = (set(map(tuple, pairs)) for pairs in (edges, edges[:, ::-1]))
        assert len(forth) == len(edges) and forth == back
        assert volume((points, faces, points)) > 0.0


@pytest.mark.parametrize("name", thinned(BLOCKS, [*BLOCKS][::3]))
def test_scenes_of_blocks_are_radiosity_problems(name):
    """The patches of the Mitsuba scene are the triangles of those of the thesis's experiments."""
    vertices, faces, reflectance, emission, _ = BLOCKS[name]().patches()
    exact = Patches(vertices, faces, reflectance=reflectance, emission=emission)
    found = scene_patches(name)
    assert str(diagnose(found)).startswith("closed")
    assert len(exact) < len(found) <= 2 * len(exact)
    for part in ("reflectance", "emission"):
        light, same = (patches.areas @ getattr(patches, part) for patches in (found, exact))
        np.testing.assert_allclose(light, np.broadcast_to(same, 3), rtol=1e-4)
    lamp = found.emission.any(axis=1)
    assert lamp.any() and (found.normals[lamp] @ [0, 0, -1] > 0.999).all()


def test_the_manual_lists_them():
    text = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text("utf-8")
    assert [name for name, *_ in theses.SCENES if f"`{name}`" not in text] == []


@pytest.mark.parametrize("name", [name for name, *_ in theses.SCENES if name not in BLOCKS])
def test_scenes_load_fast(name):
    """No more triangles than can be built in a second."""
    meshes = [shape for shape in bundled_scene(name).describe().values() if isinstance(shape, MeshDescription)]
    assert sum(len(mesh.faces) for mesh in meshes) <= 300_000
