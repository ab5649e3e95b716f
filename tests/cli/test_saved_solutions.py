"""`etendue radiosity --solution`: a solution is only written again for its own scene, and by the options it has."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from support.patches import box, joined

from etendue.cli.main import main
from etendue.products.patches import picture
from etendue.radiosity import ABuffer, read_solution, save_solution, scene_patches, solve
from etendue.surfaces import SurfaceError

meshio = pytest.importorskip("meshio")

SCENE = """<scene version="3.0.0"><default name="x" value="0"/><default name="rho" value="0.5"/>
    <default name="light" value="1"/><sensor type="perspective"><transform name="to_world">
        <lookat origin="0, -0.9, 0.2" target="0, 1, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="8"/></film></sensor>
    <shape type="cube"><boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="$rho, 0.5, 0.5"/></bsdf></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><translate z="-0.5" x="$x"/></transform>
        <bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="$light, 2, 4"/></emitter></shape>
</scene>
"""
MADE = "--bundles 16 --max-area 0.5 --seed 3"


def run(command: str) -> int:
    return main(shlex.split(f"radiosity {command}"))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, variant):
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), box((0.4, 0.4, 0.4), (0.6, 0.6, 0.6)))
    arrays = {"glow": [np.eye(30)[29]], "wall": [np.arange(30) // 4]}
    for name, shift in (("room.vtu", 0.0), ("moved.vtu", 0.1)):
        points = vertices + np.where(np.arange(len(vertices)) >= len(vertices) - 24, shift, 0)[:, None]
        meshio.write(name, meshio.Mesh(points, [("quad", faces)], cell_data=arrays))


def refused(command: str, capsys) -> str:
    capsys.readouterr()
    assert run(command) > 0
    lines = capsys.readouterr().err.splitlines()
    assert not Path("again.exr").exists() and not Path("again.vtu").exists()
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize("kind", [".npz", ".nc"])
def test_a_scene(kind, capsys):
    if kind == ".nc":
        pytest.importorskip("h5netcdf")
    assert run(f"scene.xml {MADE} -o s{kind}") == 0
    for fitting in ("", MADE, "--seed 3 --solver conjugate-gradient"):
        assert run(f"scene.xml {fitting} --solution s{kind} -o p.exr -o p{kind}") == 0
    again = f"scene.xml --solution s{kind} -o again.exr"
    for parameter, message in (
        ("-P x=0.25", "4 of 52 faces are elsewhere, the first is face 48"),
        ("-P rho=0.7", "the reflectance of 48 of 52 patches differs"),
        ("-P light=3", "the emission of 4 of 52 patches differs"),
    ):
        said = refused(f"{again} {parameter}", capsys)
        assert f"'s{kind}' is the solution of another scene (scene.xml)" in said
        assert message in said
    said = refused(f"cornell-box --solution s{kind} -o again.exr", capsys)
    assert "than 'cornell-box': it has" in said and "faces" in said
    # Metadata survive, so that the same holds for a copy.
    said = refused(f"scene.xml --solution p{kind} --max-area 0.1 -o again.exr", capsys)
    assert f"'p{kind}' was made with max_area=0.5, not with max_area=0.1" in said


def test_options_that_contradict(capsys):
    assert run(f"scene.xml {MADE} -o s.npz") == 0
    for option, message in (
        ("--seed 0", "with seed=3, not with seed=0"),
        ("--bundles 32", "with bundles=16, not with bundles=32"),
        ("--solver jacobi", "with solver=conjugate-gradient, not with solver=jacobi"),
        ("--no-shot", "without shot, not with shot=false"),
        ("--time 5", "without seconds, not with seconds=5.0"),
        ("--error 0.1 --seed 4", "without error, not with error=0.1; with seed=3, not with seed=4"),
    ):
        assert f"'s.npz' was made {message}: leave" in refused(
            f"scene.xml --solution s.npz -o again.exr {option}", capsys
        )
    assert "leave out checkpoint" in refused("scene.xml --solution s.npz -o again.exr --checkpoint c", capsys)


def test_a_mesh(capsys):
    mesh = "room.vtu --emission glow --reflectance 0.7,0.5 --bundles 16"
    assert run(f"{mesh} -o s.npz") == 0
    assert run("room.vtu --solution s.npz -o a.vtu") == 0 and run(f"{mesh} --solution s.npz -o b.vtu") == 0
    for command, message in (
        ("room.vtu --reflectance 0.3", "with reflectance=0.7,0.5, not with reflectance=0.3"),
        ("room.vtu --two-sided", "without two_sided, not with two_sided"),
        ("room.vtu --ids wall", "without ids, not with ids=wall"),
        ("moved.vtu", "6 of 30 faces are elsewhere, the first is face 24"),
    ):
        assert message in refused(f"{command} --solution s.npz -o again.vtu", capsys)


def test_a_file_without_settings(capsys):
    """As other programs and earlier versions write it: the scene is compared, options cannot be."""
    assert run(f"scene.xml {MADE} -o s.npz") == 0
    save_solution("old.npz", read_solution("s.npz")[0])
    assert run("scene.xml --solution old.npz -o p.exr") == 0
    assert "does not say its max_area" in refused("scene.xml --solution old.npz --max-area 0.5 -o again.exr", capsys)
    assert "another scene" in refused("cornell-box --solution old.npz -o again.exr", capsys)


def test_a_picture_of_another_scene_in_python():
    assert run(f"scene.xml {MADE} -o s.npz") == 0
    solution = read_solution("s.npz")[0]
    with pytest.raises(SurfaceError, match="the solution is of another scene"):
        picture(solution, "cornell-box", size=(8, 8))


def test_a_picture_of_patches_that_are_not_flat():
    """Whole shapes, whose normals vanish in the mean."""
    patches = scene_patches("scene.xml", per="shape")
    made = picture(solve(patches, ABuffer(patches).cast(16)), "scene.xml", size=(8, 6), spp=1)
    assert made.image.min() > 0
