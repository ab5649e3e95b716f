"""What masks in front of a facade reflect towards points on the floor of the room, by NumPy alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .references import Array, Opening, Outside, configuration_factor, gauss, illuminance, peak
from .rooms import DEPTH, HEIGHT, WIDTH

#: Panels of the part of an opening in which the mask is seen: its luminance varies little.
_PANELS = 3


@dataclass(frozen=True)
class Mask:
    """A diffuse strip without ends along x in front of the facade y = 0: with a ``level``, a horizontal one from the
    facade to y = -``reach`` at that height, of which the lower side reflects; with a ``top``, a vertical one at
    y = -``reach`` from the ground up to there, of which the side towards the facade does. The room, which is black,
    keeps light from it; the ground is as bright behind and below the mask as elsewhere."""

    reach: float
    level: float = 0.0
    top: float = 0.0
    reflectance: float = 0.3

    def illuminance(self, point: ArrayLike, opening: Opening, outside: Outside) -> float:
        """At a point on the floor, through an opening in the facade y = 0: sky and mask."""
        p = np.asarray(point, float)
        edge = p[1] * (self.level or self.top) / (p[1] + self.reach)  # of the mask, seen in the facade
        x0, _, z0 = opening.low
        x1, _, z1 = opening.high
        edge = float(np.clip(edge, z0, z1))
        parts = [Opening(1, (x0, 0.0, z0), (x1, 0.0, edge)), Opening(1, (x0, 0.0, edge), (x1, 0.0, z1))]
        clear, hidden = parts if self.level else parts[::-1]

        def reflected(d: Array) -> Array:
            way = (self.level - p[2]) / d[:, 2] if self.level else (p[1] + self.reach) / -d[:, 1]
            return self.reflectance / np.pi * self.received(p + way[:, None] * d, outside)

        up, total = (0.0, 0.0, 1.0), 0.0
        if clear.low[2] < clear.high[2]:
            total += illuminance(p, up, clear, outside.luminance, peak(p, clear, outside.sky.sun))
        if hidden.low[2] < hidden.high[2]:
            total += illuminance(p, up, hidden, reflected, {}, panels=_PANELS)
        return total

    def received(self, q: Array, outside: Outside) -> Array:
        """Illuminance (k,) of points (k, 3) of the mask: that without the room, less what the room hides."""
        if self.level:
            down = np.array([0.0, 0.0, -1.0])
            return outside.ground * (1.0 - _hidden_ground(q, down, self.level))
        north = np.array([0.0, 1.0, 0.0])
        free = outside.sky.vertical(north) + 0.5 * outside.ground
        hidden = np.zeros(len(q))
        for k, point in enumerate(q):
            hidden[k] = outside.ground * _hidden_ground(point[None], north, min(HEIGHT, point[2]))[0]
            hidden[k] += _hidden_sky(point, north, outside)
        return free - hidden


def _walls(q: Array) -> Iterator[tuple[int, float, tuple[float, float]]]:
    """Walls of the room that face a point in front of it: axis, place on it, and ends along the other axis."""
    yield 1, 0.0, (0.0, WIDTH)
    if q[0] < 0.0:
        yield 0, 0.0, (0.0, DEPTH)
    if q[0] > WIDTH:
        yield 0, WIDTH, (0.0, DEPTH)


def _hidden_ground(q: Array, normal: Array, top: float) -> Array:
    """Configuration factors (k,) of the walls up to ``top``, and of the roof if it is below the point."""
    result = np.zeros(len(q))
    for k, point in enumerate(q):
        for axis, place, (low, high) in _walls(point):
            ends = [(low, 0.0), (high, 0.0), (high, top), (low, top)]
            corners = [(x, place, z) if axis == 1 else (place, x, z) for x, z in ends]
            result[k] += configuration_factor(point, normal, corners)[0] if top > 0.0 else 0.0
        if normal[2] == 0.0 and point[2] > HEIGHT:
            roof = [(0, 0, HEIGHT), (WIDTH, 0, HEIGHT), (WIDTH, DEPTH, HEIGHT), (0, DEPTH, HEIGHT)]
            result[k] += configuration_factor(point, normal, roof)[0]
    return result


def _hidden_sky(q: Array, normal: Array, outside: Outside) -> float:
    """Illuminance by the sky behind the parts of the walls that are above the point."""
    if q[2] >= HEIGHT:
        return 0.0
    total = 0.0
    for axis, place, (low, high) in _walls(q):
        u, wu = gauss([low, high], 12)
        z, wz = gauss([q[2], HEIGHT], 8)
        at = np.empty((len(u), len(z), 3))
        at[..., axis], at[..., 1 - axis], at[..., 2] = place, u[:, None], z
        way = at - q
        square = (way**2).sum(-1)
        d = way / np.sqrt(square)[..., None]
        weight = np.outer(wu, wz) * np.maximum(d @ normal, 0.0) * np.abs(d[..., axis]) / square
        total += float((outside.sky.luminance(d) * weight).sum())
    return total
