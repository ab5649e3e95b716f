"""Particles in memory, pass by pass, for the benchmarks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from etendue.methods import ParticleTracing
from etendue.particles import Rows, Surfaces
from etendue.scene import load

Count = Annotated[int, typer.Option("--count", min=1000, help="Particles.")]
Scene = Annotated[str, typer.Option("--scene", help="Mitsuba XML file, or bundled scene.", metavar="SCENE")]


@dataclass
class Traced:
    """Passes of a scene: rows, and the light paths of all."""

    surfaces: Surfaces
    passes: list[Rows]
    paths: int

    @property
    def count(self) -> int:
        """Particles."""
        return sum(map(len, self.passes))


def traced(scene: str, count: int, seed: int, **settings: Any) -> Traced:
    """At least ``count`` particles."""
    tracing = ParticleTracing(ParticleTracing.Settings.from_mapping(settings))  # type: ignore[arg-type]
    tracing.prepare(load(scene), seed)
    per_pass = min(tracing.samples_per_iteration, tracing.paths_for(count))
    tracing.settings = tracing.settings.replace(samples_per_pass=per_pass)
    result = Traced(tracing.surfaces, [], 0)
    while result.count < count:
        made = tracing.step(len(result.passes), seed, {}).measurement
        result.passes += list(made.records["particles"])
        result.paths += per_pass
    return result
