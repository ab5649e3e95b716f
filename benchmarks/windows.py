"""Sun and sky through windows: error beside that of Mitsuba's ``path`` after equal times, with and without openings."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from etendue.scene.builtin.shutters import shutters

from .guided import MITSUBA, Rows, race, referenced
from .measuring import Record, verdict
from .options import Names, Seconds, Seeds, Size

#: Error of ``auto``, relative to Mitsuba's ``path``, at most.
BAR = 0.1
SCENES = "shutters"
#: The name of ``shutters`` without its panes and under an even sky, which next event finds.
OPEN = "open-shutters"
ROWS: Rows = {
    MITSUBA: ("", {}),
    "path, openings=false": ("path", {"openings": False}),
    "guided, openings=false": ("guided", {"openings": False}),
    "bpt, openings=false": ("bpt", {"openings": False}),
    "vcm, openings=false": ("vcm", {"openings": False}),
    "path": ("path", {}),
    "guided": ("guided", {}),
    "bpt": ("bpt", {}),
    "vcm": ("vcm", {}),
    "auto": ("auto", {}),
}


def measure(
    names: Names = SCENES, size: Size = "256x192", seconds: Seconds = 30.0, seeds: Seeds = 3
) -> Iterator[Record]:
    """One table a scene; the rows take turns, seed by seed."""
    for name in names:
        source = None
        if name == OPEN:
            source = {key: value for key, value in shutters().items() if "pane" not in key}
            source["sky"] = {"type": "constant", "radiance": 1.0}
        case, own = referenced(name, size, seconds, by="bpt", source=source)
        if case is None:
            continue
        outcomes = race(case, own, ROWS, seconds, seeds)
        plain = outcomes[MITSUBA]
        record = Record(
            f"Windows, {name}, {case.size[0]}x{case.size[1]}, {seconds:g} s",
            ("", "relMSE", "to Mitsuba's path", "of the seeds", "brightness", "spp", "bar"),
        )
        for row, runs in outcomes.items():
            ratio = [run["cost"] / other["cost"] for run, other in zip(runs, plain, strict=True)]
            middle = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            record.add(
                row,
                f"{middle['cost'] / seconds:.4g}",
                f"{statistics.median(ratio):.2g}",
                f"{min(ratio):.2g} to {max(ratio):.2g}",
                f"{middle['bias']:+.2%}",
                f"{middle['samples']:.0f}",
                verdict(statistics.median(ratio), BAR) if (name, row) == (SCENES, "auto") else "",
            )
        record.notes += [
            f"reference: {case.note}",
            f"relMSE without the worst 0.1 % of the pixels, less that of the reference, times the time over "
            f"{seconds:g} s; median of {seeds} seeds, ratios seed by seed; the time begins when the scene is loaded, "
            "preparation and compilation included",
        ]
        yield record
