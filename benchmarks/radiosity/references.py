"""What errors are measured against: radiosities and form factors by many more lines, in two halves that tell their own
error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from etendue.core import Array
from etendue.points import OwenSobol
from etendue.radiosity import ABuffer, FormFactors, Patches, RayScene, first_shot, form_factors, pair_errors, solve

from .scenes import SCENES

#: Rays at once.
_BLOCK = 1 << 19
#: Half of a reference of form factors: runs of so many bundles of so many lines.
_RUNS, _BUNDLES, _LINES = 4, 1024, 4096.0


@dataclass(frozen=True)
class Reference:
    """Radiosities (n, c): all light, and the light after one reflection at most; and the mean squared error of each."""

    radiosity: Array
    direct: Array
    noise: float
    direct_noise: float


def mean_squared_error(patches: Patches, found: Array, exact: Array) -> float:
    """sum A_i (B_i - exact_i)^2 / sum A_i, mean of the channels [Castro 2002, sec. 3.3]."""
    return float((patches.areas[:, None] * (found - exact) ** 2).sum() / patches.areas.sum() / found.shape[1])


def reference(scene: RayScene, rays: int, bundles: int) -> Reference:
    """The light of the lamp by ``rays`` rays, its reflections by the system of ``bundles`` bundles of lines, twice.

    As the first reflection is known to the accuracy of rays from the lamp, lines only spread what is left.
    """
    patches = scene.patches
    halves = [_half(scene, rays, bundles, seed) for seed in range(2)]
    full, direct = ([half[kind] for half in halves] for kind in range(2))
    noise, direct_noise = (mean_squared_error(patches, *pair) / 4 for pair in (full, direct))
    return Reference(np.mean(full, axis=0), np.mean(direct, axis=0), noise, direct_noise)


def _half(scene: RayScene, rays: int, bundles: int, seed: int) -> tuple[Array, Array]:
    patches, points = scene.patches, OwenSobol(4, seed=1000 + seed)
    size = min(rays, _BLOCK)
    starts = range(0, rays - size + 1, size)
    reflected = sum(first_shot(scene, points.block(size, start)).reflected for start in starts) / len(starts)
    first = reflected / patches.areas[:, None]
    segments = ABuffer(patches, OwenSobol(4, seed=2000 + seed)).cast(bundles)
    later = solve(patches.with_properties(emission=first), segments, "conjugate-gradient", tolerance=1e-8)
    return patches.emission + later.radiosity, patches.emission + first


def opened(name: str, detail: float, rays: int, bundles: int) -> tuple[RayScene, Reference]:
    """A scene by its name, and its reference."""
    scene = RayScene(SCENES[name](detail))
    return scene, reference(scene, rays, bundles)


def factor_reference(patches: Patches, bundles: int = _BUNDLES) -> tuple[FormFactors, float]:
    """Form factors, and the sum of their squared errors."""
    halves = [_factors(patches, bundles, seed) for seed in range(2)]
    mean = replace(halves[0], matrix=(halves[0].matrix + halves[1].matrix) / 2)
    return mean, pair_errors(halves[0], halves[1]) / 4


def _factors(patches: Patches, bundles: int, half: int) -> FormFactors:
    runs = [
        form_factors(ABuffer(patches, OwenSobol(4, seed=3000 + _RUNS * half + run), _LINES).cast(bundles), "reciprocal")
        for run in range(_RUNS)
    ]
    return replace(runs[0], matrix=sum((run.matrix for run in runs[1:]), start=runs[0].matrix) / _RUNS)
