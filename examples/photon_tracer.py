"""A photon tracer: photons from a Markov chain on the emitted radiance, stored on the floor, a map, and a picture.

    python examples/photon_tracer.py [folder]

writes photon-tracer.png: a ring of polished metal on a floor, beside a lamp that is brightest in its middle; on the
left rendered from the map, on the right by the method `path`. The irradiance of squares of the floor is compared with a
top view by `path`.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue.core import use_variant
from etendue.density import BinnedKernel, Histogram, Samples
from etendue.display import tonemap, write_png
from etendue.integration import Independent, Integrand, Metropolis, Mixture, QuasiMonteCarlo, UniformStep, integral
from etendue.transport import TransportFunctions

FLOOR = [(-1, 1), (-1, 1)]
REFLECTANCE = 0.6
LAMP_SIZE = 0.15  # half of its side
EDGES = 5  # of the longest path from the lamp to the eye
#: A point (u, v) of the lamp, and a direction: polar angle to its normal, azimuth.
EMISSION = [(0, 1), (0, 1), (0, math.pi / 2), (0, 2 * math.pi)]


def ring_scene(above: bool = False) -> dict[str, Any]:
    """The floor, the ring, the lamp, and a camera at the side or straight above."""
    import mitsuba as mi

    transform = mi.ScalarTransform4f()
    cell = (np.arange(32) + 0.5) / 32 - 0.5
    bright = 200 * np.exp(-12 * (cell[:, None] ** 2 + cell[None, :] ** 2))
    radiance = mi.Bitmap(np.repeat(bright[..., None], 3, axis=-1).astype(np.float32))
    eye = {"type": "perspective", "fov": 32, "to_world": transform.look_at([1.5, 2.6, 2.2], [0, 0.05, 0], [0, 1, 0])}
    if above:
        eye = {"type": "orthographic", "to_world": transform.look_at([0, 3, 0], [0, 0, 0], [0, 0, 1])}
    silver = {"type": "twosided", "bsdf": {"type": "conductor", "material": "Ag"}}
    lamp: dict[str, Any] = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.0}}
    lamp["to_world"] = transform.look_at([1.5, 1.5, 0], [0, 0.1, 0], [0, 1, 0]).scale(LAMP_SIZE)
    lamp["emitter"] = {"type": "area", "radiance": {"type": "bitmap", "bitmap": radiance, "raw": True}}
    floor: dict[str, Any] = {"type": "rectangle", "to_world": transform.rotate([1, 0, 0], -90)}
    floor["bsdf"] = {"type": "diffuse", "reflectance": REFLECTANCE}
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": EDGES},
        "floor": floor,
        "ring": {"type": "cylinder", "p0": [0, 0.001, 0], "p1": [0, 0.3, 0], "radius": 0.55, "bsdf": silver},
        "lamp": lamp,
        "eye": eye | {"film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}},
    }


def emission(light: TransportFunctions) -> tuple[Integrand, Integrand]:
    """The ray that leaves the lamp, and the flux per unit of each parameter that it carries: L_e cos sin A."""
    import drjit as dr
    import mitsuba as mi

    lamp, area = light.scene.emitters()[0].get_shape(), 4 * LAMP_SIZE**2

    def leaving(x: Any, sign: float = 1.0) -> list[Any]:
        at = lamp.sample_position(0.0, mi.Point2f(x[0], x[1]))
        local = mi.Vector3f(dr.sin(x[2]) * dr.cos(x[3]), dr.sin(x[2]) * dr.sin(x[3]), dr.cos(x[2]))
        direction = mi.Frame3f(at.n).to_world(local)
        return [*(at.p + 1e-3 * direction), *(sign * direction)]

    out = Integrand(leaving, EMISSION, on="device", values=6)
    # The radiance that leaves along a ray is what an eye on that ray sees, looking back.
    seen = light.emitted.compose(Integrand(lambda x: leaving(x, -1.0), EMISSION, on="device", values=6))
    measure = Integrand(lambda x: dr.sin(x[2]) * dr.cos(x[2]) * area, EMISSION, (0, area / 2), "device")
    return out, seen.dot([0, 1, 0]) * measure


def trace(light: TransportFunctions, photons: int, seed: int) -> Samples:
    """The photons that arrive at the floor, and the power of each."""
    import drjit as dr
    import mitsuba as mi

    out, flux = emission(light)
    power = QuasiMonteCarlo().integrate(flux, 1 << 16, seed).value
    chains = Metropolis(Mixture(UniformStep(0.3), Independent(), share=0.3), chains=photons // 32, burn_in=8)
    starts = chains.sample(flux, photons // 32 * 40, seed).points.reshape(4, -1)
    ray = out.evaluate([mi.Float(np.float32(row)) for row in starts])
    energy = mi.Color3f(power / photons)
    random = mi.PCG32(photons, seed)
    places, energies = [], []
    for _ in range(EDGES - 1):  # the last edge leads to the eye
        x, y, z, _, up, _ = light.hit.evaluate(ray)
        on_floor = (dr.abs(y) < 1e-4) & (up > 0.5) & (energy[1] > 0)
        kept = np.flatnonzero(np.array(on_floor))
        places.append(np.stack([np.array(x), np.array(z)], axis=1)[kept])
        energies.append((np.array(energy[1]) + np.zeros(photons))[kept])
        step = [*ray, random.next_float32(), random.next_float32(), random.next_float32()]
        energy, ray = energy * light.weight.evaluate(step), light.scatter.evaluate(step)
        dr.eval(energy, ray, random)
    weights = np.concatenate(energies)
    return Samples(np.clip(np.concatenate(places), -1, 1), weights, mass=float(weights.sum()))


def radiance(light: TransportFunctions, irradiance: Any) -> Integrand:
    """Radiance towards the eye: the lamp, the map on the floor, and their reflections in the ring."""
    import drjit as dr
    import mitsuba as mi

    def stored(x: Any) -> Any:
        px, _, pz, _, up, _ = light.hit.evaluate(x)
        at = mi.Point2f(dr.clip(px, -1, 1), dr.clip(pz, -1, 1))
        return dr.select(up > 0.5, irradiance(at) * (REFLECTANCE / math.pi), 0)

    off_floor = Integrand(lambda x: dr.select(light.hit.evaluate(x)[4] > 0.5, 0.0, 1.0), light.rays, (0, 1), "device")
    seen = direct = light.emitted + Integrand(stored, light.rays, (0, math.inf), "device")
    for bounce in range(2):  # reflections between the sides of the ring
        mirrored = integral(light.weight * seen.compose(light.scatter), [6, 7, 8], samples=1, seed=bounce + 1)
        seen = direct + off_floor * mirrored
    return seen


def run(
    size: int = 256, photons: int = 1 << 20, passes: int = 6, squares: int = 16, samples: int = 64
) -> dict[str, Any]:
    """Irradiance of squares of the floor, (passes, squares, squares), and pictures: by photons, and by path."""
    import mitsuba as mi

    use_variant()
    light = TransportFunctions(mi.load_dict(ring_scene()))
    stores = [trace(light, photons, seed) for seed in range(passes)]
    counted = [Histogram(store, squares, FLOOR).values for store in stores]
    weights = np.concatenate([store.weights * store.mass for store in stores]) / passes
    together = Samples(np.concatenate([store.positions for store in stores]), weights, mass=float(weights.sum()))
    smooth = BinnedKernel(together, 0.016, "epanechnikov", FLOOR, "reflect")
    mapped = light.picture(radiance(light, smooth), (size, size), samples=16, seed=50)
    picture = etendue.render(light.scene, "path", spp=samples, size=(size, size), max_depth=EDGES).image

    scene, size = mi.load_dict(ring_scene(above=True)), 4 * squares
    above = [
        etendue.render(scene, "path", spp=samples, size=(size, size), seed=n, max_depth=EDGES).image
        for n in range(passes)
    ]
    # The radiance of a diffuse floor is its irradiance times reflectance / pi. Up in the picture is z, left is x.
    turned = np.array(above)[:, ::-1, ::-1, 1].reshape(passes, squares, 4, squares, 4).mean(axis=(2, 4))
    floor = turned.transpose(0, 2, 1) * math.pi / REFLECTANCE
    return {"photons": np.array(counted), "path": floor, "mapped": mapped, "picture": picture, "stored": len(weights)}


def main(folder: Path) -> None:
    """Run, write the picture, print the results."""
    found = run()
    write_png(folder / "photon-tracer.png", tonemap(np.concatenate([found["mapped"], found["picture"]], axis=1)))
    for name in ("photons", "path"):
        means = found[name].mean(axis=(1, 2))
        print(f"{name:8}: mean irradiance {means.mean():.5f} +- {means.std(ddof=1) / len(means) ** 0.5:.5f}")
    print(f"{found['stored']} photons on the floor")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
