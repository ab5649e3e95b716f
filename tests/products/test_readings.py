"""Measuring: readings against closed forms, and their tables."""

from __future__ import annotations

import csv

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

import etendue
from etendue.core import OptionError, SceneError, UnsupportedError
from etendue.display import false_colour
from etendue.film import LUMINANCE
from etendue.lighting import EFFICACY, LightingError, Meters
from etendue.products import MeterTable

UP = [[0.0, 0.0, 1.0]]


def room(reflectance, **more):
    """A cube of side 2 around the origin, seen from inside, without a camera."""
    walls = {"type": "cube", "flip_normals": True, "bsdf": grey(reflectance)}
    return {"type": "scene", "walls": walls, **more}


def grey(reflectance):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}


def point(position, intensity=1.0):
    return {"type": "point", "position": position, "intensity": {"type": "rgb", "value": intensity}}


def floor(**more):
    return {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(4), "bsdf": grey(0.5)},
        **more,
    }


@pytest.mark.parametrize("method", ["path", "guided", "bpt"])
def test_a_point_lamp_is_exact(method):
    # On a surface, above it right under the lamp, and tilted: I cos / d^2. Meters do not shade each other.
    points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 0]]
    scene = floor(lamp=point([0, 0, 2], [1.0, 2.0, 3.0]))
    found = etendue.measure(scene, points, [[0, 0, 1], [0, 0, 1], [0, 0, 1], [-1, 0, 0]], method, spp=64, max_depth=2)
    expected = [1 / 4, 1.0, 2 / 5**1.5, 1 / 5**1.5]
    assert np.allclose(found.values, np.outer(expected, [1, 2, 3]), rtol=1e-4)
    assert np.allclose(found.photometric, EFFICACY * found.values @ np.array(LUMINANCE))


@pytest.mark.parametrize("method", ["path", "guided", "bpt"])
def test_rays_start_at_meters(method):
    # Below the edge of an awning at z = 2, a point on the floor sees nothing past it of the lamp beyond, whatever the
    # offset of rays; one that is a twentieth of a millimetre in front of the shadow's edge sees it.
    place = mi.ScalarTransform4f()
    awning = {"type": "rectangle", "to_world": place.translate([-1, 0, 2]), "bsdf": grey(0.0)}
    scene = floor(awning=awning, lamp=point([-1.0, 0, 4]))  # the shadow ends at x = 1
    tilted = {"type": "rectangle", "to_world": place.translate([3, 0, 1]).rotate([0, 1, 0], 30), "bsdf": grey(0.0)}
    points = [[1.0 - 5e-5, 0, 0], [1.0 + 5e-5, 0, 0], [1.0 + 5e-5, 0, 1e-4], [1.0 + 5e-5, 0, -1e-4]]
    found = etendue.measure(scene | {"tilted": tilted}, points, UP, method, spp=64, max_depth=2)
    assert found.values[0].max() == 0.0
    assert np.allclose(found.values[1:], 4.0 / (4.0**2 + 2.0**2) ** 1.5, rtol=1e-3)
    # On a tilted plane, with a rounding that puts it a little below.
    normal = np.array([0.5, 0, 0.75**0.5])
    found = etendue.measure(
        scene | {"tilted": tilted}, [3.0, 0, 1] - 1e-4 * normal, normal, method, spp=64, max_depth=2
    )
    to_lamp = np.array([-4.0, 0, 3.0])
    assert np.allclose(found.values, normal @ to_lamp / 125.0, rtol=1e-3)


def test_three_meters_are_no_colour(capfd):
    etendue.measure(floor(lamp=point([0, 0, 2])), np.zeros((3, 3)), UP, spp=32, max_depth=2)
    assert "nanobind" not in capfd.readouterr().err


def test_many_paths_are_more_passes():
    found = etendue.measure(floor(lamp=point([0, 0, 2])), [[0, 0, 0]], UP, spp=1 << 18, max_depth=2)
    assert found.metadata["samples"] == 1 << 18
    assert found.metadata["passes"] == 64  # and not more: a pass takes a while, however few its paths
    assert np.allclose(found.values, 0.25, rtol=1e-4)


def test_a_short_time_is_two_passes():
    """The first pass takes all of the time, and a second one is made for the standard errors."""
    found = etendue.measure(room(0.5, lamp=point([0.5, 0.4, 0.3])), [[0, 0, 0]], UP, seconds=1e-3)
    assert found.metadata["passes"] == 2
    assert found.metadata["stopped_by"] == "seconds"
    assert (found.errors > 0.0).all()


