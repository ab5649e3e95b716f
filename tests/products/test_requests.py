"""What is asked of lines: checked at once, in the words of who asks; kept in checkpoints; outputs from Python."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
from support.patches import cube

import etendue
import etendue.radiosity.casting
from etendue.cli.radiosity_outputs import Options
from etendue.core import BackendError, CheckpointError, OptionError, OutputError
from etendue.engine import Checkpoint
from etendue.film import read_exr, read_image
from etendue.jobs import (
    FormFactorRequest,
    HierarchyRequest,
    RadiosityRequest,
    SolutionOutputs,
    asked_before,
    lines,
    solutions,
)
from etendue.radiosity import RadiosityError, read_form_factors, read_solution

#: Light leaves one wall.
LIT = {"reflectance": 0.5, "emission": np.repeat([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 4)}
BOX = cube(1)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def factors(**asked):
    return FormFactorRequest(**{"source": BOX} | asked)


def radiosity(outputs=None, **asked):
    return RadiosityRequest(outputs=SolutionOutputs(**outputs or {}), **{"source": BOX} | asked)


@pytest.mark.parametrize(
    ("ask", "asked", "python", "terminal"),
    [
        (factors, {"seconds": -1}, "a budget in seconds must be a number above 0", "seconds (--time) must"),
        (factors, {"error": True}, "a budget in error must be a number above 0, not True", "error (--error) must"),
        (factors, {"bundles": 1.5}, "a budget in bundles must be a whole number", "bundles (--bundles) must"),
        (factors, {"seed": "a"}, "a seed is a whole number, not 'a'", "a seed"),
        (factors, {"lines": -1.0}, "option 'lines' must be at least 0", "option 'lines'"),
        (factors, {"save_every": 0}, "the time between saves must be above 0 seconds, not 0", "the time"),
        (factors, {"estimator": "F9"}, "there is no estimator 'F9'", "there is no estimator"),
        (factors, {"outputs": (Path("a.csv"),)}, "take .npz, .vf, .nc", "take .npz"),
        (factors, {"outputs": (Path("a.nc"),), "checkpoint": Path("a.nc")}, "'a.nc' is named for two", "'a.nc' is"),
        (factors, {"max_area": 1.0}, "max_area= is for scenes and mesh files", "--max-area is for"),
        (factors, {"source": "a.ply", "parameters": {"a": 1}}, "parameters= is for scenes in XML", "-P is for scenes"),
        (radiosity, {"solver": "gauss"}, "there is no solver 'gauss'", "there is no solver"),
        (radiosity, {"outputs": {"files": (Path("a.tiff"),)}}, "take .npz, .vtu, .ply", "take .npz"),
        (radiosity, {"outputs": {"gather": 4}}, "gather= is for pictures", "--gather is for pictures"),
        (radiosity, {"outputs": {"gather": -1}}, "gather= is a whole number of at least 0", "--gather is a"),
        (radiosity, {"outputs": {"samples": 0}}, "samples= is a whole number of at least 1", "--spp is a"),
        (
            radiosity,
            {"outputs": {"lightmap_size": 4}},
            "lightmap_size= is a whole number of at least 16",
            "--lightmap is",
        ),
        (radiosity, {"outputs": {"uv": "a.glb"}}, "uv= is for lightmaps; name the file of one", "as --lightmap 1024"),
        (
            radiosity,
            {"outputs": {"files": (Path("a.exr"),), "error_picture": True}},
            "error_picture= is for .png",
            "--error-picture is for .png",
        ),
        (
            radiosity,
            {"outputs": {"files": (Path("a.png"),), "error_picture": True}, "bundles": 1},
            "error_picture= needs at least two bundles",
            "--error-picture needs at least two",
        ),
        (
            radiosity,
            {"source": "cornell-box", "mesh": {"reflectance": 0.5}},
            "reflectance= is for mesh files; a scene has",
            "--reflectance is for",
        ),
        (
            radiosity,
            {"source": "cornell-box", "mesh": {"two_sided": True}},
            "two_sided= is for mesh files; in a scene, materials of type 'twosided'",
            "--two-sided is for",
        ),
    ],
)
def test_a_request_is_checked_at_once(ask, asked, python, terminal):
    for words, text in (({}, python), ({"wording": Options()}, terminal)):
        with pytest.raises(OptionError) as caught:
            ask(**asked, **words)
        assert text in str(caught.value)
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("kind", "asked", "needed"),
    [
        (RadiosityRequest, {"bundles": 1}, "at least two bundles to estimate the error"),
        (RadiosityRequest, {"solver": "multipath", "points": 1}, "at least two points to estimate the error"),
        (HierarchyRequest, {"bundles": 1}, "at least two passes to estimate the error"),
        (RadiosityRequest, {"ambient": "fuzzy"}, "lines to estimate the error; leave it out"),
    ],
)
def test_what_a_picture_of_errors_needs(kind, asked, needed):
    with pytest.raises(OptionError) as caught:
        kind(source=BOX, outputs=SolutionOutputs((Path("a.png"),), error_picture=True), **asked)
    assert str(caught.value) == f"error_picture= needs {needed}"


@pytest.mark.parametrize(
    ("ask", "asked", "text"),
    [
        (factors, {"outputs": (Path("no/where.npz"),)}, "there is no folder"),
        (radiosity, {"outputs": {"files": (Path("no/where.npz"),)}}, "there is no folder"),
        (radiosity, {"checkpoint": Path("no/where")}, "there is no folder"),
        (radiosity, {"outputs": {"lightmap": Path("no/where.glb")}}, "there is no folder"),
    ],
)
def test_places_that_cannot_be_written(ask, asked, text):
    with pytest.raises(OutputError, match=text):
        ask(**asked)


@pytest.mark.parametrize("ask", [factors, radiosity])
def test_records_that_cannot_be_written_cost_no_line(ask):
    Path("c.records").write_text("")
    with pytest.raises(OutputError, match=r"'c.records': it is not a folder; remove it, or choose another checkpoint"):
        ask(checkpoint=Path("c"))
    Path("c.records").unlink()
    Path("c.records").mkdir(mode=0o500)
    if not os.access("c.records", os.W_OK):  # as for every user but root
        with pytest.raises(OutputError, match="you may write to"):
            ask(checkpoint=Path("c"))
    Path("c.records").chmod(0o700)
    ask(checkpoint=Path("c"))
    assert not list(Path("c.records").iterdir())


def test_segments_go_to_files_where_memory_is_short(monkeypatch):
    """With a checkpoint, memory limits neither the number of bundles nor what is kept in it between saves."""
    whole = etendue.solve_radiosity(cube(2, **LIT), bundles=64)
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: 20 * 10_000 * 8)
    monkeypatch.setattr(lines, "free_memory", lambda: 20 * 10_000 * 8)
    in_memory = []

    def look(run, *arguments):
        (record,) = run.measurement.records.values()
        in_memory.append(len(record) - sum(map(len, record.files)))
        return save(run, *arguments)

    save = Checkpoint.write
    monkeypatch.setattr(Checkpoint, "write", look)
    with pytest.raises(RadiosityError, match="do not fit into memory"):
        etendue.solve_radiosity(cube(2, **LIT), bundles=64)
    result = etendue.solve_radiosity(cube(2, **LIT), bundles=64, checkpoint="c")
    np.testing.assert_array_equal(result.solution.radiosity, whole.solution.radiosity)
    assert len(in_memory) > 2 and max(in_memory) < len(whole.segments) / 2
    with pytest.raises(RadiosityError, match="do not fit into memory"):  # the matrix is not in files
        etendue.solve_radiosity(cube(2, **LIT), "direct", bundles=1 << 14, checkpoint="d")


def test_a_disk_that_is_too_small(monkeypatch):
    monkeypatch.setattr(lines.shutil, "disk_usage", lambda path: SimpleNamespace(free=2 * 20 * 10_000 * 8))
    with pytest.raises(RadiosityError, match="do not fit on the disk of 'c'"):
        etendue.solve_radiosity(cube(2, **LIT), bundles=1 << 14, checkpoint="c")
    assert not list(Path().iterdir())


def test_pictures_of_errors_and_lightmaps_are_outputs_as_well():
    outputs = SolutionOutputs((Path("a.png"), Path("a.exr")), error_picture=True, lightmap=Path("m.exr"))
    assert list(map(str, outputs.written)) == ["a.png", "a.exr", "a-error.png", "m.exr", "m.glb"]
    with pytest.raises(OptionError, match=r"'m\.exr' is named for two outputs"):
        radiosity({"files": (Path("m.exr"),), "lightmap": Path("m.glb"), "uv": "a.glb"})


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setattr(solutions, "find_spec", lambda name: None)
    with pytest.raises(BackendError, match=r"pip install 'etendue\[lightmap\]', or give uv="):
        radiosity({"lightmap": Path("m.glb")})


@pytest.mark.parametrize(
    ("files", "text"),
    [({"files": (Path("a.ply"),)}, r"\.ply shows one"), ({"lightmap": Path("a.exr")}, "a lightmap shows one")],
)
def test_channels_that_cannot_be_shown_cost_no_line(files, text):
    request = radiosity(files, source=cube(1, emission=[[1.0, 2.0]] * 6))
    with pytest.raises(RadiosityError, match=text):
        request.load()


def test_each_names_its_own_option_where_memory_ends(monkeypatch, capsys):
    from etendue.cli.main import main

    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: 20 * 10_000 * 8)
    with pytest.raises(RadiosityError, match=r"do not fit into memory, .* do: ask for fewer \(bundles=\), or"):
        etendue.solve_radiosity(cube(2, **LIT), bundles=4096)
    meshio.write("room.ply", meshio.Mesh(BOX.vertices, [("quad", BOX.faces.astype(np.int32))]))
    assert main(["radiosity", "room.ply", "--emission", "1", "--bundles", "4096"]) == 2
    assert "ask for fewer (--bundles), or" in capsys.readouterr().err


def test_a_mesh_from_python():
    meshio.write("room.ply", meshio.Mesh(BOX.vertices, [("quad", BOX.faces.astype(np.int32))]))
    with pytest.raises(etendue.SceneError, match=r"'room.ply' has no light; read it by etendue.radiosity.read_patches"):
        etendue.solve_radiosity("room.ply", bundles=8)


def test_what_was_asked_is_in_the_checkpoint(monkeypatch):
    """In paths that hold in any folder; not if the source was in memory."""
    outputs = SolutionOutputs((Path("a.npz"), Path("a.png")), size=(8, 6), gather=2, lightmap=Path("m.glb"), uv="n.glb")
    asked = RadiosityRequest(
        source="cornell-box", outputs=outputs, solver="jacobi", max_area=0.5, parameters={"a": 1}, shot=False, seed=3
    )
    saved = Checkpoint.__new__(Checkpoint)
    saved.notes = asked.notes()
    here = Path().absolute()
    again = asked_before(saved, bundles=16)
    known = {name: getattr(again, name) for name in ("source", "solver", "max_area", "parameters", "shot", "seed")}
    assert known == {
        "source": "cornell-box",
        "solver": "jacobi",
        "max_area": 0.5,
        "parameters": {"a": "1"},
        "shot": False,
        "seed": 3,
    }
    assert again.outputs.files == (here / "a.npz", here / "a.png") and again.outputs.size == (8, 6)
    assert (again.outputs.lightmap, again.outputs.uv) == (here / "m.glb", str(here / "n.glb"))
    assert again.bundles == 16 and asked.bundles is None
    assert asked_before(saved, output=Path("b.exr")).files == (Path("b.exr"),)
    saved.notes = RadiosityRequest(source="cornell-box", outputs=SolutionOutputs(lightmap=Path("m.glb"))).notes()
    assert asked_before(saved, output=Path("b.obj")).files == (Path("b.exr"), Path("b.obj"))
    assert RadiosityRequest(source=BOX).notes() == {}
    saved.notes = {}
    with pytest.raises(CheckpointError, match="does not contain its request"):
        asked_before(saved)


def test_the_command_line_goes_on_with_a_checkpoint_from_python(capsys):
    from etendue.cli.main import main

    meshio.write("room.ply", meshio.Mesh(BOX.vertices, [("quad", BOX.faces.astype(np.int32))]))
    etendue.compute_form_factors("room.ply", "F4", bundles=16, checkpoint="c", save="f.npz")
    assert main(["resume", "c", "--bundles", "32"]) == 0
    assert capsys.readouterr().out == f"{Path('f.npz').absolute()}\n"
    expected = etendue.compute_form_factors(BOX, "F4", bundles=32).factors
    np.testing.assert_allclose(read_form_factors("f.npz").matrix.toarray(), expected.matrix.toarray(), atol=1e-12)


def test_pictures_and_lightmaps_from_python():
    pytest.importorskip("xatlas")
    files = ["s.npz", "p.exr", "p.png"]
    result = etendue.solve_radiosity(
        "cornell-box",
        bundles=16,
        max_area=0.5,
        save=files,
        size=(12, 8),
        gather=2,
        error_picture=True,
        lightmap="m.glb",
        lightmap_size=64,
        checkpoint="c",
    )
    assert {path.name for path in Path().iterdir()} == {*files, "p-error.png", "m.exr", "m.glb", "c", "c.records"}
    assert result.picture.metadata["method"] == "radiosity-gather" and result.picture.metadata["bundles"] == 16
    np.testing.assert_allclose(read_exr("p.exr").image, result.picture.image, rtol=1e-3)
    assert read_image("p.png").shape == read_image("p-error.png").shape == (8, 12, 3)
    assert max(result.lightmap.values.shape[:2]) <= 64
    np.testing.assert_array_equal(read_solution("s.npz")[0].radiosity, result.solution.radiosity)
    assert etendue.solve_radiosity("cornell-box", bundles=8, max_area=0.5).picture is None
    with pytest.raises(OptionError, match="a picture needs a scene with a camera"):
        etendue.solve_radiosity(cube(1, emission=1.0), bundles=8, save="q.png")


def test_a_file_that_cannot_be_written_keeps_no_other_from_being_written(tmp_path, monkeypatch):
    """And where the checkpoint cannot be written either, the lines are among the temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    gone = Path("gone")
    gone.mkdir()

    def go(progress):
        if gone.exists():
            gone.rmdir()

    asked = {"bundles": 16, "save": [gone / "s.npz", "s.vtu"], "checkpoint": gone / "c"}
    with pytest.raises(OutputError, match=r"cannot write 'gone/c'.*; cannot write 'gone/s.npz'.*are kept:") as caught:
        etendue.solve_radiosity(cube(2, **LIT), callback=go, **asked)
    assert Path("s.vtu").exists()
    kept = str(caught.value).partition("resume='")[2].partition("'")[0]
    assert etendue.solve_radiosity(cube(2, **LIT), bundles=16, resume=kept).bundles == 16


