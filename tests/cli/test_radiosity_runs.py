"""`etendue form-factors` and `etendue radiosity`: budgets, Ctrl-C, checkpoints, meshes with arrays, memory."""

from __future__ import annotations

import json
import re
import shlex
import signal
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
from support import passes
from support.patches import box, joined, square

import etendue
from etendue.cli.main import main
from etendue.core import OutputError
from etendue.radiosity import LineCasting, Patches, read_form_factors, thermal

meshio = pytest.importorskip("meshio")


def run(command: str) -> int:
    return main(shlex.split(command))


def lit_room():
    """A room with a small lamp, and a pebble that few lines meet: vertices, faces, emission, reflectance."""
    lamp, pebble = square((0.47, 0.48, 0.97), (0, 0.05, 0), (0.05, 0, 0)), box((0.6, 0.3, 0.4), (0.605, 0.305, 0.405))
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), pebble, lamp)
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 100.0, 0.0)
    return vertices, faces, emission, np.linspace(0.2, 0.8, len(faces))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, variant):
    monkeypatch.chdir(tmp_path)
    vertices, faces, emission, reflectance = lit_room()
    arrays = {"glow": [emission], "rho": [reflectance], "T": [300 + emission], "wall": [np.arange(len(faces)) // 4]}
    meshio.write("room.vtu", meshio.Mesh(vertices, [("quad", faces)], cell_data=arrays))


def arrays_of(name):
    with np.load(name) as saved:
        known = {key: saved[key] for key in saved.files}
    return known, json.loads(str(known.pop("metadata")))


def interrupt_after(steps, monkeypatch):
    """Ctrl-C while lines are cast."""
    cast = LineCasting.step

    def step(self, iteration, seed, state):
        if iteration == steps:
            passes.press_ctrl_c()
        return cast(self, iteration, seed, state)

    monkeypatch.setattr(LineCasting, "step", step)


def test_a_mesh_with_arrays(capsys):
    command = "radiosity room.vtu --emission glow --reflectance rho -o s.npz --bundles 128"
    assert run(command) == 0
    err = capsys.readouterr().err
    assert "the light of one emitter was sent by" in err and "6 small patches, which few lines meet" in err
    assert "warning" not in err
    saved, _ = arrays_of("s.npz")
    _, _, emission, reflectance = lit_room()
    np.testing.assert_allclose(saved["emission"][:, 0], emission)
    np.testing.assert_allclose(saved["reflectance"][:, 0], reflectance)
    power = (saved["areas"] * (1 - reflectance) * saved["irradiance"][:, 0]).sum()
    assert power == pytest.approx((saved["areas"] * emission).sum(), rel=0.02)

    assert run(command + " --no-shot --no-local-rays") == 0
    err = capsys.readouterr().err
    assert "rays" not in err.replace("with_local_rays", "")
    worse, _ = arrays_of("s.npz")
    assert worse["irradiance_error"].sum() > 2 * saved["irradiance_error"].sum()


def test_temperatures_and_patches_by_number(capsys):
    assert run("radiosity room.vtu --temperature T --reflectance 0.3 --ids wall -o s.npz --bundles 32") == 0
    saved, _ = arrays_of("s.npz")
    vertices, faces, emission, _ = lit_room()
    assert saved["labels"].tolist() == list(range(8))
    patches = Patches(vertices, faces, ids=np.arange(len(faces)) // 4)
    areas = np.bincount(patches.front, patches.face_areas)
    means = np.bincount(patches.front, patches.face_areas * (300 + emission)) / areas
    np.testing.assert_allclose(saved["emission"], thermal(patches, means, 0.7).emission)


@pytest.mark.parametrize("name", ["rho", "gap", "colour"])
def test_patches_are_numbered_by_whole_numbers(name, capsys):
    vertices, faces, emission, reflectance = lit_room()
    gap, colour = np.where(emission > 0, np.nan, 1.0), np.ones((len(faces), 3))
    arrays = {"rho": [reflectance], "gap": [gap], "colour": [colour]}
    meshio.write("odd.vtu", meshio.Mesh(vertices, [("quad", faces)], cell_data=arrays))
    assert run(f"form-factors odd.vtu --ids {name}") == 3
    assert f"'{name}' has no whole number for each face" in capsys.readouterr().err


def test_a_mesh_under_a_sky_with_channels(capsys):
    vertices, faces, *_ = lit_room()
    meshio.write("open.ply", meshio.Mesh(vertices, [("quad", faces[4:].astype(np.int32))]))
    assert run("radiosity open.ply --sky 1,0.5,0.2 --reflectance 0.5 -o s.npz --bundles 32") == 0
    saved, _ = arrays_of("s.npz")
    np.testing.assert_allclose(saved["irradiance"], saved["irradiance"][:, :1] * [1, 0.5, 0.2])
    assert "the sky" in capsys.readouterr().err


def test_a_stopped_run_keeps_its_work_and_resumes_to_the_same(monkeypatch, capsys):
    """Bit by bit; after Ctrl-C there is a solution on what was cast."""
    command = "radiosity room.vtu --emission glow --reflectance rho"
    assert run(f"{command} -o whole.npz --bundles 240 --seed 5") == 0
    assert [path.name for path in Path().glob("whole*")] == ["whole.npz"]  # no checkpoint of what is finished
    with monkeypatch.context() as patch:
        interrupt_after(11, patch)
        assert run(f"{command} -o part.npz --bundles 240 --seed 5") == 130
    assert "stopping after this pass" in capsys.readouterr().err
    assert 96 <= arrays_of("part.npz")[1]["bundles"] < 240
    assert run("resume part.checkpoint") == 0
    assert capsys.readouterr().out == f"{Path('part.npz').absolute()}\n"
    (resumed, known), (whole, same) = arrays_of("part.npz"), arrays_of("whole.npz")
    assert known["bundles"] == same["bundles"] == 240
    assert resumed.keys() == whole.keys()
    for name, array in whole.items():
        np.testing.assert_array_equal(resumed[name], array, err_msg=name)


def test_a_checkpoint_goes_on_to_more_of_the_same_and_to_nothing_else(capsys):
    vertices, faces, *_ = lit_room()
    meshio.write("other.vtu", meshio.Mesh(vertices, [("quad", faces[:30])]))
    assert run("form-factors room.vtu --bundles 40 --checkpoint c") == 0
    assert run("resume c --bundles 64 -o more.npz") == 0
    assert arrays_of("more.npz")[1]["bundles"] == 64
    assert run("resume c --bundles 72 -o more.npz -o more.vf") == 0
    assert arrays_of("more.npz")[1]["bundles"] == 72 and Path("more.vf").is_file()
    for arguments, message in (
        ("", "used up; give a new one"),
        ("--spp 3", "method 'lines' counts bundles: give bundles in place of spp"),
        ("--particles 3", "is no file of particles"),
        ("--bundles 50", "72 bundles, more than 50"),
        ("--bundles 80 -o a.vtu", "take .npz"),
        ("--bundles 80 --scene other.vtu", "the scene is not the one"),
        ("--bundles 80 --scene gone.vtu", "there is no mesh file gone.vtu"),
    ):
        capsys.readouterr()
        assert run(f"resume c {arguments}") > 0
        assert message in capsys.readouterr().err.splitlines()[-1]


def test_pictures_are_resumed_as_they_were_asked_for(capsys, variant):
    command = "radiosity cornell-box --max-area 0.5 --size 24x16 --error-picture --flat"
    assert run(f"{command} -o p.png --bundles 16 --checkpoint c --variant {variant}") == 0
    before = Path("p.png").read_bytes()
    capsys.readouterr()
    assert run(f"resume c --bundles 64 --variant {variant}") == 0
    names = [str(Path(name).absolute()) for name in ("p.png", "p-error.png")]
    assert capsys.readouterr().out.split() == names
    after = Path("p.png").read_bytes()
    assert after != before and after[16:24] == before[16:24] == bytes([0, 0, 0, 24, 0, 0, 0, 16])


def test_ctrl_c_while_the_run_begins(monkeypatch, capsys):
    """Before the session can be told to stop: it must not go on in its thread."""
    from etendue.cli import lines

    def interrupted(*arguments, **named):
        session = start(*arguments, **named)
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            threading.Timer(0.2, pressed.set).start()
        return session

    def late(self, problem, seed):
        pressed.wait()
        prepare(self, problem, seed)

    start, prepare, pressed = lines.start_job, LineCasting.prepare, threading.Event()
    monkeypatch.setattr(lines, "start_job", interrupted)
    monkeypatch.setattr(LineCasting, "prepare", late)
    assert run("form-factors room.vtu --checkpoint c") == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not Path("factors.npz").exists() and not Path("c").exists()
    assert "etendue-session" not in {thread.name for thread in threading.enumerate()}


def test_ctrl_c_before_any_line(monkeypatch, capsys):
    def interrupted(self, problem, seed):
        passes.press_ctrl_c()
        prepare(self, problem, seed)

    prepare = LineCasting.prepare
    monkeypatch.setattr(LineCasting, "prepare", interrupted)
    assert run("form-factors room.vtu --checkpoint c") == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not Path("factors.npz").exists() and not Path("c").exists()


def test_a_file_that_cannot_be_written_costs_no_line(tmp_path, monkeypatch, capsys):
    def full(path, *arguments, **named):
        raise OutputError(f"cannot write '{path}': no space left")

    with monkeypatch.context() as patch:
        patch.setattr("etendue.products.patches.solution_files.save_solution", full)
        patch.setattr(tempfile, "tempdir", str(tmp_path))
        assert run("radiosity room.vtu --emission glow --bundles 24") == 5
    err = capsys.readouterr().err.splitlines()[-1]
    assert err.startswith("error: cannot write ") and "no space left; the lines are kept: etendue resume" in err
    assert run(f"resume{err.partition('etendue resume')[2]}") == 0
    assert Path("solution.vtu").is_file()


def test_the_words_of_progress():
    said = []
    options = {"bundles": 20, "callback": lambda update: said.append(str(update.progress))}
    etendue.compute_form_factors(Patches(*lit_room()[:2]), **options)
    assert len(said) == 3
    for words, bundles in zip(said, (8, 16, 20), strict=True):
        assert re.match(rf"{bundles} bundles, [\d.e+]+ segments, [\d.]+s, ", words) and re.search(
            r"\d [MG]segments/s", words
        )
    said.clear()
    etendue.solve_radiosity("cornell-box", "multipath", points=1 << 12, callback=options["callback"])
    assert re.match(r"4096 lines, [\d.e+]+ segments, ", said[-1])


def test_budgets_in_time_and_error(capsys):
    assert run("radiosity room.vtu --emission glow --reflectance rho -o s.npz --time 0.4") == 0
    cast = arrays_of("s.npz")[1]["bundles"]
    assert cast >= 8 and cast % 8 == 0
    assert run("radiosity room.vtu --emission glow --reflectance rho -o s.npz --error 0.03") == 0
    saved, known = arrays_of("s.npz")
    light = (saved["areas"][:, None] * saved["irradiance"]).sum()
    assert (saved["areas"][:, None] * saved["irradiance_error"]).sum() / light < 0.031
    assert known["bundles"] >= 128
    assert run("form-factors room.vtu --error 0.05 --bundles 4096") == 0
    assert 128 <= arrays_of("factors.npz")[1]["bundles"] < 4096


def test_more_lines_than_memory(monkeypatch, capsys):
    monkeypatch.setattr("etendue.radiosity.casting.free_memory", lambda: 20 * 10_000 * 8)
    assert run("radiosity room.vtu --emission glow --bundles 4096") == 2
    err = capsys.readouterr().err
    assert "4096 bundles of lines through 31 patches do not fit into memory" in err and "ask for fewer" in err
    assert len(err.splitlines()) == 1 and not Path("solution.vtu").exists()
    assert run("radiosity room.vtu --emission glow --time 60") == 0
    assert "memory holds no more than these" in capsys.readouterr().err
    assert Path("solution.vtu").exists()


def test_open_and_crowded_meshes_are_said_and_duplicates_left_out(capsys):
    vertices, faces, *_ = lit_room()
    kept = np.concatenate([faces[:23], faces[:1]]).astype(np.int32)
    meshio.write("odd.ply", meshio.Mesh(vertices, [("quad", kept)]))
    assert run("form-factors odd.ply --bundles 16") == 0
    err = capsys.readouterr().err
    assert "1 are duplicates; they are left out" in err and "not closed, 4 open edges" in err
    assert "% of what patches see is the sky" in err


@pytest.mark.parametrize("name", ["factors.npz", "factors.nc"])
def test_a_face_without_area_moves_no_row(name, capsys):
    if name.endswith(".nc"):
        pytest.importorskip("h5netcdf")
    vertices, faces, *_ = lit_room()
    sound = faces[:20].copy()
    sound[5] = sound[5, ::-1]  # rows 5 and 6 differ: the sky is behind the first
    broken = sound.copy()
    broken[4] = broken[4, 0]
    for file, rows in (("sound.ply", sound), ("broken.ply", broken)):
        meshio.write(file, meshio.Mesh(vertices, [("quad", rows.astype(np.int32))]))
    found = []
    for file in ("sound.ply", "broken.ply"):
        assert run(f"form-factors {file} -o {name} --bundles 64") == 0
        found.append(read_form_factors(name))
    assert "face 4 (counted from 0)" in capsys.readouterr().err
    factors = found[1]
    assert len(factors) == 20 and factors.face.tolist() == factors.label.tolist() == list(range(20))
    assert factors.sky[4] == factors.areas[4] == factors.matrix[[4]].nnz == 0
    others = np.arange(20) != 4
    # What was hidden by the broken face changes by a little: the share of one of 20 faces.
    np.testing.assert_allclose(factors.sky[others], found[0].sky[others], atol=0.2)
    assert factors.sky[5] > 0.9 and factors.sky[6] < 0.5


@pytest.mark.parametrize("more", ["", "-m exact"])
def test_form_factors_are_written_to_every_file(more, capsys):
    vertices, faces = box((0, 0, 0), (1, 1, 1), 1, inward=True)
    meshio.write("box.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    bundles = "" if more else "--bundles 8"
    assert run(f"form-factors box.ply {bundles} {more} -o a.npz -o b.vf -o c.npz") == 0
    assert capsys.readouterr().out == "a.npz\nb.vf\nc.npz\n" and Path("b.vf").is_file()
    np.testing.assert_array_equal(arrays_of("a.npz")[0]["data"], arrays_of("c.npz")[0]["data"])
    assert run(f"form-factors box.ply {bundles} {more} -o a.npz -o ./a.npz") == 2
    assert "named for two outputs" in capsys.readouterr().err


def test_groups_survive_subdivision(capsys):
    for area, parts in ((1, 31), (0.01, 607)):
        assert run(f"form-factors room.vtu -o f{parts}.npz --ids wall --max-area {area} --bundles 256") == 0
        assert f"8 patches of {parts} faces" in capsys.readouterr().err
    coarse, fine = read_form_factors("f31.npz"), read_form_factors("f607.npz")
    assert fine.label.tolist() == list(range(8)) and fine.face.tolist() == list(range(0, 32, 4))
    np.testing.assert_allclose(fine.matrix.toarray()[:6, :6], coarse.matrix.toarray()[:6, :6], atol=0.01)
    assert run("radiosity room.vtu -o s.npz --emission glow --ids wall --max-area 0.1 --bundles 16") == 0
    saved, _ = arrays_of("s.npz")
    assert len(saved["face"]) == len(saved["label"]) > 31 and (saved["label"] == saved["face"] // 4).all()
