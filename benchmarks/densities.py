"""Estimators of ``etendue.density`` in the plane, beside ``scipy.stats.gaussian_kde``: seconds for samples and queries.

Samples and queries are normal and arrive as arrays of NumPy; a time has their way to the device and back in it. scipy's
estimate is a sum over all pairs on one core, whose cost is their number: it is timed on a part of them.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import typer

from etendue.density import BinnedKernel, Estimator, FixedKernel, NearestNeighbours, VariableKernel, silverman

from .measuring import Record, interleaved, spread
from .options import Rounds, WarmUp

#: What scipy is given: samples and queries.
_PART = (20_000, 500)


def measure(
    count: Annotated[int, typer.Option(min=1000, help="Samples, and queries.")] = 1_000_000,
    near: Annotated[int, typer.Option(min=1, max=999, help="Samples within a kernel on average, and k.")] = 50,
    rounds: Rounds = 5,
    warm_up: WarmUp = 1,
) -> Record:
    """``count`` samples and as many queries; ``near`` samples in a kernel of fixed width on average."""
    try:
        from scipy.stats import gaussian_kde
    except ImportError:
        raise SystemExit("density compares with scipy, which is not installed: pip install -e .[dev]") from None

    random = np.random.default_rng(1)
    samples, queries = random.normal(size=(count, 2)), random.normal(size=(count, 2))
    # The mean density where samples are is 1 / (4 pi).
    narrow, wide = 2 * (near / count) ** 0.5, silverman(samples)
    makers: dict[str, Callable[[], Estimator]] = {
        f"FixedKernel, epanechnikov, {near} samples in it": lambda: FixedKernel(samples, narrow, "epanechnikov"),
        f"BinnedKernel, gaussian, h = {wide:.3f}": lambda: BinnedKernel(samples, wide),
        f"NearestNeighbours, k = {near}": lambda: NearestNeighbours(samples, near),
        f"VariableKernel, epanechnikov, k = {near}": lambda: VariableKernel(samples, near, 1.0, "epanechnikov"),
    }
    made: dict[str, Any] = {}

    def build(name: str) -> Callable[[int], None]:
        def task(_: int) -> None:
            made[name] = makers[name]()

        return task

    def ask(name: str) -> Callable[[int], None]:
        def task(_: int) -> None:
            made[f"{name} at"] = made[name](queries)

        return task

    few, some = samples[: _PART[0]], queries[: _PART[1]]

    def scipy(_: int) -> None:
        made["scipy"] = gaussian_kde(few.T, bw_method=wide)(some.T)

    tasks: dict[str, Callable[[int], Any]] = {"scipy": scipy}
    for name in makers:
        tasks |= {f"{name} build": build(name), f"{name} query": ask(name)}
    times = interleaved(tasks, rounds, warm_up)

    part = BinnedKernel(few, wide)(some)
    error = float(np.max(np.abs(part - made["scipy"])) / made["scipy"].max())
    if not error < 0.03:  # scipy's kernel has the covariance of the samples, which is not quite that of the density
        raise SystemExit(f"BinnedKernel and scipy differ by {error:g} of the largest density")

    pairs = [clock.wall / (_PART[0] * _PART[1]) * count * count for clock in times["scipy"]]
    title = f"Density of {count} samples at {count} queries in the plane"
    record = Record(title, ("", "build s", "query s", "scipy is"))
    for name in makers:
        building, asking = ([clock.wall for clock in times[f"{name} {step}"]] for step in ("build", "query"))
        ratio = statistics.median(p / (a + b) for p, a, b in zip(pairs, building, asking, strict=True))
        record.add(name, spread(building), spread(asking), f"{ratio:.0f} times slower")
    record.add("scipy gaussian_kde", "", f"{statistics.median(pairs):.0f}, from a part", "")
    record.notes += [
        f"median of {rounds} rounds in turn after {warm_up} to warm up (min … max)",
        f"scipy: {_PART[0]} samples at {_PART[1]} queries on one core, in proportion to the pairs; it sums a Gaussian "
        "over all of them, whatever the bandwidth",
        f"BinnedKernel and scipy differ by {error:.1g} of the largest density, on that part",
    ]
    return record
