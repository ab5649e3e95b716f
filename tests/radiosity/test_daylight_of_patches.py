"""Daylight coefficients of patches against closed forms and against paths from meters at the same places."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.patches import square
from support.weather import written, year

import etendue
from etendue.cli.main import main
from etendue.core import OptionError
from etendue.engine import Job
from etendue.lighting import Meters, SkyPatches, cie_sky
from etendue.products import run_job
from etendue.products.patches import DaylightRun
from etendue.radiosity import ABuffer, Patches, RadiosityError, Segments, box, daylight_of_patches, joined

SKY = SkyPatches(1)


def directed(patches, count=2048, batches=16, lines=3000):
    engine = ABuffer(patches, lines=lines)
    made = list(engine.directed(count, 0, count // batches))
    pairs, ways = [one.pairs for one in made], [one.ways for one in made]
    return Segments(patches, pairs, np.arange(batches), engine.expected(count), ways)


def test_an_open_plane_and_a_wall():
    # A horizontal plane has pi in all, a wall half of it from the sky and half from the ground.
    plane = daylight_of_patches(directed(Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)), reflectance=0.5)))
    assert plane.values[0, 0] == pytest.approx([0, 0, 0]) and plane.values[0].sum(axis=0) == pytest.approx([np.pi] * 3)
    overcast = cie_sky(16, zenith_luminance=1000.0, ground=0.2)  # horizontally 7 pi / 9 of the zenith's luminance
    luminance = SKY.luminance(overcast)
    assert plane.illuminance(luminance)[0] == pytest.approx(1000 * np.pi * 7 / 9, rel=0.01)
    wall = daylight_of_patches(directed(Patches(*square((0, 0, 0), (1, 0, 0), (0, 0, 1)))))
    assert wall.values[0, 0] == pytest.approx([np.pi / 2] * 3, rel=0.02)
    # The traditional overcast sky on a wall [Moon 1942]: .396 of the horizontal illuminance, here as an integral over
    # the azimuth, L_z (1/3) (pi/2 + 4/3), and the ground's 0.2 / 2 of the horizontal.
    expected = 1000 / 3 * (np.pi / 2 + 4 / 3) + 0.1 * 1000 * np.pi * 7 / 9
    assert wall.illuminance(luminance)[0] == pytest.approx(expected, rel=0.01)


def test_a_box_with_a_hole_is_a_cavity():
    # Light of a uniform sky in a cavity of walls of reflectance rho: each wall's irradiance H obeys the balance of the
    # whole, mean radiosities (1 - f) of the hole. A sphere would be exact; in a box without its lid the sum over the
    # walls of what is absorbed is what enters minus what leaves.
    vertices, faces = box((0, 0, 0), (1, 1, 1), 3, inward=True)
    middle = vertices[faces].mean(axis=1)
    rho = 0.7
    patches = Patches(vertices, faces[middle[:, 2] < 0.999], reflectance=rho)
    segments = directed(patches)
    found = daylight_of_patches(segments)
    irradiance = found.values[:, :, 0].sum(axis=1)  # of radiance 1 from everywhere
    absorbed = (patches.areas * (1 - rho) * irradiance).sum()
    leaving = (patches.areas * segments.sky * rho * irradiance).sum()
    assert absorbed + leaving == pytest.approx(np.pi, rel=0.01)  # through the unit square
    # With white walls everything is at radiance 1, in every direction and wherever it comes from: a furnace.
    white = daylight_of_patches(segments, patches=patches.with_properties(reflectance=1.0))
    assert white.values[:, :, 0].sum(axis=1) == pytest.approx(np.pi, rel=1e-5)
    assert white.values[:, 0] == pytest.approx(0, abs=1e-9)


def test_it_agrees_with_paths_from_meters():
    # A court: a floor and two walls of different colours, and the ground of the sky beside them.
    floor = square((0, 0, 0), (1, 0, 0), (0, 1, 0))
    wall = square((0, 1, 0), (1, 0, 0), (0, 0, 1))
    side = square((0, 0, 0), (0, 1, 0), (0, 0, 1))
    colours = np.array([[0.3, 0.5, 0.2], [0.8, 0.6, 0.4], [0.1, 0.2, 0.7]])
    patches = Patches(*joined(floor, wall, side), reflectance=colours).subdivided(0.01)
    by_lines = daylight_of_patches(directed(patches, 4096), north=20.0)
    scene = {"type": "scene"}
    for k, (vertices, _) in enumerate((floor, wall, side)):
        o, x, y = vertices[0], vertices[1] - vertices[0], vertices[3] - vertices[0]
        columns = [x / 2, y / 2, np.cross(x, y)]
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = np.stack(columns, axis=1), o + (x + y) / 2
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": colours[k].tolist()}}
        scene[f"face{k}"] = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf}
    chosen = [33, 66, 133, 166, 244, 277]
    meters = Meters(patches.centres[chosen] + 1e-4 * patches.normals[chosen], patches.normals[chosen])
    by_paths = etendue.daylight(scene, meters, spp=1 << 16, north=20.0).coefficients
    value, error = by_lines.values[chosen], np.hypot(by_lines.errors[chosen], by_paths.errors)
    # Rows of the sky, since within a patch of it the share of the few bundles is rough.
    row = np.concatenate([[0], 1 + np.repeat(np.arange(len(SKY.in_row)), SKY.in_row)])
    z = (value - by_paths.values) / np.maximum(error, 2e-3)
    assert np.abs(z).max() < 5 and np.sqrt(np.mean(z**2)) < 1.3
    assert by_lines.errors[chosen].mean() < 0.15 * value.mean()
    for k in range(len(chosen)):
        one, other = (np.stack([np.bincount(row, x[k, :, c]) for c in range(3)]) for x in (value, by_paths.values))
        assert one == pytest.approx(other, rel=0.06, abs=0.02)
    assert value.sum(axis=1) == pytest.approx(by_paths.values.sum(axis=1), rel=0.02)


def test_what_has_no_daylight_is_refused():
    closed = directed(Patches(*box((0, 0, 0), (1, 1, 1), inward=True), reflectance=0.5), 64)
    with pytest.raises(RadiosityError, match="no patch sees the sky"):
        daylight_of_patches(closed)
    plane = Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    with pytest.raises(RadiosityError, match="batches"):
        daylight_of_patches(directed(plane, 16, 1))
    with pytest.raises(RadiosityError, match="one channel or three"):
        daylight_of_patches(directed(plane, 16, 2), patches=plane.with_properties(reflectance=np.full((1, 2), 0.5)))


@pytest.mark.slow
def test_a_run_its_files_and_its_resumption(tmp_path):
    tower = Patches(*box((0, 0, 0), (1, 1, 3), 2), reflectance=0.4)
    files, weather = [tmp_path / name for name in ("c.mtx", "c.npz", "c.csv")], written(tmp_path, year())
    found = etendue.daylight(tower, surfaces=True, bundles=128, weather=weather, save=files)
    upward, values = found.coefficients.meters.directions[:, 2], found.coefficients.values
    assert values.shape == (24, 146, 3) and "EN 17037" in found.summary()
    # Nothing is around it: the roof sees the sky, the walls half of it, and nothing reflects.
    assert values[:, 1:].sum(axis=1) == pytest.approx(np.pi * (1 + np.stack([upward] * 3, axis=1)) / 2, abs=0.1)
    assert "NROWS=24" in files[0].read_text()[:200]
    with np.load(files[1]) as arrays:
        assert arrays["illuminance"].shape == (24, 8760)
    assert len(files[2].read_text().splitlines()) == 25
    checkpoint = tmp_path / "daylight.checkpoint"
    run = DaylightRun(source=tower, limits={"bundles": 64}, checkpoint=checkpoint)
    run_job(lambda: Job.open(run.task()), None, None)
    resumed = etendue.resume(checkpoint, scene=tower, bundles=128, save=tmp_path / "again.mtx")
    assert np.array_equal(resumed.coefficients.values, values)


def test_the_command(tmp_path, monkeypatch, capsys):
    meshio = pytest.importorskip("meshio")
    monkeypatch.chdir(tmp_path)
    vertices, faces = joined(square((0, 0, 0), (4, 0, 0), (0, 4, 0)), square((0, 4, 0), (4, 0, 0), (0, 0, 4)))
    meshio.write("yard.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    words = "daylight yard.ply --surfaces --reflectance 0.5 --max-area 4 --bundles 512 --north 10 -o c.npz"
    assert main(words.split()) == 0
    out, err = capsys.readouterr()
    assert out == "c.npz\n" and "8 meters, 146 patches" in err
    with np.load("c.npz") as arrays:
        assert arrays["coefficients"].shape == (8, 146, 3)
    for more, message in (
        ("--surfaces --points p.csv", "in place of"),
        ("--surfaces --max-depth 3", "paths from meters"),
        ("--points p.csv --max-area 2", "for --surfaces"),
        ("--surfaces --spp 4", "counts bundles"),
        ("--surfaces -o c.csv", "give the weather"),
        ("", "--points FILE"),
    ):
        assert main(["daylight", "yard.ply", *more.split()]) == 2, more
        assert message in capsys.readouterr().err, more
    with pytest.raises(OptionError, match="meters or of surfaces"):
        etendue.daylight("yard.ply")
    with pytest.raises(OptionError, match="surfaces=True"):
        etendue.daylight("yard.ply", [[0, 0, 1]], bundles=4)
