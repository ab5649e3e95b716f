"""A photometric web on the device: the density of rays that follow it exactly, and their directions."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, copied_to_device
from etendue.lighting import PhotometricWeb

#: Largest step between angles gamma in degrees: sines and cosines within a zone are polynomials.
_STEP = 5.0
#: Steps of Newton's method; each of those that would leave the bracket halves it instead.
_NEWTON = 8


class WebTable:
    r"""The intensity of a web over its flux, a density p per solid angle, and its sampling.

    p is bilinear in the angles C and gamma. First gamma is sampled by the zone that it is in and its density there,

    .. math:: p(\gamma) = \sin\gamma \int p(C, \gamma) dC,

    whose integral is linear in gamma, then C, in proportion to p, which is linear between planes. Directions are those
    of :class:`~etendue.lighting.PhotometricWeb`.
    """

    def __init__(self, web: PhotometricWeb) -> None:
        lit = np.flatnonzero(web.candela.any(axis=0))
        #: Cosine to the axis of the outermost direction with light, on the host.
        self.least_cosine = float(np.cos(np.deg2rad(web.gamma[min(lit[-1] + 1, len(web.gamma) - 1)])))
        web = web.subdivided(_STEP)
        c, gamma, density = np.deg2rad(web.c), np.deg2rad(web.gamma), web.candela / web.flux
        steps = 0.5 * np.diff(c)[:, None] * (density[:-1] + density[1:])
        around = np.concatenate([np.zeros((1, len(gamma))), np.cumsum(steps, axis=0)])
        below = np.append(0.0, np.cumsum(web.zonal_flux / web.flux))
        self.planes, self.angles = len(c), len(gamma)
        self.c, self.gamma, self.density, self.around, self.below = map(_table, (c, gamma, density, around, below))

    def arrays(self) -> mi.Float:
        """All numbers that the web consists of, one after the other."""
        return dr.concat([self.c, self.gamma, self.density])

    def pdf(self, d: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Float:
        """Density per solid angle of a direction of any length."""
        gamma = dr.atan2(dr.sqrt(dr.square(d.x) + dr.square(d.y)), -d.z)
        turn = dr.atan2(d.y, d.x)
        c = dr.select(turn < 0.0, turn + dr.two_pi, turn)
        first, last = (dr.gather(mi.Float, self.gamma, mi.UInt32(k), active) for k in (0, self.angles - 1))
        active = active & (gamma >= first) & (gamma <= last)
        i, s = _place(self.c, self.planes, c, active)
        j, t = _place(self.gamma, self.angles, gamma, active)
        low, high = (self._between(self.density, i + k, j, t, active) for k in (0, 1))
        return dr.select(active, dr.lerp(low, high, s), 0.0)

    def sample(self, u: mi.Point2f, active: mi.Bool | bool = True) -> mi.Vector3f:
        """A direction of unit length with this density."""
        j, share = _place(self.below, self.angles, u.y, active)
        start, end = (dr.gather(mi.Float, self.gamma, j + k, active) for k in (0, 1))
        low, high = (self._whole(j + k, active) for k in (0, 1))
        offset = _in_zone(share, start, end - start, low, high)
        t = offset / (end - start)
        # The plane before C is the last one up to which the density around the axis is at most the number.
        wanted = u.x * dr.lerp(low, high, t)
        after = dr.binary_search(1, self.planes - 1, lambda i: self._between(self.around, i, j, t, active) <= wanted)
        i = after - 1
        left = wanted - self._between(self.around, i, j, t, active)
        first, second = (self._between(self.density, i + k, j, t, active) for k in (0, 1))
        c, next_c = (dr.gather(mi.Float, self.c, i + k, active) for k in (0, 1))
        slope = (second - first) / (next_c - c)
        root = first + dr.safe_sqrt(dr.square(first) + 2.0 * slope * left)
        c = dr.minimum(c + dr.select(root > 0.0, 2.0 * left / root, 0.0), next_c)
        (sin_c, cos_c), (sin, cos) = dr.sincos(c), dr.sincos(start + offset)
        return mi.Vector3f(sin * cos_c, sin * sin_c, -cos)

    def _whole(self, j: mi.UInt32, active: mi.Bool | bool) -> mi.Float:
        """The integral of the density over C at the angle ``j``."""
        return dr.gather(mi.Float, self.around, (self.planes - 1) * self.angles + j, active)

    def _between(self, table: mi.Float, i: mi.UInt32, j: mi.UInt32, t: mi.Float, active: mi.Bool | bool) -> mi.Float:
        """The entry of a table of planes and angles for the plane ``i``, between the angle ``j`` and the next."""
        index = i * self.angles + j
        return dr.lerp(dr.gather(mi.Float, table, index, active), dr.gather(mi.Float, table, index + 1, active), t)


def _place(table: mi.Float, size: int, value: mi.Float, active: mi.Bool | bool) -> tuple[mi.UInt32, mi.Float]:
    """(interval of an ascending table that a value is in, how far, from 0 to 1)."""
    index = dr.binary_search(1, size - 1, lambda i: dr.gather(mi.Float, table, i, active) <= value) - 1
    low, high = (dr.gather(mi.Float, table, index + k, active) for k in (0, 1))
    return index, dr.clip((value - low) / (high - low), 0.0, 1.0)


def _in_zone(share: mi.Float, start: mi.Float, width: mi.Float, low: mi.Float, high: mi.Float) -> mi.Float:
    """The offset x, of a zone of angles from ``start``, where the integral of

        (low + (high - low) x / width) sin(start + x)

    is a ``share`` of that of the zone. Narrow zones: sin x and cos x are x - x^3/6 and 1 - x^2/2 + x^4/24."""
    sin, cos = dr.sincos(start)
    slope = (high - low) / width

    def integral(x: mi.Float) -> mi.Float:
        square = dr.square(x)
        even = x * (sin * (1.0 - square / 6.0) + cos * x * (0.5 - square / 24.0))
        rising = square * (sin * (0.5 - square / 8.0) + cos * x * (1.0 / 3.0 - square / 30.0))
        return low * even + slope * rising

    wanted = share * integral(width)
    below, above = mi.Float(0.0), mi.Float(width)
    x = width * share
    for _ in range(_NEWTON):
        excess = integral(x) - wanted
        below, above = dr.select(excess < 0.0, x, below), dr.select(excess < 0.0, above, x)
        following = x - excess / ((low + slope * x) * dr.sin(start + x))
        # Also false for an integrand of zero, as at the pole.
        x = dr.select((following > below) & (following < above), following, 0.5 * (below + above))
    return x


def _table(values: Array) -> mi.Float:
    return copied_to_device(mi.Float, values.ravel().astype(np.float32))
