"""Sun and sky through windows: error beside that of Mitsuba's ``path`` after equal times, with and without openings."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Iterator
from typing import Any

from etendue import film, scene

from .guided import referenced, timed
from .measuring import Record, console, verdict
from .mitsuba_pictures import picture
from .options import Names, Seconds, Seeds, Size

#: Error of ``auto``, relative to Mitsuba's ``path``, at most.
BAR = 0.1
SCENES = "shutters"
_MITSUBA, _PART, _TRIM = "Mitsuba path", 0.5, 0.001
#: Rows: method and settings.
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    _MITSUBA: ("", {}),
    "path": ("path", {}),
    "guided": ("guided", {}),
    "bpt, openings=false": ("bpt", {"openings": False}),
    "vcm, openings=false": ("vcm", {"openings": False}),
    "bpt": ("bpt", {}),
    "vcm": ("vcm", {}),
    "auto": ("auto", {}),
}


def measure(
    names: Names = SCENES, size: Size = "256x192", seconds: Seconds = 30.0, seeds: Seeds = 3
) -> Iterator[Record]:
    """One table a scene; the rows take turns, seed by seed."""
    for name in names:
        case, own = referenced(name, size, seconds, by="bpt")
        if case is None:
            continue
        errors: dict[str, list[float]] = {row: [] for row in ROWS}
        spp, bias = ({row: [] for row in ROWS} for _ in range(2))
        for seed in range(seeds):
            for row, (method, settings) in ROWS.items():
                gc.collect()  # a scene that is still alive makes the next one's kernels larger
                image, samples, taken = (
                    timed(case, method, seconds, seed, settings)
                    if method
                    else picture(scene.load(case.source, size=case.size), seed, seconds=seconds, part_seconds=_PART)
                )
                error = max(film.relative_mse(image, case.reference, trim=_TRIM) - own, 0.0)
                errors[row].append(error * taken / seconds)
                spp[row].append(samples)
                bias[row].append(film.relative_bias(image, case.reference))
                console.print(f"{name}, {row}, seed {seed}: {error:.4g} after {taken:.1f} s", style="dim")
        record = Record(
            f"Windows, {name}, {case.size[0]}x{case.size[1]}, {seconds:g} s",
            ("", "relMSE", "to Mitsuba's path", "of the seeds", "brightness", "spp", "bar"),
        )
        for row, values in errors.items():
            ratios = [a / b for a, b in zip(values, errors[_MITSUBA], strict=True)]
            record.add(
                row,
                f"{statistics.median(values):.4g}",
                f"{statistics.median(ratios):.2g}",
                f"{min(ratios):.2g} to {max(ratios):.2g}",
                f"{statistics.median(bias[row]):+.2%}",
                f"{statistics.median(spp[row]):.0f}",
                verdict(statistics.median(ratios), BAR) if row == "auto" else "",
            )
        record.notes += [
            f"reference: {case.note}",
            f"relMSE without the worst 0.1 % of the pixels, less that of the reference, times the time over "
            f"{seconds:g} s; median of {seeds} seeds, ratios seed by seed; the time begins when the scene is loaded, "
            "preparation and compilation included",
        ]
        yield record
