"""Points of ``etendue.points`` on the device beside scipy's ``qmc``: millions of points a second.

A device point is made, its coordinates are added up, and the sum over all points is reduced; none is stored. scipy
fills an array, which is all that it can do; the same array reduced by NumPy is not counted against it.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Annotated, Any

import typer

from etendue.points import point_set

from .measuring import Record, interleaved
from .options import Rounds, WarmUp

#: Millions of 4-D points a second on two cores that issue 4 asks for.
_BARS = {"halton": 350.0, "sobol": 350.0, "owen-sobol": 150.0}
_NAMES = ("halton", "sobol", "owen-sobol", "faure-halton", "weyl", "independent", "halton+shift")


def measure(
    count: Annotated[int, typer.Option(min=1, max=1 << 31, help="Points of a round.")] = 1 << 27,
    dimension: Annotated[int, typer.Option("--dimension", "-d", min=1, max=1024, help="Coordinates of a point.")] = 4,
    rounds: Rounds = 7,
    warm_up: WarmUp = 2,
    scipy_count: int = 1 << 20,
) -> Record:
    """Every sequence in turn, ``count`` points of it a round; scipy's sequences make ``scipy_count``."""
    import drjit as dr
    import mitsuba as mi

    try:
        from scipy.stats import qmc
    except ImportError:
        raise SystemExit("points compares with scipy, which is not installed: pip install -e .[dev]") from None

    means: dict[str, float] = {}

    def ours(name: str) -> Callable[[int], None]:
        points = point_set(name, dimension)

        def reduce(number: int) -> None:
            index = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, number)
            total = mi.Float(0.0)
            for d in range(dimension):
                total = total + points.coordinate(index, d)
            means[name] = float(dr.sum(total, mode="symbolic")[0]) / count

        return reduce

    engines: dict[str, Callable[[], Any]] = {
        "halton": lambda: qmc.Halton(dimension, scramble=False),
        "sobol": lambda: qmc.Sobol(dimension, scramble=False),
        "owen-sobol": lambda: qmc.Sobol(dimension, scramble=True, rng=1),
        "faure-halton": lambda: qmc.Halton(dimension, scramble=True, rng=1),
    }

    def theirs(name: str) -> Callable[[int], None]:
        engine = engines[name]()

        def fill(_: int) -> None:
            engine.reset()
            engine.random(scipy_count)

        return fill

    tasks = {name: ours(name) for name in _NAMES} | {f"scipy {name}": theirs(name) for name in engines}
    times = interleaved(tasks, rounds, warm_up)
    for name, mean in means.items():
        if not abs(mean - dimension / 2) < 1e-3 * dimension + 5 * (dimension / 12 / count) ** 0.5:
            raise SystemExit(f"{name}: the mean of {count} points' sums is {mean:g}, not {dimension / 2:g}")

    record = Record(
        f"{dimension}-D points, {count} of étendue's, {scipy_count} of scipy's",
        ("", "M points/s", "bar", "scipy M points/s", "ratio"),
    )
    for name in _NAMES:
        rate = [count / clock.wall / 1e6 for clock in times[name]]
        middle, bar = statistics.median(rate), _BARS.get(name) if dimension == 4 else None
        verdict = "" if bar is None else f"≥ {bar:g}: {'reached' if middle >= bar else 'missed'}"
        cells = [name, f"{middle:.0f} ({min(rate):.0f} … {max(rate):.0f})", verdict]
        if name in engines:
            scipy = statistics.median(scipy_count / clock.wall / 1e6 for clock in times[f"scipy {name}"])
            cells += [f"{scipy:.1f}", f"{middle / scipy:.0f}"]
        record.add(*cells, *[""] * (5 - len(cells)))
    record.notes += [
        f"median of {rounds} rounds in turn after {warm_up} to warm up (min … max); a {dimension}-D point counts once",
        "étendue: coordinates added up and reduced on the device, not stored; scipy: an array in memory, one core",
        "scipy scrambles Sobol' by a random matrix and a shift, and Halton by random permutations of the digits",
    ]
    return record
