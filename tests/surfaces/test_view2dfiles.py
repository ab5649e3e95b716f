"""Surfaces of View2D's input: every record, and their form factors by the command."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.cli.main import main
from etendue.radiosity import PatchError, exact_form_factors, read_form_factors, read_patches

HEAD = """T A floor, a ceiling and a screen ! and a comment
C 0 0 1e-6 8 0 1
G 2
V 1 0 0
V 2 4 0   / behind data
V 3 4 3
v 4 0 3
V 5 1 1.5
V 6 3 1.5
V 7 1 0
V 8 2 0
"""
FLOOR, CEILING, END = "S 1 1 2 0 0 0 .9 floor\n", "S 2 3 4 0 0 0 .8 ceiling\n", "End\n 1 --- 2 a drawing\n"
#: Between floor and ceiling, and what is left of it beside the screen.
OPEN, BESIDE = (5 - 3) / 4, (np.hypot(2, 3) - 3) / 4


def read(tmp_path, text, **arguments):
    path = tmp_path / "a.vs2"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    return read_patches(path, **arguments)


def test_surfaces_face_left_and_go_on_without_end(tmp_path):
    patches = read(tmp_path, HEAD + FLOOR + CEILING + END)
    assert list(patches.names) == ["floor", "ceiling"] and patches.period == (0, 1)
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.1, 0.2])
    np.testing.assert_allclose(patches.areas, 4)
    np.testing.assert_allclose(patches.normals, [[0, 0, 1], [0, 0, -1]], atol=1e-15)
    np.testing.assert_allclose(exact_form_factors(patches).matrix.toarray(), [[0, OPEN], [OPEN, 0]], atol=1e-14)


def test_obstacles_and_turned_surfaces(tmp_path):
    hidden = exact_form_factors(read(tmp_path, HEAD + FLOOR + CEILING + "O 3 5 6\n" + END))
    assert len(hidden) == 2 and hidden.matrix[0, 1] == pytest.approx(BESIDE, abs=1e-14)
    turned = exact_form_factors(read(tmp_path, HEAD + FLOOR + CEILING.replace("3 4", "4 3") + END))
    assert turned.matrix.nnz == 0 and turned.dark[0] == pytest.approx(OPEN, abs=1e-14)


def test_parts_and_combined_surfaces(tmp_path):
    text = HEAD + FLOOR + "S 2 7 8 0 1 0 .5 strip\n" + CEILING.replace("S 2", "S 3") + END
    parts = exact_form_factors(read(tmp_path, text))
    np.testing.assert_allclose(parts.areas, [3, 1, 4])
    assert parts.areas @ parts.matrix[:, [2]].toarray() == pytest.approx(4 * OPEN, abs=1e-13)
    null = read(tmp_path, HEAD + FLOOR + "N 2 8 7 0 1 0\n" + CEILING.replace("S 2", "S 3") + END)
    np.testing.assert_allclose(null.areas, [3, 4])
    np.testing.assert_allclose(exact_form_factors(null).matrix[0, 1], parts.matrix[0, 2], atol=1e-13)
    joined = read(
        tmp_path, HEAD + "S 1 1 8 0 0 0 .9 floor\nS 2 8 2 0 0 1 .9 rest\n" + CEILING.replace("S 2", "S 3") + END
    )
    np.testing.assert_allclose(exact_form_factors(joined).matrix.toarray(), [[0, OPEN], [OPEN, 0]], atol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace("G 2", "F 3") + FLOOR, "line 3: geometry '3' is not known: there is 2"),
        (HEAD + FLOOR.replace("2 0 0 0", "2 2 0 0"), "surface 1 is hidden by obstacle 2"),
        (HEAD + FLOOR.replace("1 2 0", "1 9 0"), "there is no vertex 9"),
        (HEAD + "S 1 1 2 0 0\n", "record S is incomplete"),
        (HEAD + END, "has no surfaces of View2D"),
        (HEAD + FLOOR.replace("S 1", "S 2"), "surface 2 comes after surface 0"),
        (HEAD + FLOOR + "S 2 5 6 0 1 0 .5 strip\n", "'strip' in 'floor'"),
    ],
)
def test_errors_name_the_line(tmp_path, text, message):
    with pytest.raises(PatchError, match=message):
        read(tmp_path, text)


def test_a_plane_and_other_files_or_periods(tmp_path):
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(PatchError, match="of space cannot be in one run"):
        read(tmp_path, HEAD + FLOOR + END, obstacles=[tmp_path / "b.obj"])
    with pytest.raises(PatchError, match="goes on along y already"):
        read(tmp_path, HEAD + FLOOR + END, periodic=(4, 2))
    assert read(tmp_path, HEAD + FLOOR + CEILING + END, periodic=(4, 0)).period == (4, 1)


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    read(tmp_path, HEAD + FLOOR + CEILING + "O 3 5 6\n" + END)
    assert main(["form-factors", "a.vs2", "-m", "auto", "-o", "f.npz", "-o", "f.vf"]) == 0
    assert "method exact: integrals take about" in capsys.readouterr().err
    assert read_form_factors("f.npz").matrix[0, 1] == pytest.approx(BESIDE, abs=1e-14)
    assert main(["form-factors", "a.vs2", "--bundles", "256", "-o", "g.npz"]) == 0
    assert read_form_factors("g.npz").matrix[0, 1] == pytest.approx(BESIDE, abs=5e-3)
