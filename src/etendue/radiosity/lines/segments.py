"""Segments: pairs of patches that see each other along a line, the stored form of lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, in_order, threads, uses_cuda
from etendue.surfaces import Patches

from ..compiling import compiled
from ..errors import RadiosityError
from .replay import DeviceSegments

Pairs = NDArray[np.uint32]
#: Divisor of a sum over the segments of a patch: their number, or the number expected from its area.
Normalisation = Literal["counted", "expected"]


@dataclass(frozen=True)
class Directed:
    """Segments with the directions of their lines.

    ``pairs``: (k, 2). ``ways``: (b, 4) a direction for each run of consecutive segments, a bundle or a ray, and the
    number of segments of the run. Lines go from the first patch of a pair to the second, so that a pair (sky, i) is a
    line from i to the sky in the opposite direction.
    """

    pairs: Pairs
    ways: Array


class Segments:
    """Pieces of lines between two patches that face each other, 8 bytes each, in the order of the lines.

    A segment is a pair of patch indices. ``n`` is the sky, where a line without further hit ends, and ``n + 1`` is
    dark: the back of a one-sided face. So every line through a patch is one of its segments. The share of the segments
    of patch ``i`` that lead to ``j`` estimates the form factor F_ij. Any sum over form factors, such as a bounce of
    light, is a pass over the segments, at a few hundred million per second.

    The lines are divided into ``batches``, whose variance gives errors.

    Attributes
    ----------
    patches: the patches that the lines were cast through; only their number and areas are used.
    chunks: arrays (k, 2), one after the other.
    batches: (chunks,) the batch of each chunk, from 0 on.
    ways: for each chunk the directions of its lines, see :class:`Directed`; ``None`` if they are not known.
    are_even: whether these directions are evenly spread, as those of bundles are, and not by the cosine law.
    expected: (n,) expected number of lines through each patch, if it is flat.
    """

    #: Contribution of local rays, see :class:`MixedSegments`.
    correction: Any = None
    extra: Array | None = None

    def __init__(
        self,
        patches: Patches,
        chunks: Sequence[Pairs],
        batches: ArrayLike,
        expected: Array,
        ways: Sequence[Array] | None = None,
        are_even: bool = True,
    ) -> None:
        self.patches = patches
        # All chunks are read-only, as chunks in files are: loops would be compiled again for writable arrays.
        self.chunks = [_read_only(chunk) for chunk in chunks]
        self.batches = np.asarray(batches, dtype=np.int64)
        self.expected = expected
        self.ways = None if ways is None else list(ways)
        self.are_even = are_even
        ends = self._ends()[: len(patches)]
        #: (n,) segments of each patch: the lines through it.
        self.counted: NDArray[np.int64] | Array = ends[:, 0].copy()
        #: (n,) segments to the sky.
        self.to_sky: NDArray[np.int64] | Array = ends[:, 1].copy()
        #: (n,) segments to the back of a face.
        self.to_dark: NDArray[np.int64] | Array = ends[:, 2].copy()

    def __len__(self) -> int:
        return sum(len(chunk) for chunk in self.chunks)

    def __repr__(self) -> str:
        return f"Segments({len(self)} of {len(self.patches)} patches, {self.batch_count} batches)"

    def __add__(self, other: Segments) -> Segments:
        """The segments of both, with separate batches. Raises :class:`RadiosityError` if the patches differ, and for
        segments with local rays: add those of lines first, then call :func:`with_local_rays`."""
        if self.correction is not None or other.correction is not None:
            raise RadiosityError(
                "segments with local rays cannot be added: add segments of lines, then call with_local_rays()"
            )
        if len(self.patches) != len(other.patches) or not np.array_equal(self.patches.areas, other.patches.areas):
            raise RadiosityError("segments of different patches cannot be added")
        batches = np.concatenate([self.batches, other.batches + self.batch_count])
        ways = None if self.ways is None or other.ways is None else self.ways + other.ways
        expected, are_even = self.expected + other.expected, self.are_even and other.are_even
        return Segments(self.patches, self.chunks + other.chunks, batches, expected, ways, are_even)

    @property
    def batch_count(self) -> int:
        """Number of batches."""
        return int(self.batches.max()) + 1 if len(self.batches) else 0

    @property
    def nbytes(self) -> int:
        """Memory of the pairs."""
        return sum(chunk.nbytes for chunk in self.chunks)

    @property
    def unseen(self) -> NDArray[np.int64]:
        """Patches without any line, whose values are unknown; empty patches are none of them."""
        return np.flatnonzero((self.counted == 0) & (self.expected > 0))

    @property
    def sky(self) -> Array:
        """(n,) the share of the segments of each patch that lead to the sky."""
        return _divide(self.to_sky[:, None], self.exchange_weights)[:, 0]

    @property
    def outside(self) -> Array:
        """(n,) the same; see :class:`Transport`."""
        return self.sky

    @property
    def dark(self) -> Array:
        """(n,) the share of the segments of each patch that lead to the back of a face: zero in a closed mesh with the
        right orientation."""
        return _divide(self.to_dark[:, None], self.exchange_weights)[:, 0]

    @property
    def exchange_weights(self) -> Array:
        """(n,) weights that make the exchange symmetric: weight_i F_ij = weight_j F_ji."""
        return self.counted.astype(np.float64)

    def gather(self, values: ArrayLike, sky: ArrayLike = 0.0, normalisation: Normalisation = "counted") -> Array:
        """Mean of ``values`` (n, c) or (n,) over the surfaces that each patch sees: F values. Of radiosities it is the
        irradiance.

        ``sky`` is the value of the sky, a number or (c,). A patch without any line gets zero.
        """
        full, shape = self._with_sky(values, sky)
        return _divide(self._gather(full), self._weights(normalisation)).reshape(shape)

    def gather_error(self, values: ArrayLike, sky: ArrayLike = 0.0) -> Array:
        """Standard error of :meth:`gather` (counted), from the variance of the batches, in the shape of ``values``. For
        batches of one point sequence this overestimates the error. Patches that only one batch has hit get zero, as
        their error is unknown. Raises :class:`RadiosityError` for less than two batches.
        """
        if self.batch_count < 2:
            raise RadiosityError("a standard error needs at least two batches of lines")
        full, shape = self._with_sky(values, sky)
        mean = _divide(self._gather(full), self.exchange_weights)
        parts = (self.batch(batch) for batch in range(self.batch_count))
        return scatter(((part._gather(full), part.counted) for part in parts), mean).reshape(shape)

    def sums(self, values: ArrayLike, sky: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Numerator (n, c) and denominator (n,) of :meth:`gather` (counted), which can be summed over segments."""
        return self._gather(self._with_sky(values, sky)[0]), self.exchange_weights

    def sky_counts(self, number_of: Callable[[Array], NDArray[np.int64]], shares: Array) -> Array:
        """(n, parts) segments of each patch that lead to the sky, by the part of the sky.

        number_of: the part of each direction (k, 3) from a patch. shares: (parts,) of the solid angle of all
        directions. A part that has got more bundles than its share gets less weight, in proportion, which removes most
        of the error of a part: its number of bundles. Raises :class:`RadiosityError` if directions are not known.
        """
        met, counts = self.directions_met(number_of, len(shares)), np.zeros((len(self.patches), len(shares)))
        for chunk, ways in zip(self.chunks, self.ways or (), strict=True):
            near, far = (number_of(sign * ways[:, :3]) for sign in (-1, 1))
            compiled().count_parts(chunk, np.cumsum(ways[:, 3]).astype(np.int64), near, far, counts)
        if not self.are_even:
            return counts
        return counts * np.divide(shares * met.sum(), met, out=np.zeros(len(met)), where=met > 0)

    def directions_met(self, number_of: Callable[[Array], NDArray[np.int64]], parts: int) -> NDArray[np.int64]:
        """(parts,) directions of bundles, or rays, in each part of the sky; see :meth:`sky_counts`."""
        if self.ways is None:
            raise RadiosityError("these segments do not know their directions: cast them with directed=True")
        numbers = [number_of(sign * ways[:, :3]) for ways in self.ways for sign in (-1, 1)]
        return np.bincount(np.concatenate(numbers), minlength=parts)

    def batch(self, number: int) -> Segments:
        """One batch."""
        kept = self.batches == number
        return self._some(kept, np.zeros(np.count_nonzero(kept)), self.expected / self.batch_count)

    def without(self, number: int) -> Segments:
        """All batches but one."""
        kept = self.batches != number
        batches = self.batches[kept] - (self.batches[kept] > number)
        return self._some(kept, batches, self.expected * (1 - 1 / self.batch_count))

    def _some(self, kept: NDArray[np.bool_], batches: ArrayLike, expected: Array) -> Segments:
        """Those of the chunks that are ``kept``."""
        chosen = np.flatnonzero(kept)
        ways = None if self.ways is None else [self.ways[k] for k in chosen]
        return Segments(self.patches, [self.chunks[k] for k in chosen], batches, expected, ways, self.are_even)

    def _weights(self, normalisation: Normalisation) -> Array:
        if normalisation not in ("counted", "expected"):
            raise RadiosityError(f"sums are divided by the 'counted' or the 'expected' lines, not {normalisation!r}")
        return self.exchange_weights if normalisation == "counted" else self.expected

    def _with_sky(self, values: ArrayLike, sky: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        x = np.asarray(values, dtype=np.float64)
        if x.ndim not in (1, 2) or len(x) != len(self.patches):
            raise RadiosityError(f"values have one row for each of {len(self.patches)} patches, not shape {x.shape}")
        full = np.zeros((len(x) + 2, 1 if x.ndim == 1 else x.shape[1]))
        full[: len(x)] = x.reshape(len(x), -1)
        full[len(x)] = sky
        return full, x.shape

    def _ends(self) -> NDArray[np.int64]:
        if uses_cuda():
            return self._on_device.ends(len(self.patches))
        ends: NDArray[np.int64] = self._sum("count_ends", np.zeros((len(self.patches) + 2, 3), np.int64))
        return ends

    def _gather(self, full: Array) -> Array:
        if uses_cuda():
            sums: Array = self._on_device.gather(full)
        elif full.shape[1] == 1:
            values = full[:, 0].copy()
            sums = self._sum("gather_one", np.zeros_like(values), values)[:, None]
        else:
            sums = self._sum("gather", np.zeros_like(full), full)
        return sums[: len(self.patches)]

    @cached_property
    def _on_device(self) -> DeviceSegments:
        """A copy on the device, 8 bytes per segment, kept as long as these segments exist."""
        return DeviceSegments(self.chunks)

    def _sum(self, loop: str, zero: Any, *arguments: Any) -> Any:
        """Sum of a compiled loop over all chunks, starting from ``zero`` in each thread."""
        add = getattr(compiled(), loop)
        parts = np.array_split(np.arange(len(self.chunks)), threads())

        def task(part: NDArray[np.int64]) -> Any:
            out = zero.copy()
            for k in part:
                add(self.chunks[k], *arguments, out)
            return out

        return sum(in_order(partial(task, part) for part in parts), start=zero)


def _read_only(chunk: Pairs) -> Pairs:
    view = chunk.view()
    view.flags.writeable = False
    return view


def scatter(parts: Iterable[tuple[Array, NDArray[np.int64] | Array]], mean: Array) -> Array:
    """Standard error (n, c) of a ``mean`` that is a quotient of sums, from the sums (n, c) and the weights (n,) of its
    independent parts; zero where only one part has a weight."""
    squares, weight, alike = np.zeros_like(mean), np.zeros(len(mean)), np.zeros(len(mean))
    for sums, weights in parts:
        weight += weights
        squares += (sums - mean * weights[:, None]) ** 2
        alike += weights**2.0
    # Bessel's correction for parts with shares w of the weight: the mean absorbs the sum of w^2 of the variance.
    return np.sqrt(_divide(squares, weight**2.0 - alike))


def _divide(sums: NDArray[Any], weights: Array) -> Array:
    out = np.zeros(sums.shape)
    return np.divide(sums, weights[:, None], out=out, where=weights[:, None] > 0)
