"""View factors of sensors: closed forms [Howell's catalogue B-3, B-4], errors, light, files, the command."""

from __future__ import annotations

import csv
import logging
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import load_npz
from support.patches import cube, square

import etendue
from etendue.cli.main import main
from etendue.core import OptionError
from etendue.lighting import Meters
from etendue.radiosity import (
    STEFAN_BOLTZMANN,
    Patches,
    RadiosityError,
    box,
    check_point_file,
    joined,
    point_factors,
    point_factors_to_error,
    read_light,
    read_patches,
)

MESHES = Path(__file__).parents[2].parent / "shared" / "meshes"
meshio = pytest.importorskip("meshio")


def parallel(a, b, c):
    """Of an element to a parallel rectangle a x b at distance c, of which it faces a corner."""
    p, q = np.hypot(a, c), np.hypot(b, c)
    return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)


def perpendicular(a, b, c):
    """Of an element to an upright rectangle of width b and height a at distance c, of which it faces a lower corner."""
    p = np.hypot(a, c)
    return (np.arctan(b / c) - c / p * np.arctan(b / p)) / (2 * np.pi)


def of_sphere(a, b, c):
    """The share of all directions of the rectangle of :func:`parallel`."""
    return np.arctan(a * b / (c * np.sqrt(a * a + b * b + c * c))) / (4 * np.pi)


def above(a, b, c):
    """A rectangle at height c over the origin, which faces down."""
    return square((0, 0, c), (0, b, 0), (a, 0, 0))


@pytest.mark.parametrize(
    ("mesh", "normal", "expected"),
    [
        (above(1, 2, 0.5), (0, 0, 1), parallel(1, 2, 0.5)),
        (above(3, 0.2, 1), (0, 0, 2), parallel(3, 0.2, 1)),
        # Upright, at x = c, from y = 0 to b and up to a.
        (square((0.7, 0, 0), (0, 0, 1.5), (0, 2, 0)), (0, 0, 1), perpendicular(1.5, 2, 0.7)),
        (above(1, 2, 0.5), None, of_sphere(1, 2, 0.5)),
        (above(1, 2, -0.5), (0, 0, 1), 0.0),
    ],
    ids=["parallel", "narrow", "perpendicular", "spherical", "behind"],
)
def test_factors_and_errors_of_a_rectangle(mesh, normal, expected):
    count = 64
    quantity = "spherical" if normal is None else "irradiance"
    sensors = Meters(np.zeros((count, 3)), [normal or (0, 0, 1)], quantity)
    found = point_factors(Patches(*mesh, two_sided=True), sensors, rays=1024)
    factors, errors = (x.toarray().sum(axis=1) for x in (found.matrix, found.errors))
    scatter = factors.std(ddof=1)
    assert abs(factors.mean() - expected) <= 4 * scatter / np.sqrt(count)
    # The variance of independent sensors is that which each of them estimates from 8 replicates.
    assert np.mean(errors**2) == pytest.approx(scatter**2, rel=4 * np.sqrt(2 / count), abs=1e-12)
    assert scatter < 0.006  # of independent rays: 0.5 / 32


def test_more_rays_have_smaller_errors():
    sensors, patches = Meters(np.full((16, 3), 0.4), [[0, 0, 1]]), cube(1)
    few, many = (point_factors(patches, sensors, rays=n) for n in (500, 8192))
    assert (few.rays, many.rays) == (512, 8192)
    largest = [np.sqrt((f.errors.toarray() ** 2).mean(axis=0)).max() for f in (few, many)]
    assert largest[1] < largest[0] / 4 / 1.5  # faster than the root of their number


