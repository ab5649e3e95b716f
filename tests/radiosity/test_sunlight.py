"""Direct light of suns: shadows in closed form, files, the command."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from support.patches import square
from support.weather import written, year

import etendue
from etendue.cli.main import main
from etendue.core import OptionError
from etendue.lighting import LightingError, Suns, read_epw
from etendue.radiosity import Patches, box, joined, sunlight

meshio = pytest.importorskip("meshio")
HEIGHT = 3.0


def ground(cells=20):
    """The ground from -5 to 5 in square patches."""
    edges = np.linspace(-5, 5, cells + 1)
    x, y = np.meshgrid(edges, edges, indexing="ij")
    i, j = (k.ravel() for k in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    at = lambda a, b: a * (cells + 1) + b  # noqa: E731
    faces = np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), faces


def place(**properties):
    """A box of 2 x 2 x 3 on the ground."""
    return Patches(*joined(ground(), box((-1, -1, 0), (1, 1, HEIGHT), 2)), **properties)


def covered(low, high, edges):
    """Lengths of the cells between ``edges`` that an interval covers."""
    return np.clip(np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1]), 0, None)


@pytest.mark.parametrize(("up", "turned"), [("z", lambda v: v), ("y", lambda v: v[:, [0, 2, 1]] * [1, 1, -1])])
def test_the_shadow_of_a_box(up, turned):
    patches = place()
    if up == "y":
        patches = Patches(turned(patches.vertices), patches.faces)
    # Suns in the east, in the zenith and oblique, which casts the hexagon of the box and its shifted copy.
    suns = Suns([[1.7, 0, 3], [0, 0, 1], [1, 2, 4]], [800, 900, 500])
    found = sunlight(patches, suns, up=up)
    cells, edges = 400, np.linspace(-5, 5, 21)
    shadow = np.outer(covered(-1 - HEIGHT * 1.7 / 3, 1, edges), covered(-1, 1, edges)).ravel() / 0.25
    z = np.abs(found.sunlit[:cells, 0] - (1 - shadow)) / np.maximum(found.error[:cells, 0], 0.01)
    assert z.max() < 5
    in_shadow = 0.25 * (1 - found.sunlit[:cells]).sum(axis=0)
    area = [4 + 2 * HEIGHT * (abs(x) + abs(y)) / up_ for x, y, up_ in ([1.7, 0, 3], [0, 0, 1], [1, 2, 4])]
    error = 0.25 * np.sqrt((found.error[:cells] ** 2).sum(axis=0))
    assert (np.abs(in_shadow - area) < 4 * error + 1e-9).all() and (error < 0.05).all()
    cosine = 3 / np.hypot(1.7, 3)
    lit = found.irradiance[:cells, 0][shadow == 0]
    assert lit == pytest.approx(800 * cosine, rel=1e-9)
    # The walls: only those towards the sun are lit, by the cosine of its rays.
    walls = found.irradiance[cells:, 0]
    east = turned(np.array([[1.0, 0, 0]]))[0]
    facing = patches.normals[cells:] @ east > 0.5
    top = patches.normals[cells:] @ turned(np.array([[0.0, 0, 1]]))[0] > 0.5
    assert walls[facing] == pytest.approx(800 * 1.7 / np.hypot(1.7, 3), rel=1e-9)
    assert walls[top] == pytest.approx(800 * cosine, rel=1e-9)
    assert not walls[~facing & ~top].any()


def test_the_errors_are_those_of_repeated_runs():
    patches, suns = place(), Suns([[1.3, 2.1, 4]], 1.0)
    runs = [sunlight(patches, suns, lines=30_000, seed=k) for k in range(24)]
    sunlit, error = (np.stack([getattr(run, name)[:400, 0] for run in runs]) for name in ("sunlit", "error"))
    edge = sunlit.std(axis=0) > 0
    assert edge.sum() > 10
    # Mean over the patches at the edge of the shadow, of variances.
    assert np.mean(error[:, edge] ** 2) == pytest.approx(np.mean(sunlit[:, edge].var(axis=0, ddof=1)), rel=0.2)


def test_rays_take_the_place_of_few_lines():
    # A mote of a plate under half of a roof, in a scene so large that hardly a line meets it.
    plate = square((-1e-3, -1e-3, 0), (2e-3, 0, 0), (0, 2e-3, 0))
    roof = square((0, 5, 1), (5, 0, 0), (0, -10, 0))  # its edge is x = 0, at height 1
    found = sunlight(Patches(*joined(plate, roof)), Suns([[0, 0, 1], [0.5e-3, 0, 1], [0.1, 0, 1], [-0.1, 0, 1]], 1.0))
    assert found.sunlit[0] == pytest.approx([0.5, 0.25, 0, 1], abs=0.02)
    assert found.error[0, 0] == pytest.approx(np.sqrt(0.25 / 256), rel=0.01)


def test_suns_below_the_horizon_and_faces_that_look_away():
    sheet = Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)), two_sided=True)
    found = sunlight(sheet, Suns([[0, 0, -1], [0, 1, 1]], 100.0))
    assert not found.irradiance[:, 0].any() and not found.irradiance[1].any()
    assert found.irradiance[0, 1] == pytest.approx(100 / np.sqrt(2))
    # A patch of two faces under a right angle has the mean of both.
    bent = joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 1, 0), (1, 0, 0), (0, 0, 3)))
    both = sunlight(Patches(*bent, ids=[7, 7]), Suns([[0, -1, 2]], 1.0))
    assert both.irradiance[0, 0] == pytest.approx((2 * 1 + 1 * 3) / np.sqrt(5) / 4, rel=1e-9)


def test_suns_of_tables_places_and_weather(tmp_path):
    table = tmp_path / "suns.csv"
    table.write_text("name,azimuth,altitude,direct_normal\nmorning, 90, 30, 500\nnoon,180,60,800\n")
    read = Suns.read(table)
    assert read.names == ("morning", "noon") and read.direct_normal.tolist() == [500, 800]
    assert read.directions == pytest.approx(np.array([[np.sqrt(0.75), 0, 0.5], [0, -0.5, np.sqrt(0.75)]]))
    table.write_text("x,y,z\n0,0,2\n")
    assert Suns.read(table).directions.tolist() == [[0, 0, 1]] and Suns.read(table).direct_normal.tolist() == [1]
    at = Suns.at(46.95, 7.45, ["2024-06-21T12:00+02:00"])
    assert at.names == ("2024-06-21T12:00+02:00",) and at.directions[0, 2] > 0.8
    weather = read_epw(written(tmp_path, year()))
    hours = Suns.of_weather(weather, range(4000, 4024))
    assert 10 < len(hours) < 18 and set(hours.direct_normal) == {500.0} and hours.names[0].startswith("2023-06-16")
    for text, message in (
        ("x,y\n1,2\n", "no suns"),
        ("x,y,z\n", "no suns"),
        ("x,y,z\n1,2,up\n", "sun 1 of"),
        ("x,y,z\n0,0,0\n", "length 0"),
        ("azimuth,altitude\n10,95\n", "beyond 90"),
        ("x,y,z,direct_normal\n0,0,1,-3\n", "from 0 on"),
    ):
        table.write_text(text)
        with pytest.raises(LightingError, match=message):
            Suns.read(table)
    with pytest.raises(LightingError, match="no direct light"):
        Suns.of_weather(weather, range(2))


def test_files(tmp_path):
    pytest.importorskip("h5netcdf")
    files = [tmp_path / name for name in ("s.csv", "s.npz", "s.nc")]
    found = etendue.sunlight(place(), Suns([[1, 0, 2], [0, 0, 1]], [300, 600], ("a", "b")), save=files)
    rows = list(csv.DictReader(files[0].open()))
    assert len(rows) == 2 * 424 and rows[424]["sun"] == "b" and rows[7]["patch"] == "patch:7"
    assert float(rows[424 + 3]["irradiance"]) == pytest.approx(600)
    with np.load(files[1]) as arrays:
        assert np.array_equal(arrays["irradiance"], found.irradiance) and arrays["suns"].tolist() == ["a", "b"]
        assert np.array_equal(arrays["sunlit"], found.sunlit)
    import h5netcdf

    with h5netcdf.File(files[2]) as saved:
        assert np.array_equal(saved["irradiance"][...], found.irradiance)
        assert saved["irradiance"].attrs["units"] == "W m-2" and saved["sun"][...].shape[0] == 2
    with pytest.raises(OptionError, match="written as"):
        etendue.sunlight(place(), [[0, 0, 1]], save=tmp_path / "s.vtu")


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    vertices, faces = joined(ground(4), box((-1, -1, 0), (1, 1, HEIGHT)))
    meshio.write("tower.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    written(tmp_path, year())
    assert main(["sunlight", "tower.ply", "--epw", "weather.epw", "--hours", "4000:4024", "-o", "day.npz"]) == 0
    out, err = capsys.readouterr()
    assert out == "day.npz\n" and "22 patches" in err and "suns" in err
    with np.load("day.npz") as arrays:
        irradiance, suns = arrays["irradiance"], arrays["sun_directions"]
    roof = np.argmax(irradiance.sum(axis=1))
    assert irradiance[roof] == pytest.approx(500 * suns[:, 2], rel=1e-6)
    place_and_time = ["--latitude", "46.95", "--longitude", "7.45", "--at", "2024-06-21T12:00+02:00"]
    assert main(["sunlight", "tower.ply", *place_and_time]) == 0 and (tmp_path / "sunlight.csv").exists()
    for words, message in (
        ([], "which suns"),
        (["--epw", "weather.epw", *place_and_time], "which suns"),
        (["--latitude", "46"], "all of"),
        (["--epw", "weather.epw", "--hours", "9000:9001"], "0 to 8760"),
        ([*place_and_time, "--up", "x"], "y or z"),
    ):
        capsys.readouterr()
        assert main(["sunlight", "tower.ply", *words]) == 2, words
        assert message in capsys.readouterr().err
