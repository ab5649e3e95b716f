"""`etendue radiosity`: pictures, lightmaps, netCDF and glTF; options that do not belong together."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import etendue
from etendue.cli.main import main
from etendue.display import false_colour
from etendue.film import read_exr, read_image

h5netcdf = pytest.importorskip("h5netcdf")
pytest.importorskip("trimesh")
meshio = pytest.importorskip("meshio")

SCENE = """<scene version="3.0.0">
    <sensor type="perspective"><float name="fov" value="60"/>
        <transform name="to_world"><lookat origin="0, -0.9, 0.2" target="0, 1, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="18"/></film></sensor>
    <sensor type="perspective"/>
    <shape type="cube"><boolean name="flip_normals" value="true"/><bsdf type="diffuse"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><translate z="-0.5"/></transform>
        <bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="1, 2, 4"/></emitter></shape>
</scene>
"""
#: Walls that emit evenly, so that E = pi L / (1 - rho) = 2 pi everywhere.
CLOSED = """<scene version="3.0.0"><sensor type="perspective"/>
    <shape type="cube"><boolean name="flip_normals" value="true"/><bsdf type="diffuse"/>
        <emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
</scene>
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)


def run(command: str, variant: str) -> int:
    return main(shlex.split(f"radiosity scene.xml --bundles 32 --max-area 0.5 --variant {variant} {command}"))


def test_a_picture_with_its_error(capsys, variant):
    assert run("-o p.exr --gather 4 --size 16x12", variant) == 0
    assert capsys.readouterr().out == "p.exr\n"
    made = read_exr("p.exr")
    assert made.image.shape == (12, 16, 3) and made.image.min() >= 0 and made.layers["error"].max() > 0
    assert made.metadata["method"] == "path" and made.metadata["bundles"] == 32
    assert made.metadata["solver"] == "conjugate-gradient" and made.metadata["samples"] == 4


def test_a_page_beside_the_solution_and_later(capsys, variant):
    assert run("-o s.npz --page", variant) == 0
    assert capsys.readouterr().out == "s.npz\ns.html\n"
    page = Path("s.html").read_text("utf-8")
    for words in ("Radiosity of scene.xml", "Energy balance", "residual over iterations", "Largest standard errors"):
        assert words in page
    assert "etendue radiosity scene.xml --bundles 32 --max-area 0.5" in page and '"name": "camera"' in page
    assert run("-o again.html --solution s.npz", variant) == 0
    assert "Energy balance" in Path("again.html").read_text("utf-8")


def test_a_solution_is_written_to_every_file(capsys, variant):
    assert run("-o s.npz -o p.exr -o s.vtu --page", variant) == 0
    assert capsys.readouterr().out == "s.npz\np.exr\ns.vtu\ns.html\n"
    assert all(Path(name).is_file() for name in ("s.npz", "p.exr", "s.vtu", "s.html"))
    assert run("-o a.vtu -o a.ply --solution s.npz", variant) == 0
    assert Path("a.vtu").is_file() and Path("a.ply").is_file()


def test_a_lightmap_beside_other_files(capsys, variant):
    pytest.importorskip("xatlas")
    assert run("-o s.npz -o m.glb --lightmap 64", variant) == 0
    assert capsys.readouterr().out == "s.npz\nm.exr\nm.glb\n" and Path("s.npz").is_file()
    assert run("-o p.exr -o m.glb --lightmap 64", variant) == 2
    assert "one of 2 outputs is the lightmap" in capsys.readouterr().err


def test_an_eight_bit_picture_and_its_error(capsys, variant):
    assert run("-o p.png --error-picture --flat --spp 2", variant) == 0
    out, err = capsys.readouterr()
    assert out == "p.png\np-error.png\n" and "p-error.png: relative standard error, black 0.1% to yellow 100%" in err
    assert read_image("p.png").shape == read_image("p-error.png").shape == (18, 24, 3)
    assert np.ptp(read_image("p-error.png")) > 0


