"""Methods of other packages: registered by a program, or found by an entry point."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import etendue
from etendue import methods
from etendue.core import OptionError
from etendue.methods import Path as PathMethod, registry

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "occlusion.py"


@pytest.fixture
def own(monkeypatch):
    """A method that is there for one test."""
    monkeypatch.setattr(registry, "_methods", dict(registry._methods))

    class Mine(PathMethod):
        """Path tracing by another name."""

        name = "mine"

    return Mine


def test_a_registered_method_is_a_method(own, tmp_path):
    etendue.register(own)
    assert methods.get("mine") is own and list(methods.table())[-1] == "mine"
    options = {"spp": 4, "size": (8, 8), "seed": 3, "samples_per_pass": 2}
    mine = etendue.render("cornell-box", "mine", checkpoint=tmp_path / "a.checkpoint", **options)
    np.testing.assert_array_equal(mine.image, etendue.render("cornell-box", "path", **options).image)
    assert etendue.resume(tmp_path / "a.checkpoint", spp=6).metadata["method"] == "mine"


def test_a_registered_method_is_a_mitsuba_integrator(own):
    etendue.register(own)
    scene = mi.cornell_box()
    scene["integrator"] = {"type": "mine", "max_depth": 3}
    scene["sensor"]["film"] |= {"width": 8, "height": 8}
    assert np.array(mi.render(mi.load_dict(scene), spp=4)).mean() > 0.0
    assert etendue.render(scene, spp=2).metadata["method"] == "mine"


def test_registered_again(own):
    """As a cell of a notebook that is run twice does: the later class counts."""
    assert etendue.register(own) is own
    again = type("Mine", (own,), {"__module__": own.__module__, "__qualname__": own.__qualname__})
    etendue.register(again)
    assert methods.get("mine") is again


def test_derived_methods_have_integrators_of_their_own():
    assert (PathMethod.plugin_name(), methods.get("guided").plugin_name()) == ("", "guided")
    assert methods.by_plugin("guided") is methods.get("guided") and methods.by_plugin("path") is None
    table = {method.plugin_name(): name for name, method in methods.table().items() if method.plugin_name()}
    assert methods.plugins() == table  # the names that are known without importing the methods


@pytest.mark.parametrize(
    ("attributes", "text"),
    [
        ({"name": "path"}, "the name 'path' is used by etendue.methods.path.Path"),
        ({"plugin": "vcm"}, "is used by etendue.methods.bidirectional.variants.Vcm"),
        ({"Settings": None}, "needs Settings"),
        ({"name": "My method"}, "small letters"),
        ({"citations": ("Nobody2020",)}, "cites Nobody2020"),
    ],
)
def test_what_cannot_be_registered(own, attributes, text):
    for key, value in attributes.items():
        setattr(own, key, value)
    with pytest.raises(OptionError, match=text):
        etendue.register(own)


@pytest.mark.parametrize("thing", [int, object(), "path"])
def test_what_is_no_method(thing):
    with pytest.raises(OptionError, match="subclass of"):
        etendue.register(thing)


@pytest.fixture
def package(tmp_path):
    """An installed package with one method that works, and one that cannot be loaded."""
    (tmp_path / "occluded.py").write_text(EXAMPLE.read_text("utf-8"), "utf-8")
    info = tmp_path / "occluded-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: occluded\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[etendue.methods]\nocclusion = occluded:Occlusion\nbroken = occluded:Missing\n"
    )
    return tmp_path


def commands(folder: Path, *lines: str) -> list[tuple[str, str, int]]:
    """What each command writes to both streams and its exit status; in one process, which finds the package."""
    code = f"""
import sys
sys.path.insert(0, {str(folder)!r})
from etendue.cli.main import main
for line in sys.argv[1:]:
    status = main(line.split())
    print(f"--{{status}}--", flush=True)
    print("----", file=sys.stderr, flush=True)
"""
    done = subprocess.run([sys.executable, "-c", code, *lines], capture_output=True, text=True, cwd=folder, timeout=300)
    assert done.returncode == 0, done.stderr
    out = re.split(r"--(\d+)--\n", done.stdout)
    return list(zip(out[:-1:2], done.stderr.split("----\n"), map(int, out[1::2]), strict=False))


def test_an_entry_point_is_in_the_command_line(package):
    listed, shown, made, refused = commands(
        package,
        "methods",
        "methods occlusion",
        "compare cornell-box -m path -m occlusion --spp 2 --size 8x8 -o page",
        "render cornell-box -m broken --spp 1 -o a.exr",
    )
    assert "occlusion" in listed[0] and "share of the hemisphere" in listed[0]
    assert "method 'broken' of another package cannot be loaded: occluded:Missing" in listed[1]
    assert "reach" in shown[0]
    assert made[2] == 0, made
    assert "occlusion" in (package / "page" / "index.html").read_text("utf-8")
    assert refused[2] == 2 and "method 'broken' cannot be loaded: occluded:Missing" in refused[1]
