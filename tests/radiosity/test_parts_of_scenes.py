"""Methods with parts of whole scenes: instances of Mitsuba, boxes around groups of objects."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import room

import etendue
from etendue.core import SceneError, UnsupportedError
from etendue.radiosity import (
    ABuffer,
    Part,
    Patches,
    box,
    form_factors,
    instanced_patches,
    read_solution,
    scene_part,
    scene_patches,
)
from etendue.surfaces import scene_parts


def translated(mi, x, y, z):
    return mi.ScalarTransform4f().translate([x, y, z])


@pytest.fixture
def scene():
    """Two blocks of a group and one by itself in a room with a lamp."""
    etendue.core.use_variant()
    import mitsuba as mi

    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [5.0, 4.0, 3.0]}}
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "to_world": translated(mi, 0, 0, -2)},
        "room": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(4),
            "flip_normals": True,
            "bsdf": grey,
        },
        "lamp": {
            "type": "rectangle",
            "to_world": translated(mi, 0, 0, 3.9) @ mi.ScalarTransform4f().rotate([1, 0, 0], 180),
            "emitter": lamp,
        },
        "blocks": {
            "type": "shapegroup",
            "one": {"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.5), "bsdf": grey},
            "two": {"type": "cube", "to_world": translated(mi, 1.2, 0, 0).scale(0.4), "bsdf": grey},
        },
        "first": {"type": "instance", "blocks": {"type": "ref", "id": "blocks"}, "to_world": translated(mi, -2, 0, -2)},
        "second": {
            "type": "instance",
            "blocks": {"type": "ref", "id": "blocks"},
            "to_world": translated(mi, 1, 2, -1).rotate([0, 0, 1], 30).scale(0.8),
        },
    }


def test_instances_are_copies_of_one_part(scene):
    around, ((patches, transforms),) = scene_parts(scene, max_area=1.0)
    assert len(transforms) == 2 and around.areas.max() < 1.001 and patches.areas.max() < 1.001
    np.testing.assert_allclose(patches.bounds, [[-0.5] * 3, [1.6, 0.5, 0.5]], atol=1e-6)
    np.testing.assert_allclose(transforms[0][:3, 3], [-2, 0, -2], atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(transforms[1]), 0.8**3, rtol=1e-5)
    root = scene_part(scene, max_area=1.0)
    assert root.total == len(around) + 2 * len(patches) == len(root.joined())
    with pytest.raises(UnsupportedError):
        scene_patches(scene)
    for name in ("first", "second"):
        del scene[name]
    assert scene_part(scene) is None


def test_a_scene_with_instances_is_that_with_its_shapes(scene, tmp_path):
    """The same light as with the shapes in place of the instances, and a file of all patches."""
    chosen = {"lines": 1 << 14, "grid": 4, "sectors": 8}
    found = etendue.solve_radiosity(scene, "boxes", passes=6, max_area=0.5, save=tmp_path / "a.npz", **chosen)
    assert (found.passes, found.bundles, found.points) == (6, 0, 0) and found.is_balanced
    parts = found.parts
    missing = (parts.lost + parts.residual).sum() / parts.sent.sum()
    assert found.solution.imbalance == pytest.approx(missing, abs=1e-9)
    for name in ("first", "second"):
        to_world = scene.pop(name)["to_world"]
        for block in ("one", "two"):
            shape = scene["blocks"][block]
            scene[f"{name}-{block}"] = shape | {"to_world": to_world @ shape["to_world"]}
    del scene["blocks"]
    flat = etendue.solve_radiosity(scene, bundles=512, max_area=0.5)
    one, other = found.solution, flat.solution
    assert len(one.patches) == len(other.patches)

    def absorbed(solution):
        return (solution.patches.areas[:, None] * solution.irradiance).sum(axis=0)

    np.testing.assert_allclose(absorbed(one), absorbed(other), rtol=0.02)
    saved, error = read_solution(tmp_path / "a.npz")
    np.testing.assert_array_equal(saved.radiosity, one.radiosity)
    assert error.shape == one.irradiance.shape


@pytest.mark.slow
def test_form_factors_of_instances_are_those_of_their_shapes(scene):
    """All instances in one mesh, each of them an object: what is in the place of an instance sees the
    same."""
    found = etendue.compute_form_factors(scene, bundles=64, max_area=8.0)
    patches = instanced_patches(scene, max_area=8.0)
    assert patches.shape_names == ("room", "lamp", "instance 0", "instance 1")
    np.testing.assert_array_equal(found.patches.vertices, patches.vertices)
    light = np.exp(patches.centres / 4)  # smooth: what patches see of it is known to few per cent
    expected = form_factors(ABuffer(patches).cast(512)).matrix @ light

    def error(factors):
        return np.sqrt((patches.areas @ (factors.matrix @ light - expected) ** 2) / (patches.areas @ expected**2)).max()

    assert error(found.factors) < 0.03
    tree = etendue.compute_form_factors(scene, "spheres", bundles=64, max_area=8.0)
    assert tree.segments.tree.objects.names == ("lamp", "instance 0", "instance 1")
    assert error(tree.factors) < 0.05
    for name in ("first", "second"):
        del scene[name]
    np.testing.assert_array_equal(instanced_patches(scene).vertices, scene_patches(scene).vertices)


def test_patches_parts_and_resumed_runs(tmp_path):
    patches = room(3, emission=np.eye(1, len(room(3)), 0)[0] * 10, reflectance=0.5)
    asked = {"objects": "components", "least": 1, "threshold": 0.3, "lines": 1 << 10}
    path = tmp_path / "a.checkpoint"
    whole = etendue.solve_radiosity(patches, "boxes", passes=4, **asked)
    assert len(whole.parts.tree) > 1 and whole.irradiance_error.shape == (len(patches), 1)
    part = etendue.solve_radiosity(patches, "boxes", passes=2, checkpoint=path, **asked)
    rest = etendue.resume(path, scene=patches, passes=4)
    assert (part.passes, rest.passes) == (2, 4)
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)
    np.testing.assert_array_equal(rest.irradiance_error, whole.irradiance_error)
    parts = Part(patches, [(Part(Patches(*box((0, 0, 0), (0.05, 0.05, 0.05)))), np.eye(4))])
    with pytest.raises(etendue.OptionError, match="parts are given: leave out objects, threshold, least and levels"):
        etendue.resume(path, scene=parts, passes=4)
    asked = {"passes": 2, "lines": 1 << 12}
    seen = etendue.solve_radiosity(parts, "boxes", **asked)
    assert seen.solution is None and seen.parts.irradiance(1).shape == (6, 1)
    assert len(etendue.solve_radiosity(parts, "boxes", save=tmp_path / "a.npz", **asked).patches) == len(patches) + 6


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"gird": 4}, "'gird'; did you mean 'grid'"),
        ({"grid": 0}, "option 'grid' must be at least 1"),
        ({"solver": "jacobi"}, "a solver is for method lines; boxes solves by itself"),
        ({"threshold": -1}, "threshold"),
        ({"objects": "shape"}, "objects are found by components, shapes, labels, or by an array of a mesh file"),
    ],
)
def test_bad_options_are_one_line(asked, message):
    with pytest.raises(etendue.OptionError, match=message) as found:
        etendue.solve_radiosity(room(2, emission=1.0, reflectance=0.5), "boxes", passes=1, **asked)
    assert "\n" not in str(found.value)


def test_instances_are_not_grouped_again(scene):
    with pytest.raises(etendue.OptionError, match="instances of the scene are its parts: leave out objects"):
        etendue.solve_radiosity(scene, "boxes", passes=1, objects="shapes")


def test_parts_without_light_are_refused():
    with pytest.raises(SceneError, match="no light"):
        etendue.solve_radiosity(Part(room(2)), "boxes", passes=1)
