"""Runs on patches: what is checked before any line is cast, room for lines, files that cannot be written, outputs."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.patches import cube

import etendue
import etendue.radiosity.casting
from etendue.core import OptionError, OutputError
from etendue.engine import Checkpoint, Job
from etendue.film import read_exr, read_image
from etendue.products import saved_task
from etendue.products.patches import FactorRun, SolutionFiles, SolutionRun, room
from etendue.radiosity import PatchSource, RadiosityError, read_solution

#: Light leaves one wall.
LIT = {"reflectance": 0.5, "emission": np.repeat([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 4)}
BOX = cube(1)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def factors(**asked):
    return FactorRun(**{"source": BOX} | asked).task()


def solution(outputs=None, **asked):
    return SolutionRun(outputs=SolutionFiles(**outputs or {}), **{"source": BOX} | asked).task()


@pytest.mark.parametrize(
    ("ask", "asked", "text"),
    [
        (factors, {"limits": {"seconds": -1}}, "a budget in seconds must be a number above 0"),
        (factors, {"seed": "a"}, "a seed is a whole number of at least 0, not 'a'"),
        (factors, {"settings": {"lines": -1.0}}, "option 'lines' must be at least 0"),
        (factors, {"save_every": 0}, "the time between saves must be above 0 seconds, not 0"),
        (factors, {"source": "a.ply", "parameters": {"a": 1}}, "parameters are for scenes in XML"),
        (solution, {"outputs": {"files": (Path("a.tiff"),)}}, "take .npz, .vtu, .ply"),
        (solution, {"outputs": {"gather": 4}}, "gather is for pictures; write .exr or .png"),
        (solution, {"outputs": {"gather": -1}}, "gather is a whole number of at least 0"),
        (solution, {"outputs": {"spp": 0}}, "spp is a whole number of at least 1"),
        (solution, {"outputs": {"lightmap_size": 4}}, "lightmap_size is a whole number of at least 16"),
        (solution, {"outputs": {"uv": "a.glb"}}, "uv is for lightmaps"),
        (solution, {"outputs": {"files": (Path("a.exr"),), "error_picture": True}}, "an error picture is for .png"),
        (solution, {"source": "cornell-box", "mesh": {"sky": 0.5}}, "sky is for mesh files; a scene has its own"),
        (
            solution,
            {"source": "cornell-box", "mesh": {"two_sided": True}},
            "two_sided is for mesh files; in a scene, materials of type 'twosided'",
        ),
    ],
)
def test_a_task_is_checked_before_its_source_is_read(ask, asked, text):
    with pytest.raises(OptionError) as caught:
        ask(**asked)
    assert text in str(caught.value)
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    ("asked", "needed"),
    [
        ({"limits": {"bundles": 1}}, "at least two bundles to estimate the error"),
        ({"method": "multipath", "limits": {"points": 1}}, "at least two points to estimate the error"),
        ({"method": "boxes", "limits": {"passes": 1}}, "at least two passes to estimate the error"),
        ({"ambient": "fuzzy"}, "lines to estimate the error; leave it out"),
    ],
)
def test_what_a_picture_of_errors_needs(asked, needed):
    with pytest.raises(OptionError, match=f"{needed}$"):
        solution({"files": (Path("a.png"),), "error_picture": True}, **asked)


@pytest.mark.parametrize(
    "asked",
    [
        {"outputs": {"files": (Path("no/where.npz"),)}},
        {"checkpoint": Path("no/where")},
        {"outputs": {"lightmap": Path("no/where.glb")}},
    ],
)
def test_places_that_cannot_be_written(asked):
    with pytest.raises(OutputError, match="there is no folder"):
        solution(**asked)


@pytest.mark.parametrize("ask", [factors, solution])
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
    monkeypatch.setattr(room, "free_memory", lambda: 20 * 10_000 * 8)
    in_memory = []

    def look(run, *arguments):
        (record,) = run.measurement.records.values()
        in_memory.append(len(record) - sum(map(len, record.files)))
        return save(run, *arguments)

    save = Checkpoint.write
    monkeypatch.setattr(Checkpoint, "write", look)
    with pytest.raises(RadiosityError, match=r"do not fit into memory, .* do: ask for fewer, or make patches larger"):
        etendue.solve_radiosity(cube(2, **LIT), bundles=64)
    result = etendue.solve_radiosity(cube(2, **LIT), bundles=64, checkpoint="c")
    np.testing.assert_array_equal(result.solution.radiosity, whole.solution.radiosity)
    assert len(in_memory) > 2 and max(in_memory) < len(whole.segments) / 2
    with pytest.raises(RadiosityError, match="do not fit into memory"):  # the matrix is not in files
        etendue.solve_radiosity(cube(2, **LIT), solver="direct", bundles=1 << 14, checkpoint="d")


def test_a_disk_that_is_too_small(monkeypatch):
    monkeypatch.setattr(room.shutil, "disk_usage", lambda path: SimpleNamespace(free=2 * 20 * 10_000 * 8))
    with pytest.raises(RadiosityError, match="do not fit on the disk of 'c'"):
        etendue.solve_radiosity(cube(2, **LIT), bundles=1 << 14, checkpoint="c")
    assert not list(Path().iterdir())


def test_pictures_of_errors_and_lightmaps_are_outputs_as_well():
    outputs = SolutionFiles((Path("a.png"), Path("a.exr")), error_picture=True, lightmap=Path("m.exr"))
    assert list(map(str, outputs.written)) == ["a.png", "a.exr", "a-error.png", "m.exr", "m.glb"]
    with pytest.raises(OptionError, match=r"'m\.exr' is named for two outputs"):
        solution({"files": (Path("m.exr"),), "lightmap": Path("m.glb"), "uv": "a.glb"})


def test_few_bundles_have_an_error_on_a_gpu(monkeypatch, tmp_path):
    """It casts hundreds of a small scene at once, but an error needs several passes."""
    monkeypatch.setattr("etendue.radiosity.lines.abuffer.uses_cuda", lambda: True)
    etendue.solve_radiosity(cube(2, **LIT), bundles=16, save=tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as saved:
        assert (saved["radiosity_error"] > 0.0).all()


@pytest.mark.parametrize(
    ("files", "text"), [({"save": "a.ply"}, r"\.ply shows one"), ({"lightmap": "a.exr"}, "a lightmap shows one")]
)
def test_channels_that_cannot_be_shown_cost_no_line(files, text):
    with pytest.raises(RadiosityError, match=text):
        etendue.solve_radiosity(cube(1, emission=[[1.0, 2.0]] * 6), callback=pytest.fail, **files)


def test_what_was_asked_is_in_the_checkpoint():
    """In paths that hold in any folder."""
    files = (Path("a.npz"), Path("a.png"))
    outputs = {"files": files, "size": (8, 6), "gather": 2, "lightmap": Path("m.glb")}
    asked = {"source": "cornell-box", "max_area": 0.5, "limits": {"bundles": 4}, "seed": 3}
    task = solution(outputs, solver="jacobi", settings={"shot": False}, checkpoint=Path("c"), **asked)
    job = Job.open(task)
    job.checkpoint(job.runner().run()).write(Path("c"))
    here = Path().absolute()
    again, saved = saved_task("c", limits={"bundles": 16})
    source, product = again.source, again.product
    assert (source.max_area, source.size, source.for_light) == (0.5, (8, 6), True)
    assert source.open().fingerprint == saved.fingerprint == job.problem.fingerprint
    assert (product.solver, product.checkpoint, again.budget.samples, again.seed) == ("jacobi", Path("c"), 16, 3)
    assert product.outputs.files == (here / "a.npz", here / "a.png") and product.outputs.size == (8, 6)
    assert product.outputs.lightmap == here / "m.glb"
    mapped = SolutionFiles(lightmap=Path("m.glb"), uv="n.glb").to_dict()
    assert SolutionFiles.from_dict(mapped).uv == str(here / "n.glb")
    assert saved.settings_of(again.method) == job.method.settings
    again, _ = saved_task("c", limits={"bundles": 16}, save="b.exr")
    assert again.product.outputs.written == (Path("b.exr"),)
    renamed = SolutionFiles(lightmap=Path("m.glb")).renamed([Path("b.obj")])  # of a lightmap alone
    assert renamed.written == (Path("b.exr"), Path("b.obj"))


def test_pictures_and_lightmaps():
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
    assert result.picture.metadata["method"] == "path" and result.picture.metadata["bundles"] == 16
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

    def go(update):
        if gone.exists():
            gone.rmdir()

    asked = {"bundles": 16, "save": [gone / "s.npz", "s.vtu"], "checkpoint": gone / "c"}
    with pytest.raises(OutputError, match=r"cannot write 'gone/c'.*; cannot write 'gone/s.npz'.*are kept:") as caught:
        etendue.solve_radiosity(cube(2, **LIT), callback=go, **asked)
    assert Path("s.vtu").exists()
    kept = str(caught.value).partition("etendue resume '")[2].partition("'")[0]
    rest = etendue.resume(kept, scene=cube(2, **LIT), bundles=16, save="s.npz")
    assert rest.bundles == 16 and Path("s.npz").exists()


def test_a_bug_costs_no_line(monkeypatch):
    """What is no error of ours is told as one that says where the lines are."""

    def fail(*arguments, **named):
        raise MemoryError

    monkeypatch.setattr("etendue.products.patches.solutions.solve", fail)
    with pytest.raises(OutputError, match=r"evaluated: MemoryError; the lines are kept: etendue resume 'c'"):
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
    assert PatchSource(source=tmp_path / "box.obj", mesh={"emission": 1.0}, for_light=True).is_mesh
    (tmp_path / "box.mtl").write_text("newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKe 0.000 0 0\n")
    assert PatchSource(source=tmp_path / "box.obj", for_light=True).is_mesh
