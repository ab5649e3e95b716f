"""Surfaces of View3D's input: every record, against closed forms and published results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from etendue.radiosity import ABuffer, LocalRays, PatchError, RayScene, exact_form_factors, form_factors, read_patches
from etendue.surfaces import find_objects

MESHES = Path(__file__).parents[2].parent / "shared" / "meshes"
needs_meshes = pytest.mark.skipif(not MESHES.is_dir(), reason="the meshes of other projects are not there")

#: Between two unit squares at distance 1, that face each other.
PLATES = 0.19982490
HEAD = """T Two plates ! and a comment
! another comment
C eps=1e-4 encl=0
F 3
V 1 0 0 0
V 2 1 0 0   / behind data
V 3 1 1 0
v 4 0 1 0
V 5 0 0 1
V 6 1 0 1
V 7 1 1 1
V 8 0 1 1
V 9 .25 .25 0
V 10 .75 .25 0
V 11 .75 .5 0
V 12 .25 .5 0
V 13 -9 -9 .5
V 14 9 -9 .5
V 15 9 9 .5
V 16 -9 9 .5
V 17 .5 -9 .5
V 18 .5 9 .5
"""
FLOOR, CEILING = "S 1 1 2 3 4 0 0 .9 floor\n", "S 2 8 7 6 5 0 0 .8 ceiling\n"
END = "End of data\n  1 ---- 2 a drawing\n"


def read(tmp_path, text, **arguments):
    path = tmp_path / "a.vs3"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    return read_patches(path, **arguments)


def test_surfaces_keep_order_names_and_emissivities(tmp_path):
    patches = read(tmp_path, HEAD + FLOOR + CEILING + END)
    assert list(patches.names) == ["floor", "ceiling"]
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.1, 0.2])
    np.testing.assert_allclose(exact_form_factors(patches).matrix.toarray(), [[0, PLATES], [PLATES, 0]], atol=1e-8)
    np.testing.assert_allclose(read(tmp_path, HEAD + FLOOR + CEILING + END, reflectance=0.5).reflectance, 0.5)
    assert read(tmp_path, HEAD + FLOOR + CEILING + END, temperature=300.0).emission[1, 0] == pytest.approx(
        0.8 * 5.670374419e-8 * 300**4
    )


def test_a_surface_is_cut_from_its_base(tmp_path):
    """The view factors of base and window add up to those of the whole floor."""
    patches = read(tmp_path, HEAD + FLOOR + CEILING + "S 3 9 10 11 12 1 0 .5 window\n" + END)
    np.testing.assert_allclose(patches.areas, [0.875, 1, 0.125], rtol=1e-12)
    assert len(patches.coincident.clashing) == 0
    factors = exact_form_factors(patches).matrix.toarray()
    assert patches.areas @ factors[:, 1] == pytest.approx(PLATES, abs=1e-8)
    assert factors[2, 1] > factors[0, 1] > 0


def test_null_surfaces_are_holes_that_occlude(tmp_path):
    patches = read(tmp_path, HEAD + FLOOR + CEILING + "N 3 12 11 10 9 1 0\n" + END)
    window = read(tmp_path, HEAD + FLOOR + CEILING + "S 3 9 10 11 12 1 0 .5 window\n" + END)
    ours, theirs = exact_form_factors(patches), exact_form_factors(window)
    assert len(ours) == 2
    np.testing.assert_allclose(ours.areas, [0.875, 1])
    np.testing.assert_allclose(ours.matrix.toarray(), theirs.matrix.toarray()[:2, :2], atol=1e-8)
    assert ours.dark[1] == pytest.approx(theirs.matrix[1, 2], abs=1e-8)


def test_combined_surfaces_are_one_patch(tmp_path):
    text = HEAD + "S 1 1 2 3 0 0 0 .9 floor\n" + CEILING + "S 3 1 3 4 0 0 1 .9 rest\n" + END
    patches = read(tmp_path, text)
    assert list(patches.names) == ["floor", "ceiling"]
    np.testing.assert_allclose(patches.areas, [1, 1])
    assert exact_form_factors(patches).matrix[0, 1] == pytest.approx(PLATES, abs=1e-8)


@pytest.mark.parametrize("screen", ["O 3 13 14 15 16 0 0\n", "O 3 16 15 14 13 0 0 .9 screen\n"])
def test_obstacles_occlude_and_have_no_row(tmp_path, screen):
    """A screen between the plates, seen from both sides, by lines and by rays."""
    patches = read(tmp_path, HEAD + FLOOR + CEILING + screen + END)
    assert len(patches) == 2
    for engine, count in ((ABuffer(patches), 64), (LocalRays(RayScene(patches)), 4096)):
        factors = form_factors(engine.cast(count))
        assert factors.matrix.nnz == 0
        assert factors.dark.min() > 0.98  # the screen reaches nine times as far as the plates
        np.testing.assert_allclose(factors.row_sums() + factors.dark, 1, atol=1e-12)


def test_half_a_screen(tmp_path):
    """At x > 1/2: the two plates see each other where the line between them passes x < 1/2, half of all by symmetry."""
    patches = read(tmp_path, HEAD + FLOOR + CEILING + "O 3 17 14 15 18 0 0\n" + END)
    factors = form_factors(ABuffer(patches).cast(1024))
    assert factors.matrix[0, 1] == pytest.approx(PLATES / 2, abs=5 * factors.errors[0, 1])
    divided = patches.subdivided(0.1)
    assert len(divided) == 32
    assert np.count_nonzero(divided.front < 0) > 1
    assert form_factors(ABuffer(divided).cast(64)).matrix[:16, 16:].sum() / 16 == pytest.approx(PLATES / 2, rel=0.05)
    assert np.array_equal(type(patches).of_arrays(patches.arrays()).front, patches.front)
    assert find_objects(patches).count == 2


def test_rectangles_by_azimuth_and_tilt(tmp_path):
    """In format 3a a floor (tilt 0) and a wall (tilt 90) of azimuth 180: y points up the plane, x to the right."""
    text = "F 3a\nS 1 R 0 0 .9 floor\n 0 0 0 180 0\n 1 1\nS 2 Q 0 0 .9 wall\n 0 0 0 180 90\n 0 1 0 0 1 0 1 1\n*\n"
    patches = read(tmp_path, text)
    np.testing.assert_allclose(patches.normals, [[0, 0, 1], [0, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(patches.centres, [[0.5, 0.5, 0], [0.5, 0, 0.5]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "M 1 1 2 3 4 0 0\n", "line 23: masks"),
        (HEAD + "S 2 1 2 3 4 0 0 .9 a\n", "line 23: surface 2 comes after surface 0"),
        (HEAD + "S 1 1 2 3 44 0 0 .9 a\n", "line 23: there is no vertex 44; there are 18"),
        (HEAD + "S 1 1 2 3 4 0 0 x a\n", "line 23: record S is incomplete"),
        (HEAD + "S 1 1 2 3 4 0 0\n", "line 23: record S is incomplete"),
        (HEAD + "S 1 1 2 3 4 0 0 9 a\n", "line 23: surface 1 has the emissivity 9"),
        (HEAD + FLOOR + CEILING + "S 3 9 10 11 12 2 0 .5 b\n", "line 25: surface b faces"),
        (HEAD + FLOOR + "S 2 5 6 7 8 1 0 .5 b\n", "line 24: 'b' in 'floor' lies in another plane"),
        (HEAD + "S 1 9 10 11 12 0 0 .9 floor\nS 2 1 2 3 4 1 0 .5 b\n", "line 24: 'b' in 'floor' is not inside"),
        (HEAD + FLOOR + "S 2 8 7 6 5 0 3 .9 a\n", "line 24: the combined surface 3 of surface 2"),
        (HEAD + "O 1 1 2 3 4 0 0\n", "all 1 surfaces are obstacles"),
        (HEAD, "has no surfaces"),
        ("F 2\n", "line 1: geometry '2'"),
        ("S 1 1 2 3 4 0 0 .9 a\n", "line 1: the record F"),
        ("F 3a\nS 1 R 0 0 .9 floor\n 0 0 0\n", "line 3: record S is incomplete"),
        ("F 3\nZ 1\n", "line 2: record 'Z' is not known"),
    ],
)
def test_broken_files(tmp_path, text, message):
    with pytest.raises(PatchError, match=message.replace("(", r"\(")) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)


def test_unknown_keys_are_named(tmp_path, caplog):
    read(tmp_path, HEAD.replace("encl=0", "encl=0 foo=1 maxD=9") + FLOOR + CEILING)
    assert "'foo' is no key of View3D" in caplog.text
    assert "further apart than maxD=9" in caplog.text


@needs_meshes
def test_examples_of_view3d():
    """L-shaped room of Pinney and Bean (twelve surfaces, eight rows), and a room by Pueltz with 960 surfaces."""
    room = read_patches(MESHES / "view3d" / "test4.vs3")
    assert list(room.names) == [f"srf-{k}" for k in range(1, 9)]
    np.testing.assert_allclose(room.areas, [9, 3, 6, 6, 3, 9, 5, 5])
    factors = form_factors(ABuffer(room).cast(1024))
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-12)
    assert len(read_patches(MESHES / "view3d" / "gunter2.vs3")) == 33
    cube = read_patches(MESHES / "view3d" / "facet.vs3")
    np.testing.assert_allclose(cube.areas, [1] * 6 + [0.25] * 2)


@needs_meshes
def test_city_of_udales():
    """Areas and sky view factors that uDALES has published for its example 201."""
    folder = MESHES / "udales-201"
    patches = read_patches(folder / "facets.vs3")
    assert patches.names[990] == "991f"
    np.testing.assert_allclose(patches.areas, np.loadtxt(folder / "facetarea.inp.201", comments="#"), rtol=1e-4)
    sky = np.loadtxt(folder / "svf.inp.201", comments="#")
    found = form_factors(ABuffer(patches).cast(512)).sky
    assert np.sqrt(np.mean((found - sky) ** 2)) < 0.01


@needs_meshes
def test_an_adjacent_obstacle_occludes():
    """A wall beside the source hides most of the receiver: factors by rays and by lines agree, and are below those
    without it."""
    path = MESHES / "view3d" / "view3d_adjacent_obstructor.vs3"
    patches = read_patches(path)
    factors = form_factors(LocalRays(RayScene(patches)).cast(1 << 14))
    assert len(factors) == 2
    open_patches, _ = patches.only([True, True])
    without = exact_form_factors(open_patches).matrix[0, 1]
    assert factors.matrix[0, 1] <= without + 5 * factors.errors[0, 1]
    assert factors.dark[0] > 0
