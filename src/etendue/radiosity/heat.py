"""Temperatures and heat of grey patches: some have a temperature, others a heat flux, or exchange heat with a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, short_repr
from etendue.surfaces import STEFAN_BOLTZMANN, Patches

from .errors import RadiosityError
from .solvers.system import Solver, Transport, solve

#: Newton's steps at most, and the change of a temperature, relative, after which they end.
_STEPS, _SETTLED = 60, 1e-11


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What is known of n patches in c cases, such as hours: numbers, (n,), or (n, c).

    emissivity: in [0, 1]. temperature: in kelvin; NaN for a patch whose temperature is to be found, from the balance

        radiosity - irradiance = flux + conductance (ambient - temperature).

    flux: heat that the patch sends into the enclosure, W/m^2; 0 for an adiabatic one. conductance: heat that it
    exchanges with a body of temperature ``ambient`` in kelvin, by air or through a wall, W/(m^2 K).
    """

    emissivity: ArrayLike = 1.0
    temperature: ArrayLike = np.nan
    flux: ArrayLike = 0.0
    conductance: ArrayLike = 0.0
    ambient: ArrayLike = 0.0

    def arrays(self, patches: int) -> dict[str, Array]:
        """Each as (n, c). Raises :class:`RadiosityError` for other shapes and numbers out of range."""
        values = {name: np.asarray(getattr(self, name), dtype=np.float64) for name in self.__dataclass_fields__}
        cases = {v.shape[1] for v in values.values() if v.ndim == 2 and v.shape[1] > 1}
        if len(cases) > 1:
            raise RadiosityError(f"conditions are of different numbers of cases: {sorted(cases)}")
        shape = (patches, *(cases or {1}))
        made = {}
        for name, v in values.items():
            if v.ndim > 2 or (v.ndim and v.shape[0] not in (1, patches)):
                raise RadiosityError(f"{name} is a number, or has a row for each of {patches} patches, not {v.shape}")
            made[name] = np.broadcast_to(v[:, None] if v.ndim == 1 else v, shape)
            bad = ~np.isfinite(made[name]) if name != "temperature" else np.isinf(made[name])
            low = made[name] < (0.0 if name != "flux" else -np.inf)
            if (bad | low).any() or (name == "emissivity" and (made[name] > 1).any()):
                range_ = {"emissivity": "in [0, 1]", "flux": "finite"}.get(name, "at least 0")
                raise RadiosityError(f"{name} must be {range_}")
        return made


@short_repr
@dataclass(frozen=True)
class HeatBalance:
    """Temperatures and heat, (n, c) of n patches in c cases.

    ``temperature``: K; NaN where nothing tells it, as of an adiabatic patch of emissivity 0. ``heat``: W that the patch
    sends into the enclosure. ``radiosity``, ``irradiance``: W/m^2. ``to_sky``: (c,) W. ``steps``: of Newton's method.
    """

    patches: Patches
    temperature: Array
    heat: Array
    radiosity: Array
    irradiance: Array
    to_sky: Array
    steps: int

    @property
    def imbalance(self) -> Array:
        """(c,) heat that is sent and does not reach the sky, relative to all radiation that leaves patches: the error
        of form factors that are not reciprocal, or whose rows do not sum to 1."""
        total = self.patches.areas @ np.abs(self.radiosity)
        lost = np.abs(self.heat.sum(axis=0) - self.to_sky)
        return np.divide(lost, total, out=np.zeros_like(total), where=total > 0)


