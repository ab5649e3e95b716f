"""An irradiance cache with gradients: indirect light is computed at few points and interpolated between them.

    python examples/irradiance_cache.py [folder]

writes irradiance-cache.png: the positions of the records in a Cornell box, and its indirect light by the cache with
gradients, by the same cache without gradients, and by the method `path`. It prints the errors against a converged
picture and the number of paths that `path` needs for the error of the cache.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

import etendue
from etendue.core import use_variant
from etendue.display import tonemap, write_png
from etendue.integration import Integrand, Stratified, integral
from etendue.scene import bundled_scene
from etendue.transport import IrradianceCache, TransportFunctions

BOUNCES = 4  # edges of the longest path: the cache holds light of two and three bounces
ACCURACY = 0.2
REACH = (0.04, 0.5)  # smallest and largest radius of a record; the box is 2 wide


def incident(light: TransportFunctions) -> Integrand:
    """Radiance along a ray without that of the lamp itself: reflected direct light and further bounces."""
    direct = integral(light.direct, [6, 7], Stratified(), samples=4, seed=1)
    reflected = direct
    for bounce in range(BOUNCES - 3):
        reflected = direct + integral(
            light.weight * reflected.compose(light.scatter), [6, 7, 8], samples=1, seed=2 + bounce
        )
    return reflected


def fill(cache: IrradianceCache, light: TransportFunctions, position: Any, normal: Any, width: int) -> None:
    """Records for all points, rows of ``width``: on grids from coarse to fine, wherever no record is valid yet."""
    row, column = np.divmod(np.arange(len(position)), width)
    met = np.abs(normal).sum(axis=1) > 0
    for stride in (64, 32, 16, 8, 4, 2, 1):
        grid = np.flatnonzero((row % stride == 0) & (column % stride == 0) & met)
        grid = grid[cache(position[grid], normal[grid])[1] == 0]
        if len(grid):
            cache.compute(incident(light), light.distance, position[grid], normal[grid], seed=stride)


def run(size: int = 192, samples: int = 128, passes: int = 6) -> dict[str, Any]:
    """Indirect pictures (height, width, 3) by the caches and, converged, by path; the variance of one path per
    pixel."""
    import mitsuba as mi

    use_variant()
    description = bundled_scene("cornell-box").build()
    description["sensor"]["film"]["rfilter"] = {"type": "box"}
    scene = mi.load_dict(description)
    light = TransportFunctions(scene)

    # First hit of each pixel's centre: position, normal, and the reflectance that turns irradiance into radiance.
    middle = (np.arange(size) + 0.5) / size
    film = [mi.Float(np.float32(f(middle, size))) for f in (np.tile, np.repeat)]
    ray = light.camera.evaluate(film)
    hit = np.stack([np.array(v, dtype=np.float64) for v in light.hit.evaluate(ray)], axis=1)
    albedo = np.array(light.albedo.evaluate(ray), dtype=np.float64).T
    position, normal = hit[:, :3], hit[:, 3:]

    found: dict[str, Any] = {}
    cache = IrradianceCache(REACH, ACCURACY)
    fill(cache, light, position, normal, size)
    for name, gradients in (("cache", True), ("without", False)):
        cache.gradients = gradients
        found[name] = (cache(position, normal)[0] * albedo / np.pi).reshape(size, size, 3)
    # Pixels that show one surface together with their neighbours: at edges the position in the pixel decides.
    emitted = np.array(light.emitted.evaluate(ray), dtype=np.float64).T
    points = np.concatenate([normal, albedo, emitted], axis=1).reshape(size, size, 9)
    around = sliding_window_view(np.pad(points, ((1, 1), (1, 1), (0, 0))), (3, 3), axis=(0, 1))
    found["inner"] = np.ptp(around, axis=(3, 4)).max(axis=2) < 1e-3
    found |= {"records": cache.records[:, :3], "rays": cache.rays}
    found["positions"] = position.reshape(size, size, 3)

    def indirect(seed: int) -> Any:
        """All light but that of one bounce: paths of all lengths minus those of up to two edges."""
        depths = [
            etendue.render(scene, "path", spp=samples, size=(size, size), seed=seed, max_depth=depth).image
            for depth in (BOUNCES, 2)
        ]
        return depths[0].astype(float) - depths[1]

    several = np.array([indirect(seed) for seed in range(passes)])
    # The two depths share random numbers, but not all of their noise: this is an upper bound of the variance.
    found |= {"path": several.mean(axis=0), "scatter": several.var(axis=0, ddof=1) * samples, "seen": samples * passes}
    return found


def summary(found: dict[str, Any]) -> dict[str, float]:
    """RMS errors relative to the mean, without edges, and the number of paths that `path` needs for the cache's
    error."""
    inner = found["inner"]
    truth, scatter = found["path"][inner], found["scatter"][inner].mean()
    noise, mean = scatter / found["seen"], truth.mean()
    squares = {k: max(((found[k][inner] - truth) ** 2).mean() - noise, 1e-12) for k in ("cache", "without")}
    return {
        "error": float(np.sqrt(squares["cache"]) / mean),
        "without": float(np.sqrt(squares["without"]) / mean),
        "bias": float(found["cache"][inner].mean() / mean - 1),
        "paths": float(scatter / squares["cache"] * inner.size),
        "rays": float(found["rays"]),
    }


def main(folder: Path) -> None:
    """Run, write the pictures, print the results."""
    found = run()
    dots = 0.3 * found["path"]
    for record in found["records"]:
        dots[np.unravel_index(((found["positions"] - record) ** 2).sum(axis=2).argmin(), dots.shape[:2])] = 0.3
    row = np.concatenate([dots, found["cache"], found["without"], found["path"]], axis=1)
    write_png(folder / "irradiance-cache.png", tonemap(row, 2.5))
    figures = summary(found)
    print(f"{len(found['records'])} records, {figures['rays']:.0f} rays into their hemispheres")
    print(f"error of the indirect light: {figures['error']:.1%}, without gradients {figures['without']:.1%}")
    print(f"path needs {figures['paths']:.2g} paths for it, {figures['paths'] / figures['rays']:.0f} times as many")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
