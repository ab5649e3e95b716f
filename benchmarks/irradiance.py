"""Irradiance caching beside ``path`` at the same number of paths a pixel: error and CPU time."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from etendue import film, render
from etendue.core import Result

from .measuring import Record, timed
from .options import Seeds, Size, whole_numbers
from .racing import Entrant

_ENTRANTS = (
    Entrant("irradiance_cache", "irradiance_cache"),
    Entrant("irradiance_cache, rays=2352, accuracy=0.1", "irradiance_cache", {"rays": 2352, "accuracy": 0.1}),
    Entrant("path", "path"),
)
#: Seed of the reference, and that of the pictures that compile the kernels.
_REFERENCE_SEED, _WARM_UP_SEED = 7001, 1 << 20


def measure(
    source: Annotated[str, typer.Option("--scene", help="A test scene, or a file.", metavar="NAME")] = "cornell-box",
    size: Size = "192x192",
    samples: Annotated[Any, typer.Option(parser=whole_numbers, metavar="N,...")] = "4,16,64",
    seeds: Seeds = 3,
    reference: Annotated[int, typer.Option(min=1, help="Samples of the reference.")] = 8192,
) -> Record:
    """A row for each method and number of paths a pixel; the methods take turns."""
    record = Record(
        f"Irradiance caching, {source}, {size[0]}x{size[1]}",
        ("", "paths a pixel", "relMSE", "CPU s", "error times CPU s, to path"),
    )
    truth = render(source, "path", spp=reference, size=size, seed=_REFERENCE_SEED).image
    outcomes: dict[tuple[str, int], list[tuple[float, float]]] = {}

    def picture(entrant: Entrant, count: int, seed: int) -> tuple[float, float]:
        """Its relMSE, and the CPU seconds that it took."""
        made: list[Result] = []
        clock = timed(
            lambda: made.append(render(source, entrant.method, spp=count, size=size, seed=seed, **entrant.settings))
        )
        return film.relative_mse(made[0].image, truth), clock.cpu

    for entrant in _ENTRANTS:
        picture(entrant, min(samples), _WARM_UP_SEED)
    for seed in range(seeds):
        for count in samples:
            for entrant in _ENTRANTS:
                outcomes.setdefault((entrant.label, count), []).append(picture(entrant, count, seed))
    for entrant in _ENTRANTS:
        for count in samples:
            of_path = np.prod(np.mean(outcomes["path", count], axis=0))
            errors, seconds = np.transpose(outcomes[entrant.label, count])
            scatter = f" ± {errors.std(ddof=1) / seeds**0.5:.1g}" if seeds > 1 else ""
            product = errors.mean() * seconds.mean() / of_path
            record.add(
                entrant.label, str(count), f"{errors.mean():.2g}{scatter}", f"{seconds.mean():.2f}", f"{product:.2f}"
            )
    record.notes.append(
        f"means of {seeds} seeds, ± standard error; kernels are compiled before; reference: path, {reference} samples"
    )
    return record
