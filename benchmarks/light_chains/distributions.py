"""Where particles lie, and how long chains stay at them (E6; figures 5.49, 5.50, 5.55, 5.56 of the thesis)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from etendue.core import Array, Measurement, Replica
from etendue.methods import MetropolisParticles, ParticleTracing
from etendue.scene import Problem

from ..measuring import Record, console
from ..options import Out
from ..plotting import save
from .against import Millions, Scenes
from .scenes import open_scene

SIZES = (0.02, 0.1, 0.5)
#: Longest stays of the columns of the table, in steps.
_COLUMNS = {"1 step": 1, "2": 2, "3 to 5": 5, "6 to 10": 10, "11 to 20": 20}
_CHAINS = 1024
#: Side of the pictures, in pixels, and the most particles that they show.
_SIDE, _SHOWN = 400, 40_000


def measure(
    scenes: Scenes = "cornell-glass,ring", millions: Millions = 1.0, out: Out = Path("distributions-output")
) -> Iterator[Record]:
    """A table of each scene; pictures and plots in ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    for name in scenes:
        problem = open_scene(name)
        yield _repeats(problem, name, millions, out)
        _picture(problem, name, out)


def _run(problem: Problem, kind: type[Any], settings: dict[str, Any]) -> tuple[Any, Measurement]:
    """A method and its first pass."""
    method = kind(kind.Settings.from_mapping({"max_bounces": 32, "specular": True} | settings))
    method.prepare(problem, 1)
    return method, Replica(method, 1).step(0)


def _chains(steps: float, size: float) -> dict[str, Any]:
    return {"chains": _CHAINS, "steps": max(8, round(steps / _CHAINS)), "step_size": size, "anew": 0.0}


def _repeats(problem: Problem, name: str, millions: float, out: Path) -> Record:
    bounds = list(_COLUMNS.values())
    record = Record(
        f"Steps for which chains stay at a particle, {name}, {millions:g} million steps",
        ("step size", "particles", *_COLUMNS, "longer", "longest", "steps in longer stays", "steps in all"),
    )
    curves = {}
    for size in SIZES:
        method, measurement = _run(problem, MetropolisParticles, _chains(1e6 * millions, size))
        repeats = method.repeats(measurement)
        count = len(repeats)
        shares = np.diff([0, *(np.count_nonzero(repeats <= n) for n in bounds), count]) / count
        lengths, particles = np.unique(repeats, return_counts=True)
        curves[f"step size {size:g}"] = [
            (float(n), float(many) / count) for n, many in zip(lengths, particles, strict=True)
        ]
        long = repeats[repeats > bounds[-1]].sum(dtype=np.float64)
        total = repeats.sum(dtype=np.float64)
        lost = measurement.counters["lost_steps"]
        record.add(
            f"{size:g}",
            str(count),
            *(f"{share:.2%}" for share in shares),
            str(repeats.max()),
            f"{long / total:.1%}",
            f"{total:.0f}" + (f" and {lost:.0f} lost" if lost else ""),
        )
    plot = out / f"repeats-{name}.svg"
    save(plot, curves, f"{name}: particles by repeats", "steps at a particle", "share of particles")
    steps = _chains(1e6 * millions, SIZES[0])["steps"]
    record.notes.append(
        f"{_CHAINS} chains of {steps} steps; shares of the particles at which a chain stayed for so many steps; the "
        "thesis: more than 20 are rare"
    )
    return record


def _picture(problem: Problem, name: str, out: Path) -> None:
    """Equally many particles of independent paths and of chains, seen from above, side by side."""
    method, measured = _run(problem, MetropolisParticles, _chains(16 * _SHOWN, 0.1))
    found = method.particles(measured)
    of_chains = np.repeat(found.position, method.repeats(measured), axis=0)
    tracer, measured = _run(problem, ParticleTracing, {"samples_per_pass": 4 * _SHOWN})
    of_paths = tracer.particles(measured).position
    lower, upper = of_paths.min(0), of_paths.max(0)
    random = np.random.default_rng(1)
    count = min(_SHOWN, len(of_paths), len(of_chains))
    panels = [
        _from_above(random.choice(points, count, replace=False), lower, upper) for points in (of_paths, of_chains)
    ]
    gap = np.ones((_SIDE, 8))
    image = (255 * np.concatenate([panels[0], gap, panels[1]], axis=1)).astype(np.uint8)
    path = out / f"particles-{name}.png"
    mi.Bitmap(image[:, :, None]).write(str(path))
    console.print(f"picture: {path}: {count} particles of independent paths, and of chains", style="dim")


def _from_above(points: Array, lower: Array, upper: Array) -> Array:
    """Dark dots on white: x to the right, z downwards, of what lies in the lower fifth."""
    low = points[points[:, 1] < lower[1] + 0.2 * (upper[1] - lower[1])]
    x, z = (np.minimum((low[:, i] - lower[i]) / (upper[i] - lower[i]) * _SIDE, _SIDE - 1).astype(int) for i in (0, 2))
    counts = np.bincount(z * _SIDE + x, minlength=_SIDE**2).reshape(_SIDE, _SIDE)
    return 0.6 ** counts.astype(np.float64)
