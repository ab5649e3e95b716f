"""The manual: generated tables are current, links lead somewhere, every example runs, in Python and of the shell."""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
from contextlib import nullcontext
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from benchmarks.measuring import Record
from support.buildings import as_idf, energyplus
from support.run_files import SCENE, example
from support.weather import written, year

import etendue
from etendue import display, methods
from etendue.cli import lines, options, particles, running
from etendue.cli.experiments import compare
from etendue.cli.inspection import doctor, viewing
from etendue.cli.main import main
from etendue.radiosity import ABuffer
from etendue.scene import colours_of

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "project"),  # made from other folders
        *(ROOT / "benchmarks").glob("*.md"),
    ],
    key=str,
)
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_EXAMPLE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_COMMAND = re.compile(r"^(?: {4})?(etendue .+)$", re.MULTILINE)  # indented, or in a fenced block


def relative(page):
    return str(page.relative_to(ROOT))


def generator():
    spec = importlib.util.spec_from_file_location("manual_tables", ROOT / "tools" / "manual_tables.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_parts_are_current():
    names = ", ".join(page.name for page in generator().stale())
    assert not names, f"{names}: run python tools/manual_tables.py"


def written_record(folder, title, columns, *cells):
    record = Record(title, columns)
    record.add(*cells)
    record.publish("llvm_ad_rgb", folder / "RESULTS.md")


def test_tables_of_records(tmp_path):
    tables = generator()
    tables.ROOT = tmp_path
    results, page = tmp_path / "RESULTS.md", tmp_path / "docs" / "page.md"
    written_record(tmp_path, "Speed of it, hall, 2 seats, 9 s", ("seconds", "bar"), "1 | 2, ≤ 3: reached", "≤ 3")
    written_record(tmp_path, "Speed of it, oven, 9 s", ("seconds", "bar"), "4", "")
    head, rule, first, second, _, source = tables.recorded("Speed of it, *, 9 s", results, page).split("\n")
    assert [head, rule] == ["|  | seconds |", "| --- | --- |"]
    assert [first, second] == [r"| hall | 1 \| 2 |", "| oven | 4 |"]
    assert "`python -m " in source and "](../RESULTS.md#speed-of-it-oven-9-s-20" in source

    with pytest.raises(ValueError, match=r"RESULTS\.md has no table 'Speed of it'"):
        tables.recorded("Speed of it", results, page)
    written_record(tmp_path, "Speed of it, hall, 9 s", ("minutes",), "1")
    with pytest.raises(ValueError, match=r"'Speed of it, hall, 9 s, .*' has other columns"):
        tables.recorded("Speed of it, *, 9 s", results, page)


@pytest.mark.parametrize(
    ("bibtex", "text"), [(r"K{\v{r}}iv{\'a}nek", "Křivánek"), (r"Ji\v{r}\'{i}", "Jiří"), ("63--66", "63–66")]
)
def test_accents_of_bibtex(bibtex, text):
    assert generator().plain(bibtex) == text


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_somewhere(page):
    for target in _LINK.findall(page.read_text("utf-8")):
        if re.match(r"\w+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), f"{relative(page)} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.+)$", file.read_text("utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{relative(page)} links to {target}"


SYMBOLS = re.findall(r"^\|.*\.py` \|$", (ROOT / "docs" / "symbols.md").read_text("utf-8"), re.MULTILINE)


@pytest.mark.parametrize("row", SYMBOLS)
def test_symbols_name_what_their_files_have(row):
    _, _, _, code, files, _ = row.split("|")
    text = "".join((ROOT / "src" / "etendue" / file).read_text("utf-8") for file in re.findall(r"`([^`]+)`", files))
    names = re.findall(r"`([^`]+)`", code)
    assert names
    for word in re.findall(r"\w\w+", " ".join(names)):
        assert re.search(rf"\b{word}\b", text), f"docs/symbols.md: no {word} in {files.strip()}"
    for name in names:
        if "." in name and name[0].isupper():
            assert re.search(rf"^class {name.split('.')[0]}\b", text, re.MULTILINE), (
                f"no class {name} in {files.strip()}"
            )


def short(function):
    """A rendering function that takes little time, whatever it is asked for."""

    def call(scene, *arguments, **named):
        if "seconds" in named:
            named["seconds"] = 0.2
        if isinstance(scene, str):
            named["size"] = (24, 18)
        return function(scene, *arguments, **named)

    return call


#: Those in docs/howto are run in order, by test_howto.py.
SINGLE = [page for page in PAGES if page.parent.name != "howto"]
EXAMPLES = [(page, n) for page in SINGLE for n in range(len(_EXAMPLE.findall(page.read_text("utf-8"))))]


@pytest.mark.usefixtures("mitsuba_files")
@pytest.mark.parametrize(("page", "number"), EXAMPLES, ids=lambda v: relative(v) if isinstance(v, Path) else str(v))
def test_examples_run(page, number, tmp_path, monkeypatch, variant):
    monkeypatch.setattr(etendue, "render", short(etendue.render))
    cast = ABuffer.cast
    monkeypatch.setattr(
        ABuffer, "cast", lambda lines, count, *rest, **named: cast(lines, min(count, 64), *rest, **named)
    )
    monkeypatch.setattr(mi, "set_variant", lambda name: None)  # that of the session stays
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.xml").write_text(SCENE)
    code = _EXAMPLE.findall(page.read_text("utf-8"))[number]
    code = code.replace("samples=1 << 21", "samples=1 << 17")
    code = code.replace("session.wait(5)", "while not session.progress.samples:\n    session.wait(0.1)")
    if "picture.exr" in code:
        made = etendue.render("scene.xml", "path", spp=2, save="picture.exr")
        made.save("reference.exr")
    exec(compile(code, relative(page), "exec"), {"__name__": "example"})


COMMANDS = sorted({command for page in SINGLE for command in _COMMAND.findall(page.read_text("utf-8"))})


@pytest.fixture(scope="module")
def folder(tmp_path_factory, variant):
    """The files that the examples of the shell name."""
    meshio = pytest.importorskip("meshio")
    path = tmp_path_factory.mktemp("shell")
    for name in {match[1] for command in COMMANDS if (match := re.match(r"etendue \w+ (\S+\.xml)", command))}:
        (path / name).parent.mkdir(exist_ok=True)
        (path / name).write_text(SCENE)
    etendue.render(path / "scene.xml", "path", save=path / "converged.exr", checkpoint=path / "picture.checkpoint")
    film = {"spp": 2, "size": (8, 6), "bootstrap": 1024}
    etendue.render(path / "scene.xml", "film_metropolis", checkpoint=path / "caustics.checkpoint", **film)
    (path / "experiment.toml").write_text(example((24, 18), "20, 60"))
    for copy in ("reference.exr", "picture.exr", "mitsuba.exr"):
        shutil.copy(path / "converged.exr", path / copy)
    (path / "desks.csv").write_text("0 0 0.5 0 0 1\n")
    written(path, year()).rename(path / "bern.epw")
    (path / "suns.csv").write_text("x,y,z\n0,0,1\n")
    for number, name in enumerate(("hall", "desks", "trees")):
        (path / f"{name}.obj").write_text(f"v 0 0 {number}\nv 1 0 {number}\nv 0 1 {number}\nf 1 2 3\n")
    (path / "room.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\ng floor\nf 1 2 3\nv 0 0 1\nv 1 0 1\nv 0 1 1\ng roof\nf 6 5 4\n"
    )
    (path / "building.idf").write_text(as_idf(energyplus(shift=1.0)).replace("Z1", "Office"))
    (path / "conditions.csv").write_text("group,temperature,flux\nfloor,310,\n*,,adiabatic\n")
    (path / "furnace.csv").write_text("name,r1,z1,r2,z2\nheater,0,0,1,0\nmelt,1,0,0,1\n")
    (path / "melting.csv").write_text("group,temperature\nheater,1500\nmelt,1100\n")
    etendue.compute_form_factors(path / "furnace.csv", "exact", save=path / "furnace.npz")
    (path / "hours.csv").write_text("hour,floor:temperature\n9:00,300\n10:00,310\n")
    etendue.solve_heat(path / "room.obj", path / "conditions.csv", bundles=8, save=path / "heat.npz")
    triangle = np.eye(3), [("triangle", np.array([[0, 1, 2]]))]
    for name, arrays in (("hall", {"rho": [[0.5]], "exitance": [[1.0]], "wall": [[0]]}), ("oven", {"T": [[500.0]]})):
        meshio.write(path / f"{name}.vtu", meshio.Mesh(*triangle, cell_data=arrays))
    etendue.trace_particles(str(path / "scene.xml"), paths=500, save=path / "room.particles")
    etendue.solve_radiosity("cornell-box", bundles=2, checkpoint=path / "solution.checkpoint")
    (path / "results").mkdir()
    shutil.copy(path / "picture.checkpoint", path / "results" / "glass.checkpoint")
    return path


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_are_understood(command, folder, monkeypatch, capsys):
    assert_understood(command, folder, monkeypatch, capsys)


@pytest.mark.parametrize("command", _COMMAND.findall((ROOT / "docs" / "index.md").read_text("utf-8")))
def test_commands_of_the_first_page_need_no_files(command, tmp_path, monkeypatch, capsys):
    assert_understood(command, tmp_path, monkeypatch, capsys)


def assert_understood(command, folder, monkeypatch, capsys):
    """All is read and checked; nothing is rendered."""
    begun, own = [], mi.variant()

    def begin(*arguments):
        begun.append(arguments)
        return 0

    def choose(variant, threads, low_priority=False, scene=None, colours=""):
        mi.set_variant(f"{own.split('_')[0]}_ad_{colours_of(scene)}" if scene is not None else own)

    monkeypatch.chdir(folder)
    monkeypatch.setattr(running, "choose_device", choose)
    monkeypatch.setattr(options.Device, "opened", lambda device: nullcontext())
    for place, name in (
        (running, "render_to_files"),
        (compare.Comparison, "run"),
        (lines, "run_on_patches"),
        (lines, "write_again"),
        (particles, "trace_to_file"),
        (viewing, "show"),
        (doctor, "run_doctor"),
    ):
        monkeypatch.setattr(place, name, begin)
    monkeypatch.setattr(running, "follow", lambda *_: begin() or running.Outcome(None, 0))
    monkeypatch.setattr(display, "develop", lambda layers, *_, **__: begun.append(layers) or layers["image"])
    words = shlex.split(command, comments=True)[1:]
    if words[:2] == ["particles", "trace"]:  # refuses to overwrite the file that the others read
        words[words.index("-o") + 1] = "new.particles"
    if words[0] == "film-picture" and "--size" in words:
        words[words.index("--size") + 1] = "64x48"
    with mi.variant_context(own):
        assert main(words) == 0, capsys.readouterr().err
    assert begun or capsys.readouterr().out


def test_the_page_on_python_lists_all_methods_and_plugins():
    text = (ROOT / "docs" / "python.md").read_text("utf-8")
    for name, method in methods.table().items():
        assert f"[{name}](methods/{name}.md)" in text, name
        assert not method.plugin_name() or f"`{method.plugin_name()}`" in text, name
