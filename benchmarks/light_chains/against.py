"""Independent light paths against Metropolis particles (E2; figures 6.10 to 6.14 of the thesis)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer

from etendue.methods import MetropolisParticles, ParticleTracing

from ..measuring import Record
from ..options import Seeds, scene_names
from .fluxes import Cells, Tally, reference, rms
from .scenes import CELLS, SCENES, WITHOUT_BSDF, open_scene

E2 = "cornell,cornell-specular,ring,glossy-office,glossy-office-sampled"
Scenes = scene_names(SCENES)
Millions = Annotated[float, typer.Option(min=0.01, help="Particles of the longest run, in millions.")]
ReferenceMillions = Annotated[float, typer.Option(min=0.1, help="Particles of the reference, in millions.")]
#: Numbers of passes of a run at which errors are taken; a pass has a sixteenth of its particles.
_AT = (1, 4, 16)


def entrants(name: str, steps: int) -> dict[str, tuple[type[Any], dict[str, Any]]]:
    """By label: class and settings without the size of a pass."""
    common = {"bsdf_sampling": name not in WITHOUT_BSDF, "specular": True}
    chains = {"chains": 1024, "steps": max(8, steps // 1024), "max_bounces": 32, **common}
    return {
        "standard": (ParticleTracing, {"sampler": "independent", **common}),
        "standard, even": (ParticleTracing, {"sampler": "owen", **common}),
        "Metropolis, steps of 0.1": (MetropolisParticles, {"step_size": 0.1, "anew": 0.0, **chains}),
        "Metropolis, a tenth anew": (MetropolisParticles, {"step_size": 0.1, "anew": 0.1, **chains}),
    }


def measure(
    scenes: Scenes = E2, millions: Millions = 4.0, reference_millions: ReferenceMillions = 100.0, seeds: Seeds = 3
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _scene(name, millions, reference_millions, seeds)


def _scene(name: str, millions: float, reference_millions: float, seeds: int) -> Record:
    problem = open_scene(name)
    cells = Cells(problem, CELLS[name])
    expected = reference(problem, cells, 1e6 * reference_millions, specular=True)  # directions by the materials
    each = round(1e6 * millions / _AT[-1])
    record = Record(
        f"Standard and Metropolis particles, {name}, {cells.count} cells",
        (
            "",
            *(f"RMS at {1e-6 * each * at:.2g}M" for at in _AT),
            "to standard",
            "CPU s",
            "rays a particle",
            "at equal CPU",
        ),
    )
    found: dict[str, list[list[float]]] = {}
    work: dict[str, list[tuple[float, float]]] = {}
    for seed in range(1, seeds + 1):
        for label, (kind, settings) in entrants(name, each).items():
            tally = Tally(kind, problem, cells, seed, **settings, **_pass(kind, problem, settings, each))
            found.setdefault(label, []).append([rms(tally.run(at), expected) for at in _AT])
            work.setdefault(label, []).append((tally.cpu, tally.rays / tally.particles))
    plain = np.array(found["standard"])
    for label, errors in found.items():
        values, (cpu, rays) = np.array(errors), np.mean(work[label], axis=0)
        ratio = values[:, -1] / plain[:, -1]
        # Variance times time, as a ratio of errors after the same time.
        equal = ratio * np.sqrt(cpu / np.mean(work["standard"], axis=0)[0])
        spread = ratio.std(ddof=1) / np.sqrt(len(ratio)) if len(ratio) > 1 else float("nan")
        record.add(
            label,
            *(f"{np.sqrt(np.mean(column**2)):.4f}" for column in values.T),
            f"{ratio.mean():.3f} ± {spread:.3f}",
            f"{cpu:.1f}",
            f"{rays:.2f}",
            f"{equal.mean():.2f}",
        )
    record.notes += [
        f"RMS of the flux of cells relative to its mean, {seeds} seeds; a particle is a hit, or a step of a chain; "
        f"reference: {reference_millions:g} million particles of independent paths",
        "at equal CPU: error relative to that of standard after the same CPU time, if errors fall as one over the root",
        "sampling of the materials removed" if name in WITHOUT_BSDF else "directions sampled by the materials",
    ]
    return record


def _pass(kind: type[Any], problem: Any, settings: dict[str, Any], particles: int) -> dict[str, Any]:
    """The setting that gives a pass so many particles."""
    if kind is MetropolisParticles:
        return {}
    probe = kind(kind.Settings.from_mapping(settings))
    probe.prepare(problem, 0)
    return {"samples_per_pass": probe.paths_for(particles)}
