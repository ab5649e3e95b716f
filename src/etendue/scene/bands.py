"""Bands of wavelengths, which a film records in place of colours: Mitsuba's ``specfilm``.

The value of band b is the integral of the radiance times its sensitivity :math:`s_b`, as in Mitsuba: it is not divided
by the integral of :math:`s_b`. Wavelengths are drawn by the sum of the sensitivities, each over its integral, so that a
narrow band gets as many as a wide one.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, SceneError, UnsupportedError

from .graph import contents, plugin_name

#: Intervals of the density of wavelengths, at most; their width in nanometres, at most; points in each.
_MOST, _WIDTH, _POINTS = 1 << 14, 1.0, 4


class Bands:
    """The bands of a film. Raises :class:`SceneError` for one that is never sensitive.

    ``names``: those of the film's spectra, in its order.
    """

    def __init__(self, film: mi.Film) -> None:
        self.names = band_names(film)
        self._curves = [curve for _, curve in _curves(film)]
        ends = np.array([curve.wavelength_range() for curve in self._curves], np.float64)
        low, high = float(ends[:, 0].min()), float(ends[:, 1].max())
        width = min(_WIDTH, *(float(curve.spectral_resolution()) for curve in self._curves))
        count = min(_MOST, math.ceil((high - low) / width))
        self._edges = np.linspace(low, high, count + 1)
        at = np.linspace(low, high, count * _POINTS + 1)
        values = self._at(at)
        # Between the ends of each band, where its sensitivity may step to 0.
        middles = (np.arange(count * _POINTS) + 0.5) / (count * _POINTS)
        inside = [_value(curve, a + (b - a) * middles) for curve, (a, b) in zip(self._curves, ends, strict=True)]
        self._integrals = np.mean(inside, axis=1) * (ends[:, 1] - ends[:, 0])
        for name, integral in zip(self.names, self._integrals, strict=True):
            if not (integral > 0.0 and np.isfinite(integral)):
                raise SceneError(f"band '{name}' of the film is not sensitive to any wavelength; correct its spectrum")
        relative = (values / self._integrals[:, None]).sum(axis=0)
        # The largest value in each interval, so that no wavelength of a band is left out.
        mass = np.max([relative[k : len(at) - _POINTS + k : _POINTS] for k in range(_POINTS + 1)], axis=0)
        mass = np.maximum(mass, 0.0)
        self._cumulated = np.concatenate([[0.0], np.cumsum(mass)]) / mass.sum()
        self._density = mass / mass.sum() * count / (high - low)

    def sampled(self, places: Array) -> tuple[Array, Array]:
        """For numbers in [0, 1), (n,): (wavelengths; weights of light there, (bands, n), sensitivity over n times the
        density)."""
        interval = np.searchsorted(self._cumulated, places, side="right") - 1
        interval = np.clip(interval, 0, len(self._density) - 1)
        begin, end = self._edges[interval], self._edges[interval + 1]
        first, last = self._cumulated[interval], self._cumulated[interval + 1]
        wavelengths: Array = begin + (end - begin) * (places - first) / (last - first)
        return wavelengths, self._at(wavelengths) / (self._density[interval] * len(places))

    def share(self, weights: Array) -> Array:
        """(bands,) what light of the same radiance at all wavelengths gives with ``weights``, over its true value."""
        result: Array = weights.sum(axis=1) / self._integrals
        return result

    def _at(self, wavelengths: Array) -> Array:
        """(bands, n) sensitivities."""
        return np.array([_value(curve, wavelengths) for curve in self._curves])


def _value(curve: mi.Texture, wavelengths: Array) -> Array:
    """(n,) values of a spectrum."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wavelengths = mi.Spectrum(mi.Float(wavelengths.astype(np.float32)))
    return np.broadcast_to(np.array(curve.eval(si)[0], np.float64), wavelengths.shape)


def band_names(film: mi.Film) -> tuple[str, ...]:
    """Names of the bands of a film, in its order; none if it records colours."""
    return tuple(name for name, _ in _curves(film))


def _curves(film: mi.Film) -> list[tuple[str, mi.Texture]]:
    return contents(film).objects if plugin_name(film) == "specfilm" else []


def require_colours(film: mi.Film, who: str) -> None:
    """Raise :class:`UnsupportedError` for a film of bands, which ``who``, the subject of the message, cannot use."""
    if plugin_name(film) == "specfilm":
        raise UnsupportedError(f"{who} needs colours, not the bands of a 'specfilm'; use an 'hdrfilm'")
