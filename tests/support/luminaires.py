"""Photometric files, written for the tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Intensity = Callable[[np.ndarray, np.ndarray], np.ndarray]

GAMMA = np.arange(0.0, 181.0, 5.0)
#: Planes in an EULUMDAT file with 24 of them, by symmetry.
STORED = {
    0: np.arange(0.0, 360.0, 15.0),
    1: np.zeros(1),
    2: np.arange(0.0, 181.0, 15.0),
    3: np.arange(-90.0, 91.0, 15.0),
    4: np.arange(0.0, 91.0, 15.0),
}


def values(intensity: Intensity, c: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """(planes, angles) intensities of a function of both angles in radians."""
    return intensity(*np.meshgrid(np.deg2rad(c), np.deg2rad(gamma), indexing="ij"))


def ies(
    intensity: Intensity,
    c: np.ndarray = STORED[1],
    gamma: np.ndarray = GAMMA,
    head: str = "IESNA:LM-63-2002\n[LUMINAIRE] A lamp\n",
    tilt: str = "TILT=NONE\n",
    lamps: str = "1 1000 1",
    shape: str = "1 2 0.3 1.2 0.1",
    ballast: str = "1 1 40",
) -> str:
    """An IES file; ``lamps``: number, lumens and multiplier; ``shape``: type, units and opening."""
    rows = [c, *values(intensity, c, gamma)]
    numbers = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in (gamma, *rows))
    return f"{head}{tilt}{lamps} {len(gamma)} {len(c)} {shape}\n{ballast}\n{numbers}\n"


def eulumdat(
    intensity: Intensity,
    symmetry: int = 1,
    gamma: np.ndarray = GAMMA,
    lamps: Sequence[tuple[float, float, float]] = ((1, 1000.0, 40.0),),
    lorl: str = "0",
    end: str = "\r\n",
) -> str:
    """An EULUMDAT file of a luminaire with an intensity in cd; ``lamps``: number, lumens and watts of each set."""
    lumens = sum(lamp[1] for lamp in lamps)
    rows = values(intensity, STORED[symmetry], gamma) * (1000.0 / lumens if lumens else 1.0)
    lines: list[object] = ["Company", 3, symmetry, 24, 15, len(gamma), 0, "report", "A lamp", "1", "file", "date"]
    lines += [1250, 350, 80, 1200, 300, 100, 0, 0, 0, "", lorl, 1, 0, len(lamps)]
    for number, flux, watts in lamps:
        lines += [number, "LED", flux, "4000", "80", watts]
    lines += [0.5] * 10 + [*STORED[0], *gamma, *(f"{v:.6f}" for v in rows.ravel())]
    return end.join(map(str, lines)) + end


def lambertian(c: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """200 cd downwards."""
    return 200.0 * np.maximum(np.cos(gamma), 0.0)


def lopsided(c: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Light of every direction, most of it towards C = 30 degrees."""
    return 60.0 + 30.0 * np.cos(gamma) + 50.0 * np.sin(gamma) ** 2 * np.cos(c - np.pi / 6)
