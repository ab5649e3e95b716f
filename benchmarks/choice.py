"""Whether ``auto`` chooses well: its error after a given time beside that of each candidate rendered by itself, and the
samples that its learning leaves. Each picture has its own process, as on the command line: in one process, scenes that
were rendered before make kernels anew."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from etendue import film, render
from etendue.core import RELATIVE_EPSILON
from etendue.methods.auto import FIXED
from etendue.scene import bundled
from etendue.scene.builtin import theses

from .measuring import PUBLIC_SCENES, Record, child, console, verdict
from .options import Names, Pixels, Seconds, Seeds

#: ``auto`` may need this many times the error of the best single choice.
BAR = 1.2
#: It must have this share of the samples that its choice makes in the same time.
SAMPLES_BAR = 0.7
#: Seconds of the pictures that fill the kernel cache.
_FILL = 0.1
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.001
#: Of the reference: each of its two halves takes this many times the time of a picture.
_HALF = 2.0
PUBLIC = ("veach-bidir", "water-caustic", "cornell-box", "soda-shoppe", "grey-white-room", "wooden-staircase")
#: Scenes without caustics that matter, whose edges merging would brighten: their reference is by ``path``.
_BY_PATH = ("grey-white-room", "wooden-staircase")
#: Those of the theses would take two hours more.
_ONLY_BY_NAME = {name for name, *_ in theses.SCENES}


def sources() -> dict[str, Any]:
    """Every test scene in RGB by name: the bundled ones and the public ones that are at hand."""
    found: dict[str, Any] = {name: name for name, one in bundled().items() if not one.is_spectral}
    for name in PUBLIC:
        path = PUBLIC_SCENES / name / "scene.xml"
        if path.is_file():
            found[f"{name} (public)" if name in found else name] = path
    return found


def measure(
    names: Names = "",
    pixels: Pixels = 65536,
    seconds: Seconds = 30.0,
    seeds: Seeds = 1,
) -> Record:
    """One row a scene, by default each that is none of the theses'; the candidates and ``auto`` take turns, seed by
    seed."""
    record = Record(
        f"Choice of auto, about {pixels} pixels, {seconds:g} s",
        ("", *FIXED, "auto", "chosen", "auto / best", "bar", "samples / its choice", "bar"),
    )
    worst = 0.0
    for name, source in chosen_sources(names).items():
        size = scaled_size(source, pixels)
        halves = halves_of(name, source, size, _HALF * seconds)
        errors: dict[str, list[float]] = {choice: [] for choice in (*FIXED, "learn")}
        chosen, shares = [], []
        with tempfile.TemporaryDirectory(prefix="kernels-") as folder:
            common = {"variant": mi.variant(), "scene": str(source), "size": size, "method": "auto"}
            for choice in FIXED:  # fills the kernel cache
                picture(common | {"choice": choice, "seconds": _FILL, "seed": 0}, folder)
            for seed in range(seeds):
                samples: dict[str, float] = {}
                for choice, values in errors.items():
                    options = common | {"choice": choice, "seconds": seconds, "seed": seed}
                    image, outcome = picture(options, folder)
                    values.append(error(image, halves))
                    samples[choice] = outcome["samples"]
                chosen.append(str(outcome["chosen"]))
                shares.append(samples["learn"] / samples[chosen[-1]])
        middle = {choice: float(np.median(values)) for choice, values in errors.items()}
        ratio = middle["learn"] / min(middle[choice] for choice in FIXED)
        share = float(np.median(shares))
        worst = max(worst, ratio)
        console.print(
            f"{name}: {', '.join(f'{k} {v:.3g}' for k, v in middle.items())}; {', '.join(chosen)}; {share:.2f}",
            style="dim",
        )
        cells = [f"{value:.3g}" for value in middle.values()]
        enough = f"≥ {SAMPLES_BAR:g}: {'reached' if share >= SAMPLES_BAR else 'missed'}"
        names_of = ", ".join(dict.fromkeys(chosen))
        record.add(name, *cells, names_of, f"{ratio:.2f}", verdict(ratio, BAR), f"{share:.2f}", enough)
    record.notes += [
        f"{error_note(seeds)}; a process each, with a kernel cache that a pass by each candidate has filled; the time "
        "of auto holds the passes that learn",
        reference_note(_HALF * seconds),
        f"worst ratio {worst:.2f}",
    ]
    return record


def chosen_sources(names: Sequence[str]) -> dict[str, Any]:
    """The scenes of the given names, by default each that is none of the theses'."""
    known = sources()
    for name in names:
        if name not in known:
            raise SystemExit(f"no test scene '{name}'; there are {', '.join(known)}")
    return {name: known[name] for name in names or [name for name in known if name not in _ONLY_BY_NAME]}


def error_note(seeds: int) -> str:
    """What :func:`error` is."""
    return (
        f"error: mean of (x - ref)² / (ref² + {RELATIVE_EPSILON:g}) without the worst 0.1 % of pixels, less that of "
        f"the reference; median of {seeds} seed{'s' if seeds > 1 else ''}"
    )


def reference_note(seconds: float) -> str:
    """What :func:`halves_of` so many seconds are."""
    return (
        f"reference: vcm with a first radius of 0.002 (path for {', '.join(_BY_PATH)}), {2 * seconds:g} s in two "
        "halves, whose difference tells its error"
    )


def halves_of(name: str, source: Any, size: tuple[int, int], seconds: float) -> list[np.ndarray]:
    """The reference in two halves of so many seconds."""
    method, settings = ("path", {}) if name in _BY_PATH else ("vcm", {"radius": 0.002})
    return [render(source, method, seconds=seconds, size=size, seed=1000 + half, **settings).image for half in range(2)]


def picture(options: dict[str, Any], folder: str) -> tuple[np.ndarray, dict[str, Any]]:
    """A picture by a fresh process with the kernel cache in ``folder``, and what is told of it."""
    out = Path(folder) / "picture.npy"
    outcome = child("picture", options | {"out": str(out)}, {"DRJIT_CACHE_DIR": folder})
    if not outcome:
        raise SystemExit("a picture failed; see above")
    return np.load(out), outcome


def scaled_size(source: Any, pixels: int, larger: bool = False) -> tuple[int, int]:
    """A size of about so many pixels, of the shape of the scene's own; not above that unless ``larger``."""
    from etendue import scene

    width, height = scene.load(source).size
    scale = (pixels / (width * height)) ** 0.5
    if not larger:
        scale = min(1.0, scale)
    return max(1, round(width * scale)), max(1, round(height * scale))


def error(image: np.ndarray, halves: Sequence[np.ndarray]) -> float:
    """Error against the mean of the halves, less that of the mean itself, which is a quarter of their difference's."""
    mean = (halves[0] + halves[1]) / 2
    own = film.relative_mse(halves[0], mean, trim=_TRIM)  # of half of the difference
    return max(film.relative_mse(image, mean, trim=_TRIM) - own, 0.0)