def test_inside_a_closed_box_all_is_seen():
    where = np.random.default_rng(1).uniform(0.05, 0.95, (20, 3))
    normals = np.random.default_rng(2).normal(size=(20, 3))
    for sensors in (Meters(where, normals), Meters(where, [[0, 0, 1]], "spherical")):
        found = point_factors(cube(3), sensors, rays=256)
        assert np.asarray(found.matrix.sum(axis=1)).ravel() == pytest.approx(1.0, abs=1e-12)
        assert not found.sky.any() and not found.ground.any() and not found.dark.any()
        assert found.gather(np.ones(54)) == pytest.approx(1.0, abs=1e-12)
        assert found.gather_error(np.ones(54)).max() < 1e-12
    # From the centre, a sphere sees each wall alike; walls are groups of nine patches.
    centre = Meters(np.full((32, 3), 0.5), [[0, 0, 1]], "spherical")
    walls = point_factors(cube(3), centre, rays=1024).of_groups(np.repeat(list("abcdef"), 9))
    assert walls.names.tolist() == list("abcdef")
    factors = walls.matrix.toarray()
    assert (np.abs(factors.mean(axis=0) - 1 / 6) < 4 * factors.std(axis=0, ddof=1) / np.sqrt(32)).all()
    # Errors of a group are those of the sum, and not of its parts.
    assert np.mean(walls.errors.toarray() ** 2) == pytest.approx(factors.var(axis=0, ddof=1).mean(), rel=0.3)


def test_what_stands_between_hides():
    # A blind at half the height covers exactly half of the ceiling as seen from the origin.
    ceiling, blind = above(2, 2, 2), above(0.5, 1, 1)
    sensors = Meters(np.zeros((32, 3)), [[0, 0, 1]])
    found = point_factors(Patches(*joined(ceiling, blind)), sensors)
    hidden = parallel(0.5, 1, 1)
    factors = found.matrix.toarray()
    for column, expected in ((0, parallel(1, 1, 1) - hidden), (1, hidden)):
        assert abs(factors[:, column].mean() - expected) < 4 * factors[:, column].std(ddof=1) / np.sqrt(32)
    # The same blind as an obstacle is nobody's patch.
    dark = point_factors(Patches(*joined(ceiling, blind), obstacles=[1]), sensors)
    assert np.array_equal(dark.matrix.toarray()[:, 0], factors[:, 0])
    assert np.array_equal(dark.dark, factors[:, 1])


def test_sheets_and_backs(caplog):
    sheet, sensors = above(1, 1, 1), Meters([[0, 0, 0], [0, 0, 2]], [[0, 0, 1], [0, 0, -1]])
    both = point_factors(Patches(*sheet, two_sided=True), sensors)
    expected = parallel(1, 1, 1)
    z = (both.matrix.toarray() - np.eye(2) * expected) / np.maximum(both.errors.toarray(), 1e-9)
    assert np.abs(z).max() < 5.5  # of Student's t with 7 degrees of freedom
    assert not both.dark.any() and not caplog.records
    with caplog.at_level(logging.WARNING):
        one = point_factors(Patches(*sheet), sensors)
    assert one.dark[0] == 0 and one.dark[1] == both.matrix.toarray()[1, 1]
    assert "1 of 2 sensors see backs" in caplog.text and "sensor 1 at [0.0, 0.0, 2.0]" in caplog.text


@pytest.mark.parametrize(("up", "turned"), [("z", [0, 1, 2]), ("y", [0, 2, 1])])
def test_sky_and_ground_of_sensors_outside_of_everything(up, turned):
    patches = Patches(*box((0, 0, 0), (1, 1, 1)))
    points = np.tile([[40, 3, 0.5]], (32, 1))[:, turned]
    found = point_factors(patches, Meters(points, [[0, 0, 1]], "spherical"), up=up, rays=1024)
    for share in (found.sky, found.ground):
        assert abs(share.mean() - 0.5) < 4 * share.std(ddof=1) / np.sqrt(32) + 1e-4  # 5e-5 is the box
    ways = np.array([[0, 0, 1.0], [0, 0, -1], [1, 0, 0], [0.6, 0, 0.8]])[:, turned]
    plane = point_factors(patches, Meters(points[:4], ways), up=up)
    # Of a slanted plane, (1 + cos) / 2 is the sky.
    assert plane.sky == pytest.approx([1, 0, 0.5, 0.9], abs=5e-3)
    assert plane.ground == pytest.approx([0, 1, 0.5, 0.1], abs=5e-3)
    assert (np.abs(plane.sky - [1, 0, 0.5, 0.9]) <= 6 * plane.ends["sky_error"]).all()


