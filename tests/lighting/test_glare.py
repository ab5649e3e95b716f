"""Discomfort glare: closed forms, Radiance's ``evalglare``, and the illuminance at an eye in a room."""

from __future__ import annotations

import importlib.util
import logging
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import scenes

import etendue
from etendue.lighting import EFFICACY, Glare, LightingError, View, glare, position_index

FRONT = View("spherical", 180.0)
#: Direction in the frame of a view, half the angle of the cone in radians, cd/m^2.
Lamp = tuple[tuple[float, float, float], float, float]
LAMPS: tuple[Lamp, ...] = (
    ((0.3, 0.5, 1.0), 0.12, 8000.0),
    ((-0.6, 0.2, 1.0), 0.08, 20000.0),
    ((0.2, -0.4, 1.0), 0.1, 5000.0),
)


def towards(right: float, up: float) -> np.ndarray:
    """Direction by angles in degrees from the line of sight, along two great circles."""
    vector = np.array([-np.tan(np.deg2rad(right)), np.tan(np.deg2rad(up)), 1.0])
    return vector / np.linalg.norm(vector)


def lit(directions: np.ndarray, lamps: tuple[Lamp, ...] = LAMPS, background: float = 150.0) -> np.ndarray:
    """Cones of light before a background that is brighter above."""
    luminance = background * (1.0 + 0.6 * directions[..., 1])
    for centre, angle, value in lamps:
        unit = np.array(centre) / np.linalg.norm(centre)
        luminance = np.where(directions @ unit > np.cos(angle), value, luminance)
    return luminance


def picture(view: View, height: int, width: int) -> np.ndarray:
    return lit(view.pixels(height, width)[0])


@pytest.mark.parametrize(
    ("view", "size", "solid", "covered"),
    [
        (View("spherical"), (20, 42), 2 * np.pi, 1.0),
        (FRONT, (16, 15), 2 * np.pi, 1.0),
        (View("spherical", 90.0), (16, 15), np.pi, np.sin(np.pi / 4)),
        # A face of a cube around the eye; and 90 degrees of the height only, by a view of the double width.
        (View("perspective", 90.0), (7, 7), 4 * np.pi / 6, None),
        (View("perspective", np.rad2deg(2 * np.arctan(2.0)), "x"), (5, 10), 4 * np.arctan(2 / 6**0.5), None),
        (View("perspective", 90.0, "y"), (5, 10), 4 * np.arctan(2 / 6**0.5), None),
    ],
)
def test_pixels(view, size, solid, covered):
    """Solid angles have their sum, cosines are those to the line of sight, and projections are solid angles times
    cosines but for the variation in a pixel."""
    directions, angles, projected = view.pixels(*size)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    assert angles.sum() == pytest.approx(solid, rel=1e-12)
    if covered is not None:
        assert projected.sum() == pytest.approx(np.pi * covered, rel=1e-12)
    fine = view.pixels(20 * size[0], 20 * size[1])
    midpoint = (fine[1] * np.maximum(fine[0][..., 2], 0.0)).reshape(size[0], 20, size[1], 20).sum((1, 3))
    np.testing.assert_allclose(projected, midpoint, rtol=2e-3, atol=1e-5)
    assert directions[0, 0] @ [1.0, 1.0, 0.0] > 0.0  # the first pixel is above, to the left (x)
    assert directions[-1, -1] @ [1.0, 1.0, 0.0] < 0.0


def test_the_spherical_sensor_has_these_directions():
    """Lamps straight ahead, to the left and above, in a picture of it."""
    place = scenes.transform().look_at([1, 2, 3], [2, 2.4, 2.3], [0.2, 1, 0.1])
    film = {"type": "hdrfilm", "width": 96, "height": 48, "rfilter": {"type": "box"}}
    frame = np.array(place.matrix)
    wanted = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.2], [0.3, 1.0, 0.5]])
    for towards_lamp in wanted / np.linalg.norm(wanted, axis=1, keepdims=True):
        centre = frame[:3, 3] + frame[:3, :3] @ (30.0 * towards_lamp)
        lamp = {"type": "sphere", "center": centre.tolist(), "radius": 4.0, "emitter": {"type": "area"}}
        scene = {"type": "scene", "sensor": {"type": "spherical", "film": film, "to_world": place}, "lamp": lamp}
        (source,) = glare(etendue.render(scene, method="path", spp=4).image, View("spherical"), threshold=200.0).sources
        np.testing.assert_allclose(source.direction, towards_lamp, atol=0.02)


