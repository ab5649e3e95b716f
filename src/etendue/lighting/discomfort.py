"""Discomfort glare of a view: UGR and DGP of a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, is_number, logger
from etendue.film import LUMINANCE

from .errors import LightingError
from .units import EFFICACY
from .views import View

#: Luminance in cd/m^2 from which pixels are a source of their own, such as the sun in a window.
_PEAK = 5e4
_LARGEST_INDEX = 16.0
#: DGP from which glare is more than imperceptible [Wienold 2009].
_CLASSES = ((0.35, "imperceptible"), (0.40, "perceptible"), (0.45, "disturbing"), (math.inf, "intolerable"))


@dataclass(frozen=True)
class GlareSource:
    """A source of glare.

    Attributes
    ----------
    direction: unit vector in the frame of :class:`View`, the mean by luminance.
    solid_angle: in sr.
    luminance: mean, in cd/m^2.
    position_index: Guth's, see :func:`position_index`.
    """

    direction: Array
    solid_angle: float
    luminance: float
    position_index: float

    @property
    def weight(self) -> float:
        """L^2 omega / P^2, what the source adds to the sums of UGR and DGP."""
        return self.luminance**2 * self.solid_angle / self.position_index**2


@dataclass(frozen=True)
class Glare:
    """Discomfort glare.

    Attributes
    ----------
    ugr: unified glare rating; -inf without sources, inf before a black background.
    dgp: daylight glare probability, 0 to 1.
    vertical_illuminance: E_v at the eye, perpendicular to the line of sight, in lx.
    background_luminance: (E_v without the sources) / pi, in cd/m^2.
    threshold: luminance above which pixels are sources, in cd/m^2.
    covered: share of the hemisphere in front of the eye that the picture shows, weighted by the cosine as in E_v.
    sources: the strongest first.
    """

    ugr: float
    dgp: float
    vertical_illuminance: float
    background_luminance: float
    threshold: float
    covered: float
    sources: tuple[GlareSource, ...]

    @property
    def category(self) -> str:
        """``imperceptible``, ``perceptible`` (DGP from 0.35), ``disturbing`` (0.40) or ``intolerable`` (0.45)."""
        return next(name for limit, name in _CLASSES if self.dgp < limit)

    def summary(self) -> str:
        """``UGR 19.3, DGP 0.26 (imperceptible), 812 lx at the eye, background 120 cd/m^2, 2 sources``."""
        count = len(self.sources)
        return (
            f"UGR {f'{self.ugr:.1f}' if count else '-'}, DGP {self.dgp:.2f} ({self.category}), "
            f"{self.vertical_illuminance:.4g} lx at the eye, background {self.background_luminance:.4g} cd/m^2, "
            f"{count} source{'' if count == 1 else 's'} above {self.threshold:.4g} cd/m^2"
        )


def glare(
    picture: ArrayLike,
    view: View,
    *,
    vertical_illuminance: float | None = None,
    threshold: float = 2000.0,
    relative: bool = False,
    low_light: bool = False,
) -> Glare:
    """Discomfort glare of a picture.

    picture: (height, width) luminance in cd/m^2; or (height, width, 3) linear RGB of a rendering, whose luminance is
        683 lm/W times that of RGB.
    view: what the picture shows of the hemisphere in front of the eye.
    vertical_illuminance: lx at the eye, from a meter there that faces the line of sight; by default that of the
        picture, which is too low, with a warning, if it does not show the hemisphere.
    threshold: luminance in cd/m^2, or with ``relative`` in multiples of the picture's mean, above which pixels are
        sources. Those that touch each other are one; those from 50,000 cd/m^2 are others than those below.
    low_light: multiply DGP by 1 / (1 + exp(4 - 0.024 E_v)), which is 1 from about 400 lx.

    With sums over sources of luminance L, solid angle omega and position index P [CIE 1995, eq. 1; Wienold 2006]::

        UGR = 8 log10(0.25 / L_b  sum L^2 omega / P^2)
        DGP = 5.87e-5 E_v + 0.0918 log10(1 + sum L^2 omega / (E_v^1.87 P^2)) + 0.16

    Raises :class:`LightingError` for a picture with invalid luminances and for illuminances that do not fit it.
    """
    luminance = _luminance(picture)
    directions, solid, projected = view.pixels(*luminance.shape)
    if not (is_number(threshold) and threshold > 0.0):
        raise LightingError(f"the threshold of glare sources is a luminance above 0, not {threshold!r}")
    if relative:
        threshold = threshold * float((luminance * solid).sum() / solid.sum())
    found = (luminance > threshold) & (solid > 0.0)
    sources, direct = [], 0.0
    for brightest in (False, True):
        inside = found & ((luminance >= _PEAK) == brightest)
        direct += float((luminance * projected)[inside].sum())
        sources += _sources(inside, luminance, solid, directions)
    seen = float((luminance * projected).sum())
    covered = float(projected.sum()) / math.pi
    illuminance = _illuminance(vertical_illuminance, seen, direct, covered)
    background = max(illuminance - direct, 0.0) / math.pi
    total = sum(source.weight for source in sources)
    if total > 0.0:
        ugr = 8.0 * math.log10(0.25 / background * total) if background > 0.0 else math.inf
        contrast = total / illuminance**1.87
    else:
        ugr, contrast = -math.inf, 0.0
    dgp = min(5.87e-5 * illuminance + 0.0918 * math.log10(1.0 + contrast) + 0.16, 1.0)
    if low_light:
        dgp /= 1.0 + math.exp(4.0 - 0.024 * illuminance)
    strongest_first = tuple(sorted(sources, key=lambda source: -source.weight))
    return Glare(ugr, dgp, illuminance, background, threshold, covered, strongest_first)


def position_index(directions: ArrayLike) -> Array:
    """Guth's position index (...) of directions (..., 3) in the frame of :class:`View`: how much brighter than at the
    line of sight a source there may be for the same discomfort; 1 to 16.

    Above the line of sight the formula of [Levin 1975] for the curves of [Guth 1963], below it that of [Iwata 2010]
    for the measurements of [Iwata 1997], as in Radiance's ``evalglare`` (from 3.02).
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    from_axis = np.hypot(x, y)
    sigma = np.rad2deg(np.arctan2(from_axis, z))
    tau = np.rad2deg(np.arctan2(np.abs(x), y))  # from the vertical
    above = (35.2 - 0.31889 * tau - 1.22 * np.exp(-2.0 * tau / 9.0)) * 1e-3 * sigma
    above += (21.0 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2
    beta = np.rad2deg(np.arctan2(np.sqrt(from_axis**2 + 0.3225 * y**2), z))
    below = 6.49e-3 * beta + 21e-5 * beta**2
    return np.minimum(np.exp(np.where(y >= 0.0, above, below)), _LARGEST_INDEX)


def _luminance(picture: ArrayLike) -> Array:
    """(height, width) cd/m^2. Raises :class:`LightingError`."""
    values = np.asarray(picture, np.float64)
    if values.ndim == 3 and values.shape[2] == 3:
        values = EFFICACY * values @ np.array(LUMINANCE)
    if values.ndim != 2 or not values.size:
        raise LightingError(f"a picture is (height, width) cd/m^2 or (height, width, 3) RGB, not {values.shape}")
    wrong = ~(np.isfinite(values) & (values >= 0.0))
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise LightingError(
            f"the picture has luminances that are negative or not finite in {wrong.sum()} pixels, the first in row "
            f"{row}, column {column}: render it with a filter without negative lobes, such as box"
        )
    return values


def _illuminance(given: float | None, seen: float, direct: float, covered: float) -> float:
    """E_v of the eye. Raises :class:`LightingError`."""
    if given is None:
        if covered < 1.0 - 1e-6:
            logger.warning(
                f"the picture shows {covered:.0%} of the hemisphere in front of the eye, weighted by the cosine; its "
                f"{seen:.4g} lx are less than those at the eye, so that UGR is too high and DGP wrong: measure the "
                "vertical illuminance there and give it"
            )
        return seen
    if not (is_number(given) and given >= 0.0):
        raise LightingError(f"the vertical illuminance is a number of lx, not {given!r}")
    if given < direct:
        raise LightingError(
            f"the glare sources of the picture alone give {direct:.4g} lx at the eye, more than the vertical "
            f"illuminance of {given:.4g} lx; check its meter, and the field of view"
        )
    return float(given)


def _sources(inside: NDArray[np.bool_], luminance: Array, solid: Array, directions: Array) -> list[GlareSource]:
    """The connected parts of pixels ``inside``."""
    if not inside.any():
        return []
    number = _connected(inside)
    omega, power = solid[inside], (luminance * solid)[inside]
    angles, powers = np.bincount(number, omega), np.bincount(number, power)
    sums = np.stack([np.bincount(number, power * axis) for axis in directions[inside].T], axis=-1)
    centres = sums / np.linalg.norm(sums, axis=-1, keepdims=True)
    rows = zip(centres, angles, powers / angles, position_index(centres), strict=True)
    return [GlareSource(centre, float(angle), float(mean), float(p)) for centre, angle, mean, p in rows]


def _connected(inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """For each pixel ``inside``, in the order of the picture, the number of its connected part (of 8 neighbours)."""
    height, width = inside.shape
    index = np.full((height + 1, width + 2), -1)
    index[:height, 1:-1][inside] = np.arange(np.count_nonzero(inside))
    here = index[:height, 1:-1]
    later = (index[:height, 2:], index[1:, :-2], index[1:, 1:-1], index[1:, 2:])
    pairs = [np.stack([here, there])[:, (here >= 0) & (there >= 0)] for there in later]
    one, other = np.concatenate(pairs, axis=1)
    # Each pixel points to one of its part with a lower number; all point to the lowest in the end.
    root = np.arange(np.count_nonzero(inside))
    while (root[one] != root[other]).any():
        low = np.minimum(root[one], root[other])
        np.minimum.at(root, root[one], low)
        np.minimum.at(root, root[other], low)
        while (root != root[root]).any():
            root = root[root]
    return np.unique(root, return_inverse=True)[1].reshape(-1)