@pytest.mark.skipif(not MESHES.is_dir(), reason="the meshes of other projects are not there")
def test_sky_view_factors_of_a_city():
    """What sensors on the facets of uDALES' example 201 see of the sky, in the mean of each, is as published."""
    folder = MESHES / "udales-201"
    patches = read_patches(folder / "geom.201.STL")
    parts = patches.subdivided(2.0)
    found = point_factors(parts, Meters(parts.centres, parts.normals), rays=256)
    outside, error = (gather(np.zeros(len(parts)), sky=1.0) for gather in (found.gather, found.gather_error))
    areas = np.bincount(parts.face, parts.areas)
    mean = np.bincount(parts.face, outside * parts.areas) / areas
    variance = np.bincount(parts.face, (error * parts.areas) ** 2) / areas**2
    off = mean - np.loadtxt(folder / "svf.inp.201", comments="#")
    # View3D's factors, and points in place of areas, are off by 0.0015 rms.
    assert np.mean(off**2) < 1.2 * variance.mean() + 0.0018**2
    assert variance.mean() < 0.004**2 and abs(off.mean()) < 5e-4


def test_far_from_the_origin():
    place = np.array([5e5, 4e6, 300.0])
    vertices, faces = box((0, 0, 0), (4, 3, 2), 2, inward=True)
    sensors = [[1, 1, 0.8], [2, 1, 0]]
    here, there = (
        point_factors(Patches(vertices + move, faces), Meters(np.array(sensors) + move, [[0, 0, 1]]), rays=1024)
        for move in (0, place)
    )
    assert there.matrix.toarray() == pytest.approx(here.matrix.toarray(), abs=0.005)
    assert there.dark.max() == 0


def test_sensors_on_faces(caplog):
    room = cube(1)
    # On the floor, on a wall, and a little below the floor by rounding.
    places, normals = [[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0.5, -1e-6]], [[0, 0, 1], [1, 0, 0], [0, 0, 1]]
    found = point_factors(room, Meters(places, normals))
    opposite = 4 * parallel(0.5, 0.5, 1)
    factors = found.matrix.toarray()
    assert factors[[0, 1, 2], [5, 1, 5]] == pytest.approx(opposite, abs=0.005)
    assert factors[[0, 1, 2], [4, 0, 4]].max() == 0 and not caplog.records
    ball = Meters([[0.5, 0.5, 0]], [[0, 0, 1]], "spherical")
    slanted = Meters([[0.5, 0.5, 0.5], [0.5, 0.5, 0]], [[1, 0, 1]], names=("a", "b"))
    for sensors, message in (
        (ball, r"sensor 0 at \[0.5, 0.5, 0.0\] lies on face 4 and would see"),
        (slanted, r"sensor 1 \('b'\) at \[0.5, 0.5, 0.0\] lies on face 4 and is slanted"),
        (Meters([[0.5, 0, 0]], [[0, 0, 1]]), "on face 2 and is"),
    ):
        with pytest.raises(RadiosityError, match=message) as error:
            point_factors(room, sensors)
        assert "\n" not in str(error.value)


def test_what_is_refused():
    sensor = Meters([[0.5, 0.5, 0.5]], [[0, 0, 1]])
    for wrong in (0, 127, 1e3, 1 << 24):
        with pytest.raises(RadiosityError, match="a sensor has 128 to"):
            point_factors(cube(1), sensor, rays=wrong)
    with pytest.raises(RadiosityError, match="not of 'cylindrical'"):
        point_factors(cube(1), Meters([[0.5, 0.5, 0.5]], [[0, 0, 1]], "cylindrical"))
    with pytest.raises(RadiosityError, match="for each of 6 patches"):
        point_factors(cube(1), sensor).gather(np.ones(5))


def test_memory_is_estimated_from_the_first_rays(monkeypatch):
    import etendue.radiosity.pointfactors as module

    sensors = Meters(np.full((600, 3), 0.5), [[0, 0, 1]])
    patches = cube(1)
    need = 40.0 * 600 * 8 * 5  # five walls are seen
    monkeypatch.setattr(module, "free_memory", lambda: 1.01 * need)
    assert len(point_factors(patches, sensors, rays=4096)) == 600
    monkeypatch.setattr(module, "free_memory", lambda: 0.99 * need)
    with pytest.raises(RadiosityError, match="take fewer sensors"):
        point_factors(patches, sensors, rays=4096)


