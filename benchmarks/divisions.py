"""The rule by which recursive stratified sampling chooses the dimension that it divides."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.integration import Integrand, RecursiveStratified, array_namespace

from .measuring import Record
from .options import Seeds


class _Within(RecursiveStratified):
    """The variance within the parts: the thesis's rule, read literally."""

    def gains(self, metrics: Array, after: Array, means: Callable[[], Array]) -> Array:
        """See :class:`RecursiveStratified`."""
        return np.maximum(after, 1e-300)


class _Between(RecursiveStratified):
    """The variance between the means of the parts."""

    def gains(self, metrics: Array, after: Array, means: Callable[[], Array]) -> Array:
        """See :class:`RecursiveStratified`."""
        return np.maximum(means().var(axis=2), 1e-300)


RULES = {"removed": RecursiveStratified, "within the parts": _Within, "between the parts' means": _Between}


def _peaks(x: Any) -> Any:
    exp = array_namespace(x[0]).exp
    near = [(x[0] - a) * (x[0] - a) + (x[1] - b) * (x[1] - b) for a, b in ((0.3, 0.7), (0.8, 0.2))]
    return exp(near[0] * -500.0) + exp(near[1] * -500.0)


#: By label: number of dimensions, function.
FUNCTIONS: dict[str, tuple[int, Callable[[Any], Any]]] = {
    "exp(-3x) y": (2, lambda x: array_namespace(x[0]).exp(x[0] * -3.0) * x[1]),
    "abs(x + y - 0.7)": (2, lambda x: abs(x[0] + x[1] - 0.7)),
    "two narrow peaks": (2, _peaks),
    "ridge across x, 3-D": (3, lambda x: array_namespace(x[0]).exp((x[0] - 0.4) * (x[0] - 0.4) * -1000.0)),
    "sin 20x + y/2": (2, lambda x: array_namespace(x[0]).sin(x[0] * 20.0) + x[1] * 0.5),
}
_PLAIN = 1 << 20


def measure(
    samples: Annotated[int, typer.Option(min=100, help="Evaluations of an integral.")] = 10_000, seeds: Seeds = 300
) -> Record:
    """Variance of plain Monte Carlo over that of each rule, with the standard error of the latter."""
    record = Record(f"Variance of plain Monte Carlo over that of RecursiveStratified, {samples} samples", ("", *RULES))
    random = np.random.default_rng(1)
    for name, (dimensions, function) in FUNCTIONS.items():
        plain = float(np.var(function(list(random.random((dimensions, _PLAIN)))))) / samples
        f = Integrand(function, dimensions)
        cells = []
        for rule in RULES.values():
            found = [rule().integrate(f, samples, seed=seed).value for seed in range(seeds)]
            cells.append(f"{plain / np.var(found, ddof=1):.2g}")
        record.add(name, *cells)
    record.notes.append(f"{seeds} seeds, standard error of a cell {100 * math.sqrt(2 / (seeds - 1)):.0f} %")
    return record