def test_photometric_outputs(capsys, variant):
    assert run("-o s.npz -o s.vtu -o s.nc -o s.png --page --photometric --size 420x410", variant) == 0
    err = capsys.readouterr().err
    with np.load("s.npz") as saved:
        lux = 683.0 * saved["irradiance"] @ [0.2126, 0.7152, 0.0722]
        np.testing.assert_allclose(saved["illuminance"], lux)
        np.testing.assert_allclose(saved["luminous_exitance"], 683.0 * saved["radiosity"] @ [0.2126, 0.7152, 0.0722])
        mean = np.average(lux, weights=saved["areas"])
        assert f"illuminance {lux.min():.4g} to {lux.max():.4g} lx, mean {mean:.4g}" in err
        assert json.loads(str(saved["metadata"]))["units"]["luminous_exitance"] == "lm/m^2"
        patches = len(lux)
    with h5netcdf.File("s.nc", "r") as file:
        assert file.variables["illuminance"].attrs["units"] == "lx"
    cells = np.concatenate(meshio.read("s.vtu").cell_data["illuminance"])
    assert cells.min() == pytest.approx(lux.min()) and len(cells) >= patches
    page = Path("s.html").read_text("utf-8")
    assert f"Illuminance {lux.min():.4g} to {lux.max():.4g} lx" in page and '"unit": "lx"' in page
    picture = np.asarray(Image.open("s.png").convert("RGB"))
    assert picture.shape[0] == 410 and picture.shape[1] > 420 and (picture[:, 421:428] == 255).all()
    # Later, from the file: the picture is irradiance, of which a wall has what its patches have.
    assert run("-o again.png --photometric --flat --solution s.npz --size 420x410", variant) == 0
    assert np.asarray(Image.open("again.png").convert("RGB")).shape[0] == 410
    assert run("-o plain.npz", variant) == 0
    with np.load("plain.npz") as saved:
        assert "illuminance" not in saved


@pytest.mark.slow
def test_the_range_of_false_colours(variant):
    """Pixels are coloured by the given scale, here and when the run is resumed."""
    closed = "--bundles 64 --max-area 1 --photometric --flat --size 420x410"
    Path("closed.xml").write_text(CLOSED)
    command = f"radiosity closed.xml {closed} --variant {variant} -o r.png --checkpoint r.checkpoint"
    assert main(shlex.split(f"{command} --range 0:5000")) == 0
    expected = false_colour(np.array([[2.0 * np.pi * 683.0]]), 0.0, 5000.0, logarithmic=False)[0, 0]
    for bundles in (96, 128):
        picture = np.asarray(Image.open("r.png").convert("RGB"))
        assert np.abs(picture[200, 200].astype(int) - expected).max() <= 2
        Path("r.png").unlink()
        assert main(shlex.split(f"resume r.checkpoint --bundles {bundles}")) == 0