def test_position_index():
    """Sources right above the line of sight, at tangents H/R: the table of CIE 117, of whose curves the formula is a
    fit. Continuous at the horizon, where both formulas meet; the largest is 16."""
    table = {0.0: 1.0, 0.1: 1.26, 0.2: 1.53, 0.5: 2.86, 0.8: 5.0, 1.0: 7.0, 1.2: 9.25, 1.5: 13.15}
    above = position_index([[0.0, tangent, 1.0] for tangent in table])
    np.testing.assert_allclose(above, list(table.values()), rtol=0.04)
    x = np.tan(np.deg2rad([10.0, 40.0, 70.0]))
    near = [position_index(np.stack([x, np.full(3, y), np.ones(3)], axis=-1)) for y in (1e-9, -1e-9)]
    np.testing.assert_allclose(*near, rtol=1e-3)
    np.testing.assert_allclose(near[0], position_index(np.stack([-x, 0 * x, np.ones(3)], axis=-1)), rtol=1e-6)
    assert position_index([0.0, 1.0, 0.1]) == 16.0
    # Below, right under the line of sight at 30 degrees: tan beta = 1.15 tan 30.
    beta = np.rad2deg(np.arctan(np.sqrt(1.3225) * np.tan(np.deg2rad(30.0))))
    expected = np.exp(6.49e-3 * beta + 21e-5 * beta**2)
    assert position_index(towards(0.0, -30.0)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.0, 25.0), (35.0, 10.0), (-20.0, -30.0)])
@pytest.mark.parametrize("n", [180, 360])
def test_one_source(place, n):
    """A cone of half angle a has 2 pi (1 - cos a) sr and gives L pi sin^2 a cos s lx. A circle of radius r,
    in pixels, has as many of them as its area, with a standard deviation of 0.82 sqrt r (Kendall 1948)."""
    angle, luminance, background = 0.15, 6000.0, 100.0
    centre = towards(*place)
    directions, _, _ = FRONT.pixels(n, n)
    found = glare(np.where(directions @ centre > np.cos(angle), luminance, background), FRONT)
    omega, projected = 2 * np.pi * (1 - np.cos(angle)), np.pi * np.sin(angle) ** 2 * centre[2]
    radius = angle * n / np.pi
    off = 3.5 * 0.82 * np.sqrt(radius) / (np.pi * radius**2)
    (source,), index = found.sources, float(position_index(centre))
    assert source.luminance == pytest.approx(luminance) and source.solid_angle == pytest.approx(omega, rel=off)
    assert np.degrees(np.arccos(min(source.direction @ centre, 1.0))) < 0.25 * 180 / n
    assert found.background_luminance == pytest.approx(background * (1 - projected / np.pi), rel=1e-3)
    illuminance = np.pi * background + (luminance - background) * projected
    assert found.vertical_illuminance == pytest.approx(illuminance, rel=off)
    ugr = 8 * np.log10(0.25 / found.background_luminance * luminance**2 * omega / index**2)
    assert found.ugr == pytest.approx(ugr, abs=8 * np.log10(1 + 2 * off))
    term = luminance**2 * omega / (illuminance**1.87 * index**2)
    dgp = 5.87e-5 * illuminance + 0.0918 * np.log10(1 + term) + 0.16
    assert found.dgp == pytest.approx(dgp, abs=0.0918 * np.log10(1 + 4 * off))


