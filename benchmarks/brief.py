"""``auto`` in a few seconds: its error beside those of the methods it chooses from. Each picture has its own process,
with an empty kernel cache: the time includes compiling."""

from __future__ import annotations

import tempfile

import mitsuba as mi
import numpy as np

from .choice import chosen_sources, error, error_note, halves_of, picture, reference_note, scaled_size
from .measuring import Record, console, verdict
from .options import Names, Pixels, Seconds, Seeds

#: Error of ``auto``, relative to the best of the methods, at most.
BAR = 1.15
METHODS = ("path", "bpt", "vcm", "auto")
#: Each half of the reference takes this many times the time of a picture.
_HALF = 3.0


def measure(names: Names = "", pixels: Pixels = 65536, seconds: Seconds = 5.0, seeds: Seeds = 1) -> Record:
    """One row a scene, by default each that is none of the theses'; the methods take turns, seed by seed."""
    record = Record(
        f"auto in {seconds:g} s, cold, about {pixels} pixels", ("", *METHODS, "chosen", "to path", "to the best", "bar")
    )
    ratios = []
    for name, source in chosen_sources(names).items():
        size = scaled_size(source, pixels)
        halves = halves_of(name, source, size, _HALF * seconds)
        errors: dict[str, list[float]] = {method: [] for method in METHODS}
        chosen = []
        for seed in range(seeds):
            for method, values in errors.items():
                options = {"variant": mi.variant(), "scene": str(source), "size": size, "method": method}
                with tempfile.TemporaryDirectory(prefix="kernels-") as folder:
                    image, outcome = picture(options | {"seconds": seconds, "seed": seed}, folder)
                values.append(error(image, halves))
            chosen.append(str(outcome["chosen"]))
        found = {method: float(np.median(values)) for method, values in errors.items()}
        if min(found.values()) <= 0.0:
            record.notes.append(f"{name}: left out, its reference is noisier than its pictures")
            continue
        ratio = found["auto"] / np.array([found["path"], min(found[method] for method in METHODS[:-1])])
        ratios.append(ratio)
        cells = [f"{value:.3g}" for value in found.values()]
        console.print(f"{name}: {', '.join(cells)}; {', '.join(chosen)}", style="dim")
        names_of = ", ".join(dict.fromkeys(chosen))
        record.add(name, *cells, names_of, *(f"{value:.2f}" for value in ratio), verdict(ratio[1], BAR))
    middle = np.median(ratios, axis=0)
    record.add("median", *[""] * (len(METHODS) + 1), *(f"{value:.2f}" for value in middle), "")
    record.notes += [
        f"{error_note(seeds)}; a process each, with an empty kernel cache",
        reference_note(_HALF * seconds),
        "auto reduces fireflies by default, the others do not",
    ]
    return record
