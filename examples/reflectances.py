"""The emissivities of an oven's walls, fitted to what a thermal camera measures.

    python examples/reflectances.py

An oven has walls and a workpiece of known temperatures. A camera measures the radiosity of every patch as a
temperature, (B / sigma)^(1/4), with an error of 1 K. It is not that of the patch: grey surfaces reflect, too. The
emissivities of seven surfaces (reflectances are one minus these) are fitted by L-BFGS-B of SciPy: each evaluation takes
one solution of the radiosity system and one adjoint solution, for any number of unknowns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize

from etendue.points import OwenSobol
from etendue.radiosity import STEFAN_BOLTZMANN, ABuffer, Patches, box, gradient, joined, solve, thermal

SURFACES = ("floor", "ceiling", "left", "right", "front", "back", "workpiece")
EMISSIVITIES = np.array([0.75, 0.9, 0.55, 0.6, 0.35, 0.8, 0.45])
TEMPERATURES = np.array([700.0, 1000.0, 800.0, 820.0, 650.0, 850.0, 450.0])  # K
NOISE = 1.0  # K


def oven() -> tuple[Patches, Any]:
    """A workpiece in a closed oven, and the surface (n,) of each patch."""
    patches = Patches(*joined(box((0, 0, 0), (1, 0.8, 0.6), 5, inward=True), box((0.3, 0.3, 0.1), (0.6, 0.5, 0.3), 2)))
    ways = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    surface = (patches.normals @ ways.T).argmax(axis=1)
    surface[6 * 25 :] = 6
    return patches, surface


def seen(solution: Any) -> Any:
    """(n,) the temperatures that a camera shows."""
    return (solution.radiosity[:, 0] / STEFAN_BOLTZMANN) ** 0.25


def run(bundles: int = 512, seed: int = 0) -> dict[str, Any]:
    """Fitted emissivities, root mean square differences in kelvin before and after, and the number of solutions."""
    patches, surface = oven()
    t = TEMPERATURES[surface]

    def solution(emissivities: Any, lines: Any) -> Any:
        return solve(thermal(patches, t, emissivities[surface]), lines, "conjugate-gradient", tolerance=1e-9)

    # Measured in a world with more lines than those of the fit, and others.
    world = ABuffer(patches, OwenSobol(4, seed=99), lines=2000).cast(4 * bundles)
    noise = NOISE * np.random.default_rng(seed).normal(size=len(patches))
    measured = seen(solution(EMISSIVITIES, world)) + noise
    lines = ABuffer(patches, OwenSobol(4, seed=1), lines=2000).cast(bundles)

    def loss(emissivities: Any) -> tuple[float, Any]:
        found = solution(emissivities, lines)
        off = seen(found) - measured
        # d(seen)/dB = seen / (4 B)
        by_radiosity = 2 * off * seen(found) / (4 * found.radiosity[:, 0]) / len(off)
        by_patch = gradient(found, lines, by_radiosity, temperatures=t).emissivity
        return float((off**2).mean()), np.bincount(surface, by_patch)

    start = np.full(len(SURFACES), 0.6)
    result = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[(0.02, 1.0)] * len(start))
    return {
        "emissivities": result.x,
        "differences": [np.sqrt(loss(x)[0]) for x in (start, result.x)],
        "solutions": result.nfev,
        "message": result.message,
    }


def main() -> None:
    """Run and print the results."""
    found = run()
    before, after = found["differences"]
    print(f"{found['solutions']} solutions and as many adjoint solutions; {found['message']}")
    print(f"difference from the measured temperatures: before {before:.1f} K, after {after:.2f} K (noise {NOISE:g} K)")
    for name, fitted, true in zip(SURFACES, found["emissivities"], EMISSIVITIES, strict=True):
        print(f"   {name:9s} {fitted:.3f}, in truth {true:.3f}")


if __name__ == "__main__":
    main()
