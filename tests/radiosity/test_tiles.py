"""Rows of form factors of the tiles of a city, and their union."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import square

import etendue
from etendue.cli.main import main
from etendue.core import OptionError
from etendue.radiosity import (
    Patches,
    RadiosityError,
    RayScene,
    box,
    exact_form_factors,
    joined,
    joined_rows,
    known_rows,
    local_form_factors,
    read_form_factors,
    read_patches,
)
from etendue.surfaces import PatchError

NAMES = ("west", "middle", "east")
RAYS = 4096


def write(path, vertices, faces):
    lines = ["v {} {} {}".format(*p) for p in vertices] + ["f " + " ".join(map(str, f)) for f in np.asarray(faces) + 1]
    path.write_text("\n".join(lines))


def write_tiles(folder, heights):
    """Three tiles of 4 x 4 with a house on the ground of each."""
    for k, (name, height) in enumerate(zip(NAMES, heights, strict=True)):
        x = 4.0 * k
        house, faces = box((x + 1, 1, 0), (x + 3, 3, height))
        above = faces[(house[faces][:, :, 2] > 0).any(axis=1)]
        strips = [((0, 0), (4, 1)), ((0, 3), (4, 1)), ((0, 1), (1, 2)), ((3, 1), (1, 2))]
        ground = [square((x + a, b, 0), (width, 0, 0), (0, depth, 0)) for (a, b), (width, depth) in strips]
        write(folder / f"{name}.obj", *joined((house, above), *ground))


@pytest.fixture
def tiles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_tiles(tmp_path, (1, 2, 3))
    return ["west.obj", "--more", "middle.obj", "--more", "east.obj"]


def test_tiles_are_joined(tiles):
    for name in NAMES:
        assert main(["form-factors", *tiles, "-m", "rays", "--rows", f"{name}.obj", "-o", f"{name}.npz"]) == 0
    rows = [f"{name}.npz" for name in NAMES]
    parts = [read_form_factors(path) for path in rows]
    for k, part in enumerate(parts):
        assert np.array_equal(np.flatnonzero(known_rows(part)), 9 * k + np.arange(9))
        assert not part.matrix[~known_rows(part)].nnz and part.row_sums()[known_rows(part)] == pytest.approx(1)
    assert np.unique(parts[0].matrix.tocoo().col).max() >= 18  # facets of the farthest tile
    assert main(["join-factors", *rows, "-o", "all.npz", "-o", "vfsparse.inp.001", "-o", "svf.inp.001"]) == 0
    whole = read_form_factors("all.npz")
    assert abs(whole.matrix - sum(part.matrix for part in parts)).max() == 0
    exact = exact_form_factors(read_patches("west.obj", more=["middle.obj", "east.obj"]))
    noise = np.sqrt(exact.matrix.todense() * (1 - exact.matrix.todense()) / RAYS)
    assert (np.abs(whole.matrix.todense() - exact.matrix.todense()) <= 5 * noise + 1e-3).all()
    assert np.loadtxt("svf.inp.001") == pytest.approx(exact.sky, abs=5 * 0.5 / np.sqrt(RAYS))
    assert main(["join-factors", *rows, "--repair", "--groups", "-o", "groups.npz"]) == 0
    groups = read_form_factors("groups.npz")
    assert groups.name.tolist() == list(NAMES) and groups.reciprocity_error() < 1e-9
    assert groups.row_sums() == pytest.approx(1, abs=1e-6)


def test_rays_to_an_error(tiles):
    mesh = read_patches("west.obj", more=["middle.obj", "east.obj"])
    found = etendue.compute_form_factors(mesh, "rays", error=0.03, rows="middle")
    assert found.factors.lines.max() == 2048 and found.stopped_by == "rays"
    errors = found.factors.row_errors()[known_rows(found.factors)]
    assert errors.max() < 0.03
    again = etendue.compute_form_factors(mesh, "rays", error=0.03, rows=["middle"], seed=1).factors
    assert (again.matrix != found.factors.matrix).nnz
    assert abs(again.matrix - found.factors.matrix).max() < 8 * np.sqrt(0.25 / 2048)


def test_parts_of_a_subdivided_tile_belong_to_it(tiles):
    mesh = read_patches("west.obj", more=["middle.obj"], two_sided=True).subdivided(1.0)
    assert mesh.files == (("west", 0), ("middle", 9)) == Patches.of_arrays(mesh.arrays()).files
    of_west = mesh.of_files(["west"])
    assert (mesh.centres[of_west, 0] <= 4).all() and (mesh.centres[~of_west, 0] >= 4).all()
    assert of_west[mesh.fronts :].any() and not of_west.all()


def test_rows_in_any_order():
    patches = Patches(*box((0, 0, 0), (1, 1, 1), 1, inward=True))
    scene = RayScene(patches)
    some = local_form_factors(scene, 64, rows=[4, 1, 4])
    assert np.array_equal(np.flatnonzero(some.lines), [1, 4]) and some.matrix.sum() == pytest.approx(2)
    assert np.array_equal(np.unique(some.matrix.tocoo().row), [1, 4])


def test_what_is_refused(tiles, tmp_path, capsys):
    mesh = read_patches("west.obj", more=["middle.obj", "east.obj"])
    parts = [etendue.compute_form_factors(mesh, "rays", error=0.2, rows=name).factors for name in NAMES]
    with pytest.raises(RadiosityError, match="9 of 27 rows are in no file, the first is row 9"):
        joined_rows([parts[0], parts[2]], ["a", "c"])
    with pytest.raises(RadiosityError, match="row 0 is in both of 'a' and 'again'"):
        joined_rows([parts[0], *parts], ["a", "again", "b", "c"])
    other = etendue.compute_form_factors("west.obj", "rays", error=0.2).factors
    with pytest.raises(RadiosityError, match="'b' and 'a' are of other patches"):
        joined_rows([parts[0], other], ["a", "b"])
    with pytest.raises(PatchError, match="no file 'north' among those of the patches: west, middle, east"):
        mesh.of_files(["north"])
    for wrong in (
        {"method": "lines"},
        {"method": "rays", "row_sums": True},
        {"method": "rays", "groups": True},
        {"method": "rays", "save": "svf.inp.001"},
        {"method": "rays", "estimator": "F4"},
        {"method": "rays", "bundles": 4},
        {"method": "rays", "up": "z"},
    ):
        with pytest.raises(OptionError):
            etendue.compute_form_factors(mesh, rows="west", **wrong)
    assert main(["join-factors", "missing.npz"]) != 0
    (tmp_path / "other").mkdir()
    write_tiles(tmp_path / "other", (1, 2, 3))
    for path in ("west.stl", "other/west.obj"):  # one that does not exist, one that is not of this run
        assert main(["form-factors", *tiles, "-m", "rays", "--rows", path, "-o", "f.npz"]) == 2
        said = f"--rows '{path}' is none of the files of this run: west.obj, middle.obj, east.obj"
        assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("suffix", [".npz", ".nc"])
def test_tiles_in_another_order_are_not_joined(tiles, tmp_path, suffix, capsys):
    if suffix == ".nc":
        pytest.importorskip("h5netcdf")
    write_tiles(tmp_path, (1, 1, 1))  # areas do not tell these apart
    turned = ["west.obj", "--more", "east.obj", "--more", "middle.obj"]
    for name, files in (("west", tiles), ("middle", tiles), ("east", turned)):
        asked = ["-m", "rays", "--error", "0.2", "--rows", f"{name}.obj", "-o", name + suffix]
        assert main(["form-factors", *files, *asked]) == 0
    rows = [name + suffix for name in NAMES]
    capsys.readouterr()
    assert main(["join-factors", *rows, "-o", "all.npz"]) != 0
    assert "row 9 is in both" in capsys.readouterr().err
    asked = ["-m", "rays", "--error", "0.2", "--rows", "middle.obj", "-o", "east" + suffix]
    assert main(["form-factors", *turned, *asked]) == 0  # its rows are the last there
    assert main(["join-factors", *rows, "-o", "all.npz"]) != 0
    assert "are of other patches: name the same files in the same order" in capsys.readouterr().err
