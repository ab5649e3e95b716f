"""Eight luminaires of an office: dimmed and aimed so that every desk has 500 lx with the least power.

    python examples/luminaires.py [folder]

prints the power before and after, and writes luminaires.png: for each luminaire, dimmed to half of what the desks need,
how much a lumen more would help in each direction of the lower hemisphere (the adjoint map).

The loss is the power and a penalty for each patch of a desk with less than 500 lx. Its gradient by all 24 variables
takes one solution and one adjoint solution of the radiosity system [Lipp 2024]; L-BFGS-B of SciPy does the rest.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from etendue.display import tonemap, write_png
from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, Patches, RayScene, box, gradient, joined, point_views, solve

SIZE = (8.0, 5.0, 2.8)
DESKS = [((x, y, 0.7), (x + 1.4, y + 0.8, 0.74)) for x in (0.5, 3.0, 5.8) for y in (0.6, 3.4)]
LAMPS = np.array([(x, y, 2.7) for x in (1.0, 3.0, 5.0, 7.0) for y in (1.25, 3.75)])
TARGET = 500.0  # lx
EFFICACY = 100.0  # lm/W
EXPONENT = 6.0  # of the lobes cos^n
PENALTY = 0.05  # watts for one lux that a desk lacks, squared


def office() -> Patches:
    """Six desks in a room. Floor, walls, ceiling and desks reflect 0.2, 0.5, 0.7 and 0.4."""
    patches = Patches(
        *joined(box((0, 0, 0), SIZE, (10, 6, 4), inward=True), *(box(*desk, (4, 2, 1)) for desk in DESKS))
    )
    up, height = patches.normals[:, 2], patches.centres[:, 2]
    known = [height > SIZE[2] - 0.01, (height < 0.01) & (up > 0.5), (height > 0.69) & (height < 0.75)]
    return patches.with_properties(np.select(known, [0.7, 0.2, 0.4], 0.5))


class Lighting:
    """The office with its lamps, as a loss of (8, 3) variables: lumens / 1000, and slopes of the axis in x and y."""

    def __init__(self, bundles: int, size: tuple[int, int], seed: int) -> None:
        self.patches = office()
        self.lines = ABuffer(self.patches, OwenSobol(4, seed=seed), lines=1000).cast(bundles)
        self.views = point_views(RayScene(self.patches), LAMPS, size, seed=seed)
        tops = (np.abs(self.patches.centres[:, 2] - 0.74) < 1e-6) & (self.patches.normals[:, 2] > 0.5)
        self.tops = np.flatnonzero(tops)

    def lobes(self, slopes: Any) -> tuple[Any, Any]:
        """(8, rows, columns) intensities of one lumen, and (8, rows, columns, 2) their derivatives by the slopes."""
        axis = np.concatenate([slopes, -np.ones((8, 1))], axis=1)
        length = np.linalg.norm(axis, axis=1)[:, None]
        axis /= length
        ways = self.views.directions
        cosine = np.maximum(np.einsum("rcx,kx->krc", ways, axis), 0)
        scale = (EXPONENT + 1) / (2 * np.pi)
        lobe = scale * cosine**EXPONENT
        # d(axis)/d(slopes) = (1 - axis axis) / length, in the two columns.
        turn = (np.eye(3) - axis[:, :, None] * axis[:, None])[:, :, :2] / length[:, :, None]
        by_slope = np.einsum("rcx,kxs->krcs", ways, turn) * (EXPONENT * scale * cosine ** (EXPONENT - 1))[..., None]
        return lobe, by_slope

    def illuminance(self, x: Any) -> Any:
        """The solution for these variables."""
        x = x.reshape(8, 3)
        intensity = 1000 * x[:, 0, None, None] * self.lobes(x[:, 1:])[0]
        return solve(self.patches, self.lines, "conjugate-gradient", shot=self.views.shot(intensity), tolerance=1e-9)

    def loss(self, x: Any) -> tuple[float, Any, Any]:
        """Watts, its gradient (24,), and the adjoint map of the lamps."""
        solution = self.illuminance(x)
        lacking = np.maximum(TARGET - solution.irradiance[self.tops], 0)
        share = PENALTY / len(self.tops)
        by_irradiance = np.zeros_like(solution.irradiance)
        by_irradiance[self.tops] = -2 * share * lacking
        adjoint = self.views.adjoint_map(gradient(solution, self.lines, dirradiance=by_irradiance))[..., 0]
        x = x.reshape(8, 3)
        lobe, by_slope = self.lobes(x[:, 1:])
        by_intensity = adjoint * self.views.solid_angles
        by_x = np.empty((8, 3))
        by_x[:, 0] = 1000 / EFFICACY + 1000 * np.einsum("krc,krc->k", by_intensity, lobe)
        by_x[:, 1:] = 1000 * x[:, :1] * np.einsum("krc,krcs->ks", by_intensity, by_slope)
        return float(1000 * x[:, 0].sum() / EFFICACY + share * (lacking**2).sum()), by_x.ravel(), adjoint

    def least(self, x: Any) -> float:
        """Illuminance of the darkest patch of a desk."""
        return float(self.illuminance(x).irradiance[self.tops].min())


def run(bundles: int = 128, size: tuple[int, int] = (90, 180), iterations: int = 300) -> dict[str, Any]:
    """Variables, watts and least lux before and after, and the adjoint map of half of the light.

    Both are dimmed together to 500 lx on the darkest patch, as measured with other lines and more rays than those that
    were optimised with.
    """
    lighting = Lighting(bundles, size, seed=1)
    meter = Lighting(2 * bundles, (2 * size[0], 2 * size[1]), seed=2)
    start = np.tile([1.0, 0.0, 0.0], (8, 1))
    start[:, 0] *= TARGET / meter.least(start)
    result = minimize(
        lambda x: lighting.loss(x)[:2],
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.05, 50.0), (-2.0, 2.0), (-2.0, 2.0)] * 8,
        options={"maxiter": iterations, "ftol": 1e-6},
    )
    end = result.x.reshape(8, 3).copy()
    end[:, 0] *= TARGET / meter.least(end)
    return {
        "lighting": lighting,
        "variables": (start, end),
        "watts": [1000 * float(x[:, 0].sum()) / EFFICACY for x in (start, end)],
        "least": [meter.least(x) for x in (start, end)],
        "solutions": result.nfev,
        "message": result.message,
        "map": lighting.loss((start * [0.5, 1, 1]).ravel())[2],
    }


def main(folder: Path) -> None:
    """Run, write the picture, print the results."""
    found = run()
    print(f"{found['solutions']} solutions and as many adjoint solutions; {found['message']}")
    for name, *values in zip(("before", "after"), found["variables"], found["watts"], found["least"], strict=True):
        x, watts, least = values
        print(f"{name}: {watts:.0f} W for {least:.0f} lx or more on every desk")
        print("   lumens " + " ".join(f"{1000 * v:5.0f}" for v in x[:, 0]))
        print("   tilt   " + " ".join(f"{np.degrees(np.arctan(np.hypot(*v))):4.0f}°" for v in x[:, 1:]))
    # Lamps as on the plan, x to the right; of each the lower hemisphere, horizon above.
    gain = -found["map"][:, found["map"].shape[1] // 2 :]
    _, rows, columns = gain.shape
    plan = gain.reshape(4, 2, rows, columns)[:, ::-1].transpose(1, 2, 0, 3).reshape(2 * rows, 4 * columns)
    write_png(folder / "luminaires.png", tonemap(np.repeat(plan[..., None], 3, axis=2), -np.log2(gain.max())))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())
