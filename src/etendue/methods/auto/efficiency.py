"""Which sample counts need the least time for a given error: errors from second moments, times from a cost model.

The error of a candidate for the sample counts is that of a picture of one camera path per pixel,

.. math:: E = \\mathrm{mean}_{tiles} \\frac{M - \\bar X^2}{\\bar I^2 + 0.01}

with the second moment M and the mean X of its camera paths (:class:`etendue.transport.Moments`) and the picture I. Its
cost is that of a camera path and its share of the light paths, in units of an edge of a path tracer, by the numbers of
vertices, connections and photons that the passes have counted. No clock is read, so a seed determines the decisions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, State
from etendue.transport import TILE, Candidate

#: Costs in units of an edge of a path tracer with its light point, fitted to CPU times of passes
#: (``python -m benchmarks auto-costs``).
CAMERA_EDGE = 1.11  #: an edge of a camera path, with the weights
CONNECTING = 0.26  #: a vertex that is connected to light vertices, by classes
CONNECTION = 0.54  #: each of its connections
LIGHT_PATH = 1.46  #: the emission of a light path
LIGHT_VERTEX = 0.44  #: a vertex of a light path, with its splat
QUERY = 0.24  #: looking for photons at a vertex
PHOTON = 0.18  #: merging a photon
#: Cost of a pass that estimates moments, over that of the same pass without.
LEARNING = 1.7
#: Share of the tiles whose noise, as far as all candidates have it, is limited to that of the others.
_OUTLIERS = 0.01


@dataclass(frozen=True)
class PassWork:
    """What a pass has done, per camera path or light path."""

    edges: float  #: of a camera path
    smooth: float  #: vertices of a camera path that can be connected
    photons: float  #: that a camera path merges, for one light path per camera path
    vertices: float  #: of a light path

    def cost(self, counts: Candidate) -> float:
        """Cost of a camera path."""
        if counts.light_paths == 0.0:
            return self.edges
        cost = CAMERA_EDGE * self.edges + (LIGHT_PATH + LIGHT_VERTEX * self.vertices) * counts.light_paths
        if counts.connections:
            cost += (CONNECTING + CONNECTION * counts.connections) * self.smooth
        if counts.merging:
            cost += QUERY * self.smooth + PHOTON * counts.light_paths * self.photons
        return cost


@dataclass(frozen=True)
class Learned:
    """Sums over the passes that have estimated moments. Arrays are never modified."""

    passes: int
    tiles: NDArray[np.float32]  #: (rows, columns, 2, candidates): moments, and means of camera paths, per camera path
    picture: NDArray[np.float32]  #: (height, width), means over the channels
    squares: NDArray[np.float32]  #: their squares
    work: NDArray[np.float64]  #: fields of :class:`PassWork`
    generation: int = 0  #: of the densities of emission that the moments are of

    @classmethod
    def none(cls) -> Learned:
        """Before the first pass."""
        nothing = np.zeros((0, 0), np.float32)
        return cls(0, nothing.reshape(0, 0, 2, 0), nothing, nothing, np.zeros(4))

    def after(self, tiles: NDArray[Any], picture: NDArray[Any], work: Sequence[float], generation: int = 0) -> Learned:
        """With one more pass: its ``tiles``, ``picture`` (height, width), work, and generation. Moments of an
        earlier generation do not hold for later passes: the new ones replace those of all passes before."""
        new = np.asarray(tiles, np.float32), np.asarray(picture, np.float32), np.square(picture, dtype=np.float32)
        if self.passes:
            tiles = (self.passes * new[0] if generation != self.generation else self.tiles) + new[0]
            new = tiles, self.picture + new[1], self.squares + new[2]
        return Learned(self.passes + 1, *new, self.work + np.asarray(work, np.float64), generation)

    def errors(self) -> NDArray[np.float64]:
        """Error of each candidate."""
        n = self.passes
        picture, squares = self.picture.astype(np.float64), self.squares.astype(np.float64)
        moments, means = np.moveaxis(self.tiles.astype(np.float64) / n, 2, 0)
        level = tiled(picture / n)
        # Mean of the squared means of the pixels, from products of different passes.
        square = tiled((np.square(picture) - squares) / (n * (n - 1))) if n > 1 else np.square(level)
        share = np.clip(means / np.maximum(level, 1e-12)[..., None], 0.0, 1.0)
        variance = moments - np.square(share) * square[..., None]
        errors = variance / (np.square(level) + RELATIVE_EPSILON)[..., None]
        # A rare bright path adds the same to all candidates. It would hide how they differ, and the cheapest would win.
        common = errors.min(axis=-1)
        above = np.maximum(common - np.quantile(common, 1.0 - _OUTLIERS), 0.0)
        error = (errors - above[..., None]).mean(axis=(0, 1))
        # Variances are differences, and may be lost in noise: no candidate is better than a thousandth of its moment.
        least = 1e-3 * (moments / (np.square(level) + RELATIVE_EPSILON)[..., None]).mean(axis=(0, 1))
        return np.maximum(error, least)

    def mean_work(self) -> PassWork:
        """Means over the passes."""
        return PassWork(*(float(value) / max(1, self.passes) for value in self.work))

    def state(self) -> State:
        """As values of a method's state."""
        return dict(vars(self))

    @classmethod
    def of(cls, state: State) -> Learned:
        """Inverse of :meth:`state`."""
        arrays = {name: np.asarray(state[name], np.float32) for name in ("tiles", "picture", "squares")}
        work = np.asarray(state["work"], np.float64)
        return cls(int(state["passes"]), work=work, generation=int(state.get("generation", 0)), **arrays)


def tiled(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over tiles; those at the border are smaller."""
    height, width = image.shape
    rows, columns = np.arange(0, height, TILE), np.arange(0, width, TILE)
    sums = np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1)
    return sums / tile_pixels(height, width)


def tile_pixels(height: int, width: int) -> NDArray[np.float64]:
    """Number of pixels of each tile, (rows, columns)."""
    sides = (np.minimum(TILE, side - np.arange(0, side, TILE)).astype(np.float64) for side in (height, width))
    return np.outer(*sides)