def test_a_single_pass_has_no_errors(caplog):
    found = etendue.measure(room(0.5, lamp=point([0.5, 0.4, 0.3])), [[0, 0, 0]], UP, spp=1)
    assert np.isnan(found.errors).all()
    assert "standard errors are not known after a single pass" in caplog.text


def test_resumed_readings(tmp_path):
    """Stopped after a third of its passes, the run goes on to the readings and files of an uninterrupted one."""
    scene, desk = room(0.5, lamp=point([0.5, 0.4, 0.3])), Meters.grid((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0), (3, 2))
    common = {"spp": 96, "samples_per_pass": 8, "seed": 3}
    whole = etendue.measure(scene, desk, **common)
    file, table, picture = (tmp_path / name for name in ("run.checkpoint", "a.csv", "a.png"))
    stopped = etendue.measure(
        scene,
        desk,
        **common,
        save=[table, picture],
        photometric=True,
        checkpoint=file,
        callback=lambda update: update.progress.passes < 4,
    )
    assert stopped.metadata["passes"] == 4
    table.unlink()
    found = etendue.resume(file, scene=scene)
    np.testing.assert_array_equal(found.values, whole.values)
    np.testing.assert_array_equal(found.errors, whole.errors)
    assert found.meters.cells == (3, 2)
    rows = list(csv.reader(table.open()))
    assert "illuminance [lx]" in rows[0]
    np.testing.assert_allclose([float(row[6]) for row in rows[1:]], whole.photometric, rtol=1e-6)
    assert etendue.resume(file, scene=scene, spp=192, save=tmp_path / "b.csv").metadata["samples"] == 192
    assert (tmp_path / "b.csv").exists()


@pytest.mark.parametrize("method", ["path", "bpt"])
def test_a_lit_disk_by_its_configuration_factor(method):
    # A disk of radius 1 at height h over a parallel meter: F = 1 / (1 + h^2), E = pi L F.
    place = mi.ScalarTransform4f().translate([0, 0, 1.5]) @ mi.ScalarTransform4f().rotate([1, 0, 0], 180)
    lamp = {"type": "disk", "to_world": place, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 2.0}}}
    found = etendue.measure(floor(lamp=lamp), [[0, 0, 0.5]], UP, method, spp=4096, max_depth=2)
    assert np.abs(found.values - np.pi * 2.0 / 2.0).max() < 4 * found.errors.max() < 0.02


@pytest.mark.parametrize("method", ["path", "guided", "bpt"])
def test_reflections_in_a_closed_room(method):
    # Walls that emit evenly: the radiance is L / (1 - rho) everywhere, and E is pi times that, in any direction.
    walls = room(0.6)
    walls["walls"]["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": 0.5}}
    points, normals = [[0, 0, 0], [0.3, -0.5, 0.9], [0, 0, -1]], [[1, 2, 3], [0, 1, 0], [0, 0, 1]]
    found = etendue.measure(walls, points, normals, method, spp=8192)
    expected = np.pi * 0.5 / (1 - 0.6)
    assert (np.abs(found.values - expected) < 4.5 * found.errors + 1e-5).all()
    assert found.errors.max() < 0.01 * expected


@pytest.mark.slow
def test_errors_are_those_of_repeated_runs():
    scene = room(0.5, lamp=point([0.5, 0.4, 0.3]))
    points = [[0, 0, z] for z in np.linspace(-0.9, 0.9, 16)]
    runs = [etendue.measure(scene, points, UP, spp=256, seed=seed) for seed in range(24)]
    spread = np.std([run.values[:, 0] for run in runs], axis=0, ddof=1)
    estimated = np.sqrt(np.mean([run.errors[:, 0] ** 2 for run in runs], axis=0))
    # 16 variances, each of 24 runs: the mean of their ratios has a relative error of 0.07 or less.
    assert abs(np.mean((spread / estimated) ** 2) - 1.0) < 0.35


def test_radiance(tmp_path):
    lamp = {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}}
    meters = Meters([[0, 0, 1], [0, 0, 1]], [[0, 0, 1], [0, 0, -1]], "radiance")
    found = etendue.measure(floor(lamp=lamp), meters, method="bpt", spp=64)
    assert np.allclose(found.values[0], [1, 2, 3])
    assert np.allclose(found.values[1], [0.5, 1, 1.5], rtol=0.05)
    found.save(tmp_path / "r.csv", photometric=True)
    assert "luminance [cd/m^2]" in (tmp_path / "r.csv").read_text()