def test_the_picture_of_irradiance_in_a_closed_room(variant):
    """Walls that emit evenly: E = pi L / (1 - rho) everywhere, and so is the picture."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    lamp = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    sensor = {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}}
    walls = {"type": "cube", "flip_normals": True, "bsdf": grey, "emitter": lamp}
    scene = {"type": "scene", "sensor": sensor, "walls": walls}
    made = etendue.solve_radiosity(scene, bundles=64, max_area=1.0, photometric=True, save="e.png", variant=variant)
    np.testing.assert_allclose(made.picture.image, np.pi * np.array([2.0, 4.0, 6.0]) * np.ones((8, 8, 1)), rtol=1e-3)


def test_arrays_and_vertex_colours(variant):
    assert run("-o s.nc", variant) == 0
    with h5netcdf.File("s.nc", "r") as file:
        assert {"radiosity", "radiosity_error", "vertex_x"} <= set(file.variables)
        assert json.loads(file.attrs["metadata"])["source"] == "scene.xml"
    assert run("-o s.glb", variant) == 0
    assert Path("s.glb").read_bytes().startswith(b"glTF")


def test_a_solution_is_written_in_other_ways(capsys, variant):
    """Later, through another sensor or as another file: the same as at once."""
    assert run("-o p.exr --sensor 0", variant) == 0
    for name in ("s.npz", "s.nc"):
        assert run(f"-o {name}", variant) == 0
        capsys.readouterr()
        assert run(f"-o again.exr --solution {name}", variant) == 0
        out, err = capsys.readouterr()
        assert out == "again.exr\n" and "segments" not in err
        for layer in ("image", "error"):
            np.testing.assert_allclose(read_exr("again.exr").layers[layer], read_exr("p.exr").layers[layer], atol=1e-5)
    assert run("-o again.vtu --solution s.nc", variant) == 0 and Path("again.vtu").is_file()


@pytest.mark.parametrize(("output", "mesh"), [("m.glb", "m.glb"), ("m.exr", "m.glb"), ("m.obj", "m.obj")])
def test_a_lightmap_and_its_mesh(output, mesh, capsys, variant):
    pytest.importorskip("xatlas")
    assert run(f"-o {output} --lightmap 128", variant) == 0
    out, err = capsys.readouterr()
    assert out == f"m.exr\n{mesh}\n" and "covered by surfaces" in err
    made = read_exr("m.exr")
    assert max(made.image.shape[:2]) <= 128 and made.image.min() > 0
    if mesh == "m.glb":  # the map on the coordinates that were written for it
        assert run("-o again.exr --lightmap 64 --uv m.glb", variant) == 0
        assert read_exr("again.exr").image.shape == (64, 64, 3)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("-o s.tiff", "take .npz, .vtu, .ply, .nc, .glb, .gltf, .exr, .png"),
        ("-o s.vtu --gather 4", "gather is for pictures"),
        ("-o s.exr --lightmap 64 --uv scene --size 8x8", "size is for pictures"),
        ("-o s.exr --error-picture", "an error picture is for .png"),
        ("-o s.png --error-picture --bundles 1", "an error picture needs at least two bundles"),
        ("-o s.vtu -o s.ply --photometric", "photometric numbers are written to .vtu, .npz, .nc, .png, .html, not to"),
        ("-o s.png --photometric --gather 4", "gather is of radiance"),
        ("-o s.vtu --photometric --temperature 300", "temperature makes heat"),
        ("-o s.png --range 0:500", "write a photometric .png"),
        ("-o s.vtu --photometric --range 0:500", "write a photometric .png"),
        ("-o s.png --photometric --range 5:1", "rises from its low to its high end, not from 5 to 1"),
        ("-o s.exr --uv scene", "uv is for lightmaps"),
        ("-o s.vtu --lightmap 64", "take .exr, .glb, .gltf, .obj"),
        ("-o s.exr --lightmap 64 --uv scene", "texture coordinates overlap"),
        ("-o s.exr --lightmap 64 --uv nothing.glb", "there is no mesh file 'nothing.glb'"),
        ("-o s.exr --sensor 7", "has no sensor 7"),
        ("-o s.exr --lightmap 4", "16"),
        ("-o nowhere/s.exr", "there is no folder"),
        ("-o s.exr --solution old.npz", "there is no file of a solution 'old.npz'"),
        ("-o s.exr --solution scene.xml", "is no file of a solution"),
    ],
)
def test_bad_input(command, message, capsys, variant):
    assert run(command, variant) in (2, 3, 5)
    err = capsys.readouterr().err
    assert message in err.splitlines()[-1]
    assert [path.name for path in Path().iterdir()] == ["scene.xml"]


@pytest.mark.parametrize(
    ("absent", "command", "message"),
    [
        ("numba", "-o s.npz", "radiosity needs numba, not installed: pip install 'etendue[radiosity]'"),
        ("xatlas", "-o m.glb --lightmap 64", "pip install 'etendue[lightmap]'"),
        ("h5py", "-o s.nc", "needs h5py, which is not installed: pip install 'etendue[netcdf]'"),
        ("h5netcdf", "-o s.nc", "needs h5netcdf, which is not installed: pip install 'etendue[netcdf]'"),
    ],
)
def test_a_missing_library_is_named_first(absent, command, message, monkeypatch, capsys, variant):
    monkeypatch.setitem(sys.modules, absent, None)
    assert run(command, variant) == 6
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and message in line
