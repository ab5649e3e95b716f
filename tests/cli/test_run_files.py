"""`etendue run`: what a run file asks for is what is rendered and kept; what is wrong in one is said before."""

from __future__ import annotations

import csv
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from support import passes
from support.run_files import SCENE, example

import etendue
from etendue import film
from etendue.cli.main import main
from etendue.core import OutputError, Result
from etendue.engine import Checkpoint
from etendue.products import Picture

BOX = '[scene]\nbundled = "cornell-box"\nsize = [16, 16]\n[method]\nname = "path"\n'


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("etendue.cli.running.set_threads", lambda count: None)  # that of the session stays
    return tmp_path


def table(path: str) -> list[dict[str, str]]:
    with open(path, encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_run_keeps_pictures_at_their_times_and_the_error_over_time(folder, capsys, monkeypatch):
    # At least 50 ms, so that a fast machine is not done before the saves, which hold 10 and 30 passes at most.
    passes.watch(monkeypatch, "bpt", lambda method, iteration: time.sleep(0.05))
    etendue.render("cornell-box", "path", spp=2048, size=(16, 16), save="reference.exr")
    Path("a.toml").write_text(
        'seed = 5\n[scene]\nbundled = "cornell-box"\nsize = [16, 16]\n'
        '[method]\nname = "bpt"\nsettings = {split_layers = true, samples_per_pass = 16}\n'
        "[budget]\nspp = 640\n[autosave]\ntimes = [0.5, 1.5]\n"
        '[output]\nfolder = "out/deep"\nname = "box"\npng = true\n'
        '[reference]\nfile = "reference.exr"\ntrim = 0.02\n'
    )
    assert main(["run", "a.toml"]) == 0
    out, err = capsys.readouterr()
    names = [f"box{stamp}.{suffix}" for stamp in ("", "-0.5s", "-1.5s") for suffix in ("exr", "png")]
    names += ["box.log", "box.csv", "box.checkpoint", "box.html"]
    assert sorted(os.listdir("out/deep")) == sorted(names)
    assert sorted(out.split()) == sorted(str(Path("out/deep") / name) for name in names)

    rows = table("out/deep/box.csv")
    assert [row["autosave"] for row in rows] == ["0.5", "1.5", ""]
    reference = film.read_image("reference.exr")
    for row, name in zip(rows, ("box-0.5s.exr", "box-1.5s.exr", "box.exr"), strict=True):
        result = film.read_exr(f"out/deep/{name}")
        assert (result.metadata["seed"], result.metadata["method"]) == (5, "bpt")
        assert int(row["passes"]) == result.metadata["passes"]
        assert float(row["rays"]) == result.metadata["rays"]
        assert float(row["relmse"]) == pytest.approx(film.relative_mse(result.image, reference), rel=1e-6)
        assert float(row["relmse_trimmed"]) == pytest.approx(film.relative_mse(result.image, reference, 0.02), rel=1e-6)
        assert float(row["luminance_rmse"]) == pytest.approx(film.luminance_rmse(result.image, reference), rel=1e-6)
        assert float(row["rendering_seconds"]) <= float(row["seconds"])
        parts = [layer for key, layer in result.layers.items() if key != "image"]
        assert len(parts) > 2
        np.testing.assert_allclose(sum(parts), result.image, rtol=1e-3, atol=1e-4)
    first, second, end = ({k: float(v) for k, v in row.items() if v} for row in rows)
    assert first["seconds"] >= 0.5
    assert second["seconds"] >= 1.5
    assert 4 * first["passes"] <= end["passes"] == 40
    # Not relMSE with all pixels, which a single rare path decides at this size.
    assert end["relmse_trimmed"] < first["relmse_trimmed"]
    assert end["luminance_rmse"] < first["luminance_rmse"]
    log = Path("out/deep/box.log").read_text("utf-8").splitlines()
    assert "cornell-box" in log[1]
    assert '"split_layers": true' in log[2]
    assert [line.split("  ", 1)[1].split(":")[0] for line in log[3:]] == [
        "autosave 0.5 s",
        "autosave 1.5 s",
        "end (samples)",
    ]
    assert "relMSE" in log[-1]
    assert "autosave 0.5 s: " in err
    page = Path("out/deep/box.html").read_text("utf-8")
    for words in ("Error over time", "Error against the reference", "etendue run a.toml", "[autosave]", "split layers"):
        assert words in page
    # The last point of the plot is the end of the run; the table and the plot read the clock one after the other.
    (last,) = set(re.findall(r" after ([0-9.]+) s\.", page))
    assert float(last) == pytest.approx(end["seconds"], abs=0.25)


def test_paths_are_relative_to_the_file_and_the_example_of_the_manual_runs(folder, capsys, monkeypatch):
    home = folder / "experiments"
    home.mkdir()
    (home / "scene.xml").write_text(SCENE)
    etendue.render(home / "scene.xml", "path", spp=4, size=(24, 18), save=home / "reference.exr")
    (home / "glass.toml").write_text(example((24, 18), "0.1, 0.3"))
    assert main(["run", "experiments/glass.toml", "--check"]) == 0
    assert "is in order: vcm on" in capsys.readouterr().out
    assert not (home / "results").exists()
    assert main(["run", "experiments/glass.toml"]) == 0
    written = sorted(os.listdir(home / "results"))
    assert {"glass.exr", "glass-merge.exr", "glass-0.1s.exr", "glass-0.1s-merge.exr", "glass-0.3s.png"} <= set(written)
    assert {"glass.log", "glass.csv", "glass.checkpoint", "glass.html"} <= set(written)
    named = capsys.readouterr().out.split()
    assert sorted(Path(name).name for name in named) == written
    merge = film.read_exr(home / "results" / "glass-merge.exr")
    assert list(merge.layers) == ["image"]
    assert merge.metadata["layer"] == "merge"
    # The checkpoint knows the camera: the scene's own would have another fingerprint, and be refused.
    before = film.read_exr(home / "results" / "glass.exr").metadata["passes"]
    assert main(["resume", "experiments/results/glass.checkpoint", "--time", "0.1"]) == 0
    assert film.read_exr(home / "results" / "glass.exr").metadata["passes"] > before


def test_the_camera_and_the_variables_reach_the_scene(folder):
    Path("scene.xml").write_text(SCENE)
    base = '[scene]\nfile = "scene.xml"\nparameters = {res = 12}\n[method]\nname = "path"\n[budget]\nspp = 2\n'
    Path("a.toml").write_text(base)
    Path("b.toml").write_text(f"{base}[camera]\norigin = [0, 5, 0.1]\ntarget = [0, 0, 0]\nfov = 20\n")
    assert main(["run", "a.toml"]) == main(["run", "b.toml"]) == 0
    a, b = film.read_exr("a.exr"), film.read_exr("b.exr")
    assert a.image.shape[1] == b.image.shape[1] == 12
    assert a.metadata["fingerprint"] != b.metadata["fingerprint"]
    row = table("a.csv")[-1]
    assert (row["samples"], row["relmse"], row["luminance_rmse"]) == ("2", "", "")


def test_periodic_saves_and_warnings_are_in_the_log(folder, capsys, monkeypatch):
    passes.watch(monkeypatch, "path", lambda method, iteration: time.sleep(0.02))
    passes.taint(monkeypatch, "path", 1.0)
    Path("a.toml").write_text(
        BOX + "settings = {samples_per_pass = 1}\n[budget]\nspp = 20\n[autosave]\nevery = 0.1\n"
        "[output]\ncheckpoint = false\npage = false\n"
    )
    assert main(["run", "a.toml"]) == 0
    assert sorted(os.listdir(folder)) == ["a.csv", "a.exr", "a.log", "a.toml"]
    log = Path("a.log").read_text("utf-8")
    assert "  save: " in log
    assert "WARNING: 20 contributions were not finite" in log
    err = capsys.readouterr().err
    assert "save: " not in err
    assert "end (samples): 20 passes" in err
    done = [int(row["passes"]) for row in table("a.csv")]
    assert done == sorted(done)
    assert len(set(done)) > 1


def test_a_run_that_ends_before_an_autosave_says_so(folder):
    Path("a.toml").write_text(BOX + "[budget]\nspp = 2\n[autosave]\ntimes = [500]\n")
    assert main(["run", "a.toml"]) == 0
    assert Path("a.log").read_text("utf-8").splitlines()[-1] == "the run ended before its autosave at 500 s"
    assert "a-500s.exr" not in os.listdir(folder)


def prepare_autosaves(monkeypatch, write, times):
    """Describe a run of nine passes of 0.11 s with autosaves at ``times``, whose outputs ``write`` writes."""
    clock = passes.simulate_clock(monkeypatch)
    monkeypatch.setattr(Picture, "write", write)
    passes.watch(monkeypatch, "path", lambda method, iteration: clock.pass_time(0.11))
    Path("a.toml").write_text(
        BOX + f"settings = {{samples_per_pass = 1}}\n[budget]\nspp = 9\n[autosave]\ntimes = [{times}]\n"
    )


def test_an_autosave_that_failed_is_made_with_the_next_one(folder, monkeypatch):
    write, failed = Picture.write, []

    def fail_once(outputs, job, run):
        if not failed:
            failed.append(run.save_times)
            raise OutputError("the disk is full")
        return write(outputs, job, run)

    prepare_autosaves(monkeypatch, fail_once, "0.2, 0.5, 50")
    assert main(["run", "a.toml"]) == 0
    assert len(failed) == 1 and {"a-0.2s.exr", "a-0.5s.exr", "a.exr"} <= set(os.listdir(folder))
    assert [row["autosave"] for row in table("a.csv")] == ["0.2", "0.5", ""]
    assert Path("a.log").read_text("utf-8").splitlines()[-1] == "the run ended before its autosave at 50 s"


def test_an_autosave_that_fails_at_the_end_costs_no_picture(folder, capsys, monkeypatch):
    write = Picture.write

    def fail(outputs, job, run):
        if outputs.pictures[0].name != "a.exr":
            raise OutputError("the disk is full")
        return write(outputs, job, run)

    prepare_autosaves(monkeypatch, fail, "0.2")
    assert main(["run", "a.toml"]) == 5
    assert "the disk is full" in capsys.readouterr().err
    assert film.read_exr("a.exr").metadata["passes"] == 9
    assert "ended before its autosave" not in Path("a.log").read_text("utf-8")


def test_a_failing_pass_keeps_its_predecessors_and_the_log_says_why(folder, capsys, monkeypatch):
    passes.fail(monkeypatch, "path", at=2)
    Path("a.toml").write_text(BOX + "settings = {samples_per_pass = 1}\n[budget]\nspp = 9\n")
    assert main(["run", "a.toml"]) == 1
    assert film.read_exr("a.exr").metadata["passes"] == 2
    end, error = Path("a.log").read_text("utf-8").splitlines()[-2:]
    assert "end (failure): 2 passes" in end
    assert error == "error: RuntimeError: out of memory (after 2 passes, which are kept)"


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_ctrl_c_keeps_everything(folder):
    Path("a.toml").write_text(
        BOX + "settings = {samples_per_pass = 1}\n[budget]\nseconds = 60\n[autosave]\ntimes = [0.2, 50]\n"
    )
    command = [sys.executable, "-m", "etendue.cli.main", "run", "a.toml"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not Path("a-0.2s.exr").exists():
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert set(out.split()) == {"a.log", "a.csv", "a-0.2s.exr", "a.exr", "a.checkpoint", "a.html"}
    assert film.read_exr("a.exr").metadata["stopped_by"] == "cancel"
    assert Checkpoint.read("a.checkpoint").stopped_by == "cancel"
    rows = table("a.csv")
    assert [row["autosave"] for row in rows] == ["0.2", ""]
    assert int(rows[1]["passes"]) > int(rows[0]["passes"])
    log = Path("a.log").read_text("utf-8")
    assert "end (cancel)" in log
    assert "before its autosave at 50 s" in log


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_a_resumed_run_goes_on_with_its_records(folder, capsys, monkeypatch):
    etendue.render("cornell-box", "path", spp=64, size=(16, 16), save="reference.exr")
    Path("a.toml").write_text(
        BOX + "settings = {samples_per_pass = 1}\n[budget]\nseconds = 2\n[autosave]\ntimes = [0.2, 1, 2]\n"
        '[output]\nfolder = "out"\n[reference]\nfile = "reference.exr"\n'
    )

    clock = passes.simulate_clock(monkeypatch)

    def interrupt(method, iteration):
        clock.pass_time(0.11)
        if iteration in (3, 6):
            passes.press_ctrl_c()

    passes.watch(monkeypatch, "path", interrupt)
    assert main(["run", "a.toml"]) == 130
    first = table("out/a.csv")
    assert [row["autosave"] for row in first] == ["0.2", ""]
    before = film.read_exr("out/a.exr").metadata["passes"]
    capsys.readouterr()

    assert main(["resume", "out/a.checkpoint"]) == 130
    assert main(["resume", "out/a.checkpoint"]) == 0  # twice: what the times are counted from adds up
    out, err = capsys.readouterr()
    rows = table("out/a.csv")
    assert rows[:2] == first
    assert [row["autosave"] for row in rows if row["autosave"]] == ["0.2", "1", "2"]
    assert len(rows) == 6  # and three ends
    for name in ("seconds", "rendering_seconds", "passes", "rays"):
        numbers = [float(row[name]) for row in rows]
        assert numbers == sorted(numbers)
        assert numbers[0] < numbers[1] < numbers[2] < numbers[-1]
    assert int(rows[2]["passes"]) > before
    seconds = {row["autosave"]: float(row["seconds"]) for row in rows}
    assert seconds["1"] >= 1.0
    assert seconds["2"] <= 2.0  # no pass was begun that would have ended later
    assert all(float(row["relmse"]) > 0 for row in rows)
    assert {"a-0.2s.exr", "a-1s.exr", "a-2s.exr", "a.exr"} <= set(os.listdir("out"))
    assert {Path(name).name for name in out.split()} >= {"a-1s.exr", "a-2s.exr", "a.exr", "a.csv", "a.log"}
    assert "autosave 1 s: " in err
    log = Path("out/a.log").read_text("utf-8")
    assert log.count("resumed after ") == 2
    assert log.splitlines()[-1].split("  ")[1].startswith("end (seconds)")


def test_what_has_changed_since_is_said(folder, capsys):
    base = BOX + "settings = {samples_per_pass = 1}\n[budget]\nspp = 1\n"
    Path("a.toml").write_text(base)
    assert main(["run", "a.toml"]) == 0
    rows = table("a.csv")
    capsys.readouterr()
    for text, message in (
        (
            base.replace('"path"', '"light"'),
            "a.toml has changed: the checkpoint was made by method 'path', not 'light'",
        ),
        (base.replace("= {", "= {rr_depth = 2, "), "a.toml has changed: the checkpoint was made with other settings"),
        ("seed = 3\n" + base, "a.toml has changed: the checkpoint was made with seed 0, not 3"),
    ):
        Path("a.toml").write_text(text)
        assert main(["resume", "a.checkpoint", "--spp", "3"]) == 4
        assert message in capsys.readouterr().err
    assert table("a.csv") == rows
    Path("a.toml").write_text(base + '[output]\nname = "b"\n')
    for spp, why in (("2", "keeps its checkpoint elsewhere"), ("3", "is gone")):
        assert main(["resume", "a.checkpoint", "--spp", spp]) == 0
        warning = rf"warning: only the picture continues, .*: the run file '.*a\.toml' {why}"
        assert re.search(warning, capsys.readouterr().err)
        Path("a.toml").unlink(missing_ok=True)
    assert main(["resume", "a.checkpoint", "--spp", "4", "-o", "c.exr"]) == 0
    assert "warning" not in capsys.readouterr().err
    assert film.read_exr("c.exr").metadata["passes"] == 4
    assert table("a.csv") == rows


BAD = [
    # names
    ("sead = 1\n" + BOX, 2, "no key 'sead'; did you mean 'seed'"),
    ("[scen]\n", 2, "no key 'scen'; did you mean 'scene'"),
    (BOX + "[budget]\nsecond = 5", 2, "[budget] has no key 'second'; did you mean 'seconds'"),
    (BOX + "radius = 5", 2, "[method] has no key 'radius'; it has: name, settings"),
    ("seconds = 5\n" + BOX, 2, "no key 'seconds'; it belongs to [budget]"),
    (BOX + "settings = {mod = 1}", 2, "[method]: method 'path' has no option 'mod'; did you mean 'mode'"),
    ('[scene]\nbundled = "cornell-bax"', 3, "did you mean 'cornell-box'"),
    (BOX.replace('"path"', '"vmc"'), 2, "did you mean 'vcm'"),
    # values
    ("= 1", 2, "is not valid TOML"),
    ("seed = -1\n" + BOX, 2, "'seed' is a whole number of at least 0, not -1"),
    ("seed = true\n" + BOX, 2, "'seed' is a whole number"),
    ("budget = 5\n" + BOX, 2, "'budget' is a table: write its keys under [budget]"),
    ('memory = "much"\n' + BOX, 2, "'memory'"),
    ("memory = 5\n" + BOX, 2, "memory bound"),
    ("threads = 0\n" + BOX, 2, "'threads' is a whole number of at least 1"),
    ('variant = "scalar_rgb"\n' + BOX, 6, "scalar_rgb"),
    (BOX + "settings = {mode = [1]}", 2, "'settings' is a table of"),
    (BOX + 'settings = {mode = "naiv"}', 2, "naive, next_event, mis"),
    (BOX + "[budget]\nseconds = 0", 2, "[budget]: a budget in seconds"),
    (BOX + "[budget]\nseconds = nan", 2, "'seconds' is a number"),
    (BOX + "[budget]\nspp = 1.5", 2, "'spp' is a whole number"),
    (BOX + "[autosave]\ntimes = 5", 2, "'times' is a list of seconds"),
    (BOX + "[autosave]\ntimes = [5, 3]\nexit_after_last = true", 2, "[autosave]: the times of saves"),
    (BOX + "[autosave]\ntimes = [5]", 2, "need a budget"),
    (BOX + "[autosave]\nexit_after_last = true", 2, "exit_after_last needs times"),
    (BOX + "[autosave]\ntimes = [5]\n[budget]\nseconds = 2", 2, "before its last autosave at 5 s"),
    (BOX + "[camera]\norigin = [0, 0]", 2, "'origin' is three numbers"),
    (BOX + "[camera]\norigin = [0, 0, 1]", 2, "[camera]: a camera needs both origin and target"),
    (BOX + "[camera]\nfov = 200", 2, "between 0 and 180"),
    (BOX + '[output]\nlayers = "both"', 2, '"together" or "separate"'),
    (BOX + '[output]\nname = "a/b"', 2, "put the path into folder"),
    (BOX + '[output]\nfolder = "file"', 5, "is a file"),
    (BOX + '[output]\nfolder = "file/deep"', 5, "is a file"),
    (BOX + '[reference]\nfile = "no.exr"', 3, "there is no picture 'no.exr'"),
    (BOX + '[reference]\nfile = "file"', 3, "file"),
    (BOX + '[reference]\nfile = "small.exr"', 2, "use size = [8, 8] in [scene]"),
    (BOX + "[reference]\ntrim = 0.1", 2, "file is missing"),
    ("[scene]\nsize = [8, 8]", 2, "[scene]: name one scene"),
    ('[scene]\nfile = "a"\nbundled = "b"', 2, "[scene]: name one scene"),
    ('[scene]\nfile = "no.xml"', 3, "there is no scene file 'no.xml'"),
    ('[scene]\nbundled = "stage"\nsize = [0, 5]', 2, "'size' is width and height"),
    ('[scene]\nbundled = "stage"\nparameters = {a = 1}', 2, "a bundled scene has none"),
    ('[scene]\nbundled = "stage"\nsensor = 3', 2, "no sensor 3"),
]


@pytest.mark.parametrize(("text", "status", "message"), BAD, ids=[f"{n}" for n in range(len(BAD))])
@pytest.mark.parametrize("option", [[], ["--check"]], ids=["run", "check"])
def test_what_is_wrong_is_said_in_one_line_before_anything_is_made(text, status, message, option, folder, capsys):
    Path("a.toml").write_text(text)
    Path("file").write_text("")
    film.write_exr("small.exr", Result({"image": np.ones((8, 8, 3), np.float32)}))
    before = sorted(os.listdir(folder))
    assert main(["run", "a.toml", *option]) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"error: [^\n]+\n", err)
    assert message in err
    assert sorted(os.listdir(folder)) == before


def test_a_file_that_is_not_there(folder, capsys):
    assert main(["run", "no.toml"]) == 2
    assert "there is no run file 'no.toml'" in capsys.readouterr().err
    assert main(["run", "."]) == 2
    assert "cannot read the run file" in capsys.readouterr().err
