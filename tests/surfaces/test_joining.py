"""Several mesh files as one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from etendue.cli.main import main
from etendue.radiosity import exact_form_factors, read_form_factors, read_patches
from etendue.surfaces import PatchError

#: Of unit squares face to face at distance 1 [Howell's catalogue, C-11].
FACING = 0.199824895698387


def square(path: Path, z: float, names: str, up: bool = True, side: float = 1.0) -> Path:
    low, high = 0.5 - side / 2, 0.5 + side / 2
    corners = [(low, low), (high, low), (high, high), (low, high)][:: 1 if up else -1]
    path.write_text("\n".join([*(f"v {x} {y} {z}" for x, y in corners), f"g {names}", "f 1 2 3 4", ""]))
    return path


def test_patches_of_two_files(tmp_path):
    low, high = square(tmp_path / "low.obj", 0, "floor"), square(tmp_path / "high.obj", 1, "roof", up=False)
    patches = read_patches(low, more=[high])
    assert patches.names.tolist() == ["floor", "roof"]
    factors = exact_form_factors(patches)
    np.testing.assert_allclose(factors.matrix.todense(), [[0, FACING], [FACING, 0]], atol=1e-9)
    assert read_patches(low, more=[high], ids="file").names.tolist() == ["low", "high"]
    # Groups of one name are one group.
    square(high, 1, "floor", up=False)
    assert len(read_patches(low, more=[high], ids="groups")) == 1


def test_obstacles_of_a_file_have_no_row_and_occlude(tmp_path, monkeypatch, capsys):
    """A plate between the squares, so large that they see nothing of each other."""
    monkeypatch.chdir(tmp_path)
    for name, z, up, side in (("low", 0, True, 1), ("high", 1, False, 1), ("plate", 0.5, True, 3)):
        square(Path(f"{name}.obj"), z, name, up, side)
    both = "form-factors low.obj --more high.obj --bundles 1024 --checkpoint c"
    assert main([*both.split(), "-o", "open.npz"]) == 0
    assert main([*both.split(), "--obstacles", "plate.obj", "-o", "shut.npz"]) == 0
    open_, shut = read_form_factors("open.npz"), read_form_factors("shut.npz")
    assert len(open_) == len(shut) == 2
    assert abs(open_.matrix[0, 1] - FACING) < 5 * open_.errors.max()
    assert shut.matrix.nnz == 0 or shut.matrix.max() == 0
    assert main(["resume", "c", "--bundles", "2048", "-o", "again.npz"]) == 0
    assert len(read_form_factors("again.npz")) == 2
    assert main(["form-factors", "low.obj", "--obstacles", "none.obj", "-o", "f.npz"]) != 0
    assert "there is no mesh file" in capsys.readouterr().err


def test_emissivities_that_one_file_lacks(tmp_path):
    plates = "T\nF 3\nV 1 0 0 0\nV 2 1 0 0\nV 3 1 1 0\nV 4 0 1 0\nS 1 1 2 3 4 0 0 0.9 floor\nEnd of Data\n"
    (tmp_path / "a.vs3").write_text(plates)
    high = square(tmp_path / "high.obj", 1, "roof", up=False)
    with pytest.raises(PatchError, match=r"^high has no reflectance as other files have"):
        read_patches(tmp_path / "a.vs3", more=[high])
    np.testing.assert_allclose(read_patches(tmp_path / "a.vs3", more=[high], reflectance=0.3).reflectance, 0.3)
    (tmp_path / "b.vs3").write_text(plates.replace(" 0\nV", " 2\nV").replace(" 0\nS", " 2\nS"))
    patches = read_patches(tmp_path / "a.vs3", more=[tmp_path / "b.vs3"], obstacles=[high])
    np.testing.assert_allclose(patches.reflectance, 0.1)
    assert patches.names.tolist() == ["floor", "floor"]


def test_colours_of_one_file_and_grey_of_another(tmp_path):
    grey = tmp_path / "a.vs3"
    grey.write_text("T\nF 3\nV 1 0 0 0\nV 2 1 0 0\nV 3 1 1 0\nS 1 1 2 3 0 0 0 0.9 floor\nEnd of Data\n")
    lamp = tmp_path / "lamp.rad"
    lamp.write_text("void glow white 0 0 4 3 2 1 0\nwhite polygon lamp 0 0 9 0 0 1  0 1 1  1 0 1\n")
    patches = read_patches(grey, more=[lamp])
    np.testing.assert_allclose(patches.reflectance, [[0.1, 0.1, 0.1], [0, 0, 0]])
    np.testing.assert_allclose(patches.emission, [[0, 0, 0], [3 * np.pi, 2 * np.pi, np.pi]])


def test_faces_of_no_group_stay_so(tmp_path):
    path = square(tmp_path / "low.obj", 0, "floor")
    path.write_text(path.read_text() + "g\nf 1 3 4\n")
    other = tmp_path / "high.obj"
    other.write_text("v 0 0 1\nv 0 1 1\nv 1 0 1\nf 1 2 3\ng roof\nf 1 3 2\n")
    assert read_patches(path, more=[other]).names.tolist() == ["floor", "", "", "roof"]