def test_the_irradiance_is_that_of_the_radiosities(tmp_path):
    # A black ceiling of 500 K over a black floor of 300 K, and surroundings of 280 K.
    vertices, faces = joined(above(2, 2, 1), square((0, 0, -9), (2, 0, 0), (0, 2, 0)))
    file, mesh, table = (tmp_path / name for name in ("heat.npz", "plates.vtu", "known.csv"))
    meshio.write(mesh, meshio.Mesh(vertices, [("quad", faces.astype(np.int32))], cell_data={"part": [[0, 1]]}))
    table.write_text("group,temperature\n0,500\n1,300\n")
    etendue.solve_heat(mesh, table, surroundings=280.0, bundles=64, save=file)
    found = etendue.compute_point_factors(mesh, np.zeros((16, 3)), [0, 0, 1], solution=file, rays=2048)
    share = parallel(2, 2, 1)
    expected = STEFAN_BOLTZMANN * (share * 500**4 + (1 - share) * 280**4)
    e, error = found.irradiance[:, 0], found.irradiance_error[:, 0]
    assert abs(e.mean() - expected) < 4 * e.std(ddof=1) / 4
    assert np.mean(error**2) == pytest.approx(e.var(ddof=1), rel=4 * np.sqrt(2 / 16))
    # Looking down, there is the other plate, nearly all is the surroundings.
    down = etendue.compute_point_factors(mesh, [[0, 0, 0]], [0, 0, -1], solution=file)
    share = parallel(2, 2, 9)
    expected = STEFAN_BOLTZMANN * (share * 300**4 + (1 - share) * 280**4)
    assert down.irradiance[0, 0] == pytest.approx(expected, abs=6 * down.irradiance_error[0, 0])


def test_light_of_radiosity_solutions(tmp_path):
    room = cube(2, reflectance=0.5, emission=np.repeat([[2.0, 1.0, 0.0]], 24, axis=0))
    solved = etendue.solve_radiosity(room, bundles=64, save=tmp_path / "room.npz")
    found = etendue.compute_point_factors(
        room, [[0.3, 0.4, 0.5]], solution=tmp_path / "room.npz", save=tmp_path / "p.csv"
    )
    # In a closed room of one emission and one reflectance, B = E / (1 - rho) everywhere.
    assert found.irradiance[0] == pytest.approx([4, 2, 0], rel=2e-3)
    assert solved.solution.radiosity == pytest.approx(np.repeat([[4.0, 2, 0]], 24, axis=0), rel=2e-3)
    row = next(csv.DictReader((tmp_path / "p.csv").open()))
    assert float(row["spherical_irradiance_1"]) == pytest.approx(4, rel=2e-3)
    assert "spherical_irradiance_3_error" in row and "nx" not in row
    for other, message in ((cube(1), "24 patches, and there are 6"), (Patches(*box((0, 0, 0), (1, 1, 2), 2)), "other")):
        with pytest.raises(RadiosityError, match=message):
            read_light(tmp_path / "room.npz", other)
    (tmp_path / "not.npz").write_text("")
    np.savez(tmp_path / "others.npz", radiosity=np.zeros(3))
    for name, message in (("no.npz", "no file"), ("not.npz", "no radiosities"), ("others.npz", "no radiosities")):
        with pytest.raises(RadiosityError, match=message):
            read_light(tmp_path / name, room)


def test_light_is_that_of_paths(tmp_path):
    points, normals = [[0, 0.5, 0], [0, 0.9, 0]], [[0, 1, 0], [1, 0, 0]]
    etendue.solve_radiosity("cornell-box", max_area=0.05, bundles=256, save=tmp_path / "s.npz")
    for normal, quantity in ((normals, "irradiance"), (None, "spherical")):
        found = etendue.compute_point_factors(
            "cornell-box", points, normal, max_area=0.05, solution=tmp_path / "s.npz", rays=32768
        )
        read = etendue.measure("cornell-box", points, normals, quantity=quantity, spp=4096)
        # Light is constant on patches, and lines are few: two per cent.
        assert (np.abs(found.irradiance - read.values) < 4 * read.errors + 0.02 * read.values).all()
        assert (read.errors < 0.03 * read.values).all()


