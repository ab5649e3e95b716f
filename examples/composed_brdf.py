"""A material composed of functions: a texture times a diffuse lobe, plus a lobe whose exponent varies with position.

    python examples/composed_brdf.py [folder]

writes composed-brdf.png: a plate with this material under three lamps, seen from above; on the left as an integral of
functions, on the right rendered by the method `path` with the same function as a material. The two differ by noise
only. The albedo is known in closed form: at normal incidence the lobe (n + 2) / (2 pi) cos^n reflects the same share
for every exponent, so the albedo is texture + k_s everywhere.
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
from etendue.integration import Box, Integrand, QuasiMonteCarlo, Stratified, array_namespace, constant, integral
from etendue.scene import composed_bsdf
from etendue.transport import TransportFunctions, film_picture

K_S = 0.3  # share of the light that the lobe reflects at normal incidence
EYE = 4.0  # height of the eye above the plate, which reaches from -1 to 1
LAMPS = ((11, 7, 3), (3, 8, 5), (4, 5, 12))  # radiance
#: Parameters of a material: u, v, direction to the light x, y, z, direction to the eye x, y, z.
BOX = Box.of([(0, 1)] * 2 + [(-1, 1)] * 6)


def hemisphere(x: Any) -> list[Any]:
    """A direction from two uniform numbers, of density cos / pi."""
    top, angle = array_namespace(x[0]), 2 * math.pi * x[1]
    return [top.sqrt(1 - x[0]) * top.cos(angle), top.sqrt(1 - x[0]) * top.sin(angle), top.sqrt(x[0])]


def texture(x: Any) -> list[Any]:
    """4 x 4 colours, interpolated linearly: each counts by its distance."""
    top, colours = array_namespace(x[0]), np.random.default_rng(5).uniform(0.05, 0.65, (4, 4, 3))
    near = [[top.maximum(0, 1 - abs(3 * v - k)) for k in range(4)] for v in x]
    return [sum(near[0][i] * near[1][j] * colours[i, j, c] for i in range(4) for j in range(4)) for c in range(3)]


def power_lobe(x: Any) -> Any:
    """(n + 2) / (2 pi) cos^n of the cosine x[0] and the exponent x[1]."""
    return (x[1] + 2) / (2 * math.pi) * array_namespace(x[0]).maximum(x[0], 0) ** x[1]


def exponent(x: Any) -> Any:
    """Waves between 10 and 200."""
    return 105 + 95 * array_namespace(x[0]).sin(20 * x[0]) * array_namespace(x[0]).sin(20 * x[1])


DIRECTION = Integrand(hemisphere, 2, (-1, 1), "either", values=3)


def brdf() -> Integrand:
    """The material: of eight parameters, three values."""
    diffuse = Integrand(texture, 2, (0.05, 0.65), "either", values=3) * (1 / math.pi)
    lobe = Integrand(power_lobe, [(-1, 1), (10, 200)], (0, 202 / (2 * math.pi)), "either")
    # Cosine of the angle between one direction and the mirror image of the other.
    cosine = Integrand(lambda x: x[2] * x[5] - x[0] * x[3] - x[1] * x[4], [(-1, 1)] * 6, (-1, 1), "either")
    sharpness = Integrand(exponent, 2, (10, 200), "either")
    glossy = lobe.compose(cosine.of(range(2, 8), BOX), sharpness.of([0, 1], BOX))
    return diffuse.of([0, 1], BOX) + K_S * glossy


def albedo(f: Integrand, positions: Any) -> Any:
    """Share of the light from straight above that a material reflects, (3, n), at ``positions`` (2, n) in NumPy."""
    box = [(0, 1)] * 4  # u, v, and two numbers that sample a direction
    above = [constant(v, box) for v in (0.0, 0.0, 1.0)]
    position = Integrand(lambda x: [x[0], x[1]], box, (0, 1), "either", values=2)
    reflected = f.compose(position, *above, DIRECTION.of([2, 3], box)) * math.pi
    return np.array(integral(reflected, [2, 3], QuasiMonteCarlo(), 4096).evaluate(positions))


def plate(f: Integrand) -> dict[str, Any]:
    """The plate under three lamps that face it, and the eye, for Mitsuba."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at
    scene: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 2}}
    scene["plate"] = {"type": "rectangle", "bsdf": composed_bsdf(f)}
    for number, radiance in enumerate(LAMPS):
        angle = 2 * math.pi * number / len(LAMPS)
        scene[f"lamp{number}"] = {
            "type": "rectangle",
            "to_world": look([1.1 * math.cos(angle), 1.1 * math.sin(angle), 2.2], [0, 0, 0], [0, 0, 1]).scale(0.35),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": list(radiance)}},
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
        }
    scene["eye"] = {
        "type": "perspective",
        "fov": 2 * math.degrees(math.atan(1 / EYE)),
        "to_world": look([0, 0, EYE], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}},
    }
    return scene


def seen_from_above(f: Integrand, scene: Any) -> Integrand:
    """Radiance of the plate at (u, v) towards the eye: int f(u, v, w, eye) L(u, v, w) cos dw, by composition."""
    light = TransportFunctions(scene)
    box = [(0, 1)] * 4
    position = Integrand(lambda x: [x[0], x[1]], box, (0, 1), "device", values=2)
    direction = DIRECTION.of([2, 3], box)
    on_plate = Integrand(lambda x: [2 * x[0] - 1, 2 * x[1] - 1, 0 * x[0] + 1e-4], box, on="device", values=3)
    incoming = light.emitted.compose(on_plate, direction)  # only lamps emit

    def towards_eye(x: Any) -> list[Any]:
        offset = [1 - 2 * x[0], 1 - 2 * x[1], EYE + 0 * x[0]]
        length = array_namespace(x[0]).sqrt(sum(v * v for v in offset))
        return [v / length for v in offset]

    eye = Integrand(towards_eye, box, (-1, 1), "device", values=3)
    return f.compose(position, direction, eye) * incoming * math.pi


def run(size: int = 160, samples: int = 256, passes: int = 4) -> dict[str, Any]:
    """Several pictures of both kinds, (passes, height, width, 3), and the largest error of the albedo."""
    import mitsuba as mi

    use_variant()
    f = brdf()
    positions = np.random.default_rng(1).random((2, 200))
    expected = np.array(texture(positions)) + K_S
    worst = float(np.abs(albedo(f, positions) - expected).max())

    scene = mi.load_dict(plate(f))
    reflected = integral(seen_from_above(f, scene), [2, 3], Stratified(), samples, seed=1)
    # The film begins at its upper left; v runs from below.
    upright = Integrand(lambda x: [x[0], 1 - x[1]], 2, (0, 1), "device", values=2)
    seen = reflected.compose(upright)
    shape, path = (size, size), {"spp": 2 * samples, "max_depth": 2}
    composed = [film_picture(seen, shape, samples=2, seed=100 + n) for n in range(passes)]
    rendered = [etendue.render(scene, "path", size=shape, seed=n, **path).image for n in range(passes)]
    return {"composed": np.array(composed), "rendered": np.array(rendered), "albedo_error": worst}


def main(folder: Path) -> None:
    """Run, write the picture, print the results."""
    found = run()
    pictures = [found[name].mean(axis=0) for name in ("composed", "rendered")]
    write_png(folder / "composed-brdf.png", tonemap(np.concatenate(pictures, axis=1), 0.0, "filmic"))
    print(f"albedo at normal incidence: at most {found['albedo_error']:.1e} from texture + k_s")
    print(f"mean radiance: {pictures[0].mean():.5f} as an integral of functions, {pictures[1].mean():.5f} by path")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
