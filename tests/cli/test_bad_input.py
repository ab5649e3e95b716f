"""Whatever is wrong: one line that says what and what to do, a status that is not 0, no traceback."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import pytest

from etendue.cli.main import main

SENSOR = '<sensor type="perspective"/>'
LIGHT = '<emitter type="constant"/>'
PLY = """ply
format binary_little_endian 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of broken scenes, which is the current one."""
    import struct

    def scene(name: str, content: str) -> None:
        (tmp_path / name).write_text(f'<scene version="3.0.0">{content}</scene>')

    (tmp_path / "malformed.xml").write_text('<scene version="3.0.0"><sensor></scene>')
    scene("no-emitter.xml", SENSOR + '<shape type="sphere"/>')
    scene("no-sensor.xml", LIGHT + '<shape type="sphere"/>')
    albedo = '<float name="albedo" value="1.5"/>'
    medium = f'<medium name="interior" type="homogeneous">{albedo}</medium>'
    scene("medium.xml", SENSOR + LIGHT + f'<shape type="sphere">{medium}</shape>')
    texture = '<texture name="reflectance" type="bitmap"><string name="filename" value="no.png"/></texture>'
    scene("texture.xml", SENSOR + LIGHT + f'<shape type="sphere"><bsdf type="diffuse">{texture}</bsdf></shape>')
    scene("variable.xml", SENSOR + LIGHT + '<shape type="sphere"><float name="radius" value="$r"/></shape>')
    scene("plugin.xml", SENSOR + LIGHT + '<shape type="spere"/>')
    for name, x in (("nan", float("nan")), ("inf", float("inf"))):
        data = struct.pack("<9f", 0, 0, x, 1, 0, 0, 0, 1, 0) + struct.pack("<B3i", 3, 0, 1, 2)
        (tmp_path / f"{name}.ply").write_bytes(PLY.encode() + data)
        mesh = f'<shape type="ply"><string name="filename" value="{name}.ply"/></shape>'
        scene(f"{name}.xml", SENSOR + LIGHT + mesh)
    (tmp_path / "checkpoint").write_text("no checkpoint")
    (tmp_path / "file").write_text("")
    monkeypatch.chdir(tmp_path)
    return tmp_path


BAD = [
    # scenes
    ("render missing.xml", 3, "there is no scene file 'missing.xml'"),
    ("render cornell-bax", 3, "did you mean 'cornell-box'"),
    ("render malformed.xml", 3, "malformed.xml"),
    ("render no-emitter.xml", 3, "no emitter"),
    ("render no-sensor.xml", 3, "no sensor"),
    ("render medium.xml", 3, "medium"),
    ("render texture.xml", 3, "no.png"),
    ("render nan.xml", 3, "nan"),
    ("render inf.xml", 3, "inf"),
    ("render variable.xml", 3, "-P r=VALUE"),
    ("render plugin.xml", 3, "spere"),
    ("render cornell-box -P a=1", 2, "parameters"),
    ("render cornell-box --sensor 3", 2, "no sensor 3"),
    ("render file", 3, "file"),
    ("render .", 3, "folder"),
    # methods and their settings
    ("render cornell-box -m vmc", 2, "did you mean 'vcm'"),
    ("render cornell-box -m path -D mod=naive", 2, "did you mean 'mode'"),
    ("render cornell-box -m path -D mode=naiv", 2, "naive, next_event, mis"),
    ("render cornell-box -m path -D mode", 2, "-D needs name=value, not 'mode'"),
    ("render cornell-box -m path -D aovs=1 -D aovs=0", 2, "gives 'aovs' twice"),
    ("render cornell-box --max-depth 3 -D max_depth=4", 2, "gives 'max_depth' twice; give it once"),
    ("render cornell-box --max-dept 3", 2, "there is no option '--max-dept'; did you mean '--max-depth'?"),
    ("render cornell-box --xyzzy", 2, "there is no option '--xyzzy'; -h lists them"),
    ("render cornell-box --max-depth", 2, "--max-depth needs a value"),
    ("render cornell-box --aovs=maybe", 2, "'aovs' must be true or false, not 'maybe'"),
    ("render cornell-box -m path -o a.png --tone agz", 2, "did you mean 'agx'"),
    ("render cornell-box -m path -o a.png --exposure dark", 2, "number of stops or 'auto'"),
    ("render cornell-box -m path -o a.png --exposure nan", 2, "number of stops from -300 to 300"),
    ("render cornell-box --for-denoising -D reconstruction=neighbours", 2, "leave out reconstruction"),
    ("render cornell-box -m film_metropolis --for-denoising", 2, "use pssmlt"),
    ("render cornell-box --no-bsdf-sampling -m bpt", 2, "method 'bpt' has no option 'bsdf_sampling'"),
    ("render cornell-box --pyramid -m path", 2, "method 'path' has no option 'pyramid'"),
    ("render cornell-box -m bpt --pyramid-depth 13", 2, "at most 12"),
    (
        "render cornell-box -m bpt --pyramid --size 200x100 --memory 100M",
        2,
        "depth 5 at 200x100 needs 67 MB, too much for",
    ),
    ("render cornell-box -D samples_per_pass=100000000", 2, "at most 4096"),
    ("render cornell-box --max-depth -2", 2, "max_depth"),
    # budgets
    ("render cornell-box --time 0", 2, "--time must be above 0"),
    ("render cornell-box --time -5", 2, "--time must be above 0"),
    ("render cornell-box --time soon", 2, "--time needs a time such as"),
    ("render cornell-box --spp 0", 2, "--spp must be above 0, not 0"),
    ("render cornell-box --spp -1", 2, "--spp"),
    ("render cornell-box --spp 1.5", 2, "--spp"),
    ("render cornell-box --error 0", 2, "--error must be above 0"),
    ("render cornell-box --error nan", 2, "--error must be above 0"),
    # other options
    ("render cornell-box --size 0x5", 2, "--size needs WIDTHxHEIGHT"),
    ("render cornell-box --size 640", 2, "--size needs WIDTHxHEIGHT"),
    ("render cornell-box --size 99999x99999", 2, "at most 2^30 pixels"),
    ("render cornell-box --memory 1", 2, "of at least 16777216"),
    ("render cornell-box --memory much", 2, "--memory needs a size"),
    ("render cornell-box --memory 0G", 2, "--memory needs a size"),
    ("render cornell-box --save-every never", 2, "--save-every needs a time"),
    ("render cornell-box --save-every=-1", 2, "--save-every"),
    ("render cornell-box --seed -1", 2, "a seed is"),
    ("render cornell-box --threads 0", 2, "threads"),
    ("render cornell-box --threads 100000", 2, "from 1 to 1024"),
    ("render cornell-box --variant scalar_rgb", 6, "variant 'scalar_rgb' is not supported"),
    ("render cornell-box --checkpoint c --no-checkpoint", 2, "exclude each other"),
    # outputs, found before anything is rendered
    ("render cornell-box -o missing/a.exr", 5, "no folder 'missing'"),
    ("render cornell-box -o file/a.exr", 5, "'file' is a file"),
    ("render cornell-box -o a.exr -o a.exr", 2, "'a.exr' is named for two outputs; give each a name of its own"),
    ("render cornell-box -o a.exr --checkpoint ./a.exr", 2, "'a.exr' is named for two outputs"),
    ("render cornell-box -o ''", 2, ".exr or .png"),
    ("render cornell-box --checkpoint ''", 5, "it is a folder"),
    ("resume ''", 4, "checkpoint"),
    ("compare cornell-box -o a -o b", 2, "-o names one file or folder here, not 2: a, b"),
    ("demo -o a -o b", 2, "-o names one file or folder here, not 2: a, b"),
    ("particles trace cornell-box -o a -o b", 2, "-o names one file or folder here, not 2: a, b"),
    ("particles compress file -o a -o b", 2, "-o names one file or folder here, not 2: a, b"),
    ("render cornell-box -o a.jpg", 2, ".exr or .png"),
    ("render cornell-box --checkpoint missing/c", 5, "no folder 'missing'"),
    ("compare cornell-box -o file", 5, "cannot make the folder 'file': that is a file"),
    ("compare cornell-box -o file/folder", 5, "cannot make the folder"),
    # the command line itself
    ("rendr cornell-box", 2, "render"),
    ("render", 2, "SCENE"),
    ("render cornell-box --tiem 5", 2, "there is no option '--tiem'; did you mean '--time'?"),
    # other commands
    ("resume missing", 4, "there is no checkpoint"),
    ("resume checkpoint -m path", 2, "-m"),
    ("resume checkpoint", 4, "not an étendue checkpoint"),
    ("compare cornell-box -m path -m pth", 2, "did you mean 'path'"),
    ("compare cornell-box -m path -m path", 2, "each method once"),
    ("compare cornell-box -D moed=mis", 2, "no option 'moed'"),
    ("compare cornell-box -D bpt.aovs=1", 2, "'bpt' is not among the compared methods"),
    ("compare cornell-box --reference missing.exr", 3, "missing.exr"),
    ("methods vmc", 2, "did you mean 'vcm'"),
    ("cite multipth", 2, "did you mean 'multipath'"),
    ("demo --time 0", 2, "--time must be above 0"),
    ("compare cornell-box --variant scalar_rgb", 6, "variant 'scalar_rgb' is not supported"),
    ("demo --variant scalar_rgb", 6, "variant 'scalar_rgb' is not supported"),
]


@pytest.mark.parametrize(("command", "status", "message"), BAD, ids=[command for command, *_ in BAD])
def test_bad_input(command, status, message, folder, capsys):
    before = sorted(os.listdir(folder))
    assert main(shlex.split(command)) == status
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert lines[-1].startswith("error: ")
    assert message in lines[-1]
    assert len(lines) == 1, f"more than one line: {lines}"
    assert "Traceback" not in err
    assert out == ""
    assert sorted(os.listdir(folder)) == before


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(folder, capsys):
    (folder / "locked").mkdir(mode=0o500)
    assert main(["render", "cornell-box", "-o", "locked/a.exr"]) == 5
    assert "choose a place you may write to" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["render no-sensor.xml --debug", "--debug render no-sensor.xml"])
def test_debug_shows_the_traceback(command, folder, capsys):
    assert main(command.split()) == 3
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.splitlines()[-1].startswith("error: ")


def test_what_nobody_foresaw_is_one_line_too(folder, capsys, monkeypatch):
    def fail(*arguments, **named):
        raise ZeroDivisionError("oh\nno")

    monkeypatch.setattr("etendue.scene.source.load", fail)
    assert main(["render", "cornell-box", "-m", "path", "--spp", "1"]) == 70
    err = capsys.readouterr().err.splitlines()
    assert err == ["error: ZeroDivisionError: oh no (unexpected; --debug shows where, please report it)"]