def test_light_of_lamps_without_a_surface_is_told_to_be_missing(tmp_path, caplog):
    scene = {
        "type": "scene",
        "floor": {"type": "rectangle"},
        "lamp": {"type": "point", "position": [0, 0, 2], "intensity": 1.0},
    }
    etendue.solve_radiosity(scene, bundles=4, save=tmp_path / "s.npz")
    with caplog.at_level(logging.WARNING):
        etendue.compute_point_factors(scene, [[0, 0, 1]], [0, 0, -1], solution=tmp_path / "s.npz")
    assert "lamp" in caplog.text and "direct light is missing" in caplog.text


def test_files(tmp_path):
    sensors = Meters([[0.5, 0.5, 0.25], [0.25, 0.5, 0.5]], [[0, 0, 1], [1, 0, 0]], names=("desk", "screen, left"))
    files = [tmp_path / "s.csv", tmp_path / "s.npz"]
    found = etendue.compute_point_factors(cube(1), sensors, save=files, rays=1024)
    with files[0].open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["desk", "screen, left"]
    assert [float(rows[1][c]) for c in ("x", "y", "z", "nx", "ny", "nz")] == [0.25, 0.5, 0.5, 1, 0, 0]
    columns = [*(f"patch:{k}" for k in range(6)), "sky", "ground", "backs"]
    assert list(rows[0])[7:] == columns + [f"{name}_error" for name in columns]
    for suffix, values in (("", found.matrix), ("_error", found.errors)):
        written = [[float(row[f"patch:{k}{suffix}"]) for k in range(6)] for row in rows]
        assert written == pytest.approx(values.toarray(), rel=1e-8)
    assert sum(float(rows[0][c]) for c in columns) == pytest.approx(1, abs=1e-7)
    assert np.array_equal(load_npz(files[1]).toarray(), found.matrix.toarray())
    with np.load(files[1]) as arrays:
        assert arrays["sensors"].tolist() == ["desk", "screen, left"] and arrays["names"].tolist() == columns[:6]
        assert np.array_equal(arrays["errors"], found.errors.data) and np.array_equal(arrays["sky"], found.sky)
        assert np.array_equal(arrays["points"], sensors.points) and int(arrays["rays"]) == 1024
    with pytest.raises(OptionError, match="written as"):
        etendue.compute_point_factors(cube(1), sensors, save=tmp_path / "s.vtu")


