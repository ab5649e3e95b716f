"""Re-weighting of fireflies: the error of a picture with and without it, on every bundled scene."""

from __future__ import annotations

import numpy as np

from etendue import film, render

from .choice import scaled_size
from .measuring import Record, console
from .options import Methods, Names, Pixels, Seeds
from .tuning import REFERENCES, SCENES

_SAMPLES = 48
#: Samples of a reference, in passes whose radius is small.
_REFERENCE = 2048


def measure(
    names: Names = SCENES, methods: Methods = "path,bpt,vcm", pixels: Pixels = 9216, seeds: Seeds = 3
) -> Record:
    """relMSE with ``reweight`` over that without, of the same samples."""
    record = Record(
        f"Re-weighting of fireflies, {_SAMPLES} samples",
        ("", *(f"{method}: {what}" for method in methods for what in ("without", "with", "brightness"))),
    )
    ratios: list[list[float]] = []
    for name in names:
        size = scaled_size(name, pixels)
        method, settings = REFERENCES.get(name, ("bpt", {}))
        reference = render(name, method, spp=_REFERENCE, size=size, seed=1000, **settings).image
        cells, row = [], []
        for kind in methods:
            plain, calm, light = [], [], []
            for seed in range(seeds):
                images = [
                    render(name, kind, spp=_SAMPLES, size=size, seed=seed, reweight=on).image for on in (False, True)
                ]
                plain.append(film.relative_mse(images[0], reference))
                calm.append(film.relative_mse(images[1], reference))
                light.append(images[1].sum() / images[0].sum() - 1.0)
            row.append(float(np.mean(calm) / np.mean(plain)))
            cells += [f"{np.mean(plain):.4g}", f"{np.mean(calm):.4g}", f"{np.mean(light):+.2%}"]
        ratios.append(row)
        record.add(name, *cells)
        console.print(f"{name}: {row}", style="dim")
    means = np.exp(np.mean(np.log(ratios), 0))
    record.notes += [
        "geometric mean of with over without: "
        + ", ".join(f"{method} {mean:.2f}" for method, mean in zip(methods, means, strict=True)),
        f"mean of {seeds} seeds, without subtracting the noise of the reference ({_REFERENCE} samples)",
    ]
    return record
