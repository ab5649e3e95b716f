"""Objects: connected parts, shapes, labels, arrays; walls; smallest spheres; what is refused."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.patches import BOXES, box, joined, room, square
from support.scenes import diffuse, transform

from etendue.radiosity import PatchError, Patches, find_objects, scene_patches
from etendue.surfaces import bounding_sphere, joint_sphere


def turned(mesh, angle):
    c, s = np.cos(angle), np.sin(angle)
    return mesh[0] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), mesh[1]


def test_boxes_in_a_room_are_objects_and_the_room_is_walls():
    patches = room(4)
    objects = find_objects(patches)
    assert objects.count == 4 and objects.names == ("1", "2", "3", "4")
    assert objects.walls.tolist() == list(range(6 * 16))
    for k, (low, high) in enumerate(BOXES):
        np.testing.assert_allclose([objects.lower[k], objects.upper[k]], [low, high])
        size = np.subtract(high, low)
        own = patches.areas[objects.of_patch == k].sum()
        assert objects.areas[k] == pytest.approx(own) == pytest.approx(2 * np.prod(size) * (1 / size).sum())
        np.testing.assert_allclose(objects.spheres[0][k], np.mean([low, high], axis=0))
        assert objects.spheres[1][k] == pytest.approx(np.linalg.norm(size) / 2)


def test_parts_are_connected_by_position_even_if_rounded_and_by_patches_of_many_faces():
    far = box((3, 0, 0), (4, 1, 1), 2)
    for angle in (0.0, 0.3, 1.1):
        mesh = joined(turned(box((0, 0, 0), (1, 1, 1), (2, 3, 4)), angle), turned(far, angle))
        noise = 1e-7 * np.random.default_rng(1).uniform(-1, 1, mesh[0].shape)  # each wall has vertices of its own
        objects = find_objects(Patches(mesh[0] + noise, mesh[1]), walls=())
        assert [np.count_nonzero(objects.of_patch == k) for k in range(objects.count)] == [52, 24]
    one = np.concatenate([np.arange(52), np.arange(24)])  # patches with faces of both
    assert find_objects(Patches(*mesh, ids=one), walls=()).count == 1


def test_vertices_that_are_near_but_not_the_same_do_not_connect():
    low, high = box((0, 0, 0), (1, 1, 1)), box((1.0001, 0, 0), (2, 1, 1))
    assert find_objects(Patches(*joined(low, high)), walls=()).count == 2
    dense = np.random.default_rng(2).uniform(size=(20_000, 3))  # neighbours along each axis are close
    corners = dense[:, None] + 1e-3 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.3]])
    triangles = Patches(corners.reshape(-1, 3), np.arange(60_000).reshape(-1, 3))
    assert find_objects(triangles, walls=()).count > 19_900


def test_the_back_of_a_sheet_belongs_to_the_object_of_its_front():
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), inward=True), square((0.2, 0.2, 0.5), (0.3, 0, 0), (0, 0.3, 0)))
    patches = Patches(vertices, faces, two_sided=[False] * 6 + [True])
    objects = find_objects(patches)
    assert objects.of_patch.tolist() == [-1] * 6 + [0, 0] and objects.areas.tolist() == [pytest.approx(0.18)]
    given = find_objects(patches, [-1] * 6 + [5])
    assert given.of_patch.tolist() == [-1] * 6 + [0, 0] and given.names == ("5",)
    with pytest.raises(PatchError, match="patch 6 and its back, patch 7, are one sheet"):
        find_objects(patches, [-1] * 6 + [5, 4])


def test_walls_are_also_flat_sides_and_rooms_with_thick_walls_and_can_be_named():
    sides = [patch for patch in range(6)]
    room_of_sheets = Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), box((0.4, 0.4, 0.1), (0.6, 0.6, 0.5))))
    by_side = [*sides, *[6] * 6]
    assert find_objects(room_of_sheets, by_side).count == 7  # an array says what is a wall
    with_labels = Patches(room_of_sheets.vertices, room_of_sheets.faces)
    with_labels.labels = np.array(by_side)
    objects = find_objects(with_labels, "labels")
    assert objects.names == ("6",) and objects.walls.tolist() == sides
    thick = Patches(
        *joined(
            box((-0.1, -0.1, -0.1), (1.1, 1.1, 1.1)),
            box((0, 0, 0), (1, 1, 1), inward=True),
            box((0.4,) * 3, (0.6,) * 3),
        )
    )
    assert find_objects(thick).names == ("2",)
    assert find_objects(thick, walls=["2", "0"]).names == ("1",)
    assert find_objects(thick, walls=()).count == 3


def test_without_walls_all_parts_are_objects():
    plates = Patches(*joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))))
    assert find_objects(plates).count == 2
    one = find_objects(Patches(*box((0, 0, 0), (1, 1, 1), 2, inward=True)))
    assert one.count == 1 and len(one.walls) == 0


def test_shapes_of_a_scene_are_kept_also_when_their_faces_are_divided():
    grey = diffuse(0.5, 0.5, 0.5)
    scene = {
        "type": "scene",
        "room": {"type": "cube", "flip_normals": True, "bsdf": grey},
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": grey},
        "sheet": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, 0.5]).scale(0.2),
            "bsdf": {"type": "twosided", "bsdf": grey},
        },
    }
    scene = mi.load_dict(scene)
    for options in ({"max_area": 0.05}, {}, {"per": "shape"}):
        patches = scene_patches(scene, segments=8, **options)
        objects = find_objects(patches, "shapes")
        assert sorted(objects.names) == ["ball", "sheet"]
        ball, sheet = (objects.names.index(name) for name in ("ball", "sheet"))
        assert objects.areas[sheet] == pytest.approx(2 * 0.16)
        assert objects.spheres[1][ball] == pytest.approx(0.3, rel=1e-5)
        named = find_objects(patches, "shapes", walls=["room", "ball"])
        assert named.names == ("sheet",)
        assert find_objects(patches.with_properties(reflectance=0.1), "shapes").names == objects.names


def test_the_walls_of_a_room_that_is_open_and_whose_boxes_reach_through_the_floor():
    patches = scene_patches("cornell-box")
    by_shape, by_part = find_objects(patches, "shapes"), find_objects(patches)
    assert set(by_shape.names) == {"light", "small-box", "large-box"} and by_part.count == 3
    np.testing.assert_array_equal(by_shape.walls, by_part.walls)


def test_objects_that_overlap_are_named():
    boxes = [
        box((0, 0, 0), (2, 2, 2)),
        box((1, 1, 1), (3, 3, 3)),
        box((3, 0, 0), (4, 3.1, 2.9)),
        box((0.5,) * 3, (0.6,) * 3),
    ]
    objects = find_objects(Patches(*joined(*boxes)), walls=())
    assert objects.overlapping().tolist() == [[0, 1], [0, 3]]


@pytest.mark.parametrize(
    ("by", "message"),
    [
        ([0, 1], "one for each of 102 patches, not int64 of shape"),
        (np.zeros(102), "not float64"),
        (np.full(102, -1), "all 102 patches are walls"),
        ("shape", "not by 'shape'"),
        ("shapes", "not of a scene's shapes"),
    ],
)
def test_what_does_not_fit_is_refused(by, message):
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), 4, inward=True), box((0.4,) * 3, (0.6,) * 3)))
    with pytest.raises(PatchError, match=message):
        find_objects(patches, by)
    with pytest.raises(PatchError, match="no group of patches is called '7'"):
        find_objects(patches, walls=[7])
    with pytest.raises(PatchError, match="there is no object"):
        find_objects(patches, walls=[0, 1])


@pytest.mark.parametrize("seed", range(8))
def test_the_smallest_sphere_holds_all_points_and_none_is_smaller(seed):
    random = np.random.default_rng(seed)
    points = random.normal(size=(int(random.integers(4, 400)), 3)) * random.uniform(0.1, 5, 3)
    centre, radius = bounding_sphere(points)
    distance = np.linalg.norm(points - centre, axis=1)
    assert distance.max() == pytest.approx(radius)
    # It is the smallest if its centre is in the hull of the points on it: from anywhere else one of them is farther.
    on = points[distance > radius * (1 - 1e-7)]
    assert 2 <= len(on) <= 5
    for way in random.normal(size=(500, 3)):
        assert np.linalg.norm(on - (centre + 1e-4 * radius * way), axis=1).max() > radius


def test_smallest_spheres_of_few_points_of_corners_and_of_spheres():
    for points, centre, radius in (
        ([[1, 2, 3]], [1, 2, 3], 0),
        ([[1, 2, 3]] * 4, [1, 2, 3], 0),
        ([[0, 0, 0], [2, 0, 0], [1, 0.5, 0]], [1, 0, 0], 1),
        (box((0, 0, 0), (1, 2, 3), 5)[0], [0.5, 1, 1.5], np.sqrt(14) / 2),
    ):
        found = bounding_sphere(np.array(points, dtype=float))
        np.testing.assert_allclose(found[0], centre, atol=1e-9)
        assert found[1] == pytest.approx(radius)
    a, b = np.zeros(3), np.array([4.0, 0, 0])
    centre, radius = joint_sphere(a, 1, b, 2)
    np.testing.assert_allclose(centre, [2.5, 0, 0])
    assert radius == 3.5
    assert joint_sphere(a, 9, b, 2)[1] == 9 and joint_sphere(a, 1, b, 7)[1] == 7