def test_tables(tmp_path):
    meters = Meters([[0, 0, 0], [1, 0, 0]], UP, names=("under, the lamp", "beside"))
    scene = floor(lamp=point([0, 0, 2]))
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    found = etendue.measure(scene, meters, spp=64, save=paths, photometric=True)
    rows = list(csv.DictReader(paths[0].open()))
    assert paths[0].read_text() == paths[1].read_text()
    assert [row["name"] for row in rows] == ["under, the lamp", "beside"]
    assert np.allclose([float(row["illuminance [lx]"]) for row in rows], found.photometric, rtol=1e-6)
    assert np.allclose([float(row["illuminance_error"]) for row in rows], found.photometric_error, rtol=1e-6)
    found.save(tmp_path / "c.csv")
    rows = list(csv.DictReader((tmp_path / "c.csv").open()))
    assert float(rows[1]["irradiance_g [W/m^2]"]) == pytest.approx(found.values[1, 1], rel=1e-6)
    assert "uniformity" in found.summary() and "2 meters" in repr(found)


def test_a_picture_of_a_grid_is_seen_from_the_side_that_meters_face(tmp_path):
    """A lamp near the end of the first edge and the beginning of the second: at the lower right."""
    desk = Meters.grid([-1, -1, 0.5], [2, 0, 0], [0, 1, 0], (8, 4))
    found = etendue.measure(floor(lamp=point([0.8, -0.9, 1.5])), desk, spp=16, max_depth=2)
    found.save(tmp_path / "lux.png", photometric=True, low=0.0, high=1000.0)
    found.save(tmp_path / "watts.png", low=0.0, high=1000.0 / EFFICACY)
    lux, watts = (np.asarray(Image.open(tmp_path / name).convert("RGB")) for name in ("lux.png", "watts.png"))
    # Eight by four cells of 0.25 x 0.25 make 800 x 400 pixels; away from lines and labels.
    expected = false_colour(found.photometric.reshape(4, 8)[::-1], 0.0, 1000.0, logarithmic=False)
    same = np.stack([lux[y::100, x:800:100] == expected for y in (4, 50, 95) for x in (4, 50, 95)]).all(axis=-1)
    assert same.mean() > 0.9 and same.any(axis=0).all()
    assert expected[3, 7].sum() > expected[0, 0].sum() and found.meters.cells == (8, 4)
    # Lines differ from the colours of the cells, and those in watts are elsewhere; the cells are the same.
    assert (lux[:400, :800] == watts[:400, :800]).all(axis=2).mean() > 0.9
    assert not (lux[:, 800:].shape == watts[:, 800:].shape and (lux[:, 800:] == watts[:, 800:]).all())


