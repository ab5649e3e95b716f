"""What pictures by ``stratified`` would gain from two things that the recursive integrator has and they have not: reuse
of the samples that explore a region, and shares of regions by their cost."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import typer
from numpy.typing import NDArray

from etendue import scene
from etendue.core import IndependentSource, Replica, seed_key
from etendue.integration import Integrand, RecursiveStratified, Regions
from etendue.integration.estimate import Work
from etendue.integration.recursive import _Plan
from etendue.methods.adaptive.dimensions import NumberedSource
from etendue.methods.adaptive.stratified import StratifiedPath
from etendue.methods.base import total
from etendue.scene.builtin import pieces
from etendue.transport import dimensions as dim

from ..measuring import Record
from ..options import Seeds, named

#: Numbers of the host.
Array = NDArray[Any]
PARAMETERS = ("light1", "light1 bounce1")


def _lamps() -> dict[str, Any]:
    """One lamp of nine lights a floor, the others shine above the ceiling. Lengths: metres."""
    floor = pieces.rectangle((-2.0, 0.0, 2.0), (4.0, 0.0, 0.0), (0.0, 0.0, -4.0), pieces.matt(0.5, 0.5, 0.5))
    ceiling = pieces.rectangle((-6.0, 2.3, -6.0), (12.0, 0.0, 0.0), (0.0, 0.0, 12.0), pieces.matt(0.5, 0.5, 0.5))
    model: dict[str, Any] = {
        "type": "scene",
        "sensor": pieces.camera((0.0, 1.2, 3.4), (0.0, 0.4, 0.0), 45.0, rfilter="box"),
        "floor": floor,
        "ceiling": ceiling,
        "ball": {"type": "sphere", "center": [0.0, 0.4, 0.0], "radius": 0.4, "bsdf": pieces.matt(0.6, 0.4, 0.3)},
    }
    for i in range(9):
        corner = (-0.95, 2.2, 0.15) if i == 8 else (0.4 * i - 1.55, 3.5, -0.15)
        black = pieces.matt(0.0, 0.0, 0.0)
        model[f"lamp-{i}"] = pieces.rectangle(corner, (0.3, 0.0, 0.0), (0.0, 0.0, 0.3), black, 30.0, 30.0, 30.0)
    return model


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell-box": scene.bundled_scene("cornell-box").build,
    "cornell-glass": scene.bundled_scene("cornell-glass").build,
    "nine lamps": _lamps,
}


ALL = ",".join(SCENES)


@dataclass(frozen=True)
class _Entrant:
    """A variant of ``stratified``. worth: that of an exploring path to the picture, relative to one of a pass; 0: no
    reuse. costs: whether shares of regions go by the rays of their paths, too."""

    worth: float = 0.0
    costs: bool = False


ENTRANTS = {
    "as it is": _Entrant(),
    "reuse": _Entrant(worth=1.0),
    "reuse, at a quarter": _Entrant(worth=0.25),
    "cost": _Entrant(costs=True),
}


class _Numbers(NumberedSource):
    """Given numbers; only contributions that depend on them count, if ``only``."""

    only = False
    walk: int | None = None

    def weight(self, depth: mi.UInt32, by_light_point: bool) -> mi.Float:
        """See :class:`NumberedSource`."""
        if not self.only:
            return mi.Float(1.0)
        used: mi.Bool | bool = False if self.walk is None else depth > self.walk
        if by_light_point:
            used |= depth == 1
        return dr.select(used, mi.Float(1.0), 0.0)


class _Thinned(Regions):
    """Regions whose paths have a factor less than 1, since the exploration of the regions above counts as well."""

    factors: Array

    def tables(self) -> list[Array]:
        """See :class:`Regions`."""
        p, reached, weight, *rest = super().tables()
        return [p, reached, weight * self.factors, *rest]


class _Exploring(_Plan):
    """A plan that tells the weight in the picture of each point that explores a region."""

    def __init__(self, study: _Study, options: RecursiveStratified, work: Work) -> None:
        super().__init__(options, work)
        self._study = study

    def evaluate(self, level: Any, regions: Array, counts: Array, keep: bool = False) -> Any:
        """See :class:`_Run`."""
        volume = level.volume[regions]
        own, left = self._study.weights(volume)
        self._study.pending = np.repeat(own * left * volume / counts, counts)
        return super().evaluate(level, regions, counts, keep)


class _Study(StratifiedPath):
    """``stratified``, with reuse or with costs. The weights of reuse are constants, not estimated variances as in the
    integrator, so that the picture stays unbiased."""

    entrant = _Entrant()

    def prepare(self, problem: Any, seed: int) -> None:
        """See :class:`StratifiedPath`."""
        super().prepare(problem, seed)
        self.pending: Array = np.empty(0)
        self.plans: list[Array] = []  #: what exploration adds to the pictures of a plan, (pixels, 3)
        self.spent = 0.0  #: rays of exploration

    def weights(self, volume: Array) -> tuple[Array, Array]:
        """(weight of the exploration of a region beside its parts, product of 1 - weight over the regions above).
        A path of exploration counts as ``worth`` paths of the passes that share the plan."""
        o, worth = self.settings, self.entrant.worth
        depth = np.rint(-np.log2(volume)).astype(int)
        left = (1.0 - o.exploration) ** np.arange(64)
        own = worth * o.exploration * left / (worth * left + o.update)
        above = np.concatenate([[1.0], np.cumprod(1.0 - own)])
        return own[depth], above[depth]

    def _plan(self, number: int, seed: int, samples: int) -> Regions:
        (draws,) = self._groups[0].draws
        pixels = self.camera.pixels
        calls, rays = 0, mi.UInt32(0)
        picture = np.zeros((pixels, 3))

        def traced(x: Sequence[mi.Float], only: bool) -> tuple[mi.UInt32, Any]:
            lanes = dr.arange(mi.UInt32, dr.width(x[0]))
            source = _Numbers(IndependentSource(lanes, seed, f"explore {calls}", number), {})
            source.give(draws, x, self.left_by_pick())
            source.only = only
            bounces = [vertex for vertex, component in draws if component == dim.DIRECTION]
            source.walk = min(bounces, default=None)
            u = IndependentSource(lanes, seed, f"explore pixel {calls}", number).next_1d(0, 0)
            pixel = dr.minimum(mi.UInt32(u * pixels), pixels - 1)
            return pixel, self.trace(pixel, source)

        def luminance(x: Sequence[mi.Float]) -> mi.Float:
            nonlocal calls, rays
            calls += 1
            _, state = traced(x, only=False)
            radiance, _ = self.kept(state.radiance)
            value = mi.luminance(radiance)
            rays = state.rays
            dr.eval(value, rays)
            self.spent += total(rays)
            self._explored += total(rays)
            if self.entrant.worth:
                pixel, again = traced(x, only=True)
                colours, at = np.array(self.kept(again.radiance)[0]), np.array(pixel)
                weight, self.pending = np.split(self.pending, [len(at)])
                for channel in range(3):
                    picture[:, channel] += np.bincount(at, colours[channel] * weight * pixels, pixels)
            return value

        cost = (lambda x: mi.Float(rays)) if self.entrant.costs else None
        f = Integrand(luminance, len(draws), on="device", cost=cost)
        plan_seed, _ = seed_key(seed, "plan", number)
        run = _Exploring(self, self._integrator, Work(f, plan_seed))
        run.descend(pixels * samples)
        made = _Thinned(*(np.concatenate(found) for found in zip(*run.regions, strict=True)))
        made.factors = self.weights(np.where(made.volume > 0.0, made.volume, 1.0))[1]
        self.plans.append(picture)
        return made


def measure(
    scenes: Annotated[
        Any, typer.Option("--scene", parser=named(SCENES, "scene"), help="Names, separated by commas.", metavar="NAMES")
    ] = ALL,
    sampler: Annotated[str, typer.Option(help="Random numbers: independent or owen.")] = "independent",
    plans: Annotated[int, typer.Option(min=1, help="Plans of a run, of 8 passes each.")] = 1,
    seeds: Seeds = 8,
) -> Record:
    """Variance between seeds of each variant, relative to ``stratified`` as it is."""
    record = Record(
        f"Reuse and cost of regions in stratified, 64x64, {sampler}",
        ("", "parameters", "", "variance", "brightness", "rays", "variance x CPU", "rays of plans"),
    )
    for name in scenes:
        problem = scene.load(SCENES[name](), size=(64, 64))
        for parameters in PARAMETERS:
            found = {
                label: _pictures(problem, entrant, parameters, sampler, plans, seeds)
                for label, entrant in ENTRANTS.items()
            }
            first = found["as it is"]
            for label, run in found.items():
                ratio, error = _ratio(run.pictures, first.pictures)
                # Reuse costs nothing here: the paths that are traced again only by this benchmark are not counted.
                cpu = f"{ratio * run.cpu / first.cpu:.3f}" if not ENTRANTS[label].worth else ""
                record.add(
                    name,
                    parameters,
                    label,
                    f"{ratio:.3f} ± {error:.3f}",
                    "{:+.2%} ± {:.2%}".format(*_brightness(run.pictures, first.pictures)),
                    f"{run.rays / first.rays:.3f}",
                    cpu,
                    f"{run.planned / run.rays:.3f}",
                )
    record.notes += [
        f"variance: between {seeds} seeds, over the squared mean + 0.01, mean of the pixels; relative to the first "
        "row; ± by the jackknife over seeds",
        "brightness: relative to the first row minus 1, and its standard error over the same seeds",
        "rays of plans: share of the rays that explore; reuse is free: its own time is not counted",
    ]
    return record


@dataclass(frozen=True)
class _Runs:
    """Pictures (seeds, pixels, 3), rays, rays of exploration and CPU seconds of all seeds."""

    pictures: Array
    rays: float
    planned: float
    cpu: float


def _pictures(problem: Any, entrant: _Entrant, parameters: str, sampler: str, plans: int, seeds: int) -> _Runs:
    settings = _Study.Settings(
        **{
            "max_depth": problem.max_depth,
            "parameters": parameters,
            "sampler": sampler,
            "reconstruction": "independent",  # a path contributes to its own pixel only
        }
    )
    pictures, rays, planned, cpu = [], 0.0, 0.0, 0.0
    for seed in range(-1, seeds):  # the first compiles
        method = _Study(settings)
        method.entrant = entrant
        method.prepare(problem, seed + 1)
        prepared: Any = method
        replica, measured = Replica(prepared, seed + 1), None
        start = time.process_time()
        for number in range(plans * method.settings.update):
            step = replica.step(number)
            measured = step if measured is None else measured + step
        if seed < 0:
            continue
        assert measured is not None
        cpu += time.process_time() - start
        rays, planned = rays + measured.counters["rays"], planned + method.spent
        pictures.append(measured.mean("image").reshape(-1, 3) + np.mean(method.plans, axis=0))
    return _Runs(np.stack(pictures), rays, planned, cpu)


def _ratio(pictures: Array, first: Array) -> tuple[float, float]:
    """(variance over that of the first pictures, standard error by the jackknife over seeds)."""
    every = np.arange(len(pictures))
    left_out = np.array([_variance(pictures, first, every != k) for k in every])
    error = np.sqrt((len(every) - 1) * np.mean((left_out - left_out.mean()) ** 2))
    return _variance(pictures, first, every >= 0), float(error)


def _brightness(pictures: Array, first: Array) -> tuple[float, float]:
    """(mean over that of the first pictures minus 1, its standard error)."""
    each = pictures.mean(axis=(1, 2)) / first.mean() - first.mean(axis=(1, 2)) / first.mean()
    return float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each)))


def _variance(pictures: Array, first: Array, used: Array) -> float:
    mean = first[used].mean(axis=0)
    both = [(p[used].var(axis=0, ddof=1) / (mean**2 + 0.01)).mean() for p in (pictures, first)]
    return float(both[0] / both[1])
