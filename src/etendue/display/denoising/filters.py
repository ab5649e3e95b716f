"""Gaussian, bilateral and guided filter of a picture, on the device.

Pixels are packets of four floats. Windows end at the border of the picture and weights are normalised there, so that a
constant picture stays as it is. Colours that are compared between pixels are compressed, ``log(1 + x / level)`` with
the mean luminance as level, because the noise of light grows with the light.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.film import LUMINANCE

from .pictures import Features, Picture

#: Standard deviation of Gaussian weights in space, relative to the radius of the window.
_SPACE = 0.5
#: Differences at which the weight of the bilateral filter is exp(-1/2): compressed colours, albedo, normals.
_COLOUR, _ALBEDO, _NORMAL = 0.6, 0.1, 0.2
#: Standard deviations of a pixel by which the accepted difference of colours grows.
_NOISE = 3.0
#: Pixels per lane of the bilateral filter.
_STRIP = 4
#: Value of the guides outside the picture.
_FAR = 1e4
#: Variance of a guide that is taken for noise: of features, and of the luminance if its variance is not known.
_FEATURE_NOISE, _LIGHT_NOISE = 1e-3, 0.05
#: The same of the luminance, relative to its variance.
_LIGHT_VARIANCE = 2.0


def gaussian(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """Gaussian blur; the standard deviation is ``strength`` times half the radius."""
    height, width = component.shape[:2]
    offsets = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (offsets / max(_SPACE * radius * strength, 1e-3)) ** 2)
    frame = Frame(width, height)
    values = [packets(component)]
    for down in (False, True):
        values = frame.along(down, radius, values, weights=weights)
    return unpacked(values[0], height, width)


def bilateral(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """Mean of the pixels of the window, with weights by distance, compressed colour, albedo and normal [Tomasi 1998].

    If the variance is known, the accepted difference of colours grows with the noise that both pixels have at least.
    ``strength`` multiplies it.
    """
    height, width = component.shape[:2]
    pairs = ((features.albedo, _ALBEDO), (features.normal, _NORMAL))
    guides = [layer / np.float32(unit) for layer, unit in pairs if layer is not None]
    layers = [_noise(component, features.variance), _mixture(guides, height, width), component]
    layers += [compressed(component) / np.float32(max(_COLOUR * strength, 1e-6)), *guides]
    # The channels of a pixel one after the other. Outside the picture the guides differ so much that all weights are
    # zero, so that taps need no check of the border.
    strips = -(-height // _STRIP)
    channels = sum(layer.shape[2] for layer in layers)
    padded = np.full((strips * _STRIP + 2 * radius, width + 2 * radius, -(-channels // 4) * 4), _FAR, dtype=np.float32)
    inside = padded[radius : radius + height, radius : radius + width]
    inside[:, :, :channels] = np.concatenate(layers, axis=2)
    padded[:, :, channels:] = 0.0
    count, line = padded.shape[2] // 4, dr.opaque(mi.Int32, width + 2 * radius)
    values = dr.copy(mi.Float(padded.ravel()))
    far = dr.opaque(mi.Int32, radius)
    # A lane computes the pixels of a strip of a column: a neighbour is read once for all of them.
    lane = dr.arange(mi.Int32, width * strips)
    strip = lane // dr.opaque(mi.Int32, width)
    column = lane - strip * dr.opaque(mi.Int32, width)
    first = (strip * _STRIP + far) * line + column + far

    def read(place: mi.Int32) -> list[mi.Float]:
        found = [dr.gather(mi.Vector4f, values, mi.UInt32(place * count + k)) for k in range(count)]
        return [channel for packet in found for channel in packet]

    own = [read(first + line * k) for k in range(_STRIP)]
    space = dr.opaque(mi.Float, -0.5 / (_SPACE * radius) ** 2)
    last = far + _STRIP

    def tap(down: mi.Int32, across: mi.Int32, *sums: mi.Vector4f) -> tuple[mi.Int32 | mi.Vector4f, ...]:
        value = read(first + down * line + across)
        colour = mi.Vector4f(*value[2:5], 1.0)
        result = []
        for k, total in enumerate(sums):
            differences = [dr.square(a - b) for a, b in zip(value[5:], own[k][5:], strict=True)]
            noise = 2.0 * dr.minimum(value[0], own[k][0])
            squared = sum(differences[:3]) * dr.rcp(1.0 + noise) + sum(differences[3:]) * dr.rcp(1.0 + own[k][1])
            below = down - k
            w = dr.exp(mi.Float(across * across + below * below) * space - 0.5 * squared)
            w = dr.select((below >= -far) & (below <= far), w, 0.0)
            result.append(dr.fma(colour, w, total))
        # Counted, because an integer division is slow.
        ends = across == far
        return dr.select(ends, down + 1, down), dr.select(ends, -far, across + 1), *result

    empty = [mi.Vector4f(0.0) for _ in range(_STRIP)]
    _, _, *sums = dr.while_loop((-far, -far, *empty), lambda down, *_: down < last, tap)
    means = [dr.ravel(mi.Color3f(s.x, s.y, s.z) / s.w) for s in sums]
    dr.eval(means)  # together, or the loop runs once for each
    rows = [np.array(mean).reshape(strips, width, 3) for mean in means]
    return np.stack(rows, axis=1).reshape(-1, width, 3)[:height]


def _noise(component: Picture, variance: Picture | None) -> Picture:
    """Variance of the compressed colours (height, width, 1), for the bilateral filter, over the squared difference that
    it accepts; 0 if it is not known. Means over 3x3 pixels, because the variance is uncertain after few passes."""
    height, width = component.shape[:2]
    if variance is None:
        return np.zeros((height, width, 1), np.float32)
    light = np.array(LUMINANCE, np.float32)
    values = [packets(np.stack([np.maximum(variance, 0.0).mean(axis=2), np.maximum(component, 0.0) @ light], axis=2))]
    frame = Frame(width, height)
    for down in (False, True):
        values = frame.along(down, 1, values)
    around = unpacked(values[0], height, width).astype(np.float64)  # of light that may be faint
    level = max(float((np.maximum(component, 0.0) @ light).mean()), 1e-20)
    noise = (_NOISE / _COLOUR) ** 2 * around[:, :, :1] / np.square(level + around[:, :, 1:2])
    return np.minimum(noise, _FAR).astype(np.float32)


def _mixture(guides: Sequence[Picture], height: int, width: int) -> Picture:
    """Squared difference (height, width, 1) of the features of a pixel from those of the more similar one of its two
    neighbours in a row, or in a column if it is larger. Pixels on an edge, which show both of its sides, differ from
    all others, and would keep their noise."""
    result = np.zeros((height, width, 1), np.float32)
    for axis in range(2 if guides else 0):
        steps = np.square(np.diff(np.concatenate(guides, axis=2), axis=axis)).sum(axis=2, keepdims=True)
        before, after = (np.insert(steps, place, 0.0, axis) for place in (0, steps.shape[axis]))
        result = np.maximum(result, np.minimum(before, after))
    return result


def guided(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """Linear regression of the picture on a guide in each window, averaged over the windows of a pixel [He 2013].

    The guide is albedo, normal and the luminance of the picture, which shows lamps, caustics and shadows. The luminance
    is not compressed: the slope of a picture on itself is at most 1, so noise beside a lamp stays but does not grow.
    ``strength`` multiplies the variance of a guide that is taken for noise.
    """
    height, width = component.shape[:2]
    frame = Frame(width, height)
    light = component @ np.array(LUMINANCE, dtype=np.float32)[:, None]
    level = max(float(light.mean()), 1e-20)
    light /= np.float32(level)
    layers = [layer for layer in (features.albedo, features.normal) if layer is not None]
    first = np.concatenate([light, *layers[:1]], axis=2)  # four channels, if there are features
    layers = [first, *layers[1:]]
    count = sum(layer.shape[2] for layer in layers)
    noise = np.full_like(light, _LIGHT_NOISE)
    if features.variance is not None:
        variance = np.maximum(features.variance, 0.0).mean(axis=2, keepdims=True, dtype=np.float64)
        noise = np.minimum(_LIGHT_VARIANCE * variance / level**2, 1e20).astype(np.float32)
    guides, value = [packets(layer) for layer in layers], packets(np.concatenate([component, noise], axis=2))
    dr.eval(guides, value)

    def read(place: mi.UInt32, inside: mi.Bool | bool = True) -> list[mi.Float]:
        found = [dr.gather(mi.Vector4f, guide, place, inside) for guide in guides]
        return [packet[c] for packet, layer in zip(found, layers, strict=True) for c in range(layer.shape[2])]

    def moments(place: mi.UInt32, inside: mi.Bool) -> list[mi.Vector4f]:
        g, (*v, noise) = read(place, inside), dr.gather(mi.Vector4f, value, place, inside)
        products = [g[i] * g[j] for i in range(count) for j in range(i + 1)]
        return _in_packets([noise, *g, *v, *products, *(a * b for a in g for b in v)])

    def regression(means: list[mi.Vector4f]) -> list[mi.Vector4f]:
        noise, *m = [channel for packet in means for channel in packet]
        g, v, rest = m[:count], m[count : count + 3], iter(m[count + 3 :])
        covariance = {(i, j): next(rest) - g[i] * g[j] for i in range(count) for j in range(i + 1)}
        for i in range(count):
            covariance[i, i] = dr.maximum(covariance[i, i], 0.0) + dr.opaque(mi.Float, strength) * (
                noise if i == 0 else dr.opaque(mi.Float, _FEATURE_NOISE)
            )
        cross = [[next(rest) - g[i] * v[c] for c in range(3)] for i in range(count)]
        slopes = _solve(covariance, cross)
        level = [v[c] - sum(slopes[i][c] * g[i] for i in range(count)) for c in range(3)]
        return _in_packets([*level, *(slope for row in slopes for slope in row)])

    values = frame.along(False, radius, moments)
    values = frame.along(True, radius, values, then=regression)
    values = frame.along(False, radius, values)

    def apply(lines: list[mi.Vector4f]) -> list[mi.Vector4f]:
        m = [channel for packet in lines for channel in packet]
        g = read(frame.lane)
        return _in_packets([m[c] + sum(m[3 + 3 * i + c] * g[i] for i in range(count)) for c in range(3)])

    return unpacked(frame.along(True, radius, values, then=apply)[0], height, width)


class Frame:
    """The pixels of a picture, one lane each."""

    def __init__(self, width: int, height: int) -> None:
        self.lane = dr.arange(mi.UInt32, width * height)
        self._size = mi.Point2i(dr.opaque(mi.Int32, width), dr.opaque(mi.Int32, height))
        self._y = mi.Int32(self.lane) // self._size.x
        self._x = mi.Int32(self.lane) - self._y * self._size.x

    def at(self, across: mi.Int32, down: mi.Int32) -> tuple[mi.UInt32, mi.Bool]:
        """(pixel at this offset from each pixel, whether it is inside the picture)."""
        x, y = self._x + across, self._y + down
        inside = (x >= 0) & (x < self._size.x) & (y >= 0) & (y < self._size.y)
        return mi.UInt32(y * self._size.x + x), inside

    def along(
        self,
        down: bool,
        radius: int,
        source: Sequence[mi.Float] | Callable[[mi.UInt32, mi.Bool], list[mi.Vector4f]],
        *,
        weights: NDArray[np.float64] | None = None,
        then: Callable[[list[mi.Vector4f]], list[mi.Vector4f]] | None = None,
    ) -> list[mi.Float]:
        """Weighted means along rows or columns, with equal weights by default. ``source``: packets, or a function of
        pixels. ``then`` is applied to the means. The result is evaluated."""
        if not callable(source):
            stored = source
            dr.eval(stored)

            def source(place: mi.UInt32, inside: mi.Bool) -> list[mi.Vector4f]:
                return [dr.gather(mi.Vector4f, values, place, inside) for values in stored]

        table = mi.Float([1.0] * (2 * radius + 1) if weights is None else list(weights))
        width, nothing = mi.Float(0.0), mi.Int32(0)

        def tap(
            number: mi.Int32, weight: mi.Float, *sums: mi.Vector4f
        ) -> tuple[mi.Int32 | mi.Float | mi.Vector4f, ...]:
            away = number - radius
            place, inside = self.at(*((nothing, away) if down else (away, nothing)))
            w = dr.select(inside, dr.gather(mi.Float, table, mi.UInt32(number)), 0.0)
            values = source(place, inside)
            return number + 1, weight + w, *(dr.fma(v, w, s) for v, s in zip(values, sums, strict=True))

        last = dr.opaque(mi.Int32, 2 * radius + 1)
        empty = [mi.Vector4f(0.0) for _ in source(self.lane, mi.Bool(True))]
        _, weight, *sums = dr.while_loop((mi.Int32(0), width, *empty), lambda number, *_: number < last, tap)
        means = [s / weight for s in sums]
        result = [dr.ravel(packet) for packet in (means if then is None else then(means))]
        dr.eval(result)
        return result


def packets(layer: Picture) -> mi.Float:
    """The layer (height, width, up to 4 channels) on the device, four floats a pixel."""
    padded = np.zeros((*layer.shape[:2], 4), dtype=np.float32)
    padded[:, :, : layer.shape[2]] = layer
    return dr.copy(mi.Float(padded.ravel()))


def unpacked(values: mi.Float, height: int, width: int) -> Picture:
    """Inverse of :func:`packets`."""
    return np.array(np.array(values, np.float32).reshape(height, width, 4)[:, :, :3])


def compressed(component: Picture) -> Picture:
    """``log(1 + x / level)``, the level being the mean luminance; negative values are 0."""
    x = np.maximum(component, 0.0)
    level = float((x @ np.array(LUMINANCE, dtype=np.float32)).mean())
    return np.log1p(x / np.float32(level)) if level > 0.0 else x


def _in_packets(values: list[mi.Float]) -> list[mi.Vector4f]:
    padded = [*values, *([mi.Float(0.0)] * (-len(values) % 4))]
    return [mi.Vector4f(*padded[i : i + 4]) for i in range(0, len(padded), 4)]


def _solve(a: dict[tuple[int, int], mi.Float], b: list[list[mi.Float]]) -> list[list[mi.Float]]:
    """``a^-1 b`` by Cholesky's decomposition of the lower triangle ``a``."""
    n = len(b)
    lower: dict[tuple[int, int], mi.Float] = {}
    for i in range(n):
        for j in range(i + 1):
            rest = a[i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
            lower[i, j] = dr.sqrt(dr.maximum(rest, 1e-12)) if i == j else rest / lower[j, j]
    forward: list[list[mi.Float]] = []
    for i in range(n):
        forward.append([(b[i][c] - sum(lower[i, k] * forward[k][c] for k in range(i))) / lower[i, i] for c in range(3)])
    result: list[list[mi.Float]] = [[] for _ in range(n)]
    for i in reversed(range(n)):
        result[i] = [
            (forward[i][c] - sum(lower[k, i] * result[k][c] for k in range(i + 1, n))) / lower[i, i] for c in range(3)
        ]
    return result
