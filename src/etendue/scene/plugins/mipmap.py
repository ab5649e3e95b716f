"""Texture ``mipmap``: Mitsuba's ``bitmap``, averaged over the footprint of a pixel on the surfaces that the camera sees
[Williams 1983].

It has the parameters of ``bitmap``. A texel of level l is the mean of 2^l by 2^l texels of the picture. Where
``si.duv_dx`` and ``si.duv_dy`` are known (étendue's methods know them at the first hits of camera rays), the value is
interpolated between the levels whose texels are about as wide as the shorter of the two; along the longer one the
samples of the pixel average. Elsewhere the value is that of ``bitmap``.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, copied_to_device

from ..packet import require_rgb

#: Coordinates of texels from any whole numbers, by wrap mode.
_WRAP: dict[str, Callable[[mi.Int32, mi.Int32], mi.Int32]] = {
    "repeat": lambda i, n: _remainder(i, n),
    "clamp": lambda i, n: dr.clip(i, 0, n - 1),
    "mirror": lambda i, n: dr.minimum(_remainder(i, 2 * n), 2 * n - 1 - _remainder(i, 2 * n)),
}


def make_mipmap() -> type:
    """The texture class for the current variant, in RGB only: the texels of spectra cannot be averaged."""
    require_rgb("textures of type 'mipmap'")

    class Mipmap(mi.Texture):
        """A bitmap with coarser copies of itself."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "mipmap"
            finest = mi.Properties("bitmap")
            keys = list(props.keys())
            for key in keys:
                finest[key] = props[key]
            finest["format"] = "variant"  # else texels of 8 bits are kept as they are, and decoded when they are read
            made = mi.PluginManager.instance().create_object(finest)
            for key in keys:
                props.mark_queried(key, finest.was_queried(key))  # Mitsuba names those that are not
            self.bitmap = next(iter(made.expand()), made)  # Mitsuba has a class for each kind of texels
            self._wrap = _WRAP[props.get("wrap_mode", "repeat")]
            self._build()

        def _build(self) -> None:
            own = mi.traverse(self.bitmap)
            level = np.array(own["data"], np.float64)
            matrix = np.array(own["to_uv"].matrix, np.float64)
            self._to_uv = [[dr.opaque(mi.Float, float(value)) for value in row] for row in matrix[:2]]
            levels = [level]
            while max(level.shape[:2]) > 1:
                level = _halved(_halved(level, 0), 1)
                levels.append(level)
            self._channels = level.shape[2]
            sizes = np.array([one.shape[:2] for one in levels], np.int64)
            texels = np.concatenate([one.reshape(-1) for one in levels])
            begins = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))[:-1]])
            self._texels = copied_to_device(mi.Float, texels)
            self._heights, self._widths, self._begins = (
                copied_to_device(mi.UInt32, values) for values in (*sizes.T, begins)
            )
            self._last = dr.opaque(mi.Float, len(levels) - 1.0)

        def _level(self, si: mi.SurfaceInteraction3f) -> mi.Float:
            """The level whose texels are as wide as the footprint."""
            size = mi.Vector2f(dr.gather(mi.UInt32, self._widths, 0), dr.gather(mi.UInt32, self._heights, 0))
            widths = []
            for side in (si.duv_dx, si.duv_dy):
                turned = mi.Vector2f(*(a * side.x + b * side.y for a, b, _ in self._to_uv))
                widths.append(dr.norm(turned * size))
            width = dr.minimum(*widths)
            return dr.select(width > 1.0, dr.minimum(dr.log2(width), self._last), 0.0)  # 0 also for what is no number

        def _sample(self, level: mi.UInt32, uv: mi.Point2f, active: mi.Bool) -> list[mi.Float]:
            """The channels of a level, bilinearly interpolated."""
            w, h = (mi.Int32(dr.gather(mi.UInt32, n, level, active)) for n in (self._widths, self._heights))
            begin = dr.gather(mi.UInt32, self._begins, level, active)
            x, y = uv.x * mi.Float(w) - 0.5, uv.y * mi.Float(h) - 0.5
            left, below = mi.Int32(dr.floor(x)), mi.Int32(dr.floor(y))
            u, v = x - mi.Float(left), y - mi.Float(below)
            total = [mi.Float(0.0)] * self._channels
            for i, along in ((0, 1.0 - u), (1, u)):
                for j, up in ((0, 1.0 - v), (1, v)):
                    row, column = (
                        dr.clip(self._wrap(at, n), 0, n - 1) for at, n in ((below + j, h), (left + i, w))
                    )  # also for coordinates that are no numbers
                    texel = begin + mi.UInt32(row * w + column)
                    for k in range(self._channels):
                        value = dr.gather(mi.Float, self._texels, texel * self._channels + k, active)
                        total[k] = total[k] + along * up * value
            return total

        def _filtered(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> list[mi.Float]:
            level, active = self._level(si), mi.Bool(active)
            fine = mi.UInt32(level)
            share = level - mi.Float(fine)
            uv = mi.Point2f(*(a * si.uv.x + b * si.uv.y + c for a, b, c in self._to_uv))
            coarse = dr.minimum(fine + 1, mi.UInt32(self._last))
            pair = self._sample(fine, uv, active), self._sample(coarse, uv, active)
            return [a + share * (b - a) for a, b in zip(*pair, strict=True)]

        def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Color3f:
            return self.eval_3(si, active)

        def eval_3(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Color3f:
            values = self._filtered(si, active)
            return mi.Color3f(*values) if len(values) == 3 else mi.Color3f(values[0])

        def eval_1(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Float:
            values = self._filtered(si, active)
            return mi.luminance(mi.Color3f(*values)) if len(values) == 3 else values[0]

        def eval_1_grad(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Vector2f:
            return self.bitmap.eval_1_grad(si, active)

        def sample_position(self, sample: mi.Point2f, active: mi.Bool | bool = True) -> tuple[mi.Point2f, mi.Float]:
            return self.bitmap.sample_position(sample, active)

        def pdf_position(self, p: mi.Point2f, active: mi.Bool | bool = True) -> mi.Float:
            return self.bitmap.pdf_position(p, active)

        def mean(self) -> mi.Float:
            return self.bitmap.mean()

        def max(self) -> mi.Float:
            return self.bitmap.max()

        def resolution(self) -> mi.ScalarVector2i:
            return self.bitmap.resolution()

        def is_spatially_varying(self) -> bool:
            return True

        def traverse(self, callback: mi.TraversalCallback) -> None:
            callback.put("bitmap", self.bitmap, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            self._build()

        def to_string(self) -> str:
            return f"Mipmap[{self.bitmap}]"

    return Mipmap


def _remainder(i: mi.Int32, n: mi.Int32) -> mi.Int32:
    """i modulo n, from 0 to n - 1. By floats, as lanes that do not count may have n = 0, which stops a processor."""
    rest = i - n * mi.Int32(dr.floor(mi.Float(i) / mi.Float(n)))
    return dr.select(rest < 0, rest + n, dr.select(rest >= n, rest - n, rest))  # the quotient is rounded


def _halved(picture: Array, axis: int) -> Array:
    """Means of pairs of rows, or of columns; of an odd number, each of the half takes as much of what there is."""
    count = picture.shape[axis]
    half = max(count // 2, 1)
    if count == 1:
        return picture
    sums = np.concatenate([np.zeros_like(picture.take([0], axis)), picture.cumsum(axis)], axis)
    edges = np.linspace(0.0, count, half + 1)
    low = np.minimum(edges.astype(int), count - 1)
    shape = [-1 if k == axis else 1 for k in range(3)]
    part = (edges - low).reshape(shape)
    at = sums.take(low, axis) * (1.0 - part) + sums.take(low + 1, axis) * part
    found: Array = np.diff(at, axis=axis) * (half / count)
    return found
