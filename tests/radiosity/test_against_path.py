"""The picture of a solution against that of the method ``path``, for the same diffuse scene."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support.running import run
from support.scenes import diffuse, rgb, transform

from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, RayScene, scene_patches, solve
from etendue.scene import load

WIDTH, HEIGHT = 8, 6
#: Turns of the rectangle that looks up: the walls of the room from -1 to 1, each with its reflectance.
WALLS = {
    "floor": ((1, 0, 0), 0, (0.5, 0.4, 0.3)),
    "ceiling": ((1, 0, 0), 180, (0.6, 0.6, 0.6)),
    "left": ((0, 1, 0), 90, (0.7, 0.2, 0.2)),
    "right": ((0, 1, 0), -90, (0.2, 0.3, 0.7)),
    "back": ((1, 0, 0), 90, (0.7, 0.7, 0.6)),
    "front": ((1, 0, 0), -90, (0.4, 0.6, 0.4)),
}


def diffuse_room():
    """A coloured room whose whole ceiling shines, with two boxes in the air; the camera stands inside."""
    look = transform().look_at([0.1, -0.95, 0.1], [0, 1, -0.15], [0, 0, 1])
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    scene = {"type": "scene", "sensor": {"type": "perspective", "fov": 75, "to_world": look, "film": film}}
    for name, (axis, angle, colour) in WALLS.items():
        place = transform().rotate(axis, angle).translate([0, 0, -1])
        scene[name] = {"type": "rectangle", "to_world": place, "bsdf": diffuse(*colour)}
    scene["ceiling"]["emitter"] = {"type": "area", "radiance": rgb(1.0, 0.9, 0.7)}
    for name, place, turn, colour in (("one", (-0.4, 0.3, -0.3), 20, 0.8), ("two", (0.45, 0.5, -0.5), 50, 0.3)):
        cube = transform().translate(place).rotate([0, 0, 1], turn).scale([0.25, 0.25, 0.35])
        scene[name] = {"type": "cube", "to_world": cube, "bsdf": diffuse(colour, 0.5, 0.5)}
    return load(scene)


def picture(problem, max_area, grid=24):
    """Radiances (height, width, 3) of a solution: means of grid x grid rays in every pixel."""
    patches = scene_patches(problem.scene, max_area=max_area)
    solution = solve(patches, ABuffer(patches, OwenSobol(4, seed=1)).cast(1024), "conjugate-gradient")
    y, x = ((np.arange(n * grid) + 0.5) / (n * grid) for n in (HEIGHT, WIDTH))
    x, y = (np.ascontiguousarray(a.ravel(), np.float32) for a in np.meshgrid(x, y))
    rays, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    scene = RayScene(patches)
    seen = scene.first_patches(scene.local(np.array(rays.o).T), np.array(rays.d).T.astype(np.float64))
    assert seen.max() < len(patches)
    radiance = (solution.radiosity / np.pi)[seen]
    return radiance.reshape(HEIGHT, grid, WIDTH, grid, 3).mean(axis=(1, 3))


@pytest.mark.slow
def test_the_picture_of_a_solution_is_that_of_path():
    """Pixel by pixel. What patches blur is known from patches of four times the area, as it falls with the area."""
    problem = diffuse_room()
    traced = run(problem, "path", passes=12, samples=512).images
    fine, coarse = picture(problem, 0.012), picture(problem, 0.048)
    blur = np.abs(fine - coarse) / 3
    scatter = traced.std(axis=0, ddof=1) / np.sqrt(len(traced))
    assert scatter.mean() < 0.01 * traced.mean() and blur.mean() < 0.005 * traced.mean()
    z = (traced.mean(axis=0) - fine) / np.sqrt(scatter**2 + blur**2 + (0.001 * fine) ** 2)
    # Each pixel's scatter is known from 12 passes: Student's t has a larger square than a normal number.
    assert stats.chi2.sf((z**2).sum() * (9 / 11), z.size) > 1e-5, np.round(z[..., 0], 1)
    np.testing.assert_allclose(traced.mean(axis=(0, 1, 2)), fine.mean(axis=(0, 1)), rtol=0.005)
