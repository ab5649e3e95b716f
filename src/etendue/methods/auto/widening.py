"""How much larger than the width of a pixel tells the merge radius may be: its noise against its bias, measured.

A larger radius has less noise, and blurs more. Some passes take turns with the radius and a larger one. The noise of
either is the variance between its passes. The bias of the larger one, relative to the smaller, is the difference of
their pictures; its square is estimated by products of the differences of two pairs of passes, whose noise is
independent, and in tiles, where noise averages out and bias does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, State
from etendue.transport import TILE

from .efficiency import tiled

#: Passes of either radius, and the larger one over the other.
_PASSES, _MOST = 6, 4.0
#: Photons in a disc, in the mean, above which there is no trial: merges are no longer rare, and passes with larger
#: discs cost more and blur more than the choice gains.
_PHOTONS = 0.25
#: Passes after which the error shall be small.
_HORIZON = 64
#: Share of the pixels whose variance, and of the tiles whose bias, is limited to that of the others.
_BRIGHT, _BIASED = 0.001, 0.01
#: Ratio to the least error, times cost, up to which a smaller factor is as good.
_ALIKE = 1.03


@dataclass(frozen=True)
class Trial:
    """Passes that take turns with the radius and ``most`` times that. Arrays are never modified."""

    most: float  #: 0: not known yet
    factor: float  #: on the radius of passes that are not part of the trial
    tiles: NDArray[np.float32]  #: (passes, tile rows, tile columns), means over pixels and channels
    pixels: NDArray[np.float32]  #: (passes, height / 2, width / 2)

    @classmethod
    def none(cls) -> Trial:
        """Before the first pass."""
        return cls(0.0, 1.0, np.zeros((0, 0, 0), np.float32), np.zeros((0, 0, 0), np.float32))

    def begun(self, photons: float) -> Trial:
        """The trial, or none, for discs that hold ``photons``."""
        return Trial(_MOST if photons <= _PHOTONS else 1.0, 1.0, self.tiles, self.pixels)

    @property
    def begins(self) -> bool:
        """Whether no pass has been made."""
        return self.most == 0.0

    @property
    def runs(self) -> bool:
        """Whether the next pass is part of the trial."""
        return self.most > 1.0 and len(self.tiles) < 2 * _PASSES

    @property
    def next(self) -> float:
        """The factor of the next pass."""
        return self.most if self.runs and len(self.tiles) % 2 else self.factor

    def after(self, picture: NDArray[np.float64], cost: NDArray[np.float64]) -> Trial:
        """With one more pass: its picture (height, width), means over the channels. ``cost`` (2): of a pass without
        photons, and of merging the photons of the radius."""
        tiles, pixels = tiled(picture)[None], picture[None, ::2, ::2]
        if len(self.tiles):
            tiles, pixels = np.concatenate([self.tiles, tiles]), np.concatenate([self.pixels, pixels])
        made = Trial(self.most, 1.0, tiles.astype(np.float32), pixels.astype(np.float32))
        if made.runs:
            return made
        nothing = np.zeros((0, 0, 0), np.float32)
        return Trial(1.0, made._best(cost), nothing, nothing)

    def _best(self, cost: NDArray[np.float64]) -> float:
        """The least factor of those with the least error after :data:`_HORIZON` passes, times cost."""
        noise = self._variances()
        # By the radius r, the variance of merges is as 1 / r^2, and the bias as r^2 - 1.
        merged = max(0.0, noise[0] - noise[1]) / (1.0 - self.most**-2)
        factors = np.append(2.0 ** np.arange(0.0, np.log2(self.most), 0.5), self.most)
        variance = noise[0] - merged * (1.0 - factors**-2.0)
        bias = self._bias() * ((factors**2 - 1.0) / (self.most**2 - 1.0)) ** 2
        products = (variance / _HORIZON + bias) * (cost[0] + cost[1] * factors**2)
        return float(factors[(products <= _ALIKE * products.min()).argmax()])

    def _variances(self) -> NDArray[np.float64]:
        """Mean relative variances of passes with either radius."""
        pixels = self.pixels.astype(np.float64)
        # By the brightness of tiles: that of a pixel with a rare bright path would hide its noise.
        level = self.tiles.mean(0, dtype=np.float64).repeat(TILE // 2, 0).repeat(TILE // 2, 1)
        scale = np.square(level[: pixels.shape[1], : pixels.shape[2]]) + RELATIVE_EPSILON
        both = np.array([pixels[k::2].var(axis=0, ddof=1) / scale for k in range(2)])
        return np.minimum(both, np.quantile(both[0], 1.0 - _BRIGHT)).mean(axis=(1, 2))

    def _bias(self) -> float:
        """Mean squared relative bias of the larger radius, and its standard error."""
        tiles = self.tiles.astype(np.float64)
        differences = tiles[1::2] - tiles[::2]
        count = len(differences)
        products = np.square(differences.sum(0)) - np.square(differences).sum(0)
        relative = products / (count * (count - 1)) / (np.square(tiles.mean(0)) + RELATIVE_EPSILON)
        limit = np.quantile(np.abs(relative), 1.0 - _BIASED)
        relative = np.clip(relative, -limit, limit)
        return max(0.0, float(relative.mean())) + float(relative.std() / np.sqrt(relative.size))

    def state(self) -> State:
        """As values of a method's state."""
        return dict(vars(self))

    @classmethod
    def of(cls, state: State) -> Trial:
        """Inverse of :meth:`state`."""
        arrays = (np.asarray(state[name], np.float32) for name in ("tiles", "pixels"))
        return cls(float(state["most"]), float(state["factor"]), *arrays)