def test_a_bug_costs_no_line(monkeypatch):
    """What is no error of ours is told as one that says where the lines are."""

    def fail(*arguments, **named):
        raise MemoryError

    monkeypatch.setattr("etendue.jobs.solving.solve", fail)
    with pytest.raises(
        OutputError, match=r"the lines could not be evaluated: MemoryError; the lines are kept: resume='c'"
    ):
        etendue.solve_radiosity(cube(2, **LIT), bundles=8, checkpoint="c")


def test_a_model_whose_materials_emit_is_a_scene(tmp_path):
    """OBJ with MTL: reflectance of Kd, emission pi Ke; with values of faces it is a mesh, as without a lamp."""
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    text = "mtllib box.mtl\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
    for number, side in enumerate(sides):
        text += f"usemtl {'lamp' if number == 1 else 'wall'}\nf " + " ".join(map(str, side)) + "\n"
    (tmp_path / "box.obj").write_text(text)
    (tmp_path / "box.mtl").write_text(
        "newmtl wall\nKd 0.5 0.5 0.5\nKs 0 0 0\nnewmtl lamp\nKd 0 0 0\nKs 0 0 0\nKe 2 2 2\n"
    )
    result = etendue.solve_radiosity(str(tmp_path / "box.obj"), bundles=64)
    patches = result.patches
    inside = patches.areas > 0
    assert set(np.round(patches.reflectance[inside].ravel(), 6)) == {0.0, 0.5}
    assert patches.emission.max() == pytest.approx(2 * np.pi)
    assert result.is_balanced
    given = RadiosityRequest(source=str(tmp_path / "box.obj"), mesh={"emission": 1.0})
    assert given.is_mesh
    (tmp_path / "box.mtl").write_text("newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKe 0.000 0 0\n")
    assert RadiosityRequest(source=str(tmp_path / "box.obj")).is_mesh
