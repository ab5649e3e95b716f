"""Array operations of integrators, for NumPy on the host and for Dr.Jit on the device.

Points are coordinate-major everywhere: ``x[i]`` is coordinate ``i`` of all ``n`` points, an array of ``n`` numbers.
On the host ``x`` is an ndarray of shape (d, n) in double precision, on the device a list of d arrays of Mitsuba's
``Float``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, IndependentSource, copied_to_device, use_variant

if TYPE_CHECKING:
    import mitsuba as mi

#: Real numbers, whole numbers and masks: one for each point.
Numbers: TypeAlias = "Array | mi.Float"
Whole: TypeAlias = "NDArray[np.int64] | mi.UInt32"
Mask: TypeAlias = "NDArray[np.bool_] | mi.Bool"
#: Coordinate-major points.
Points: TypeAlias = "Array | list[mi.Float]"

#: Dimensions that fit into one vertex of a random source on the device.
_COMPONENTS = 64
#: Samples of a stratum up to which the device adds them in one lane, rather than by a block reduction.
_UNROLLED = 32


class Backend(Protocol):
    """The array operations of integrators. ``seed`` and the number of calls determine every random number."""

    #: The best number of points to evaluate at once.
    batch: int
    #: Limits on the parts of an axis and the cells of a grid, so that positions within them still have enough digits.
    parts: int
    cells: int

    def uniform(self, count: int, dimension: int) -> Points:
        """``count`` independent points of the unit cube; new ones in each call."""
        ...

    def points(self, values: Array) -> Points:
        """Points from an array (d, n) of the host."""
        ...

    def index(self, count: int) -> Whole:
        """0 … count-1."""
        ...

    def opaque(self, number: int) -> int | mi.UInt32:
        """A whole number that may change from batch to batch without compiling another kernel."""
        ...

    def number(self, index: Whole) -> Numbers:
        """Whole numbers as real ones."""
        ...

    def split(self, value: Numbers, limit: int) -> tuple[Whole, Numbers]:
        """Integer part of numbers in [0, limit], at most ``limit - 1``, and the remainder."""
        ...

    def table(self, values: Array) -> Numbers:
        """A table that :meth:`take` reads."""
        ...

    def take(self, table: Numbers, index: Whole) -> Numbers:
        """Entries of a table."""
        ...

    def where(self, mask: Mask, yes: Any, no: Any) -> Any:
        """Choice between two arrays."""
        ...

    def exp(self, value: Numbers) -> Numbers:
        """Exponential function."""
        ...

    def broadcast(self, value: Numbers | float, x: Points) -> Numbers:
        """``value`` as an array of as many numbers as there are points ``x``."""
        ...

    def clean(self, values: Numbers) -> Numbers:
        """``values`` with non-finite numbers replaced by zero and counted by :meth:`rejected`."""
        ...

    def compute(self, *values: Any) -> None:
        """Evaluate arrays now, so that later kernels do not compute them again."""
        ...

    def rejected(self) -> int:
        """How many values :meth:`clean` has replaced so far."""
        ...

    def histogram(self, index: Whole, weights: Sequence[Numbers], size: int) -> list[Numbers]:
        """For each of ``weights`` the sums over equal ``index``: ``size`` numbers, on the device not yet evaluated;
        :meth:`host` reads them."""
        ...

    def moments(self, values: Numbers) -> tuple[float, float]:
        """Mean, and sum of squared deviations from it."""
        ...

    def strata(self, values: Numbers, size: int) -> tuple[float, float]:
        """Over strata of ``size`` consecutive values: sum of their means, sum of the variances of these means."""
        ...

    def host(self, values: Numbers) -> Array:
        """As a NumPy array of doubles."""
        ...


class HostBackend:
    """NumPy, in double precision."""

    batch = 1 << 16  # fits into the cache of a core with a few temporaries
    parts = 1 << 40
    cells = 1 << 24

    def __init__(self, seed: int) -> None:
        self._random = np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed)))
        self._rejected = 0

    def uniform(self, count: int, dimension: int) -> Array:
        """See :class:`Backend`."""
        return self._random.random((dimension, count))

    def points(self, values: Array) -> Array:
        """See :class:`Backend`."""
        return np.ascontiguousarray(values, dtype=np.float64)

    def index(self, count: int) -> NDArray[np.int64]:
        """See :class:`Backend`."""
        return np.arange(count)

    def opaque(self, number: int) -> int:
        """See :class:`Backend`."""
        return number

    def number(self, index: NDArray[np.int64]) -> Array:
        """See :class:`Backend`."""
        return np.asarray(index, dtype=np.float64)

    def split(self, value: Array, limit: int) -> tuple[NDArray[np.int64], Array]:
        """See :class:`Backend`."""
        whole = value.astype(np.int64)
        np.minimum(whole, limit - 1, out=whole)
        return whole, value - whole

    def table(self, values: Array) -> Array:
        """See :class:`Backend`."""
        return np.asarray(values, dtype=np.float64).ravel()

    def take(self, table: Array, index: NDArray[np.int64]) -> Array:
        """See :class:`Backend`."""
        return table[index]

    def where(self, mask: NDArray[np.bool_], yes: Any, no: Any) -> Any:
        """See :class:`Backend`."""
        return np.where(mask, yes, no)

    def exp(self, value: Array) -> Array:
        """See :class:`Backend`."""
        return np.exp(value)

    def broadcast(self, value: Array | float, x: Points) -> Array:
        """See :class:`Backend`."""
        return np.broadcast_to(np.asarray(value, dtype=np.float64), np.shape(x[0]))

    def clean(self, values: Array) -> Array:
        """See :class:`Backend`."""
        finite = np.isfinite(values)
        if finite.all():
            return values
        self._rejected += int(finite.size - np.count_nonzero(finite))
        return np.where(finite, values, 0.0)

    def compute(self, *values: Any) -> None:
        """See :class:`Backend`."""

    def rejected(self) -> int:
        """See :class:`Backend`."""
        return self._rejected

    def histogram(self, index: NDArray[np.int64], weights: Sequence[Array], size: int) -> list[Numbers]:
        """See :class:`Backend`."""
        return [np.asarray(np.bincount(index, w, size), dtype=np.float64) for w in weights]

    def moments(self, values: Array) -> tuple[float, float]:
        """See :class:`Backend`."""
        mean = float(values.mean())
        deviation = values - mean
        return mean, float(deviation @ deviation)

    def strata(self, values: Array, size: int) -> tuple[float, float]:
        """See :class:`Backend`."""
        rows = values.reshape(-1, size)
        mean = rows.mean(axis=1)
        squares = ((rows - mean[:, None]) ** 2).sum()
        return float(mean.sum()), float(squares / (size * (size - 1)))

    def host(self, values: Array) -> Array:
        """See :class:`Backend`."""
        return np.asarray(values, dtype=np.float64)


class DeviceBackend:
    """Dr.Jit under the current variant of Mitsuba: single precision, but means and variances in double precision."""

    batch = 1 << 22
    parts = 1 << 16
    cells = 1 << 12

    def __init__(self, seed: int) -> None:
        use_variant()
        import drjit as dr
        import mitsuba as mi

        self._dr, self._seed, self._calls = dr, seed, 0
        self._float, self._double, self._uint = mi.Float, mi.Float64, mi.UInt32
        self._counter = dr.zeros(mi.UInt32, 1)

    def uniform(self, count: int, dimension: int) -> list[mi.Float]:
        """See :class:`Backend`."""
        source = IndependentSource(self.index(count), self._seed, "integration", self._calls)
        self._calls += 1
        return [source.next_1d(a // _COMPONENTS, a % _COMPONENTS) for a in range(dimension)]

    def points(self, values: Array) -> list[mi.Float]:
        """See :class:`Backend`."""
        return [self.table(row) for row in values]

    def index(self, count: int) -> mi.UInt32:
        """See :class:`Backend`."""
        return self._dr.arange(self._uint, count)

    def opaque(self, number: int) -> mi.UInt32:
        """See :class:`Backend`."""
        return self._dr.opaque(self._uint, number)

    def number(self, index: mi.UInt32) -> mi.Float:
        """See :class:`Backend`."""
        return self._float(index)

    def split(self, value: mi.Float, limit: int) -> tuple[mi.UInt32, mi.Float]:
        """See :class:`Backend`."""
        whole = self._dr.minimum(self._uint(value), limit - 1)
        return whole, value - self._float(whole)

    def table(self, values: Array) -> mi.Float:
        """See :class:`Backend`."""
        array = np.asarray(values)
        if array.dtype.kind in "iu":
            return copied_to_device(self._uint, array.astype(np.uint32))
        return copied_to_device(self._float, array.astype(np.float32))

    def take(self, table: mi.Float, index: mi.UInt32) -> mi.Float:
        """See :class:`Backend`."""
        return self._dr.gather(type(table), table, index)

    def where(self, mask: mi.Bool, yes: Any, no: Any) -> Any:
        """See :class:`Backend`."""
        return self._dr.select(mask, yes, no)

    def exp(self, value: mi.Float) -> mi.Float:
        """See :class:`Backend`."""
        return self._dr.exp(value)

    def broadcast(self, value: mi.Float | float, x: Points) -> mi.Float:
        """See :class:`Backend`."""
        return self._float(value) + self._dr.zeros(self._float, self._dr.width(x[0]))

    def clean(self, values: mi.Float) -> mi.Float:
        """See :class:`Backend`."""
        finite = self._dr.isfinite(values)
        # A masked scatter costs nothing if all values are finite, and is part of the kernel that computes them.
        self._dr.scatter_reduce(self._dr.ReduceOp.Add, self._counter, self._uint(1), self._uint(0), ~finite)
        return self._dr.select(finite, values, 0)

    def compute(self, *values: Any) -> None:
        """See :class:`Backend`."""
        self._dr.eval(*values)

    def rejected(self) -> int:
        """See :class:`Backend`."""
        return int(self._counter[0])

    def histogram(self, index: mi.UInt32, weights: Sequence[mi.Float], size: int) -> list[Numbers]:
        """See :class:`Backend`."""
        dr = self._dr
        sums = [dr.zeros(self._float, size) for _ in weights]
        for total, weight in zip(sums, weights, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, total, self._float(weight), index)
        return sums

    def moments(self, values: mi.Float) -> tuple[float, float]:
        """See :class:`Backend`."""
        dr, count = self._dr, self._dr.width(values)
        dr.eval(values)
        mean = float(dr.sum(self._double(values))[0]) / count
        deviation = self._double(values) - dr.opaque(self._double, mean)
        return mean, float(dr.sum(deviation * deviation)[0])

    def strata(self, values: mi.Float, size: int) -> tuple[float, float]:
        """See :class:`Backend`."""
        dr = self._dr
        dr.eval(values)
        count = dr.width(values) // size
        if size <= _UNROLLED:
            first = dr.arange(self._uint, count) * size
            members = [self._double(dr.gather(type(values), values, first + j)) for j in range(size)]
            mean = sum(members) / size
            squares = sum(dr.square(member - mean) for member in members)
        else:
            double = self._double(values)
            mean = dr.block_sum(double, size) / size
            dr.eval(mean)
            squares = dr.block_sum(
                dr.square(double - dr.gather(self._double, mean, dr.arange(self._uint, count * size) // size)), size
            )
        total, spread = dr.sum(mean), dr.sum(squares)
        dr.eval(total, spread)
        return float(total[0]), float(spread[0]) / (size * (size - 1))

    def host(self, values: mi.Float) -> Array:
        """See :class:`Backend`."""
        return np.array(values, dtype=np.float64)


def array_namespace(x: Any) -> Any:
    """The module whose ``exp``, ``sqrt``, ``sin``, ``minimum`` … take ``x``: ``numpy`` or ``drjit``.

    With it, one function serves the host and the device: ``lambda x: array_namespace(x[0]).exp(-x[0] * x[1])``.
    """
    if isinstance(x, np.ndarray | float | int | np.generic):
        return np
    import drjit as dr

    return dr
