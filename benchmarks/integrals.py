"""``etendue.integration.Vegas`` beside the ``vegas`` package: error at equal evaluations, and evaluations a second.

The integral is the Gaussian in four dimensions of that package's tutorial. Its ``beta=0`` adapts bins only, as ours
does; ``beta=0.75``, its default, also moves samples between strata. Errors are of ten iterations after ten to warm up.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import numpy as np
import typer

from etendue.integration import Integrand, Vegas, library

from .measuring import Record, interleaved, spread, verdict
from .options import Rounds, WarmUp, whole_numbers

_DOMAIN = [(-1.0, 1.0), (0.0, 1.0), (0.0, 1.0), (0.0, 1.0)]
_SCALE = 1013.2118364296088  # the integral is 1 to 13 digits
_ITERATIONS = 10
_ERROR_BAR, _SPEED_BAR = 1.5, 4.0


def gaussian(x: Any) -> Any:
    """The integrand, on arrays of either library."""
    squared = 0.0
    for v in x:
        squared = squared + (v - 0.5) * (v - 0.5)
    return library(x[0]).exp(squared * -100.0) * _SCALE


def _theirs() -> tuple[Any, Callable[[int], Any]]:
    """The package, and what seeds its random numbers."""
    try:
        import gvar
        import vegas
    except ImportError:
        raise SystemExit("integration compares with vegas, which is not installed: pip install -e .[dev]") from None
    return vegas, gvar.ranseed


def measure(
    evaluations: Annotated[
        Any, typer.Option(parser=whole_numbers, help="An iteration's, separated by commas.", metavar="N,...")
    ] = "1000,10000,100000",
    seeds: Annotated[int, typer.Option(min=2, help="Runs whose errors are averaged.")] = 40,
    timed: Annotated[
        int, typer.Option("--speed", min=1000, help="Evaluations of an iteration that is timed.")
    ] = 1_000_000,
    rounds: Rounds = 7,
    warm_up: WarmUp = 2,
) -> Iterator[Record]:
    """Errors, then speeds."""
    yield errors(evaluations, seeds)
    yield speed(timed, rounds, warm_up)


def errors(evaluations: list[int], seeds: int) -> Record:
    """RMS error over ``seeds`` runs of each, for so many ``evaluations`` an iteration."""
    vegas, seeded = _theirs()
    batch = vegas.rbatchintegrand(gaussian)
    f = Integrand(gaussian, _DOMAIN)

    def package(beta: float) -> Callable[[int, int], tuple[float, float, int]]:
        def run(count: int, seed: int) -> tuple[float, float, int]:
            seeded(seed)
            integrator = vegas.Integrator(_DOMAIN)
            integrator(batch, nitn=_ITERATIONS, neval=count, beta=beta)
            result = integrator(batch, nitn=_ITERATIONS, neval=count, beta=beta)
            return float(result.mean) - 1.0, float(result.sdev), int(result.sum_neval)

        return run

    def ours(count: int, seed: int) -> tuple[float, float, int]:
        method = Vegas(iterations=2 * _ITERATIONS, warm_up=_ITERATIONS)
        result = method.integrate(f, 2 * _ITERATIONS * count, seed=seed)
        return result.value - 1.0, result.standard_error, result.samples // 2

    record = Record(
        f"Gaussian in four dimensions, errors of {seeds} seeds",
        ("evaluations an iteration", "", "RMS error", "standard error", "evaluations that count", "to beta=0", "bar"),
    )
    methods = {"vegas beta=0": package(0.0), "vegas beta=0.75": package(0.75), "étendue": ours}
    for count in evaluations:
        reference = 0.0
        for name, run in methods.items():
            found = np.array([run(count, seed + 1) for seed in range(seeds)])
            rms, stated, used = math.sqrt((found[:, 0] ** 2).mean()), found[:, 1].mean(), found[:, 2].mean()
            # Not all take as many as they are given: what an error would be at equal evaluations.
            worth = rms * math.sqrt(used)
            reference = reference or worth
            bar = verdict(worth / reference, _ERROR_BAR) if name == "étendue" else ""
            record.add(str(count), name, f"{rms:.2e}", f"{stated:.2e}", f"{used:.0f}", f"{worth / reference:.2f}", bar)
    record.notes += [
        "RMS error: against the known integral; standard error: what the integrator states, on average",
        "'to beta=0': RMS errors times the root of the evaluations, relative to those of vegas with beta=0",
        f"an RMS error of {seeds} seeds is known to {100 / math.sqrt(2 * seeds):.0f} %",
    ]
    return record


def speed(evaluations: int, rounds: int, warm_up: int) -> Record:
    """Evaluations a second of ten iterations, in turn."""
    vegas, seeded = _theirs()
    batch = vegas.rbatchintegrand(gaussian)
    used: dict[str, int] = {}

    def package(name: str, beta: float) -> Callable[[int], None]:
        def run(number: int) -> None:
            seeded(number + 1)
            result = vegas.Integrator(_DOMAIN)(batch, nitn=_ITERATIONS, neval=evaluations, beta=beta)
            used[name] = int(result.sum_neval)

        return run

    def ours(name: str, on: Any) -> Callable[[int], None]:
        f = Integrand(gaussian, _DOMAIN, on=on)
        method = Vegas(iterations=_ITERATIONS)

        def run(number: int) -> None:
            used[name] = method.integrate(f, _ITERATIONS * evaluations, seed=number).samples

        return run

    base = "vegas beta=0"
    tasks = {base: package(base, 0.0), "vegas beta=0.75": package("vegas beta=0.75", 0.75)}
    tasks |= {f"étendue, {on}": ours(f"étendue, {on}", on) for on in ("device", "host")}
    times = interleaved(tasks, rounds, warm_up)
    rates = {name: [used[name] / clock.wall / 1e6 for clock in clocks] for name, clocks in times.items()}
    record = Record(
        f"Gaussian in four dimensions, ten iterations of {evaluations} evaluations",
        ("", "M evaluations/s", "to beta=0", "bar"),
    )
    for name, rate in rates.items():
        ratio = [a / b for a, b in zip(rate, rates[base], strict=True)]
        middle = statistics.median(ratio)
        bar = f"≥ {_SPEED_BAR:g}: {'reached' if middle >= _SPEED_BAR else 'missed'}" if "device" in name else ""
        record.add(name, spread(rate, ".1f"), spread(ratio), bar)
    record.notes += [
        f"median of {rounds} rounds in turn after {warm_up} to warm up (min … max); a ratio is that of one round",
        "vegas: `rbatchintegrand` of the same function in NumPy, one core; étendue: the device by Dr.Jit on all cores "
        "in single precision, the host by NumPy on one",
    ]
    return record
