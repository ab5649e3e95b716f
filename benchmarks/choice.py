"""Whether ``auto`` chooses well: its error after a given time beside that of each candidate rendered by itself."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from typing import Any

import numpy as np

from etendue import film
from etendue.api import render
from etendue.core import RELATIVE_EPSILON
from etendue.methods.auto import CANDIDATES
from etendue.scene import bundled

from .measuring import PUBLIC_SCENES, Record, console, verdict

#: ``auto`` may need this many times the error of the best single choice.
BAR = 1.2
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.001
#: Of the reference: each of its two halves takes this many times the time of a picture.
_HALF = 2.0
PUBLIC = ("veach-bidir", "water-caustic", "cornell-box")


def sources() -> dict[str, Any]:
    """Every test scene by name: the bundled ones and the public ones that are at hand."""
    found: dict[str, Any] = {name: name for name in bundled()}
    for name in PUBLIC:
        path = PUBLIC_SCENES / name / "scene.xml"
        if path.is_file():
            found[f"{name} (public)" if name in found else name] = path
    return found


def measure(names: Sequence[str], pixels: int, seconds: float, seeds: int) -> Record:
    """One row a scene; the candidates and ``auto`` take turns, seed by seed."""
    known = sources()
    record = Record(
        f"Choice of auto, about {pixels} pixels, {seconds:g} s",
        ("", *CANDIDATES, "auto", "chosen", "auto / best", "bar"),
    )
    worst = 0.0
    for name in names or known:
        if name not in known:
            raise SystemExit(f"no test scene '{name}'; there are {', '.join(known)}")
        size = scaled_size(known[name], pixels)
        halves = [
            render(known[name], "vcm", seconds=_HALF * seconds, size=size, seed=1000 + half, radius=0.002).image
            for half in range(2)
        ]
        errors: dict[str, list[float]] = {choice: [] for choice in (*CANDIDATES, "probe")}
        chosen = []
        for seed in range(seeds):
            for choice, values in errors.items():
                gc.collect()  # a scene that is still alive makes the next one's kernels larger
                rendering = render(known[name], "auto", seconds=seconds, size=size, seed=seed, choice=choice)
                values.append(_error(rendering.image, halves))
                if choice == "probe":
                    chosen.append(str(rendering.metadata["chosen"]))
        middle = {choice: float(np.median(values)) for choice, values in errors.items()}
        ratio = middle["probe"] / min(middle[choice] for choice in CANDIDATES)
        worst = max(worst, ratio)
        console.print(
            f"{name}: {', '.join(f'{k} {v:.3g}' for k, v in middle.items())}; {', '.join(chosen)}", style="dim"
        )
        cells = [f"{value:.3g}" for value in middle.values()]
        record.add(name, *cells, ", ".join(dict.fromkeys(chosen)), f"{ratio:.2f}", verdict(ratio, BAR))
    record.notes += [
        f"error: mean of (x - ref)² / (ref² + {RELATIVE_EPSILON:g}) without the worst 0.1 % of pixels, less that of "
        f"the reference; median of {seeds} seed{'s' if seeds > 1 else ''}; the time of auto holds its probe",
        f"reference: vcm with a first radius of 0.002, {2 * _HALF * seconds:g} s in two halves, whose difference tells "
        "its error",
        f"worst ratio {worst:.2f}",
    ]
    return record


def scaled_size(source: Any, pixels: int) -> tuple[int, int]:
    """A size of about so many pixels, of the shape of the scene's own."""
    from etendue import scene

    width, height = scene.load(source).size
    scale = min(1.0, (pixels / (width * height)) ** 0.5)
    return max(1, round(width * scale)), max(1, round(height * scale))


def _error(image: np.ndarray, halves: Sequence[np.ndarray]) -> float:
    """Error against the mean of the halves, less that of the mean itself, which is a quarter of their difference's."""
    mean = (halves[0] + halves[1]) / 2
    own = film.relative_mse(halves[0], mean, trim=_TRIM)  # of half of the difference
    return max(film.relative_mse(image, mean, trim=_TRIM) - own, 0.0)
