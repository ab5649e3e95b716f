"""Radiosity: form factors between patches as integrals of four parameters, by any integrator, and a linear system.

    python examples/radiosity.py [folder] [integrator]

writes radiosity.png: a closed room with a block hanging in it, lit by the middle of its ceiling; radiosity with patches
of two sizes, and the method `path`. The integrator of the form factors is quasimontecarlo, stratified or meansample,
which compute all of them together, or vegas or recursivestratified, which adapt to each separately and are used for the
larger patches only.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue.core import use_variant
from etendue.display import tonemap, write_png
from etendue.integration import Integrand, MeanSample, QuasiMonteCarlo, RecursiveStratified, Stratified, Vegas, integral
from etendue.transport import TransportFunctions

METHODS = QuasiMonteCarlo(), Stratified(), MeanSample(), Vegas(iterations=4), RecursiveStratified()
INTEGRATORS = {type(method).__name__.lower(): method for method in METHODS}
WHITE, RED, GREEN = (0.75, 0.75, 0.75), (0.6, 0.1, 0.08), (0.15, 0.45, 0.12)
LAMP = 10.0  # radiosity of the middle ninth of the ceiling
Patches = dict[str, Any]  # corner, a, b, normal, colour, emission: (n, 3) each; area: (n,)


def walls() -> list[tuple[Any, ...]]:
    """Corner, sides a and b (the normal is a cross b) and colour: a cube of side 1 seen from inside, and a block."""
    x, y, z = np.eye(3)
    o, foot, up = 0 * x, np.array([0.4, 0.12, 0.2]), 0.5 * y
    p, q = np.array([0.3, 0, -0.1]), np.array([0.1, 0, 0.3])
    room = [(o, z, x, WHITE), (y, x, z, WHITE), (o, x, y, WHITE), (z, y, x, WHITE), (o, y, z, RED), (x, z, y, GREEN)]
    sides = [(foot, up, p, WHITE), (foot + q, p, up, WHITE), (foot, q, up, WHITE), (foot + p, up, q, WHITE)]
    return [*room, *sides, (foot + up, q, p, WHITE), (foot, p, q, WHITE)]


def divided(n: int) -> Patches:
    """Walls of the room in n x n patches, n a multiple of 3, those of the block in n/3 x n/3."""
    rows = []
    for number, (corner, a, b, colour) in enumerate(walls()):
        parts = n if number < 6 else n // 3
        for i, j in np.ndindex(parts, parts):
            lit = number == 1 and {i * 3 // n, j * 3 // n} == {1}
            rows.append((corner + (a * i + b * j) / parts, a / parts, b / parts, colour, (LAMP * lit,) * 3))
    columns = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
    patches = dict(zip(("corner", "a", "b", "colour", "emission"), columns, strict=True))
    cross = np.cross(patches["a"], patches["b"])
    patches["area"] = np.linalg.norm(cross, axis=1)
    patches["normal"] = cross / patches["area"][:, None]
    return patches


def room() -> dict[str, Any]:
    """The same for Mitsuba, whose rectangles are the patches of the coarsest division."""
    import mitsuba as mi

    p, scene = divided(3), {"type": "scene", "integrator": {"type": "path", "max_depth": -1}}
    for k, (a, b) in enumerate(zip(p["a"] / 2, p["b"] / 2, strict=True)):
        matrix = np.eye(4)
        matrix[:3] = np.stack([a, b, p["normal"][k], p["corner"][k] + a + b], axis=1)
        colour = {"type": "rgb", "value": p["colour"][k].tolist()}
        shape = {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix)}
        shape["bsdf"] = {"type": "diffuse", "reflectance": colour}
        if p["emission"][k].any():
            shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": LAMP / math.pi}}
        scene[f"patch{k}"] = shape
    scene["eye"] = {
        "type": "perspective",
        "fov": 80,
        "to_world": mi.ScalarTransform4f().look_at([0.5, 0.5, 0.99], [0.5, 0.47, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
    }
    return scene


def exchange(patches: Patches, scene: Any) -> Integrand:
    """(patch i, patch j, u, v, u', v') -> what a point on i sees of all of j, minus what is occluded around (u', v').

    The factor cos cos' / (pi r^2) is unbounded at an edge that two patches share. Without occlusion its integral over j
    is known (Lambert's formula), and occluders are not at the edge. A patch must lie in front of all of i, or behind
    it.
    """
    import drjit as dr
    import mitsuba as mi

    tables = {name: mi.Float(np.float32(values).ravel()) for name, values in patches.items()}

    def look(x: Any) -> tuple[Any, ...]:
        """A point on i, slightly offset, and normals and sides of both."""
        i, j = mi.UInt32(x[0]), mi.UInt32(x[1])
        corner, a, b, n = (dr.gather(mi.Vector3f, tables[k], i) for k in ("corner", "a", "b", "normal"))
        other = [dr.gather(mi.Vector3f, tables[k], j) for k in ("corner", "a", "b", "normal")]
        return corner + x[2] * a + x[3] * b + 1e-4 * n, n, dr.gather(mi.Float, tables["area"], i), j, *other

    def whole(x: Any) -> Any:
        point, n, area, _, corner, a, b, _ = look(x)
        ends = [v - point for v in (corner, corner + a, corner + a + b, corner + b)]
        before = [dr.dot(v, n) > -3e-4 for v in ends]
        ends = [dr.normalize(v) for v in ends]
        sides = zip(ends, ends[1:] + ends[:1], strict=True)
        total = sum(dr.dot(n, dr.normalize(dr.cross(q, p))) * dr.safe_acos(dr.dot(p, q)) for p, q in sides)
        return dr.select(before[0] & before[1] & before[2] & before[3], dr.maximum(total, 0) / (2 * math.pi) * area, 0)

    def hidden(x: Any) -> Any:
        point, n, area, j, corner, a, b, m = look(x)
        offset = corner + x[4] * a + x[5] * b + 1e-4 * m - point
        r = dr.norm(offset)
        way = offset / r
        cosines = dr.maximum(dr.dot(way, n), 0) * dr.maximum(-dr.dot(way, m), 0)
        covered = scene.ray_test(mi.Ray3f(point, way, r, 0.0, mi.Color0f()), cosines > 0)
        factor = cosines / (math.pi * r * r) * area * dr.gather(mi.Float, tables["area"], j)
        return dr.select(covered, factor, 0)

    box = [(0, len(patches["area"]))] * 2 + [(0, 1)] * 4
    return Integrand(whole, box, (0, math.inf), "device") - Integrand(hidden, box, (0, math.inf), "device")


def form_factors(f: Integrand, areas: Any, integrator: Any, samples: int) -> Any:
    """F[i, j], the share of what leaves patch i that reaches patch j; from half of them, as A_i F_ij = A_j F_ji."""
    import mitsuba as mi

    pairs = np.array(np.triu_indices(len(areas), 1)) + 0.5
    if integrator.batched:  # an integral over the four parameters is a function of the other two
        values = integral(f, [2, 3, 4, 5], integrator, samples).evaluate([mi.Float(np.float32(row)) for row in pairs])
    else:
        values = [integrator.integrate(f.fix({0: i, 1: j}), samples).value for i, j in pairs.T]
    i, j = pairs.astype(int)
    factors = np.zeros((len(areas), len(areas)))
    factors[i, j] = factors[j, i] = np.array(values)
    return factors / areas[:, None]


def solve(factors: Any, patches: Patches) -> Any:
    """Radiosity B = E + colour F B, for each channel: (n, 3)."""
    channels = zip(patches["colour"].T, patches["emission"].T, strict=True)
    return np.stack([np.linalg.solve(np.eye(len(e)) - c[:, None] * factors, e) for c, e in channels], axis=1)


def patch_of(patches: Patches, hit: Any) -> Any:
    """Index of the patch of each point; ``hit`` is (n, 6), position and normal."""
    offset = hit[:, None, :3] - patches["corner"]
    u, v = (np.einsum("nkc,kc->nk", offset, patches[s] / (patches[s] ** 2).sum(axis=1)[:, None]) for s in "ab")
    away = np.abs(np.einsum("nkc,kc->nk", offset, patches["normal"])) + (hit[:, 3:] @ patches["normal"].T < 0.9)
    outside = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) - 0.5
    return (away + np.maximum(outside, 0)).argmin(axis=1)


def run(size: int = 160, divisions: Any = (3, 9), by: str = "quasimontecarlo", samples: int = 256) -> dict[str, Any]:
    """Pictures by radiosity with each division, (height, width, 3), by path, and the row sums of the form factors."""
    import mitsuba as mi

    use_variant()
    scene = mi.load_dict(room())
    light = TransportFunctions(scene)
    middle = (np.arange(size) + 0.5) / size
    film = [mi.Float(np.float32(f(middle, size))) for f in (np.tile, np.repeat)]
    hit = np.stack([np.array(v) for v in light.hit.evaluate(light.camera.evaluate(film))], axis=1)
    found: dict[str, Any] = {"sums": [], "pictures": []}
    for n in divisions:
        patches = divided(n)
        factors = form_factors(exchange(patches, scene), patches["area"], INTEGRATORS[by], samples)
        found["sums"].append(factors.sum(axis=1))
        seen = np.concatenate([patch_of(patches, part) for part in np.array_split(hit, 16)])
        found["pictures"].append((solve(factors, patches) / math.pi)[seen].reshape(size, size, 3))
    found["path"] = etendue.render(scene, "path", spp=256, size=(size, size), max_depth=40).image
    return found


def difference(picture: Any, path: Any) -> float:
    """Root mean square difference where no part of the lamp is seen, relative to the mean."""
    dark = path.max(axis=2) < 0.1 * LAMP / math.pi
    return float(np.sqrt(((picture - path)[dark] ** 2).mean()) / path[dark].mean())


def main(folder: Path, integrator: str = "quasimontecarlo") -> None:
    """Run, write the picture, print the results."""
    divisions = (3, 9) if INTEGRATORS[integrator].batched else (3,)
    found = run(divisions=divisions, by=integrator)
    pictures = [*found["pictures"], found["path"]]
    write_png(folder / "radiosity.png", tonemap(np.concatenate(pictures, axis=1), 1.5))
    for n, sums, picture in zip(divisions, found["sums"], found["pictures"], strict=True):
        print(f"{len(sums)} patches: rows of form factors add up to {sums.mean():.4f} +- {sums.std():.4f}", end=", ")
        print(f"difference from path {difference(picture, found['path']):.1%} ({n} x {n} on a wall)")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(), *sys.argv[2:3])
