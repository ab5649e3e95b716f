"""Thermal radiation: emission by temperature, grey or in wavelength bands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array

from .errors import SurfaceError
from .patches import Patches

#: W / (m^2 K^4)
STEFAN_BOLTZMANN = 5.670374419e-8
#: Second constant of radiation, m K.
_C2 = 1.438776877e-2


def thermal(
    patches: Patches,
    temperatures: ArrayLike,
    emissivity: ArrayLike | Callable[[Array], ArrayLike],
    *,
    edges: ArrayLike | None = None,
    surroundings: float = 0.0,
) -> Patches:
    """The same patches at these temperatures: their emission is that of grey or banded surfaces, in W/m^2, and their
    reflectance one minus the emissivity.

    temperatures: in kelvin, a number or (n,).
    emissivity: in [0, 1], in the forms of a reflectance of :class:`Patches`; or a function that gives it for the
        temperatures (n,). A surface of emissivity 0 is adiabatic: it reflects everything, whatever its temperature.
    edges: (b + 1,) ascending wavelengths in metres that bound b bands; the last may be infinite. Without them all
        wavelengths are one band.
    surroundings: temperature of a black sky, in kelvin.

    The net heat of a solution is :attr:`Solution.net_power`. Raises :class:`SurfaceError` for temperatures below
    zero, emissivities out of range, and edges that do not ascend.
    """
    t = np.asarray(temperatures, dtype=np.float64)
    if t.shape not in ((), (1,), (len(patches),)):
        raise SurfaceError(f"temperatures are a number, or one for each of {len(patches)} patches, not {t.shape}")
    t = np.broadcast_to(t, (len(patches),))
    if not (np.isfinite(t).all() and (t >= 0).all() and surroundings >= 0):
        raise SurfaceError("temperatures are finite numbers of at least 0 kelvin")
    values = np.asarray(emissivity(t) if callable(emissivity) else emissivity, dtype=np.float64)
    epsilon = values.reshape(-1, 1) if values.ndim < 2 else values
    if not ((epsilon >= 0) & (epsilon <= 1)).all():
        raise SurfaceError("emissivities are in [0, 1]")
    if len(epsilon) not in (1, len(patches)):
        raise SurfaceError(f"emissivity has {len(epsilon)} rows for {len(patches)} patches")
    share, sky = np.ones((len(t), 1)), np.ones((1, 1))
    if edges is not None:
        share, sky = band_shares(t, edges), band_shares(np.array([surroundings]), edges)
    if epsilon.shape[1] not in (1, share.shape[1]) and share.shape[1] != 1:
        raise SurfaceError(f"emissivity has {epsilon.shape[1]} columns for {share.shape[1]} bands")
    if epsilon.shape[1] > 1 and edges is None:
        raise SurfaceError(f"emissivity has {epsilon.shape[1]} columns: give the edges of the bands")
    emission = epsilon * share * STEFAN_BOLTZMANN * t[:, None] ** 4
    reflectance = np.broadcast_to(1 - epsilon, emission.shape)
    return patches.with_properties(reflectance, emission, sky[0] * STEFAN_BOLTZMANN * surroundings**4)


def band_shares(temperatures: ArrayLike, edges: ArrayLike) -> Array:
    """Shares (n, b) of the emission of black bodies of temperatures (n,) between wavelengths ``edges`` (b + 1,).

    Computed by the series in exp(-x), x = c2 / (wavelength temperature), and for small x by the power series [Chang
    1984]. Raises :class:`SurfaceError` for edges that do not ascend from 0 or more.
    """
    return _bands(np.asarray(temperatures, dtype=np.float64), edges)[0]


def band_emission(temperatures: Array, edges: ArrayLike) -> tuple[Array, Array]:
    """Emission (n, b) of black bodies of temperatures (n,) between wavelengths ``edges`` (b + 1,), W/m^2, and its
    derivative by the temperature; as :func:`band_shares`."""
    share, slope = _bands(temperatures, edges)
    cube = STEFAN_BOLTZMANN * temperatures[:, None] ** 3
    return share * cube * temperatures[:, None], (4 * share + slope) * cube


def _bands(temperatures: Array, edges: ArrayLike) -> tuple[Array, Array]:
    """Shares of bands (n, b), and their logarithmic derivatives T df/dT."""
    limits = np.asarray(edges, dtype=np.float64)
    if limits.ndim != 1 or len(limits) < 2 or limits[0] < 0 or not (np.diff(limits) > 0).all():
        raise SurfaceError("edges of bands are two or more wavelengths in metres that ascend, from 0")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        x = np.nan_to_num(_C2 / (limits * temperatures[:, None]), nan=np.inf, posinf=np.inf)
        # Of the share below, d/dx is the integrand of Planck's law.
        slope = np.where((x > 0) & (x < 700), 15 / np.pi**4 * x**4 / np.expm1(x), 0.0)
    return np.diff(_share_below(x), axis=1), np.diff(slope, axis=1)


def _share_below(x: Array) -> Array:
    """Share of black emission at wavelengths below c2 / (x T)."""
    small = np.minimum(x, 1.0)
    powers = 1 / 3 - small / 8 + small**2 / 60 - small**4 / 5040 + small**6 / 272160 - small**8 / 13305600
    share = 1 - 15 / np.pi**4 * small**3 * powers
    is_large = (x > 0.95) & (x < 700)
    y = x[is_large]
    decay, power, terms = np.exp(-y), np.ones_like(y), np.zeros_like(y)
    for k in range(1, 41):
        power *= decay
        terms += power * (((y / k + 3 / k**2) * y + 6 / k**3) * y + 6 / k**4)
    share[is_large] = 15 / np.pi**4 * terms
    share[x >= 700] = 0.0
    return share