def heat_balance(
    patches: Patches,
    transport: Transport,
    conditions: Conditions,
    *,
    surroundings: ArrayLike = 0.0,
    solver: Solver | None = None,
    tolerance: float = 1e-10,
) -> HeatBalance:
    """Temperatures and heat of grey patches, for all cases at once.

    surroundings: temperature of a black sky in kelvin, a number or (c,). solver: see :func:`solve`; by default
    conjugate-gradient, or gauss-seidel for form factors that are not reciprocal. tolerance: of its residual.

    Given temperatures and fluxes are a linear system for sigma T^4 and are solved at once. A conductance makes it
    nonlinear: Newton's method then solves it with each patch reflecting dB/dG of its irradiance G, B(G) its radiosity.

    Raises :class:`RadiosityError` for a flux that a patch of emissivity 0 cannot send, a temperature that would have to
    be below zero, heat that can leave by no patch, and if Newton's method does not converge.
    """
    known = conditions.arrays(len(patches))
    sky = STEFAN_BOLTZMANN * np.asarray(surroundings, dtype=np.float64) ** 4
    shape = np.broadcast_shapes(known["flux"].shape, (1, *np.shape(sky)))
    e, t, q, h, ambient = (np.broadcast_to(known[name], shape) for name in known)
    given = ~np.isnan(t)
    impossible = np.flatnonzero((~given & (e == 0) & (h == 0) & (q != 0)).any(axis=1))
    if len(impossible):
        raise RadiosityError(f"patch {impossible[0]} has emissivity 0, and can neither send nor receive a heat flux")
    if solver is None:
        solver = "conjugate-gradient" if transport.exchange_weights is not None else "gauss-seidel"
    coupled = ~given & (h > 0)
    reflectance = np.where(given, 1 - e, 1.0)
    emission = np.where(given, e * STEFAN_BOLTZMANN * np.where(given, t, 0.0) ** 4, q)
    # The first guess of a coupled patch: as warm as its ambient.
    temperature = np.where(given, t, ambient)
    if coupled.any():
        reflectance, emission = _tangent(coupled, temperature, e, q, h, ambient, reflectance, emission)
    for step in range(1, _STEPS + 1):
        radiosity, irradiance = _linear(patches, transport, reflectance, emission, sky, solver, tolerance)
        found = np.where(given, t, _temperatures(irradiance, e, q, h, ambient, patches.areas > 0))
        change = np.abs(found - temperature)[coupled].max(initial=0.0)
        temperature = found
        if change <= _SETTLED * np.abs(temperature[coupled]).max(initial=1.0):
            to_sky = (patches.areas[:, None] * transport.sky[:, None] * (radiosity - sky)).sum(axis=0)
            heat = patches.areas[:, None] * (radiosity - irradiance)
            return HeatBalance(patches, temperature, heat, radiosity, irradiance, to_sky, step)
        reflectance, emission = _tangent(coupled, temperature, e, q, h, ambient, reflectance, emission)
    raise RadiosityError(
        f"temperatures still change by {change:.2g} K after {_STEPS} steps: look for conductances that are far too "
        "small or too large"
    )


def _tangent(
    coupled: NDArray[np.bool_],
    t: Array,
    e: Array,
    q: Array,
    h: Array,
    ambient: Array,
    reflectance: Array,
    emission: Array,
) -> tuple[Array, Array]:
    """Reflectance and emission of the tangent B(G) = E + rho G of coupled patches at their temperatures; others as they
    are."""
    cubic = 4 * e * STEFAN_BOLTZMANN * t**3
    # From e (sigma T^4 - G) = q + h (ambient - T): dT/dG = e / (4 e sigma T^3 + h), and B = G + q + h (ambient - T).
    slope = 1 - h * np.divide(e, cubic + h, out=np.zeros_like(e * h), where=coupled)
    sent = q + h * (ambient - t)
    irradiance = STEFAN_BOLTZMANN * t**4 - np.divide(sent, e, out=np.zeros_like(sent), where=e > 0)
    tangent = sent + (1 - slope) * irradiance
    return np.where(coupled, slope, reflectance), np.where(coupled, tangent, emission)


def _temperatures(irradiance: Array, e: Array, q: Array, h: Array, ambient: Array, exists: NDArray[np.bool_]) -> Array:
    """Temperatures of patches that send q + h (ambient - T): the root of e sigma T^4 + h T = e G + q + h ambient."""
    right = e * irradiance + q + h * ambient
    cold = np.flatnonzero((exists[:, None] & (right < -1e-9 * np.abs(q))).any(axis=1))
    if len(cold):
        raise RadiosityError(
            f"patch {cold[0]} would have to be colder than 0 K to take up the heat flux that it is given"
        )
    right = np.maximum(right, 0.0)
    a = e * STEFAN_BOLTZMANN
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.minimum(np.where(a > 0, (right / a) ** 0.25, np.inf), np.where(h > 0, right / h, np.inf))
        t = np.where((a > 0) | (h > 0), t, np.nan)
        for _ in range(60):  # from above, where the function is convex: every step ends above the root
            change = (a * t**4 + h * t - right) / (4 * a * t**3 + h)
            t = t - np.nan_to_num(change)
    return t


def _linear(
    patches: Patches,
    transport: Transport,
    reflectance: Array,
    emission: Array,
    sky: Array,
    solver: Solver,
    tolerance: float,
) -> tuple[Array, Array]:
    """Radiosity and irradiance for an emission that may be negative, as the difference of two solutions."""
    cases = emission.shape[1]
    sky = np.broadcast_to(np.atleast_1d(sky), (cases,))
    parts = [(np.maximum(emission, 0.0), sky)]
    if (emission < 0).any():
        parts.append((np.maximum(-emission, 0.0), np.zeros(cases)))
    whole = patches.with_properties(
        np.concatenate([reflectance] * len(parts), axis=1),
        np.concatenate([e for e, _ in parts], axis=1),
        np.concatenate([s for _, s in parts]),
    )
    found = solve(whole, transport, solver, tolerance=tolerance)
    if len(parts) == 1:
        return found.radiosity, found.irradiance
    return tuple(x[:, :cases] - x[:, cases:] for x in (found.radiosity, found.irradiance))  # type: ignore[return-value]
