"""Whether emission or connections that learn, all techniques for direct light, or fewer photons from diffuse surfaces,
pay: error times CPU time of ``bpt`` and ``vcm`` with it beside the same without."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from etendue import methods, scene
from etendue.core import RELATIVE_EPSILON, Measurement, Replica

from .choice import scaled_size, sources
from .measuring import Record, console
from .options import Methods, Names, Pixels, Seconds, Seeds

SCENES = "street,flat,cornell-box,ajar,stage,skylight,grey-white-room"
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.002
#: Seed of the run that compiles.
_WARM_UP = 1 << 20


@dataclass
class _Run:
    """A method that renders with one seed."""

    replica: Replica
    seconds: float = 0.0
    total: Measurement | None = None

    def step(self) -> None:
        """One pass."""
        begin = time.process_time()
        done = 0 if self.total is None else len(self.total.iterations)
        made = self.replica.step(done)
        self.seconds += time.process_time() - begin
        self.total = made if self.total is None else self.total + made

    def picture(self) -> NDArray[np.float64]:
        """The mean so far."""
        assert self.total is not None
        return self.replica.develop(self.total).image.astype(np.float64)


def measure(
    names: Names = SCENES,
    kinds: Methods = "bpt,vcm",
    what: Annotated[str, typer.Option(help="What is switched: emission, connections, direct or photons.")] = "emission",
    on: Annotated[str, typer.Option(help="The value of guide_emission that is compared with off.")] = "on",
    pixels: Pixels = 27648,
    seconds: Seconds = 30.0,
    seeds: Seeds = 5,
) -> Iterator[Record]:
    """One table; a row a scene and method. Runs take turns, pass by pass, by the CPU time they have used."""
    switches: dict[str, tuple[str, dict[str, Any]]] = {
        "emission": ("guide_emission", {"off": "off", "on": on}),
        "connections": ("guide_connections", {"off": False, "on": True}),
        "direct": ("direct_light", {"off": "next_event", "on": "all"}),
        "photons": ("diffuse_photons", {"off": 1.0, "on": 0.1}),
    }
    if what not in switches:
        raise SystemExit(f"--what {what}: give {', '.join(switches)}")
    setting, values = switches[what]
    record = Record(
        f"{setting}={values['on']} beside {values['off']}, about {pixels} pixels, {seconds:g} s of CPU time, "
        f"{seeds} seeds",
        ("", "method", "relMSE off", "relMSE on", "ms a pass off, on", "error x time, on / off", "brightness"),
    )
    known = sources()
    for name in names:
        problem = scene.load(known[name], size=scaled_size(known[name], pixels))
        for kind in kinds:
            runs = {key: _prepared(problem, kind, {setting: value}, seeds) for key, value in values.items()}
            while going := [run for group in runs.values() for run in group if run.seconds < seconds]:
                min(going, key=lambda run: run.seconds).step()
            record.add(name, kind, *_row(runs))
            console.print(*record.rows[-1], style="dim")
            del runs
            gc.collect()  # a scene that is still alive makes the next one's kernels larger
    record.notes += [
        "error: the mean over pixels of the variance between seeds over the squared brightness (the median of all "
        f"runs, plus {RELATIVE_EPSILON:g}), without the worst {_TRIM:.1%} of the pixels; without a reference, so the "
        "blur of merging, which both have, does not count",
        "ratio: of all seeds, and with one seed left out (smallest and largest)",
        "one process, pass by pass in turn, CPU time of all threads; a first pass with another seed compiles",
    ]
    yield record


def _prepared(problem: Any, kind: str, settings: dict[str, Any], seeds: int) -> list[_Run]:
    cls = methods.get(kind)
    runs = []
    for seed in (_WARM_UP, *range(seeds)):
        method = cls(cls.Settings.from_mapping({"max_depth": problem.max_depth, **settings}))
        method.prepare(problem, seed)
        runs.append(_Run(Replica(method, seed)))
    runs[0].step()
    return runs[1:]


def _row(runs: dict[str, list[_Run]]) -> Sequence[str]:
    pictures = {value: np.stack([run.picture() for run in group]) for value, group in runs.items()}
    level = np.median(np.concatenate(list(pictures.values())), axis=0)
    taken = {value: statistics.mean(run.seconds for run in group) for value, group in runs.items()}
    passes = {
        value: statistics.mean(len(run.total.iterations) for run in group if run.total) for value, group in runs.items()
    }

    def error(value: str, kept: Sequence[int]) -> float:
        variance = pictures[value][list(kept)].var(axis=0, ddof=1) / (level**2 + RELATIVE_EPSILON)
        pixels = np.sort(variance.mean(-1).ravel())
        return float(pixels[: int((1.0 - _TRIM) * len(pixels))].mean())

    count = len(pictures["on"])
    every = list(range(count))
    sets = [every] + [[i for i in every if i != left] for left in every] if count > 2 else [every]
    ratios = [error("on", kept) * taken["on"] / (error("off", kept) * taken["off"]) for kept in sets]
    bias = pictures["on"].mean() / pictures["off"].mean() - 1.0
    return (
        f"{error('off', every):.4g}",
        f"{error('on', every):.4g}",
        ", ".join(f"{1e3 * taken[value] / passes[value]:.0f}" for value in ("off", "on")),
        f"{ratios[0]:.2f} ({min(ratios):.2f} … {max(ratios):.2f})",
        f"{bias:+.2%}",
    )
