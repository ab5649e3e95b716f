"""What the 3-D view draws: boxes hold their members, powers sum to that of the lights, solutions are those of jobs."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from etendue import methods
from etendue.core import OptionError, prepared, use_variant
from etendue.density import HashGrid, KdTree
from etendue.radiosity import find_objects, save_solution, scene_patches
from etendue.scene import LightTable, load
from etendue.transport import Edge, Event
from etendue.viewer.figures import meshes, packing, paths, solution, trees


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    use_variant()
    return np.random.default_rng(2).normal(size=(1000, 3)).astype(np.float32) * [3, 1, 1]


def test_boxes_of_a_kd_tree_hold_their_points(points: np.ndarray) -> None:
    tree = KdTree(mi.Point3f(*points.astype(np.float32).T.copy()))
    level, lower, upper = tree.boxes()
    order = np.array(tree.order)
    assert level[0] == 0 and np.allclose(lower[0], points.min(axis=0)) and np.allclose(upper[0], points.max(axis=0))
    for depth in range(int(level.max()) + 1):
        low, high = lower[level == depth], upper[level == depth]
        assert len(low) == -(-len(order) * (1 << depth) // (16 << int(level.max())))  # the last may be empty
        inside = ((points[:, None] >= low - 1e-5) & (points[:, None] <= high + 1e-5)).all(axis=2)
        assert inside.any(axis=1).all()  # every point is in a box of every level
    leaves = level == level.max()
    for k, (low, high) in enumerate(zip(lower[leaves], upper[leaves], strict=True)):
        own = points[order[16 * k : 16 * k + 16]]
        np.testing.assert_allclose([own.min(axis=0), own.max(axis=0)], [low, high], rtol=1e-6)


def test_cells_of_a_hash_grid_hold_their_points(points: np.ndarray) -> None:
    there = mi.Point3f(*points.astype(np.float32).T.copy())
    grid = HashGrid(there, 0.2, points.min(axis=0).tolist(), points.max(axis=0).tolist())
    lower, upper, counts = grid.occupied(there)
    assert counts.sum() == len(points)
    np.testing.assert_allclose(upper - lower, 0.4, rtol=1e-5)
    inside = ((points[:, None] >= lower - 1e-5) & (points[:, None] <= upper + 1e-5)).all(axis=2)
    assert inside.any(axis=1).all()
    np.testing.assert_allclose(inside.sum(axis=0), counts, atol=1)  # a point on a face is in two


def test_spheres_and_boxes_hold_the_objects_of_a_scene() -> None:
    problem = load("cornell-box", size=(8, 8))
    patches = scene_patches(problem)
    objects = find_objects(patches, "shapes")
    found = trees.spheres(problem)
    assert found["level"].min() == 0 and len(found["radii"]) == 2 * objects.count
    corners = patches.vertices[patches.faces].reshape(-1, 3)
    assert np.linalg.norm(corners - found["centres"][0], axis=1).max() <= found["radii"][0] * (1 + 1e-5)
    boxes = trees.multipath_boxes(problem)
    low, high = boxes["corners"][0].min(axis=0), boxes["corners"][0].max(axis=0)
    assert ((corners >= low - 1e-4) & (corners <= high + 1e-4)).all()
    for box in boxes["corners"][1:]:
        assert ((box >= low - 1e-4) & (box <= high + 1e-4)).all()


def test_photons_have_the_power_of_the_lights() -> None:
    """In a closed room every path leaves a photon of its first edge, unless it goes through glass."""
    problem = load("cornell-box", size=(8, 8))
    rays = methods.LightRays(problem).trace(None, 3000)
    rays = rays[rays.number == 1]
    found = paths.hits(rays, 3000)
    closed = rays.event != Event.LEFT
    assert len(found["points"]) == closed.sum() > 1000 and (found["number"] == 1).all()
    np.testing.assert_allclose(found["power"].sum(axis=0), rays.value[closed].sum(axis=0) / 3000, rtol=1e-4)
    assert found["power"].sum() / 3 < 1.05 * LightTable(problem.scene).total_power


def test_lines_are_the_edges_of_the_paths() -> None:
    settings = methods.Path.Settings(max_depth=4, samples_per_pass=1)
    method = prepared(methods.Path(settings), load("cornell-glass", size=(16, 16)), 0)
    rays = methods.rays_through(method, 8.0, 8.0, 50)
    assert rays is not None
    found = paths.lines(rays)
    np.testing.assert_array_equal(found["edges"], np.stack([rays.start, rays.end], axis=1))
    assert (found["kind"] == Edge.CAMERA).sum() >= 50 and (found["kind"] == Edge.NEXT_EVENT).sum() > 10
    assert np.isfinite(found["edges"]).all() and (found["value"] >= 0).all() and found["number"].max() <= 4


def test_of_many_edges_of_a_kind_some_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    rays = methods.LightRays(load("cornell-box", size=(8, 8))).trace(None, 100)
    monkeypatch.setattr(paths, "_MOST", 30)
    found = paths.lines(rays)
    assert 15 < len(found["edges"]) <= 30 < len(rays)


def test_the_mesh_of_a_scene_has_the_area_of_its_shapes() -> None:
    problem = load("cornell-glass", size=(8, 8))
    mesh = meshes.scene_mesh(problem)
    sides = mesh.triangles[:, 1:] - mesh.triangles[:, :1]
    areas = np.bincount(mesh.shape, 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    for name, area, shape in zip(mesh.names, areas, problem.scene.shapes(), strict=True):
        expected = float(np.array(shape.surface_area()).ravel()[0])
        assert area == pytest.approx(expected, rel=0.02 if shape.shape_type() == mi.ShapeType.Sphere else 1e-4), name
    assert not mesh.missing and not mesh.left_out
    payload, table = packing.joined({"a": np.arange(3, dtype=np.uint8), "b": mesh.triangles})
    assert table[1] == {"name": "b", "type": "float32", "shape": list(mesh.triangles.shape), "offset": 8}
    np.testing.assert_array_equal(np.frombuffer(payload, "<f4", offset=8).reshape(mesh.triangles.shape), mesh.triangles)


@pytest.mark.slow
def test_a_live_solution_converges_to_that_of_a_furnace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A closed cube whose walls reflect rho and emit e: every radiosity is e / (1 - rho)."""
    rho, radiance = 0.5, 1.0
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
        "cube": {
            "type": "cube",
            "flip_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": rho}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
        },
    }
    live = solution.LiveSolution(load(scene), max_area=0.3)
    while not live.step(0.05):
        pass
    found = live.values()
    np.testing.assert_allclose(found["radiosity"], np.pi * radiance / (1 - rho), rtol=0.02)
    assert found["residual"].max() < 1e-3 and (found["error"] >= 0).all()
    mesh = live.mesh()
    sides = mesh["triangles"][:, 1:] - mesh["triangles"][:, :1]
    areas = np.bincount(mesh["front"], 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    np.testing.assert_allclose(areas, mesh["areas"], rtol=1e-4)
    for error in (live.error, None):  # a saved one is shown as it was
        save_solution(tmp_path / "kept.npz", live.solution, irradiance_error=error)
        kept = solution.SavedSolution(live._problem, tmp_path / "kept.npz")
        values = kept.values()
        np.testing.assert_allclose(values["radiosity"], found["radiosity"], rtol=1e-6)
        np.testing.assert_allclose(values["error"], found["error"] if error is not None else 0.0, rtol=1e-6)
        assert kept.is_done and not kept.step() and (kept.error is None) == (error is None)
        assert kept.names()[0] == live.names()[0] and (kept.names()[1] == live.names()[1]).all()
        np.testing.assert_allclose(kept.mesh()["areas"], mesh["areas"], rtol=1e-6)
    bundles = live.bundles
    while not live.step(0.05):
        pass
    assert live.bundles > bundles
    # It ends with the solution on as many lines as are kept.
    assert not live.is_done
    monkeypatch.setattr(solution, "MOST_SEGMENTS", 1)
    live.step(0.0)
    bundles = live.bundles
    assert live.is_done and not live.step(0.05) and live.bundles == bundles
    live.close()
    with pytest.raises(OptionError, match="area"):
        solution.LiveSolution(load(scene), max_area=1e-6)