def test_several_sources():
    """Sums over sources; the order is that of their strength. Crops and resolutions show the same."""
    views = {View("spherical"): (300, 600), FRONT: (500, 500), View("perspective", 90.0): (500, 500)}
    found = {view: glare(picture(view, *size), view, vertical_illuminance=1300.0) for view, size in views.items()}
    for result in found.values():
        assert [round(source.luminance) for source in result.sources] == [20000, 5000, 8000]
        total = sum(
            (value / position_index(np.array(centre))) ** 2 * 2 * np.pi * (1 - np.cos(angle))
            for centre, angle, value in LAMPS
        )
        direct = sum(
            value * np.pi * np.sin(angle) ** 2 * centre[2] / np.linalg.norm(centre) for centre, angle, value in LAMPS
        )
        # Areas of circles of 10 pixels are right to 3 %, their sum to 1.5 %.
        assert result.background_luminance == pytest.approx((1300.0 - direct) / np.pi, abs=0.015 * direct / np.pi)
        assert result.ugr == pytest.approx(8 * np.log10(0.25 / result.background_luminance * total), abs=0.12)
        assert result.dgp == pytest.approx(
            5.87e-5 * 1300 + 0.0918 * np.log10(1 + total / 1300**1.87) + 0.16, abs=0.0918 * np.log10(1.03)
        )


def test_connected_pixels():
    """A spiral is one source, pixels that touch at corners, too; and a sun in a window is one of its own."""
    values = np.full((60, 60), 50.0)
    view = View("perspective", 30.0)
    spiral = values.copy()
    for k in range(0, 26, 4):
        spiral[k, k : 60 - k] = spiral[k : 60 - k, 59 - k] = spiral[59 - k, k : 60 - k] = 3000.0
        spiral[k + 4 : 60 - k, k] = spiral[k + 4, k : k + 5] = 3000.0
    assert len(glare(spiral, view, vertical_illuminance=1e5).sources) == 1
    chess = np.where(np.indices((60, 60)).sum(0) % 2, 3000.0, 50.0)
    assert len(glare(chess, view, vertical_illuminance=1e5).sources) == 1
    apart = np.where((np.indices((60, 60)) % 2 == 0).all(0), 3000.0, 50.0)
    assert len(glare(apart, view, vertical_illuminance=1e5).sources) == 900
    window = values.copy()
    window[10:30, 10:30], window[15:17, 20:22] = 4000.0, 1e8
    suns = glare(window, view, vertical_illuminance=1e6).sources
    assert [source.luminance for source in suns] == pytest.approx([1e8, 4000.0])


def test_thresholds_and_classes():
    values = np.full((90, 90), 100.0)
    values[40:44, 40:44] = 900.0
    none = glare(values, FRONT)
    assert none.ugr == -np.inf and not none.sources and none.category == "imperceptible"
    assert none.dgp == pytest.approx(5.87e-5 * none.vertical_illuminance + 0.16)
    assert len(glare(values, FRONT, threshold=800.0).sources) == 1
    relative = glare(values, FRONT, threshold=5.0, relative=True)
    mean = 100.0 + 800.0 * relative.sources[0].solid_angle / (2 * np.pi)
    assert len(relative.sources) == 1 and relative.threshold == pytest.approx(5 * mean)
    for illuminance, category in ((3000, "imperceptible"), (3600, "perceptible"), (4500, "disturbing"), (6000, "int")):
        assert glare(values, FRONT, vertical_illuminance=illuminance).category.startswith(category)
    assert glare(values, FRONT, vertical_illuminance=1e6).dgp == 1.0
    assert glare(np.zeros((9, 9)), FRONT).vertical_illuminance == 0.0
    black = np.zeros((90, 90))
    black[40:44, 40:44] = 5000.0
    assert glare(black, FRONT).ugr == np.inf
    rgb = np.repeat((values / EFFICACY)[..., None], 3, axis=2)
    assert glare(rgb, FRONT, threshold=800.0).ugr == pytest.approx(glare(values, FRONT, threshold=800.0).ugr)


