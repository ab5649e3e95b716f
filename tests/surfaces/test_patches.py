"""Patches from arrays: areas, sides, subdivision, what is refused, what a diagnosis finds."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, cube, joined, room, square

from etendue.radiosity import PatchError, Patches, diagnose

UNIT = square((0, 0, 0), (1, 0, 0), (0, 1, 0))


def test_areas_normals_and_centres():
    vertices = [[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0], [0, 0, 4]]
    patches = Patches(vertices, [[0, 1, 2, 3], [0, 4, 1]])
    np.testing.assert_allclose(patches.areas, [6, 4])
    np.testing.assert_allclose(patches.normals, [[0, 0, 1], [0, 1, 0]])
    np.testing.assert_allclose(patches.centres, [[1, 1.5, 0], [2 / 3, 0, 4 / 3]])
    assert len(patches) == 2 and patches.channels == 1


def test_a_closed_surface_has_the_area_of_the_box_and_no_mean_normal():
    patches = Patches(*box((0, 0, 0), (1, 2, 3), (2, 3, 4)), ids=np.zeros(2 * (6 + 12 + 8), int))
    np.testing.assert_allclose(patches.areas, [22])
    np.testing.assert_allclose(patches.normals, [[0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(patches.centres, [[0.5, 1, 1.5]])


def test_patches_by_number_come_in_order_of_their_numbers():
    patches = Patches(*box((0, 0, 0), (1, 1, 1), 1), ids=[7, 7, 3, 3, 5, 5], reflectance=[0.3, 0.5, 0.7])
    assert patches.labels.tolist() == [3, 5, 7] and patches.front.tolist() == [2, 2, 0, 0, 1, 1]
    np.testing.assert_allclose(patches.areas, 2)
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.3, 0.5, 0.7])


def test_the_back_of_a_sheet_is_a_patch_of_its_own():
    vertices, faces = joined(UNIT, square((0, 0, 1), (1, 0, 0), (0, 1, 0)))
    patches = Patches(vertices, faces, two_sided=[False, True], reflectance=[0.2, 0.6], emission=[1, 2])
    assert len(patches) == 3 and patches.back.tolist() == [-1, 2] and patches.other_side.tolist() == [-1, 2, 1]
    np.testing.assert_allclose(patches.normals[2], [0, 0, -1])
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.2, 0.6, 0.6])
    np.testing.assert_allclose(patches.emission[:, 0], [1, 2, 0])
    own = patches.with_properties(reflectance=[0.2, 0.6, 0.1])
    np.testing.assert_allclose(own.reflectance[:, 0], [0.2, 0.6, 0.1])
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.2, 0.6, 0.6])


def test_a_bent_quadrilateral_becomes_two_triangles_of_one_patch():
    bent = Patches([[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0]], [[0, 1, 2, 3]])
    dart = Patches([[0, 0, 0], [1, 0, 0], [0.2, 0.2, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    assert len(bent) == len(dart) == 1 and len(bent.faces) == len(dart.faces) == 2
    np.testing.assert_allclose(dart.areas, [0.2])
    assert (dart.face_normals[:, 2] > 0).all()


@pytest.mark.parametrize(
    "faces", [[[0, 1, 2], [0, 1, 2, 3]], [[0, 1, 2, 2], [0, 1, 2, 3]], [[0, 0, 1, 2], [3, 0, 1, 2]]]
)
def test_triangles_and_quadrilaterals_mixed(faces):
    patches = Patches(UNIT[0], faces)
    np.testing.assert_allclose(patches.areas, [0.5, 1])


@pytest.mark.parametrize("max_area", [2.0, 0.3, 0.011])
def test_subdivision_keeps_area_sides_and_properties(max_area):
    triangle = np.array([[0, 0, 2], [3, 0, 2], [0, 1, 2]]), np.array([[0, 1, 2, 2]])
    slanted = np.array([[0, 0, 3], [4, 0, 3], [3, 1, 3], [0, 1, 3]]), np.array([[0, 1, 2, 3]])
    vertices, faces = joined(UNIT, triangle, slanted)
    patches = Patches(
        vertices, faces, reflectance=[0.1, 0.2, 0.3], emission=[[1, 2], [3, 4], [5, 6]], two_sided=[0, 1, 0]
    )
    fine = patches.subdivided(max_area)
    assert fine.areas.max() <= max_area * (1 + 1e-9)
    for label, area in enumerate([1, 1.5, 3.5]):
        chosen = fine.labels == label
        np.testing.assert_allclose(fine.areas[chosen].sum(), area * (2 if label == 1 else 1))
        np.testing.assert_allclose(fine.reflectance[chosen, 0], 0.1 * (label + 1))
    np.testing.assert_allclose((fine.emission * fine.areas[:, None]).sum(axis=0), [1 + 4.5 + 17.5, 2 + 6 + 21])
    fronts = fine.other_side[fine.back[fine.back >= 0]]
    np.testing.assert_allclose(fine.normals[fronts], [[0, 0, 1]] * len(fronts), atol=1e-12)


def test_subdivision_into_more_than_memory_holds_is_refused():
    with pytest.raises(PatchError, match=r"faces of at most 1e-13 would be 1e\+13 or more and need 5e\+06 GB"):
        Patches(*UNIT).subdivided(1e-13)


def test_what_is_not_larger_is_not_cut():
    patches = cube(2)
    assert len(patches.subdivided(0.25)) == 24 and len(patches.subdivided(0.2499)) == 96


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"vertices": [[0, 0, 0], [1, 0, np.nan], [1, 1, 0], [0, 1, 0]]}, "1 of 4 vertices are not finite"),
        ({"vertices": [[0, 0], [1, 0]]}, "an array (v, 3)"),
        ({"faces": [[0, 1, 9]]}, "face 0 names vertex 9"),
        ({"faces": [[0, 1, -1]]}, "names vertex -1"),
        ({"faces": []}, "there are no faces"),
        ({"faces": [[0, 1, 2], [0, 1]]}, "face 1 has 2 corners"),
        ({"faces": [[0.0, 1.0, 2.0]]}, "whole numbers"),
        ({"faces": [[0, 1, 2], [0, 1, 1]]}, "1 of 2 faces have no area, the first is face 1"),
        ({"reflectance": 1.1}, "must be in [0, 1]"),
        ({"reflectance": np.nan}, "reflectance of 1 patches must be numbers"),
        ({"reflectance": [0.5, 0.5]}, "reflectance has 2 rows for 1 patches"),
        ({"emission": -1}, "emission of 1 patches must not be negative"),
        ({"emission": np.inf}, "emission of 1 patches"),
        ({"emission": "bright"}, "emission is a number"),
        ({"reflectance": [[0.1, 0.2]], "emission": [[1, 2, 3]]}, "2 channels"),
        ({"ids": [1, 2]}, "ids are whole numbers, one for each of 1 faces"),
        ({"two_sided": [True, False]}, "two_sided is one answer"),
        ({"sky": -1}, "the sky"),
    ],
)
def test_what_cannot_be_is_refused(change, words):
    arguments = {"vertices": UNIT[0], "faces": UNIT[1], **change}
    with pytest.raises(PatchError) as error:
        Patches(arguments.pop("vertices"), arguments.pop("faces"), **arguments)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_an_area_that_is_none_is_refused():
    with pytest.raises(PatchError, match="positive"):
        cube(1).subdivided(0)


def test_a_room_is_closed():
    found = diagnose(room(4))
    assert found.is_closed and str(found) == "closed" and len(found.duplicates) == 0


def test_what_a_diagnosis_finds():
    vertices, faces = box((0, 0, 0), (1, 1, 1), 2)
    open_box = diagnose(Patches(vertices, faces[1:]))
    assert len(open_box.open_edges) == 4 and not open_box.is_closed and "4 open edges" in str(open_box)
    # The lowest wall of one box is divided: its corners are on edges of the other walls.
    (coarse, walls), (fine, halves) = box((0, 0, 0), (1, 1, 1), 1), box((0, 0, 0), (1, 1, 1), 3)
    low = Patches(fine, halves).centres[:, 2] < 1e-9
    corners, mixed = joined((coarse, walls[Patches(coarse, walls).centres[:, 2] > 0.1]), (fine, halves[low]))
    assert diagnose(Patches(corners, mixed)).is_closed
    one_less = diagnose(Patches(corners, mixed[:-1]))
    assert len(one_less.open_edges) == 4  # two of its neighbours, and the edges of two walls as a whole
    turned = faces.copy()
    turned[5] = turned[5][::-1]
    assert len(diagnose(Patches(vertices, turned)).flipped_edges) == 4
    twice = diagnose(Patches(vertices, np.concatenate([faces, np.roll(faces[3:4], 1, axis=1)])))
    assert twice.duplicates.tolist() == [24] and len(twice.crowded_edges) == 4
    back_to_back = diagnose(Patches(UNIT[0], np.concatenate([UNIT[1], UNIT[1][:, ::-1]])))
    assert back_to_back.is_closed and len(back_to_back.duplicates) == 0
    sheet = diagnose(Patches(*UNIT, two_sided=True))
    assert str(sheet) == "all two-sided" and not sheet.is_closed


def test_a_sphere_around_all_faces_ignores_vertices_without_one():
    patches = Patches(np.concatenate([UNIT[0], [[100, 0, 0]]]), UNIT[1])
    np.testing.assert_allclose(patches.sphere[0], [0.5, 0.5, 0])
    np.testing.assert_allclose(patches.sphere[1], np.sqrt(0.5))


@pytest.mark.parametrize("n", [2, 3, 7, 10])
@pytest.mark.parametrize("away", [0.0, 0.1, 5e5])
def test_parts_of_faces_meet_at_vertices(n, away):
    """Bit for bit, or what is smooth over edges would have cracks: on a turned cube, of squares and of triangles."""
    plain = cube(1)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    squares = plain.faces
    triangles = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    for faces, area in ((squares, 1.0), (triangles, 0.5)):
        parts = Patches(plain.vertices @ turn.T + away, faces).subdivided(1.0001 * area / n**2)
        assert len(np.unique(parts.vertices, axis=0)) == 6 * n**2 + 2
