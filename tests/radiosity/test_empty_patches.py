"""Empty patches, whose faces were left out: their rows are zero, and all other rows are those without them."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, square

import etendue
from etendue.radiosity import (
    ABuffer,
    Patches,
    RayScene,
    exact_form_factors,
    form_factors,
    local_form_factors,
    multipath_bundles,
    read_form_factors,
    read_solution,
    save_form_factors,
    save_solution,
    scene_patches,
    shot_at_patches,
    solve,
    with_local_rays,
)
from etendue.radiosity.factors.formfactors import ESTIMATORS

#: Rows of degenerate and duplicate faces: in the middle, and behind all others.
EMPTY = [5, 25, 26]


@pytest.fixture(autouse=True)
def no_division_by_zero(variant):
    with np.errstate(all="raise", under="ignore"):
        yield


def rooms(two_sided=False):
    """A room with a lamp, and the same room with three broken faces."""
    vertices, faces = box((0, 0, 0), (1, 1, 1), 2, inward=True)
    broken = np.concatenate([faces[:5], [[3, 3, 4, 4]], faces[5:], [[0, 1, 2, 2]], faces[:1]])
    made = []
    for corners, left_out in ((faces, []), (broken, EMPTY)):
        emission = np.where(np.isin(np.arange(len(corners)), [0, *left_out]), 3.0, 0.0)
        rest = {"reflectance": 0.5, "emission": emission, "two_sided": two_sided, "left_out": left_out}
        made.append(Patches(vertices, corners, **rest))
    return made


def kept(patches):
    return np.flatnonzero(~patches.empty)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_form_factors(estimator, two_sided):
    sound, broken = rooms(two_sided)
    assert len(broken) == 27 * (1 + two_sided) and broken.empty.sum() == 3 * (1 + two_sided)
    expected = form_factors(ABuffer(sound).cast(32), estimator)
    found = form_factors(ABuffer(broken).cast(32), estimator)
    dense = found.matrix.toarray()
    np.testing.assert_allclose(dense[np.ix_(kept(broken), kept(broken))], expected.matrix.toarray(), atol=1e-15)
    assert not dense[broken.empty].any() and not dense[:, broken.empty].any() and not found.sky[broken.empty].any()
    if not two_sided:
        np.testing.assert_allclose(found.repaired().row_sums(), ~broken.empty)


def test_other_form_factors():
    sound, broken = rooms()
    expected, found = exact_form_factors(sound).matrix.toarray(), exact_form_factors(broken)
    np.testing.assert_allclose(found.matrix.toarray()[np.ix_(kept(broken), kept(broken))], expected, atol=1e-12)
    for factors in (found, local_form_factors(RayScene(broken), 64)):
        np.testing.assert_allclose(factors.row_sums(), ~broken.empty)
    by_objects = etendue.compute_form_factors(broken, "spheres", objects="labels", walls=(), bundles=8).factors
    np.testing.assert_allclose(by_objects.row_sums(), ~broken.empty, atol=0.05)
    assert not by_objects.row_sums()[broken.empty].any()


@pytest.mark.parametrize("solver", ["jacobi", "conjugate-gradient", "gauss-seidel", "direct"])
def test_solutions(solver):
    sound, broken = rooms()
    found = []
    for patches in (sound, broken):
        segments = ABuffer(patches).cast(32)
        on_segments = solver in ("jacobi", "conjugate-gradient")
        found.append(solve(patches, segments if on_segments else form_factors(segments), solver))
    np.testing.assert_allclose(found[1].radiosity[kept(broken)], found[0].radiosity, rtol=1e-12)
    assert not found[1].radiosity[broken.empty].any() and not found[1].irradiance[broken.empty].any()


@pytest.mark.parametrize(
    "options",
    [
        {"bundles": 16},
        {"method": "multipath", "points": 1 << 14},
        {"method": "boxes", "objects": "labels", "passes": 2},
        {"ambient": "fuzzy"},
        {"ambient": "fuzzy", "sub_scenes": "objects", "objects": "labels"},
    ],
)
def test_every_way_to_solve(options):
    _, broken = rooms()
    radiosity = etendue.solve_radiosity(broken, **options).solution.radiosity
    assert len(radiosity) == 27 and not radiosity[broken.empty].any() and (radiosity[kept(broken)] > 0).all()


def test_lines_and_rays_avoid_them():
    _, broken = rooms()
    lines = ABuffer(broken).cast(8)
    assert len(lines.unseen) == 0
    mixed = with_local_rays(lines, least=1 << 20)
    assert not mixed.counted[broken.empty].any()
    assert not shot_at_patches(RayScene(broken), 4096).irradiance[broken.empty].any()
    assert not multipath_bundles(ABuffer(broken), 32).radiosity[broken.empty].any()


@pytest.mark.parametrize("kind", [".npz", ".nc"])
@pytest.mark.parametrize("two_sided", [False, True])
def test_files_keep_rows_numbers_and_names(kind, two_sided, tmp_path):
    if kind == ".nc":
        pytest.importorskip("h5netcdf")
    _, broken = rooms(two_sided)
    broken.shapes, broken.shape_names = np.arange(len(broken)) % 3 - 1, ("Tür", "wall")
    segments = ABuffer(broken).cast(16)
    save_form_factors(tmp_path / f"f{kind}", form_factors(segments))
    factors = read_form_factors(tmp_path / f"f{kind}")
    assert len(factors) == len(broken)
    np.testing.assert_array_equal(factors.face, np.tile(np.arange(27), 1 + two_sided))
    np.testing.assert_array_equal(factors.label, broken.labels)
    assert factors.name[:3].tolist() == ["", "Tür", "wall"]

    solution = solve(broken, segments)
    save_solution(tmp_path / f"s{kind}", solution)
    again = read_solution(tmp_path / f"s{kind}")[0]
    np.testing.assert_array_equal(again.radiosity, solution.radiosity)
    for name in ("face", "labels", "names", "areas", "front", "back", "other_side", "emission"):
        np.testing.assert_array_equal(getattr(again.patches, name), getattr(broken, name))
    if kind == ".npz":
        with np.load(tmp_path / "s.npz") as saved:
            assert saved["face"].tolist() == broken.face.tolist() and saved["name"].tolist() == broken.names.tolist()
            assert saved["label"].tolist() == broken.labels.tolist()


def test_parts_of_faces_know_their_face_and_groups_may_keep_them():
    _, broken = rooms()
    parts = broken.subdivided(0.07)
    assert parts.face.tolist() == np.repeat(np.arange(27), np.where(broken.empty, 1, 4)).tolist()
    np.testing.assert_allclose(np.bincount(parts.face, parts.areas), broken.areas)
    groups = Patches(broken.vertices, broken.faces, ids=np.arange(24) % 2).subdivided(0.07, grouped=True)
    assert len(groups) == 2 and len(groups.faces) == 96 and groups.face.tolist() == [0, 1]
    np.testing.assert_allclose(groups.areas, [3, 3])


def test_broken_faces_of_a_scene_keep_their_rows():
    import mitsuba as mi

    vertices, _ = square((0, 0, 0), (1, 0, 0), (0, 1, 0))
    mesh = mi.Mesh("broken", len(vertices), 3)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel().astype(np.float32)
    parameters["faces"] = np.array([[0, 1, 2], [0, 1, 1], [0, 2, 3]], np.uint32).ravel()
    parameters.update()
    scene = mi.load_dict({"type": "scene", "mesh": mesh, "light": {"type": "constant"}})
    patches = scene_patches(scene)
    assert patches.empty.tolist() == [False, True, False] and patches.face.tolist() == [0, 1, 2]
