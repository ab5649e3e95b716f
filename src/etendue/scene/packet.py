"""Wavelengths of a pass, and the colour of their light.

Under a spectral variant, light is carried at four wavelengths, the *packet*, which all paths of a pass share: a vertex
of a light path can then be joined to any camera path. The wavelengths are evenly spread over a distribution that
follows the sensitivity of the eye [Radziszewski 2009], and those of successive passes fall between each other, so that
R passes are a quadrature of 4 R points. Under other variants light has no wavelengths: it is RGB.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, UnsupportedError
from etendue.points import Sobol

from .bands import Bands

#: Flag of materials that refract light of different wavelengths in different directions. Refracted paths go on with the
#: hero alone; from there on, all wavelengths of their rays are the hero's.
DISPERSES = 1 << 24
_HERO: ContextVar[bool] = ContextVar("hero", default=False)
#: Weight of a pass for a band that none of its wavelengths is in.
LEAST_WHITE = 1e-9
#: Steps of the tables of colour matching functions and of D65, which are linear in between, in nanometres.
_STEP = 5.0


def is_spectral() -> bool:
    """Whether light has wavelengths under the current variant."""
    return "spectral" in (mi.variant() or "")


def is_rgb() -> bool:
    """Whether light is RGB under the current variant."""
    return (mi.variant() or "").endswith("rgb")


def require_rgb(what: str) -> None:
    """Raise :class:`UnsupportedError` unless light is RGB. ``what``: the subject of the message, in the plural."""
    if not is_rgb():
        raise UnsupportedError(
            f"{what} are computed in RGB, not under {mi.variant()}; set an RGB variant (llvm_ad_rgb)"
        )


def brightness(light: mi.Spectrum) -> mi.Float:
    """Luminance of RGB, the mean of other light: for choices, which any measure serves."""
    return mi.luminance(light) if is_rgb() else dr.mean(light)


@contextmanager
def hero_chosen() -> Iterator[None]:
    """Materials that are called inside the block let the hero go on alone, in place of a wavelength at random."""
    token = _HERO.set(True)
    try:
        yield
    finally:
        _HERO.reset(token)


def is_hero_chosen() -> bool:
    """Whether this is inside a block of :func:`hero_chosen`."""
    return _HERO.get()


def hero_alone(wavelengths: mi.Spectrum) -> mi.Bool:
    """Lanes whose path carries light of the hero only, whose throughput counts four times."""
    return wavelengths[1] == wavelengths[0]


def spread_wavelengths(lanes: int = 1) -> mi.Spectrum:
    """Wavelengths between 400 and 700 nm, evenly spread over all lanes; none unless the variant is spectral."""
    if not is_spectral():
        return mi.Color0f()
    lane = dr.arange(mi.Float, lanes)
    return mi.Spectrum(*(400.0 + 75.0 * (k + (lane + 0.5) / lanes) for k in range(4)))


def entry(values: Iterable[mi.Float], number: mi.UInt32) -> mi.Float:
    """One of some values by its number, as of a spectrum by that of a wavelength."""
    *others, found = values
    for k, one in reversed(list(enumerate(others))):
        found = dr.select(number == k, one, found)
    return found


class Packet:
    """The wavelengths of the pass that is being made; none, unless the variant is spectral.

    ``wavelengths`` (nanometres) are those of rays and interactions; the first is the *hero*. ``white``: (3,) colour of
    the pass in linear sRGB if all light is D65 and nothing absorbs: 1 in the mean over passes. The picture is divided
    by the mean of its passes.

    ``bands``: those of a film that records no colours. ``white`` then is the value of each band for light of the same
    radiance at all wavelengths, over its true value.
    """

    def __init__(self, bands: Bands | None = None) -> None:
        self.bands = bands
        self.wavelengths = spread_wavelengths()
        self.white: Array = np.ones(3)
        self.choose(0, 0)

    def choose(self, iteration: int, seed: int, disperses: bool = False) -> None:
        """Take the wavelengths of a pass. ``disperses``: the hero, which goes on alone where light is dispersed, is
        evenly spread over passes, else the four together are."""
        if not is_spectral():
            return
        # Evenly spaced after 2^m passes, and shifted at random. In quarters, the first number is the place in each, and
        # the second says which is the hero's: a (0, 2)-sequence.
        (first, second), shift = Sobol(2).value(iteration & 0xFFFFFFFF), np.random.default_rng(seed).random(2)
        hero = (first + shift[0]) % 1.0
        if not disperses:
            hero = (np.floor(4.0 * second) + hero) / 4.0
        places = (hero + np.arange(4) / 4.0) % 1.0
        if self.bands is not None:
            wavelengths, self._in_bands = self.bands.sampled(places)
            # A band that the pass does not serve has next to no weight in the mean of passes.
            self.white = np.maximum(self.bands.share(self._in_bands), LEAST_WHITE)
            self.wavelengths = _opaque(wavelengths)
            return
        wavelengths, density = _sampled(places)
        *matching, light = (np.interp(wavelengths, *curve) for curve in _curves(mi.variant()))
        matrix = np.array(matching) / (4.0 * density)
        self.white = matrix @ light
        self.wavelengths, self._light, *self._rows = (_opaque(row) for row in (wavelengths, light, *matrix))

    @contextmanager
    def drawn(self, u: mi.Float | None) -> Iterator[None]:
        """Inside the block the wavelengths are those of numbers ``u``, one lane each, uniform in [0, 1); ``None``
        leaves them as they are. For methods whose paths have wavelengths of their own."""
        if u is None:
            yield
            return
        kept = self.wavelengths, self._light, self._rows
        rate, middle, low, high = _shape()
        hero = [u + k / 4.0 for k in range(4)]
        places = mi.Spectrum(*(x - dr.floor(x) for x in hero))
        wavelengths = middle + dr.atanh(low + (high - low) * places) / rate
        inverse = (high - low) / rate * dr.square(dr.cosh(rate * (wavelengths - middle)))
        columns = [mi.xyz_to_srgb(mi.cie1931_xyz(one)) * mi.MI_CIE_Y_NORMALIZATION for one in wavelengths]
        self.wavelengths = wavelengths
        self._light = mi.Spectrum(*(mi.cie_d65(one) for one in wavelengths))
        self._rows = [mi.Spectrum(*(column[i] for column in columns)) * inverse * 0.25 for i in range(3)]
        try:
            yield
        finally:
            self.wavelengths, self._light, self._rows = kept

    def rgb(self, light: mi.Spectrum) -> mi.Color3f:
        """Light in linear sRGB; a colour remains as it is."""
        if isinstance(light, mi.Color3f):
            return light
        if not is_spectral():
            return mi.Color3f(light[0])
        return mi.Color3f(*(dr.dot(row, light) for row in self._rows))

    def recorded(self, light: mi.Spectrum) -> mi.Color3f | mi.Spectrum:
        """Light as a pass sums it: :meth:`rgb`, or light at the four wavelengths if the film records bands."""
        return self.rgb(light) if self.bands is None else mi.Spectrum(light)

    def in_bands(self, sums: NDArray[np.float32]) -> NDArray[np.float32]:
        """Sums of recorded light, (..., 4), as the film's bands, (..., bands)."""
        return np.ascontiguousarray(sums @ self._in_bands.T.astype(np.float32))

    def albedo(self, share: mi.Spectrum) -> mi.Color3f:
        """The colour of what reflects a share of the light, under D65."""
        return self.rgb(share * self._light if is_spectral() else share)


