"""The commands on small pictures; signals and start-up in processes of their own."""

from __future__ import annotations

import html
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support import passes
from support.tev import fake_tev

import etendue
from etendue import film, products
from etendue.cli import options
from etendue.cli.main import main
from etendue.core import OptionError, citations
from etendue.engine import Checkpoint


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_pyramid_in_the_file_and_on_the_page(folder, capsys):
    settings = "--size 16x12 --spp 2 --pyramid-depth 2 -D direct_light=all"
    assert run(f"compare cornell-box -m bpt -m path {settings} -o out") == 0
    layers = film.read_exr("out/bpt.exr").layers
    parts = ("s0_t2", "s0_t3", "s1_t2", "s2_t1", "longer")
    assert set(layers) == {"image", *parts} | {f"{name}_unweighted" for name in parts if name != "longer"}
    np.testing.assert_allclose(sum(layers[name] for name in parts), layers["image"], rtol=1e-5, atol=1e-6)
    assert list(film.read_exr("out/path.exr").layers) == ["image"]
    assert "Technique pyramid" in Path("out/index.html").read_text("utf-8")


def test_render_writes_picture_and_checkpoint_with_metadata(folder, capsys):
    asked = "--spp 4 --seed 9 -o a.exr -o a.png --aovs --components -D rr_depth=3"
    with fake_tev() as tev:
        assert run(f"render cornell-box -m path --size 16x12 {asked} --tev {tev.address}") == 0
    out, err = capsys.readouterr()
    assert out == "a.exr\na.png\na.checkpoint\n"
    assert "path: 1 pass, 4 spp" in err
    result = film.read_exr("a.exr")
    assert result.image.shape == (12, 16, 3)
    assert {"albedo", "normal", "depth", "emitted"} <= result.layers.keys()
    total = sum(result.layers[name] for name in film.COMPONENTS)
    np.testing.assert_allclose(total, result.image, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(np.stack([tev.images["a"][c] for c in "RGB"], -1), result.image)
    np.testing.assert_array_equal(tev.images["a"]["depth.Z"], result.layers["depth"][..., 0])
    m = result.metadata
    assert (m["method"], m["seed"], m["samples"], m["scene"]) == ("path", 9, 4, "cornell-box")
    assert m["settings"]["rr_depth"] == 3
    assert m["settings"]["aovs"] is True
    assert m["versions"].keys() == {"etendue", "mitsuba", "drjit", "variant"}
    assert m["rays"] > 0
    assert m["seconds"] > 0
    assert Checkpoint.read("a.checkpoint").fingerprint == m["fingerprint"]


def test_names_of_outputs_come_from_scene_and_method(folder, capsys):
    assert run("render cornell-box -m path --size 8x8 --spp 1 --no-checkpoint --tev localhost:1") == 0
    assert os.listdir(folder) == ["cornell-box-path.exr"]
    assert "no tev at localhost:1 (Connection refused)" in capsys.readouterr().err


def test_an_error_is_a_relative_standard_error_everywhere(folder, capsys):
    """In Python, by the command and in a run file, where the budget in paths also has its name of version 1."""
    made = etendue.render("cornell-box", "path", error=0.02, size=(16, 12), samples_per_pass=8)
    assert made.metadata["stopped_by"] == "error" and 0.017 < made.metadata["error"] <= 0.02
    assert made.layers.keys() == {"image"} and made.metadata["samples"] > 16 * 8
    assert run("render cornell-box -m path --error 0.02 --size 16x12 --samples-per-pass 8 -o a.exr") == 0
    assert f"error {made.metadata['error']:.2g}" in capsys.readouterr().err
    head = '[scene]\nbundled = "cornell-box"\nsize = [16, 12]\n[method]\nname = "path"\n'
    head += "settings = {samples_per_pass = 8}\n"
    Path("b.toml").write_text(f"{head}[budget]\nerror = 0.02\n")
    Path("c.toml").write_text(f"{head}[budget]\nsamples = {made.metadata['samples']}\n")
    assert run("run b.toml") == run("run c.toml") == 0
    for name in "abc":
        np.testing.assert_array_equal(film.read_image(f"{name}.exr"), made.image)


def test_a_bundled_scene_stays_what_it_is_where_a_file_has_its_name(folder, capsys):
    """In the checkpoint, in a run file, and by a line where it is a question."""
    os.mkdir("stage")
    assert run("render stage -m path --size 8x8 --spp 1 -D samples_per_pass=1 -o a.exr") == 0
    assert "'stage' is read as the bundled scene; the folder of that name has no scene.xml\n" in capsys.readouterr().err
    Path("stage/scene.xml").write_text("no scene")
    Path("a.toml").write_text('[scene]\nbundled = "stage"\nsize = [8, 8]\n[method]\nname = "path"\n[budget]\nspp = 1\n')
    assert run("resume a.checkpoint --spp 2") == run("run a.toml") == 0
    assert "is read as" not in capsys.readouterr().err
    assert run("render stage -m path --size 8x8 --spp 1") == 3
    assert run("compare stage -m path --size 8x8 --spp 1") == 3


@pytest.mark.parametrize(("before", "after"), [("exr png", "exr png"), ("png", "png"), ("", "exr")])
def test_resume_updates_the_pictures_beside_the_checkpoint(before, after, folder, capsys):
    assert run("render cornell-box -m path --size 8x8 --spp 1 -D samples_per_pass=1 --checkpoint a -o b.exr") == 0
    os.rename("a", "a.checkpoint")
    for suffix in before.split():
        Path(f"a.{suffix}").write_bytes(b"stale")
    capsys.readouterr()
    assert run("resume a.checkpoint --spp 2") == 0
    assert capsys.readouterr().out.split() == [*(f"a.{suffix}" for suffix in after.split()), "a.checkpoint"]
    assert {p.name for p in folder.iterdir()} == {"b.exr", "a.checkpoint", *(f"a.{s}" for s in after.split())}
    assert all(Path(f"a.{suffix}").stat().st_size > 5 for suffix in after.split())


def test_without_a_method_the_scene_decides(folder, capsys):
    scene = '<scene version="3.0.0"><integrator type="NAME"><float name="radius" value="0.01"/></integrator>'
    scene += '<emitter type="constant"/><shape type="sphere"/><sensor type="perspective"/></scene>'
    for name, method in (("bpm", "bpm"), ("volpath", "auto")):
        Path("a.xml").write_text(scene.replace("NAME", name))
        assert run("render a.xml --size 8x8 --spp 1 --no-checkpoint") == 0
        out, err = capsys.readouterr()
        assert out == f"a-{method}.exr\n"
        assert ("the scene names the integrator" in err) == (name == "volpath")
        settings = film.read_exr(f"a-{method}.exr").metadata["settings"]
        assert (settings["radius"] == 0.01) == (name == "bpm")


def test_compare_writes_pictures_and_a_page(folder, capsys):
    etendue.render("cornell-box", "path", spp=16, size=(16, 16), save="reference.exr")
    command = (
        "compare cornell-box -m path -m bpt --size 16x16 --spp 8 -o out --reference reference.exr -D path.mode=naive"
    )
    assert main(command.split()) == 0
    assert capsys.readouterr().out == f"{Path('out/index.html')}\n"
    assert sorted(os.listdir("out")) == ["bpt.exr", "bpt.png", "index.html", "path.exr", "path.png"]
    assert film.read_exr("out/path.exr").metadata["settings"]["mode"] == "naive"
    page = Path("out/index.html").read_text("utf-8")
    assert "relMSE" in page
    assert "naive" in page


def test_settings_of_one_method_win_over_those_of_all():
    for settings in ({"vcm.radius": "1", "radius": "3"}, {"radius": "3", "vcm.radius": "1"}):
        assert options.settings_by_method(["path", "vcm", "bpm"], settings) == {
            "path": {},
            "vcm": {"radius": "1"},
            "bpm": {"radius": "3"},
        }


def test_compare_tells_the_error_of_a_method_in_its_place(folder, capsys, monkeypatch):
    passes.fail(monkeypatch, "bpt", at=0)
    assert run("compare cornell-box -m bpt -m path --size 8x8 --spp 1 -o out") == 70
    out, err = capsys.readouterr()
    assert out == f"{Path('out/index.html')}\n"
    assert "out of memory" in err
    assert sorted(os.listdir("out")) == ["index.html", "path.exr", "path.png"]
    page = Path("out/index.html").read_text("utf-8")
    assert "<strong>bpt</strong> failed: " in page and "out of memory" in page
    assert "etendue compare cornell-box -m bpt -m path --size 8x8 --spp 1 -o out" in page


def test_the_page_names_a_command_that_makes_the_same_picture(folder):
    """Also of a run that was ended by its time: with as many passes and the samples of a pass that it had."""
    assert run("compare cornell-box -m path --seed 7 --size 12x8 --time 0.2 --max-depth 3 -o out") == 0
    page = html.unescape(Path("out/index.html").read_text("utf-8"))
    words = shlex.split(re.search(r"<code>(etendue render .*?)</code>", page)[1])
    assert main([*words[1:], "--no-checkpoint"]) == 0
    np.testing.assert_array_equal(film.read_image("path.exr"), film.read_image("out/path.exr"))


def test_compare_averages_errors_over_seeds(folder, capsys):
    etendue.render("cornell-box", "path", spp=16, size=(8, 8), save="reference.exr")
    assert run("compare cornell-box -m path --size 8x8 --spp 4 --seeds 3 --reference reference.exr -o out") == 0
    assert {"path.exr", "path-seed-1.exr", "path-seed-2.exr"} <= set(os.listdir("out"))
    assert "Bars are standard errors over seeds" in Path("out/index.html").read_text("utf-8")


def test_compare_refuses_a_reference_of_another_size_before_rendering(folder, capsys):
    etendue.render("cornell-box", "path", spp=1, size=(8, 8), save="reference.exr")
    assert run("compare cornell-box --size 16x16 --spp 1 --reference reference.exr") == 2
    assert "use --size 8x8" in capsys.readouterr().err


def test_demo_writes_a_page(folder, capsys):
    assert run("demo --time 0.2 --size 24x18 -o d") == 0
    assert capsys.readouterr().out == f"{Path('d/index.html')}\n"
    assert {"path.exr", "vcm.exr", "path.png", "vcm.png"} <= set(os.listdir("d"))
    assert all("fireflies" in film.read_exr(f"d/{name}.exr").metadata for name in ("path", "vcm"))


def test_methods_and_manual_pages(capsys):
    """Of methods of every kind, also by their earlier names."""
    assert run("methods") == 0
    out = capsys.readouterr().out
    assert {"auto", "lines", "spheres", "multipath", "boxes", "particles"} <= products.table().keys()
    for name, method in products.table().items():
        assert re.search(rf"^{name}\s+\S", out, re.MULTILINE)
        assert run(f"methods {name}") == 0
        page = capsys.readouterr().out
        assert page.startswith(f"{name}: ")
        for setting, *_ in method.Settings.describe():
            assert setting in page
    for old, name in (
        ("global-lines", "lines"),
        ("hierarchical-lines", "spheres"),
        ("hierarchical-multipath", "boxes"),
    ):
        assert run(f"methods {old}") == 0
        assert capsys.readouterr().out.startswith(f"{name}: ")


def test_cite_prints_every_paper_of_every_method(capsys):
    for name, method in products.table().items():
        assert method.citations
        assert run(f"cite {name}") == 0
        entries = citations.parse(capsys.readouterr().out)
        assert set(method.citations) <= entries.keys()


def test_scenes(capsys):
    from etendue.scene import bundled

    assert run("scenes") == 0
    out = capsys.readouterr().out
    assert all(name in out for name in bundled())


def test_version_and_help(capsys):
    assert run("--version") == 0
    assert re.match(r"etendue \S+, mitsuba 3\S+, drjit \S+\n$", capsys.readouterr().out)
    assert run("render --help") == 0
    text = capsys.readouterr().out
    for option in ("--time", "--spp", "--error", "--size", "--seed", "--variant", "--max-depth", "--threads"):
        assert option in text


@pytest.mark.parametrize(
    ("command", "shown", "others"),
    [
        ("render -m bpt", ["--max-depth", "--pyramid-depth", "--connections"], ["--photons"]),
        ("render", ["--max-depth", "--aovs"], ["--pyramid-depth", "--photons"]),
        ("compare -m path -m vcm", ["--max-depth", "--mode"], ["--photons"]),
        ("view --method pm", ["--photons"], ["--pyramid-depth"]),
        ("form-factors", ["--local-rays", "--replicates"], ["--main-share"]),
        ("form-factors -m spheres", ["--main-share", "--engine"], ["--grid"]),
        ("radiosity -m multipath", ["--generator", "--point-set"], ["--grid", "--local-rays"]),
        ("radiosity -m boxes", ["--grid", "--inside"], ["--local-rays"]),
        ("particles trace -m metropolis_particles", ["--chains", "--steps"], ["--keep"]),
    ],
)
def test_help_shows_the_settings_of_the_method(command, shown, others, capsys):
    assert run(f"{command} -h") == 0
    words = capsys.readouterr().out.split()
    assert set(shown) <= set(words) and not set(others) & set(words)


def test_settings_are_options(folder, capsys):
    """As -D, in every spelling; where methods have settings of one name and other kinds, that of the method."""
    assert run("render cornell-box -m path --size 8x8 --spp 1 -o a.exr --max-depth 3 --aovs --rr-depth=2") == 0
    made = film.read_exr("a.exr")
    settings = made.metadata["settings"]
    assert (settings["max_depth"], settings["rr_depth"], settings["aovs"]) == (3, 2, True) and "normal" in made.layers
    assert run("render cornell-box -m vegas --size 8x8 --spp 1 -o b.exr --no-bsdf-sampling --one-path=yes") == 0
    settings = film.read_exr("b.exr").metadata["settings"]
    assert (settings["bsdf_sampling"], settings["one_path"]) == (False, True)
    assert run("form-factors cornell-box -o f.npz --bundles 16 --replicates 8 --no-local-rays --checkpoint f") == 0
    settings = json.loads(Checkpoint.read("f").settings)
    assert (settings["replicates"], settings["local_rays"], settings["shot"]) == (8, False, True)
    assert run("radiosity cornell-box -o s.npz --shot --bundles 8 --checkpoint s") == 0
    assert json.loads(Checkpoint.read("s").settings)["shot"] is True
    assert run("radiosity cornell-box -m multipath -o s.npz --points 4096 --shot 5000 --checkpoint m") == 0
    assert json.loads(Checkpoint.read("m").settings)["shot"] == 5000
    command = "radiosity cornell-box -m boxes -o s.npz --passes 1 --grid 2 --threshold 2 --objects components"
    assert run(f"{command} --checkpoint h") == 0
    kept = Checkpoint.read("h")
    assert json.loads(kept.settings)["grid"] == 2
    assert float(kept.scene["groups"]["threshold"]) == 2.0


@pytest.mark.parametrize("command", ["methods", "render --help"])
def test_a_command_whose_reader_is_gone(command):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as pipe:
        run = subprocess.run([sys.executable, "-m", "etendue", *command.split()], stdout=pipe, stderr=subprocess.PIPE)
    assert (run.returncode, run.stderr) == (141, b"")


def test_nonfinite_contributions_are_reported(folder, capsys, monkeypatch):
    passes.taint(monkeypatch, "path", 2.0)
    assert run("render cornell-box -m path --size 8x8 --spp 3 -D samples_per_pass=1 -o a.exr") == 0
    assert "warning: 6 contributions were not finite" in capsys.readouterr().err
    assert film.read_exr("a.exr").metadata["nonfinite"] == 6


def test_a_failing_pass_is_one_line_and_its_predecessors_are_written(folder, capsys, monkeypatch):
    passes.fail(monkeypatch, "path", at=2)
    assert run("render cornell-box -m path --size 8x8 --spp 9 -D samples_per_pass=1 -o a.exr") == 1
    out, err = capsys.readouterr()
    assert out == "a.exr\na.checkpoint\n"
    assert err.splitlines() == ["error: RuntimeError: out of memory (after 2 passes, which are kept)"]
    assert film.read_exr("a.exr").metadata["passes"] == 2
    monkeypatch.undo()
    os.chdir(folder)
    assert run("resume a.checkpoint") == 0
    assert film.read_exr("a.exr").metadata["passes"] == 9


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("60", 60), ("1.5", 1.5), ("90s", 90), ("5m", 300), ("1h30m", 5400), ("2h", 7200), ("1e-1", 0.1)],
)
def test_times(text, seconds):
    assert options.parse_time(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "m", "1x", "1m1h", "--", "1.2.3"])
def test_bad_times(text):
    with pytest.raises(OptionError):
        options.parse_time(text)


def test_sizes_of_memory():
    assert options.parse_memory("2G") == 2 << 30
    assert options.parse_memory("512MiB") == 512 << 20
    assert options.parse_memory("1000") == 1000


def test_help_is_immediate():
    """It imports no more packages than those on which it stands, and what prints it: a variant of Mitsuba, or Numba,
    would take as long again."""
    code = """
import sys
from etendue.cli.main import main
main(["--help"])
import mitsuba
files = {name: getattr(module, "__file__", None) or "" for name, module in sys.modules.items()}
print(*{name.split(".")[0] for name, file in files.items() if "site-packages" in file}, mitsuba.variant())
"""
    *packages, variant = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True, timeout=60)
        .stdout.splitlines()[-1]
        .split()
    )
    assert variant == "None"
    stands_on = {"mitsuba", "drjit", "numpy", "typer", "rich"}
    prints = {"annotated_doc", "markdown_it", "mdurl", "pygments", "shellingham", "click", "etendue"}
    assert stands_on <= set(packages)
    assert {name for name in packages if not name.startswith("_")} <= stands_on | prints