def test_pictures_that_do_not_show_the_hemisphere(caplog):
    view = View("perspective", 60.0)
    with caplog.at_level(logging.WARNING):
        part = glare(picture(view, 40, 40), view)
    assert "of the hemisphere" in caplog.text and 0.2 < part.covered < 0.5
    caplog.clear()
    glare(picture(view, 40, 40), view, vertical_illuminance=2000.0)
    glare(picture(FRONT, 40, 40), FRONT)
    assert not caplog.text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"picture": np.zeros((4, 4, 2))}, "not \\(4, 4, 2\\)"),
        ({"picture": np.full((4, 4), np.nan)}, "16 pixels, the first in row 0, column 0"),
        ({"picture": -np.eye(4)}, "filter without negative lobes"),
        ({"threshold": 0.0}, "threshold of glare sources"),
        ({"threshold": np.nan}, "threshold of glare sources"),
        ({"vertical_illuminance": -1.0}, "number of lx"),
        ({"picture": np.full((4, 4), 1e4), "vertical_illuminance": 300.0}, "more than the vertical illuminance"),
    ],
)
def test_bad_pictures(change, message):
    given = {"picture": np.full((4, 4), 10.0), "view": FRONT} | change
    with pytest.raises(LightingError, match=message) as error:
        glare(**given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("fisheye",), "perspective or spherical"),
        (("perspective",), "give fov"),
        (("perspective", 180.0), "between 0 and 180"),
        (("spherical", 361.0), "0 to 360"),
        (("spherical", "180"), "0 to 360"),
        (("perspective", 60.0, "z"), "x or y"),
    ],
)
def test_bad_views(given, message):
    with pytest.raises(LightingError, match=message):
        View(*given)


def evalglare() -> str | None:
    """Radiance's program, of the package ``pyradiance`` or in the path."""
    found = importlib.util.find_spec("pyradiance")
    inside = Path(found.origin).parent / "bin" / "evalglare" if found is not None and found.origin else None
    return str(inside) if inside is not None and inside.exists() else shutil.which("evalglare")


def rgbe(luminance: np.ndarray) -> tuple[bytes, np.ndarray]:
    """Grey pixels of Radiance's pictures, and their luminances: eight bits, 179 lm/W."""
    mantissa, exponent = np.frexp(luminance / 179.0)
    digits = np.floor(256.0 * mantissa)
    pixels = np.stack([digits, digits, digits, exponent + 128.0], axis=-1)
    return pixels.astype(np.uint8).tobytes(), 179.0 * np.ldexp((digits + 0.5) / 256.0, exponent)


def by_evalglare(
    folder: Path, pixels: bytes, size: int, view: str, *options: str
) -> tuple[dict[str, float], np.ndarray]:
    """What ``evalglare`` finds with the rounded coefficients of the paper: numbers by name, and rows of sources."""
    head = f"#?RADIANCE\nVIEW= {view} -vp 0 0 0 -vd 0 1 0 -vu 0 0 1\nFORMAT=32-bit_rle_rgbe\n\n-Y {size} +X {size}\n"
    (folder / "a.hdr").write_bytes(head.encode() + pixels)
    paper = ["-w", "2", "1", "1.87", "2", "1", "5.87e-5", "0.0918", "0.16"]
    command = [evalglare() or "", "-d", *paper, *options, "a.hdr"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder).stdout.splitlines()
    count = int(lines[0].split()[0])
    rows = np.array([line.split() for line in lines[1 : count + 1]], np.float64)
    names, numbers = lines[count + 1].split(":")
    return dict(zip(names.split(","), map(float, numbers.split()), strict=True)), rows


def assert_same_glare(ours: Glare, theirs: dict[str, float], rows: np.ndarray, area: float, index: float) -> None:
    """``area``, ``index``: relative differences of solid angles and position indices of a source."""
    assert len(rows) == len(ours.sources)
    for source in ours.sources:
        row = rows[np.argmin(np.abs(rows[:, 4] - source.luminance))]
        assert source.luminance == pytest.approx(row[4], rel=5e-3)  # eight bits
        assert source.solid_angle == pytest.approx(row[5], rel=area)
        assert source.position_index == pytest.approx(row[6], rel=index)
    assert ours.vertical_illuminance == pytest.approx(theirs["E_v"], rel=area)
    assert ours.background_luminance == pytest.approx(theirs["lum_backg"], rel=2 * area)
    factor = np.log10(1 + 2 * index + area)
    assert ours.ugr == pytest.approx(theirs["ugr"], abs=8 * (factor + np.log10(1 + 2 * area)))
    assert ours.dgp == pytest.approx(theirs["dgp"], abs=0.0918 * factor + 1e-5)