def test_only_grids_have_pictures(tmp_path):
    scene = floor(lamp=point([0, 0, 2]))
    with pytest.raises(OptionError, match="needs a grid of meters"):
        etendue.measure(scene, [[0, 0, 0]], spp=1, save=tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
    with pytest.raises(LightingError, match="there are 1 meters, but 2x2 cells"):
        Meters([[0, 0, 0]], UP, cells=(2, 2))
    grid = Meters.grid([0, 0, 0], [1, 0, 0], [0, 1, 0], (2, 1))
    assert Meters(**grid.to_dict()).cells == (2, 1)
    with pytest.raises(OptionError, match=r"write a \.png"):
        MeterTable.of(grid, tmp_path / "a.csv", scale=(0.0, 1.0))


def test_bad_meters(tmp_path, caplog):
    scene = floor(lamp=point([0, 0, 2]))
    with pytest.raises(UnsupportedError, match="'vcm' measures nothing"):
        etendue.measure(scene, [[0, 0, 0]], method="vcm", spp=1)
    with pytest.raises(OptionError, match="written as"):
        etendue.measure(scene, [[0, 0, 0]], spp=1, save=tmp_path / "a.exr")
    place = mi.ScalarTransform4f().translate([2, 2, 1.5])
    solid = {"type": "cube", "to_world": place, "bsdf": grey(0.5)}
    with pytest.raises(SceneError, match=r"meter 1 at \[2.0, 2.0, 1.5\]: inside a solid"):
        etendue.measure(floor(lamp=point([0, 0, 2]), solid=solid), [[3, 0, 0], [2, 2, 1.5]], spp=1)
    # A solid whose faces have two sides is only dark inside.
    solid |= {"bsdf": {"type": "twosided", "bsdf": grey(0.5)}}
    etendue.measure(floor(lamp=point([0, 0, 2]), solid=solid), [[3, 0, 0], [2, 2, 1.5]], spp=16)
    assert "1 of 2 meters read 0, as number 1" in caplog.text


def test_a_scene_far_from_the_origin():
    # In render space, too, points are where they are meant.
    far = np.array([5000.0, -3000.0, 200.0])
    place = mi.ScalarTransform4f().translate(far.tolist())
    scene = {
        "type": "scene",
        "floor": {"type": "rectangle", "to_world": place @ mi.ScalarTransform4f().scale(4), "bsdf": grey(0.5)},
        "lamp": point((far + np.array([0, 0, 2])).tolist()),
    }
    found = etendue.measure(scene, far + np.array([[0, 0, 0], [1, 0, 0]]), UP, spp=64, max_depth=2)
    assert np.allclose(found.values[:, 0], [1 / 4, 2 / 5**1.5], rtol=1e-3)


def test_workers_measure_the_same():
    scene = room(0.5, lamp=point([0.5, 0.4, 0.3]))
    here, there = (
        etendue.measure(scene, [[0, 0, 0], [0, 0, 0.5]], UP, spp=512, samples_per_pass=64, workers=n) for n in (None, 1)
    )
    assert np.allclose(here.values, there.values, rtol=1e-5)


def test_sensors_of_mitsuba():
    # An irradiance meter on a square sees a point lamp, and reads the mean of meters on it; its own material is black.
    lamp = point([0.3, 0.2, 1.5], [1.0, 2.0, 3.0])
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    place = mi.ScalarTransform4f().translate([0, 0, 0.5])
    square = {"type": "rectangle", "to_world": place, "bsdf": grey(0.0)}
    meter = {"type": "irradiancemeter", "film": film}
    scene = floor(lamp=lamp, square=square | {"meter": meter})
    grid = Meters.grid((-1, -1, 0.5), (2, 0, 0), (0, 2, 0), (20, 20))
    by_grid = etendue.measure(floor(lamp=lamp, square=square), grid, spp=64).values.mean(axis=0)
    for method in ("path", "bpt"):
        read = etendue.render(scene, method, spp=4096).image[0, 0]
        assert read == pytest.approx(by_grid, rel=5e-3), method
    # A radiance meter, and a distant one, of a floor of reflectance 1/2 under a uniform sky.
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 2.0}}
    ray = {"type": "radiancemeter", "origin": [0.1, 0.2, 1], "direction": [0, 0.1, -1], "film": film}
    away = {"type": "distant", "direction": [0, 0, -1], "target": [0, 0, 0], "film": film}
    for sensor in (ray, away):
        read = etendue.render(floor(lamp=sky, sensor=sensor), "path", spp=1024).image[0, 0]
        assert read == pytest.approx([1.0] * 3, rel=5e-3), sensor["type"]
        with pytest.raises(UnsupportedError, match="use path, guided or bpt"):
            etendue.render(floor(lamp=sky, sensor=sensor), "vcm", spp=1)


def test_cylindrical_and_spherical_irradiance():
    # Of a point lamp: I sin / (pi d^2) with the angle to the axis, and I / (4 d^2); of a uniform sky: pi L.
    lamp, up = point([1, 0, 1]), [[0.0, 0.0, 1.0]]
    square = 2.0
    for quantity, expected in (("cylindrical", 0.5**0.5 / (np.pi * square)), ("spherical", 1 / (4 * square))):
        meters = Meters([[0, 0, 0.0]], up, quantity)
        mote = {"type": "sphere", "center": [0, 0, -9], "radius": 0.01}
        found = etendue.measure({"type": "scene", "mote": mote, "lamp": lamp}, meters, spp=1 << 16)
        assert np.abs(found.values - expected).max() < 4 * found.errors.max() < 0.02 * expected, quantity
        sky = {"type": "constant", "radiance": {"type": "rgb", "value": 2.0}}
        found = etendue.measure({"type": "scene", "mote": mote, "sky": sky}, meters, spp=1 << 14)
        assert np.allclose(found.values, 2.0 * np.pi, rtol=2e-3), quantity
