"""The rendering equation solved in two ways: by recursion, and expanded into paths of a given number of bounces.

    python examples/ray_tracers.py [folder]

writes ray-tracers.png: a Cornell box with four weak lights besides its lamp, by a recursive distribution ray tracer, by
an expanded path tracer with uniform random numbers, and by the same path tracer with random numbers from a density that
VEGAS has learned, which samples the lamp more often. All three have the mean of the method `path`. The noise of the
last two, which trace the same number of paths, is compared.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue.core import use_variant
from etendue.display import tonemap, write_png
from etendue.film import LUMINANCE
from etendue.integration import (
    Box,
    Importance,
    Integrand,
    MeanSample,
    ProductDensity,
    Vegas,
    array_namespace,
    integral,
)
from etendue.scene import bundled_scene
from etendue.transport import TransportFunctions, film_picture

BOUNCES = 4  # edges of the longest path; `max_depth` of the method path
#: Parameters of the path tracer: bounces; film u, v; lamp u, v; then lobe, u, v of each bounce but the last.
FILM, LAMP, FIRST = [1, 2], [3, 4], 5
#: Groups that VEGAS learns. The film is left out, so that the density can be used for every pixel.
GROUPS = [[0], LAMP, *([FIRST + 3 * k + 1, FIRST + 3 * k + 2] for k in range(BOUNCES - 2))]


def scene() -> Any:
    """The bundled Cornell box, and four weak lights in it."""
    import mitsuba as mi

    description = bundled_scene("cornell-box").build()
    description["sensor"]["film"]["rfilter"] = {"type": "box"}
    for number, colour in enumerate(((1, 0.2, 0.1), (0.1, 0.8, 0.2), (0.1, 0.3, 1), (0.8, 0.6, 0.1))):
        intensity = {"type": "rgb", "value": [0.05 * v for v in colour]}
        description[f"weak{number}"] = {
            "type": "point",
            "position": [0.4 * number - 0.6, 0.3, 0.5],
            "intensity": intensity,
        }
    return mi.load_dict(description)


def distribution_ray_tracer(light: TransportFunctions, branching: int = 4) -> Integrand:
    """Radiance as a function of rays: L = L_e + L_r, L_r = direct light + int weight L_r du, by recursion.

    Direct light is an integral over the lamps, indirect light one over directions, so each lamp counts once.
    """
    direct = integral(light.direct, [6, 7], samples=branching, seed=1)
    reflected = direct
    for bounce in range(BOUNCES - 2):
        incoming = light.weight * reflected.compose(light.scatter)
        reflected = direct + integral(incoming, [6, 7, 8], samples=branching, seed=2 + bounce)
    return light.emitted + reflected


def path_tracer(light: TransportFunctions) -> Integrand:
    """The expanded equation: the number of bounces is the first parameter, and one evaluation is one path.

    The visible lamp is left out: it has no noise, but would attract all samples of an adaptive method.
    """

    def path(x: Any) -> list[Any]:
        top = array_namespace(x[0])
        ray = light.camera.evaluate(x[1:3])
        value: Any = 0
        throughput: Any = 1
        for bounce in range(1, BOUNCES):
            ends_here = (x[0] >= bounce) & (x[0] < bounce + 1)
            value = value + top.select(ends_here, throughput * light.direct.evaluate([*ray, *x[3:5]]), 0)
            if bounce + 1 < BOUNCES:
                step = [*ray, *x[FIRST + 3 * bounce - 3 : FIRST + 3 * bounce]]
                throughput = throughput * light.weight.evaluate(step)
                ray = light.scatter.evaluate(step)
        return value

    dimension = FIRST + 3 * (BOUNCES - 2)
    return Integrand(path, [(1, BOUNCES), *[(0, 1)] * (dimension - 1)], (0, np.inf), "device", values=3)


def without_film(density: ProductDensity) -> ProductDensity:
    """The density of the parameters other than those of the film, in their order."""
    box, kept = density.domain, [a for a in range(density.domain.dimension) if a not in FILM]
    part = Box.of([(box.lower[a], box.upper[a]) for a in kept])
    return ProductDensity(part, [[kept.index(a) for a in group] for group in density.groups], density.factors)


def pictures(light: TransportFunctions, f: Integrand, integrator: Any, size: int, samples: int, passes: int) -> Any:
    """Pictures of the path tracer, ``samples`` paths a pixel in each: (passes, height, width, 3)."""
    others = [a for a in range(f.dimension) if a not in FILM]
    seen = light.emitted.compose(light.camera) + integral(f, others, integrator, samples=1, seed=10)
    return np.array([film_picture(seen, (size, size), samples, seed=100 + n) for n in range(passes)])


def run(size: int = 192, samples: int = 32, passes: int = 6, learning: int = 1_000_000) -> dict[str, Any]:
    """Pictures by each, (passes, height, width, 3), and the mean of the whole picture by VEGAS."""
    use_variant()
    box = scene()
    light = TransportFunctions(box)

    radiance = distribution_ray_tracer(light)
    recursive = [light.picture(radiance, (size, size), samples // 4, seed=200 + n) for n in range(passes)]
    paths = path_tracer(light)
    uniform = MeanSample().integrate(paths.dot(LUMINANCE), learning)
    learned = Vegas(GROUPS, iterations=8, warm_up=2).integrate(paths.dot(LUMINANCE), learning)
    density = without_film(learned.details["density"])
    rendered = [
        etendue.render(box, "path", spp=4 * samples, size=(size, size), seed=n, max_depth=BOUNCES).image
        for n in range(passes)
    ]
    return {
        "recursive": np.array(recursive),
        "expanded": pictures(light, paths, MeanSample(), size, samples, passes),
        "vegas": pictures(light, paths, Importance(density), size, samples, passes),
        "path": np.array(rendered),
        "estimates": (uniform, learned),
    }


def noise(images: Any) -> float:
    """Variance of a pixel in one pass, relative to the square of the mean picture; over the darker 99 in 100."""
    relative = images.var(axis=0, ddof=1).mean(axis=-1) / (images.mean(axis=0).mean(axis=-1) ** 2 + 1e-3)
    return float(np.sort(relative.ravel())[: int(0.99 * relative.size)].mean())


def main(folder: Path) -> None:
    """Run, write the pictures, print the results."""
    found = run()
    names = ("recursive", "expanded", "vegas")
    write_png(folder / "ray-tracers.png", tonemap(np.concatenate([found[n][0] for n in names], axis=1), 1.0))
    for name in (*names, "path"):
        means = found[name].mean(axis=(1, 2, 3))
        print(f"{name:10}: mean radiance {means.mean():.5f} +- {means.std(ddof=1) / len(means) ** 0.5:.5f}")
    uniform, learned = found["estimates"]
    print(f"mean luminance by uniform numbers {uniform}, by VEGAS {learned}")
    print(f"variance of a pixel, uniform over VEGAS: {noise(found['expanded']) / noise(found['vegas']):.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