def test_tables_that_nobody_could_read(tmp_path):
    patches, sensors = cube(1), Meters(np.zeros((2, 3)), [[0, 0, 1]])
    patches.shapes, patches.shape_names = np.arange(6), ("a", "b", "c", "d", "e", "sky")
    with pytest.raises(RadiosityError, match="two columns 'sky'"):
        check_point_file(tmp_path / "s.csv", patches, sensors)
    check_point_file(tmp_path / "s.npz", patches, sensors)
    with pytest.raises(RadiosityError, match="of no use"):
        check_point_file(tmp_path / "s.csv", cube(60), Meters(np.zeros((50_000, 3)), [[0, 0, 1]]))


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.obj").write_text(
        "v 0 0 1\nv 0 1 1\nv 1 1 1\nv 1 0 1\ng roof\nf 1 2 3\nf 1 3 4\n"
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\ng floor\nf 5 6 7\nf 5 7 8\n"
    )
    (tmp_path / "desks.pts").write_text("0.5 0.5 0.5 0 0 1\n0.5 0.5 0.25 0 0 -1\n")
    (tmp_path / "heads.pts").write_text("0.5 0.5 0.5\n")
    assert main(["point-factors", "room.obj", "-p", "desks.pts", "--groups", "-o", "s.csv", "-o", "s.npz"]) == 0
    out, err = capsys.readouterr()
    assert out == "s.csv\ns.npz\n" and "4 patches" in err and "2 sensors see" in err and "8192 rays each" in err
    rows = list(csv.DictReader((tmp_path / "s.csv").open()))
    for row, name, height in zip(rows, ("roof", "floor"), (0.5, 0.25), strict=True):
        share, error = float(row[name]), float(row[f"{name}_error"])
        assert abs(share - 4 * parallel(0.5, 0.5, height)) < 6 * error < 0.01
        assert float(row["sky" if name == "roof" else "ground"]) == pytest.approx(1 - share, abs=1e-7)
    assert main(["point-factors", "room.obj", "-p", "heads.pts", "--spherical", "--rays", "1024"]) == 0
    row = next(csv.DictReader((tmp_path / "sensors.csv").open()))
    above_and_below = sum(float(row[f"{group}:{k}"]) for k, group in enumerate(("roof", "roof", "floor", "floor")))
    assert above_and_below == pytest.approx(8 * of_sphere(0.5, 0.5, 0.5), abs=0.01)
    grid = ["--grid", "0.1,0.1,0.5 0.8,0,0 0,0.8,0", "--cells", "3x2"]
    assert main(["point-factors", "room.obj", *grid, "-o", "grid.npz"]) == 0
    with np.load("grid.npz") as arrays:
        assert arrays["shape"].tolist() == [6, 4]
    for name, text, words, message in (
        ("no", None, [], "cannot read"),
        ("empty", "# none\n", [], "has no meters"),
        ("zero", "0 0 0.5 0 0 1\n0 0 0.5 0 0 0\n", [], "meter 1 has a direction of length 0"),
        ("nan", "0 0 nan 0 0 1\n", [], "number 0 is not finite"),
        ("few", "0 0 0.5\n", [], "line 1 of 'few.pts' is no meter"),
        ("many", "7 0 0 0.5 0 0 1\n", [], "line 1 of 'many.pts' is no meter"),
        ("face", "0.5 0.4 0 0 1 1\n", [], "lies on face 2"),
        ("fine", "0.5 0.4 0.5 0 1 1\n", ["--rays", "5"], "128 to"),
        ("fine", "0.5 0.4 0.5 0 1 1\n", ["--up", "x"], "y or z"),
        ("fine", "0.5 0.4 0.5 0 1 1\n", ["--solution", "s.npz"], "no radiosities"),
        ("fine", "0.5 0.4 0.5 0 1 1\n", ["-o", "s.xls"], "change the name"),
    ):
        if text is not None:
            (tmp_path / f"{name}.pts").write_text(text)
        capsys.readouterr()
        assert main(["point-factors", "room.obj", "--points", f"{name}.pts", *words]) in (2, 3), name
        assert message in capsys.readouterr().err, name
    assert main(["point-factors", "room.obj"]) == 2


@pytest.mark.parametrize("groups", [False, True])
def test_rays_until_an_error_is_reached(variant, groups):
    """Of groups, whose factors are sums; the error is met, and the rays are those that it takes."""
    patches = Patches(*box((0, 0, 0), (2, 3, 2.5), 3, inward=True))
    patches.shapes, patches.shape_names = np.arange(len(patches)) % 2, ("a", "b")
    meters = Meters([[0.7, 1.1, 1.0], [1.5, 2.0, 0.4]], [(0, 0, 1), (0, 0, -1)])
    found = [point_factors_to_error(patches, meters, error, groups=groups) for error in (3e-3, 3e-4)]
    for made, error in zip(found, (3e-3, 3e-4), strict=True):
        assert len(made.names) == len(patches)
        assert (made.of_groups() if groups else made).largest_error <= error
    assert found[0].rays < found[1].rays <= 1 << 18


def test_an_error_out_of_reach(variant, caplog):
    meters = Meters([[0.7, 0.5, 0.5]], [(0, 0, 1)])
    found = point_factors_to_error(cube(2), meters, 1e-9, rays=4096)
    assert found.rays == 4096 and "up to" in caplog.text and "after 4096 rays of each sensor, the most" in caplog.text
    with pytest.raises(RadiosityError, match="the error of a factor is a positive number"):
        point_factors_to_error(cube(2), meters, -1)
