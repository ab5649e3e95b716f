"""The bundled scenes: sound geometry, and pictures from every method."""

from itertools import product

import mitsuba as mi
import numpy as np
import pytest
from support.tables import FAST_SCENES, RGB_SCENES, crossed, thinned

from etendue import methods
from etendue.core import Replica, UnsupportedError
from etendue.scene import load
from etendue.scene.meshes import brilliant, height_field, lathe, smooth

SCENES = RGB_SCENES


def closed(points, faces):
    """Whether every edge is used once in each direction, vertices at the same place being one."""
    _, place = np.unique(np.round(points, 6), axis=0, return_inverse=True)
    corner = place.reshape(-1)[faces]
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    counted = {(int(a), int(b)) for a, b in edges}
    return len(counted) == len(edges) and all((b, a) in counted for a, b in counted)


def volume(points, faces):
    """Enclosed volume, positive if the faces look out."""
    a, b, c = (points[faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def facing(points, faces, normals):
    """Smallest cosine between a face's normal and its vertices' normals."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    geometric = np.cross(b - a, c - a)
    length = np.linalg.norm(geometric, axis=1, keepdims=True)
    assert length.min() > 0.0
    return float(np.einsum("fi,fvi->fv", geometric / length, normals[faces]).min())


def test_turned_solids():
    t = np.linspace(-np.pi / 2, np.pi / 2, 60)
    points, faces, normals = lathe(np.stack([np.cos(t).clip(0), np.sin(t)], -1), 96, closed=False)
    assert closed(points, faces)
    assert volume(points, faces) == pytest.approx(4 / 3 * np.pi, rel=5e-3)
    assert facing(points, faces, normals) > 0.99
    square = smooth(np.array([[1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0]]), 8, closed=True)
    points, faces, normals = lathe(square, 96, closed=True)
    assert closed(points, faces)
    assert 6.0 < volume(points, faces) < np.pi * 3  # the square ring less its rounded corners
    assert facing(points, faces, normals) > 0.9


def test_cut_stone():
    points, faces = brilliant(1.0, 0.4, 0.8, 9)
    assert closed(points, faces)
    assert 1.0 < volume(points, faces) < np.pi * 1.2


def test_height_field():
    def height(x, z):
        return 0.1 * np.sin(3 * x) * np.cos(2 * z)

    points, faces, normals = height_field(height, (-1, 1), (0, 2), (20, 30))
    np.testing.assert_allclose(points[:, 1], height(points[:, 0], points[:, 2]))
    assert facing(points, faces, normals) > 0.97
    assert normals[:, 1].min() > 0.9


def mesh_arrays(shape):
    params = mi.traverse(shape)
    points = np.array(params["vertex_positions"]).reshape(-1, 3)
    return points, np.array(params["faces"]).reshape(-1, 3).astype(np.int64)


def test_the_glass_of_the_caustics_scene_is_closed():
    scene = load("caustics").scene
    shapes = {s.id(): s for s in scene.shapes()}
    triangles = sum(s.primitive_count() for s in scene.shapes() if s.is_mesh())
    assert triangles < 100_000
    for name in ("vase", "stone", "ring", "socket"):
        points, faces = mesh_arrays(shapes[name])
        assert closed(points, faces), name
        assert volume(points - points.mean(0), faces) > 0, name
    for name in ("vase", "stone", "ring", "ball", "copper-ball"):  # nothing stands in another thing or in the floor
        box = shapes[name].bbox()
        assert 0.0 < box.min.y < 0.01, name
    solids = ("vase", "stone", "ball", "copper-ball")
    for i, first in enumerate(solids):
        for second in solids[i + 1 :]:
            assert not shapes[first].bbox().overlaps(shapes[second].bbox()), (first, second)


def test_the_caustics_scene_is_closed_to_the_outside():
    """No ray from inside the room escapes: the walls, the floor and the basin fit together."""
    problem = load("caustics")
    n = 100_000
    random = np.random.default_rng(1)
    directions = random.normal(size=(3, n))
    directions /= np.linalg.norm(directions, axis=0)
    for origin in ([-1.3, 1.0, 1.6], [-1.3, -0.3, 1.6], [2.0, 3.0, 4.0]):
        ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(directions.astype(np.float32)))
        assert np.array(problem.scene.ray_test(ray)).all()


def test_the_room_behind_the_door_is_closed_and_lit_indirectly():
    problem = load("ajar", size=(32, 24))
    random = np.random.default_rng(2)
    directions = random.normal(size=(3, 100_000))
    directions /= np.linalg.norm(directions, axis=0)
    for origin in ([-1.5, 1.5, 4.0], [1.5, 2.0, -1.5]):
        ray = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(directions.astype(np.float32)))
        assert np.array(problem.scene.ray_test(ray)).all()

    def brightness(depth):
        cls = methods.get("path")
        runner = cls(cls.Settings(max_depth=depth, samples_per_pass=64))
        runner.prepare(problem, 1)
        return Replica(runner, 1).step(0).mean().mean()

    assert brightness(2) == 0.0
    assert brightness(3) < 0.3 * brightness(12)


@pytest.mark.parametrize("name", thinned(SCENES, FAST_SCENES))
def test_building_again_gives_the_same_scene(name):
    assert load(name).fingerprint == load(name).fingerprint


#: Scenes of the theses with every fourth method, each scene with others.
THESES = list(product([name for name in SCENES if name not in FAST_SCENES], methods.table()))[::4]


def has_chains(method):
    return "bootstrap" in {setting for setting, *_ in methods.get(method).Settings.describe()}


#: Where few of many paths find light, or scenes are large: the bootstrap of chains takes up to half a minute.
SLOW_STARTS = {"gaps", "flat", "six-cubes"}
MEDIA = ("fog", "aquarium", "smoke")
ROWS = [
    pytest.param(*row.values, marks=pytest.mark.slow) if has_chains(row.values[1]) else row
    for row in crossed(FAST_SCENES, methods.table(), 18, 2)
    if row.values[0] not in SLOW_STARTS or not has_chains(row.values[1])
]


@pytest.mark.parametrize(("name", "method"), ROWS + thinned(THESES, ()))
def test_every_method_renders_it(name, method):
    problem = load(name, size=(24, 18))
    cls = methods.get(method)
    fewer = {"bootstrap": 1 << 13} if has_chains(method) else {}
    runner = cls(cls.Settings.from_mapping({"max_depth": 6, "samples_per_pass": 8} | fewer))
    if name in MEDIA and cls.media != "scattering":
        with pytest.raises(UnsupportedError, match="scatters light"):
            runner.prepare(problem, 1)
        return
    runner.prepare(problem, 1)
    replica = Replica(runner, 1)
    measurement = replica.step(0)
    assert measurement.counters["nonfinite"] == 0
    picture = replica.develop(measurement).image
    assert picture.shape == (18, 24, 3)
    assert np.isfinite(picture).all()
    if name != "gaps":  # two gaps, in which few of so few paths find the lamp
        assert picture.mean() > 1e-3
