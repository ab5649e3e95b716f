"""Small steps of several sizes in one run, beside those of one tuned size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from numpy.typing import NDArray

from etendue.core import Replica
from etendue.methods.metropolis.chains import Chains
from etendue.methods.metropolis.mmlt import Mmlt
from etendue.methods.metropolis.pssmlt import Pssmlt
from etendue.methods.metropolis.states import PassResult, Progressed
from etendue.methods.metropolis.walk import Walk
from etendue.scene import bundled_scene, load
from etendue.transport import Splats

from ..choice import scaled_size
from ..measuring import Record
from ..options import Names, Pixels, Seeds

Array = NDArray[Any]
#: By label: factors on the tuned size, one of which a small step of all chains takes, in no regular order.
MIXTURES: dict[str, tuple[float, ...]] = {
    "one": (1.0,),
    "1/4, 4": (0.25, 4.0),
    "1/8, 1, 8": (0.125, 1.0, 8.0),
    "1/32, 1": (1 / 32, 1.0),
}
_LARGEST = 1.0


class _MixedWalk(Walk):
    """Chains whose small steps have one of several sizes. Steps of each size are symmetric, so that any order of them
    that is fixed beforehand leaves the target as it is."""

    factors: tuple[float, ...] = (1.0,)

    def step(self, seed: int, is_large: bool) -> None:
        """See :class:`Walk`."""
        size = self.carried.size
        chosen = np.random.default_rng([seed & 0xFFFFFFFF, self.carried.steps]).choice(self.factors)
        self.carried = replace(self.carried, size=min(size * float(chosen), _LARGEST))
        super().step(seed, is_large)
        self.carried = replace(self.carried, size=size)


class _Mixed(Chains):
    """A runner of :class:`_MixedWalk`."""

    factors: tuple[float, ...] = (1.0,)

    def run(self, carried: Progressed, steps: int, seed: int, splats: Splats | None) -> tuple[Progressed, PassResult]:
        """See :class:`Chains`."""
        owed = carried.owed + carried.share * steps
        large = min(int(owed + 1e-9), steps)
        carried = replace(carried, owed=owed - large)
        walk = _MixedWalk(self, carried, splats, large / steps, dr.zeros(mi.Float, self.chains))
        walk.factors = self.factors
        for index in range(steps):
            walk.step(seed, (index + 1) * large // steps > index * large // steps)
        return walk.finish(steps, seed)


class _FixedPssmlt(Pssmlt):
    """Passes of equally many steps."""

    def _plan(self) -> int:
        return self._steps


class _FixedMmlt(Mmlt):
    """Passes of equally many steps."""

    def _plan(self) -> int:
        return self._steps


#: Methods and settings.
METHODS: dict[str, tuple[type[Any], dict[str, Any]]] = {
    "pssmlt": (_FixedPssmlt, {}),
    "mmlt": (_FixedMmlt, {}),
}


def measure(
    scenes: Names = "ajar,gaps",
    pixels: Pixels = 3072,
    passes: Annotated[int, typer.Option(min=1, help="Passes of a run, of 64 steps a pixel.")] = 8,
    seeds: Seeds = 5,
) -> Iterator[Record]:
    """One table a scene: variance between seeds after equally many steps, relative to steps of one size."""
    for name in scenes:
        problem = load(bundled_scene(name), size=scaled_size(name, pixels))
        record = Record(
            f"Small steps of several sizes, {name}, {problem.size[0]}x{problem.size[1]}, {64 * passes} steps a pixel",
            ("method", "sizes", "variance", "tuned size", "accepted", "rays"),
        )
        for method in METHODS:
            first: Array | None = None
            for label, factors in MIXTURES.items():
                runs = [_run(problem, method, factors, seed, passes) for seed in range(seeds)]
                pictures = np.stack([picture for picture, _ in runs])
                first = pictures if first is None else first
                ratio, error = _ratio(pictures, first)
                size, accepted, rays = np.mean([facts for _, facts in runs], axis=0)
                cells = f"{ratio:.2f} ± {error:.2f}", f"{size:.4f}", f"{accepted:.0%}", f"{rays / 1e6:.2f} M"
                record.add(method, label, *cells)
        record.notes.append(
            f"variance of pictures between {seeds} seeds over the squared mean + 0.01, mean of the pixels without the "
            "worst 1 %, over that of the first row; ± by the jackknife; sizes: factors on the tuned one"
        )
        yield record


def _run(
    problem: Any, method: str, factors: tuple[float, ...], seed: int, passes: int
) -> tuple[Array, tuple[float, float, float]]:
    """(picture, (tuned size, share of the small steps that is accepted, rays))."""
    kind, own = METHODS[method]
    made: Any = kind(kind.Settings(**{"max_depth": problem.max_depth, "samples_per_pass": 64} | own))
    made.prepare(problem, seed)
    old = made.runner
    made.runner = _Mixed(old.target, old.size, old.chains, old.bootstrap, old.sampler, old.equalise, old.room)
    made.runner.factors = factors
    replica = Replica(made, seed)
    total = replica.step(0)
    for number in range(1, passes):
        total = total + replica.step(number)
    facts = made.facts(total, replica.state)
    return total.mean("image").reshape(-1, 3), (facts["step_size"], facts["accepted_small"], total.counters["rays"])


def _ratio(pictures: Array, first: Array) -> tuple[float, float]:
    """(variance over that of the first pictures, standard error by the jackknife over seeds)."""
    seeds = np.arange(len(pictures))
    left_out = np.array([_variance(pictures[seeds != k], first[seeds != k]) for k in seeds])
    error = np.sqrt((len(seeds) - 1) * np.mean((left_out - left_out.mean()) ** 2))
    return _variance(pictures, first), float(error)


def _variance(pictures: Array, first: Array) -> float:
    mean = first.mean(axis=0)
    each = [np.sort((p.var(axis=0, ddof=1) / (mean**2 + 0.01)).mean(axis=1)) for p in (pictures, first)]
    kept = [values[: round(0.99 * len(values))].mean() for values in each]
    return float(kept[0] / kept[1])
