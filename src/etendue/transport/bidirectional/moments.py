"""Second moments of the picture for candidate sample counts, estimated by a pass with other counts.

With the balance heuristic a contribution is f / S, where S is the sum of the densities of the path by all techniques,
each times its sample count. The contributions of a candidate with the sum S' are f / S', and the expected sum of their
squares over all samples of a pass is the integral of f^2 / S', to which each sample of the running pass adds its square
times S / S' [Grittmann 2022]. Light that a candidate rarely finds thus counts in full, because the running pass finds
it by other techniques.

The contributions of a camera path to a pixel are not independent. Let c be a contribution of the running pass, r = S/S'
and q the candidate's count of its technique over the running one. The sum X of q r c over a camera path has the mean of
a candidate's camera path. In X^2, the squares of single contributions, (q r c)^2, are replaced by their estimate above,
r c^2, and the products of two connections of a vertex, of which there are n (n - 1) for n connections, are counted
accordingly. The contributions of light paths to the camera (splats) are taken as independent.

A photon is merged by several camera paths of a pixel. The weights account for that by ``eta_discount``, a factor on the
count of merges, which the square of a merge is divided by. Beyond that, the noise of merges is larger by a factor
``merge_noise``: for each candidate, of the squares of its own merges, q (r c)^2 for a merge of the running pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from .linear import Counts

#: Side of the tiles in which moments are summed, in pixels.
TILE = 8


@dataclass(frozen=True)
class Candidate:
    """Sample counts that a pass may have."""

    light_paths: float  #: per camera path
    connections: int
    merging: bool

    def counts(self, eta_unit: mi.Float, pixels: int) -> Counts:
        """The counts in the weights; ``eta_unit``: eta_vm for one light path per camera path."""
        merge = self.light_paths * eta_unit if self.merging else 0.0
        connected = self.connections if self.light_paths > 0.0 else 0
        return Counts(self.light_paths * pixels, float(connected), merge)


@dataclass
class Sums:
    """Loop state, one lane per camera path; lists have an entry per candidate."""

    total: list[mi.Float]  #: X
    excess: list[mi.Float]  #: what is added to X^2
    edges: mi.UInt32
    smooth: mi.UInt32  #: vertices that can be connected
    photons: mi.UInt32  #: merged


class Moments:
    """Moments of a pass, in tiles.

    Parameters
    ----------
    candidates: the counts whose moments are estimated.
    used: those of the pass.
    size: width and height of the film.
    splat_scale: camera paths of a pixel over light paths of the pass, the factor on splats.
    eta_discount: factor on the count of merges in the weights.
    merge_noise: variance of merges over that of as many independent samples.
    """

    def __init__(
        self,
        candidates: Sequence[Candidate],
        used: Candidate,
        size: tuple[int, int],
        splat_scale: float,
        eta_discount: float,
        merge_noise: float,
    ) -> None:
        self.candidates = candidates
        self.used = used
        self._width = size[0]
        self._columns, self._rows = (-(-side // TILE) for side in size)
        self._splat_scale = dr.opaque(mi.Float, splat_scale)
        self._per_merge, self._merge_noise = 1.0 / eta_discount, merge_noise
        connections = [c.connections if c.light_paths > 0.0 else 0 for c in candidates]
        once = [1.0] * len(candidates)
        self._shares = {
            "emission": once,
            "next_event": once,
            "connection": [k / max(1, used.connections) for k in connections],
            "merge": [c.light_paths / used.light_paths if c.merging else 0.0 for c in candidates],
        }
        k = used.connections
        pairs = k * (k - 1) / 2
        # Coefficients of the products of two connections of a vertex, beyond those in X^2.
        self._pairs = [n * (n - 1) / pairs - 2.0 * (n / k) ** 2 for n in connections] if pairs else []
        # For each tile: moments, means, and padding to packets of four.
        self._stride = -(-2 * len(candidates) // 4) * 4
        self.clear()

    def clear(self) -> None:
        """Discard all sums."""
        self.array = dr.zeros(mi.Float, self._columns * self._rows * self._stride)
        self._walked: list[mi.UInt32] = []

    # ------------------------------------------------------------------ in the camera walk

    def begin(self, lanes: int, importance: mi.Spectrum) -> Sums:
        """The sums before the first edge of ``lanes`` camera paths; ``importance``: their weights."""
        self._importance = importance
        return self.blank(lanes)

    def blank(self, lanes: int) -> Sums:
        """Empty sums."""
        totals, excess = ([dr.zeros(mi.Float, lanes) for _ in self.candidates] for _ in range(2))
        return Sums(totals, excess, *(dr.zeros(mi.UInt32, lanes) for _ in range(3)))

    def add(
        self, sums: Sums, family: str, value: mi.Spectrum, ratios: Sequence[mi.Float], active: mi.Bool
    ) -> list[mi.Float]:
        """Add a weighted contribution of a technique family; ``ratios``: of its weights. Returns its value for each
        candidate."""
        # dr.mean would write the number of lanes into the kernel, and the pilot could not share it with the passes.
        c = dr.sum(value * self._importance) / float(dr.size_v(mi.Spectrum))
        active = active & dr.isfinite(c) & dr.isfinite(sum(ratios))
        c = dr.select(active, c, 0.0)
        merged = family == "merge"
        square = dr.square(c) * self._per_merge if merged else dr.square(c)
        values = []
        for i, (share, ratio) in enumerate(zip(self._shares[family], ratios, strict=True)):
            ratio = dr.select(active, ratio, 0.0)
            values.append(c * ratio)
            sums.excess[i] = sums.excess[i] + square * ratio
            if share > 0.0:
                own = values[-1] * share
                sums.total[i] = sums.total[i] + own
                sums.excess[i] = sums.excess[i] - dr.square(own)
                if merged:
                    more = (self._merge_noise - 1.0) * share
                    sums.excess[i] = sums.excess[i] + more * square * dr.square(ratio)
        return values

    def add_connections(
        self, sums: Sums, connections: Sequence[tuple[mi.Spectrum, Sequence[mi.Float], mi.Bool]]
    ) -> None:
        """Add the connections of a vertex: (weighted contribution, ratios, mask) each."""
        values = [self.add(sums, "connection", *one) for one in connections]
        for i, coefficient in enumerate(self._pairs):
            if coefficient != 0.0:
                for j, second in enumerate(values):
                    for first in values[:j]:
                        sums.excess[i] = sums.excess[i] + coefficient * first[i] * second[i]

    def close(self, sums: Sums, pixel: mi.UInt32) -> None:
        """Add the sums of finished camera paths to the tiles of their pixels."""
        y = pixel // self._width
        x = pixel - y * self._width
        moments = [dr.square(x) + e for x, e in zip(sums.total, sums.excess, strict=True)]
        self._scatter(self._tile(x, y), [*moments, *sums.total], mi.Bool(True))
        self._walked += [sums.edges, sums.smooth, sums.photons]

    # ------------------------------------------------------------------ in the light walk

    def splat(self, position: mi.Point2f, value: mi.Spectrum, ratios: Sequence[mi.Float], active: mi.Bool) -> None:
        """Add a weighted splat at a film position in pixels."""
        c = dr.sum(value) * (self._splat_scale / float(dr.size_v(mi.Spectrum)))
        active = active & dr.isfinite(c) & dr.isfinite(sum(ratios))
        square = dr.square(c)
        x, y = (mi.UInt32(dr.maximum(place, 0.0)) for place in (position.x, position.y))
        self._scatter(self._tile(x, y), [square * ratio for ratio in ratios], active)

    def _tile(self, x: mi.UInt32, y: mi.UInt32) -> mi.UInt32:
        return dr.minimum(y // TILE, self._rows - 1) * self._columns + dr.minimum(x // TILE, self._columns - 1)

    def _scatter(self, tile: mi.UInt32, values: Sequence[mi.Float], active: mi.Bool) -> None:
        first = tile * (self._stride // 4)
        for i in range(0, len(values), 4):
            four = [*values[i : i + 4], *([0.0] * max(0, i + 4 - len(values)))]
            dr.scatter_reduce(dr.ReduceOp.Add, self.array, mi.Vector4f(*four), first + i // 4, active)

    # ------------------------------------------------------------------ after the pass

    def schedule(self) -> None:
        """Schedule all that has been added."""
        dr.schedule(self.array, *self._walked)

    def walked(self) -> NDArray[np.float64]:
        """Edges, vertices that can be connected, and merged photons of all camera paths."""
        sums = [float(np.asarray(values).sum(dtype=np.float64)) for values in self._walked]
        return np.array(sums).reshape(-1, 3).sum(axis=0)

    def tiles(self) -> NDArray[np.float64]:
        """Sums over the camera paths of each tile, (tile rows, tile columns, 2, candidates): the moments, and the means
        of camera paths."""
        count = len(self.candidates)
        values = np.array(self.array, np.float64).reshape(self._rows, self._columns, self._stride)
        return values[..., : 2 * count].reshape(self._rows, self._columns, 2, count)