def _shape() -> tuple[float, float, float, float]:
    """Rate and middle of the density of wavelengths, and its cumulated function at the ends, from 360 to 830 nm."""
    rate, middle = 0.0072, 538.0
    low, high = (float(np.tanh(rate * (end - middle))) for end in (mi.MI_CIE_MIN, mi.MI_CIE_MAX))
    return rate, middle, low, high


def _sampled(u: Array) -> tuple[Array, Array]:
    """(wavelengths between 360 and 830 nm for numbers in [0, 1), their density)."""
    rate, middle, low, high = _shape()
    wavelengths = middle + np.arctanh(low + (high - low) * u) / rate
    return wavelengths, rate / ((high - low) * np.cosh(rate * (wavelengths - middle)) ** 2)


@cache
def _curves(variant: str) -> list[tuple[Array, Array]]:
    """(wavelengths, values) of linear sRGB for radiance at one wavelength, three curves, and of D65 with luminance
    1."""
    at = np.arange(mi.MI_CIE_MIN, mi.MI_CIE_MAX + 0.5 * _STEP, _STEP)
    wavelengths = mi.Float(np.minimum(at, mi.MI_CIE_MAX - 1e-3).tolist())
    matching = mi.xyz_to_srgb(mi.cie1931_xyz(wavelengths)) * mi.MI_CIE_Y_NORMALIZATION
    light = mi.cie_d65(wavelengths)
    return [(at, np.array(curve, np.float64)) for curve in (*matching, light)]


def _opaque(numbers: Array) -> mi.Spectrum:
    return mi.Spectrum(*(dr.opaque(mi.Float, float(number)) for number in numbers))