@pytest.mark.skipif(evalglare() is None, reason="needs Radiance (pip install pyradiance)")
def test_evalglare_and_a_perspective_picture(tmp_path):
    """The same pixels: solid angles agree to six digits. Its position of a source is that of a whole pixel, 0.3 degrees
    off at most; the position index changes by at most 5 % a degree."""
    view, n = View("perspective", 90.0), 400
    pixels, luminance = rgbe(picture(view, n, n))
    theirs, rows = by_evalglare(tmp_path, pixels, n, "-vtv -vh 90 -vv 90")
    assert_same_glare(glare(luminance, view), theirs, rows, 1e-5, 0.015)


@pytest.mark.skipif(evalglare() is None, reason="needs Radiance (pip install pyradiance)")
@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_evalglare_and_a_fisheye_picture(tmp_path, scale):
    """The hemisphere, with pixels of 0.6 degrees in its projection and in ours: circles of 8 to 12 pixels have areas
    within 3 % of each other. Dark scenes, a fifth as bright, have the correction for low light."""
    n = 300
    y, x = 1.0 - 2.0 * (np.mgrid[:n, :n] + 0.5) / n
    radius = np.hypot(x, y)
    angle = 0.5 * np.pi * radius
    flat = np.sin(angle) / radius
    fisheye = np.stack([flat * x, flat * y, np.cos(angle)], axis=-1)
    pixels, _ = rgbe(np.where(radius < 1.0, scale * lit(fisheye), 1e-9))
    options = ["-C", "l+", "-b", str(2000.0 * scale)]
    theirs, rows = by_evalglare(tmp_path, pixels, n, "-vta -vh 180 -vv 180", *options)
    ours = glare(scale * picture(FRONT, n, n), FRONT, threshold=2000.0 * scale, low_light=True)
    assert_same_glare(ours, theirs, rows, 0.03, 0.03)
    if scale < 1.0:
        plain = glare(scale * picture(FRONT, n, n), FRONT, threshold=2000.0 * scale)
        assert ours.dgp < 0.95 * plain.dgp


def test_an_eye_in_a_room():
    """Spherical pictures by four seeds show the illuminance that a meter at the eye reads, and the lamp in its place:
    the square of 0.5 m at a height of 0.8 above the eye and 1 in front of it."""
    eye = [0.0, 0.0, 0.9]
    place = scenes.transform().look_at(eye, [0.0, 0.0, 0.0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 96, "height": 48, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "sensor": {"type": "spherical", "film": film, "to_world": place},
        "walls": {
            "type": "cube",
            "to_world": scenes.transform().scale([1, 1, 1]),
            "bsdf": scenes.diffuse(0.6, 0.5, 0.4),
        },
        "lamp": scenes.lamp([0.0, 0.8, -0.1], 0.25, 10.0),
    }
    scene["walls"]["flip_normals"] = True
    views = [etendue.render(scene, method="path", spp=16, seed=seed).image for seed in range(4)]
    found = [glare(image, View("spherical")) for image in views]
    read = etendue.measure(scene, [eye], [[0, 0, -1]], spp=4096)
    values = np.array([result.vertical_illuminance for result in found])
    error = np.hypot(values.std(ddof=1) / 2.0, read.photometric_error[0])
    # Beside noise: pixels average over latitude and longitude, not over the projected solid angle, 0.1 % for the lamp.
    assert values.mean() == pytest.approx(read.photometric[0], abs=3.5 * error + 1e-3 * values.mean())
    assert error < 0.01 * values.mean()
    side = (np.arange(100) + 0.5) / 200 - 0.25
    x, z = np.meshgrid(side, 1.0 + side)
    omega = 0.25 * (0.8 / (x**2 + 0.8**2 + z**2) ** 1.5).mean()
    luminance = EFFICACY * (0.9278 * 10.0 + 0.0722 * 8.0)
    for result in found:
        source = result.sources[0]
        # Pixels across its edges are dimmer: some are no source, others are beyond the lamp.
        assert source.luminance * source.solid_angle == pytest.approx(luminance * omega, rel=0.1)
        np.testing.assert_allclose(source.direction, np.array([0, 0.8, 1.0]) / 1.64**0.5, atol=0.03)
