"""Temperatures and heat of patches: some have a temperature, others a heat flux, or exchange heat with a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, short_repr
from etendue.surfaces import STEFAN_BOLTZMANN, Patches

from .errors import RadiosityError
from .factors.groups import named_patch
from .heatbands import Nodes, check_edges, check_ends, emitted, joint_balance, too_cold
from .solvers.system import Solver, Transport, solve

#: Newton's steps at most, and the change of a temperature, relative, after which they end.
_STEPS, _SETTLED = 60, 1e-11
#: Numbers of patches, cases and bands that are solved for at once.
_MOST = 1 << 19


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What is known of n patches in c cases, such as hours: numbers, (n,), or (n, c).

    emissivity: in [0, 1]; with ``edges``, (n, b) of b bands, in all cases. temperature: in kelvin; NaN for a patch
    whose temperature is to be found, from the balance

        radiosity - irradiance = flux + conductance (ambient - temperature).

    flux: heat that the patch sends into the enclosure, W/m^2; 0 for an adiabatic one. conductance: heat that it
    exchanges with a body of temperature ``ambient`` in kelvin, by air or through a wall, W/(m^2 K).
    surroundings: temperature of a black sky in kelvin, a number or (c,).
    edges: (b + 1,) ascending wavelengths in metres that bound the bands, from 0 to infinity; ``None`` for grey patches.
    nodes: (n,) whole numbers; patches of equal ones of at least 0 have one temperature together, such as both sides of
    a sheet, and the balance is that of their sum.
    """

    emissivity: ArrayLike = 1.0
    temperature: ArrayLike = np.nan
    flux: ArrayLike = 0.0
    conductance: ArrayLike = 0.0
    ambient: ArrayLike = 0.0
    surroundings: ArrayLike = 0.0
    edges: ArrayLike | None = None
    nodes: ArrayLike | None = None

    def arrays(self, patches: int) -> dict[str, Array]:
        """Each as (n, c), the emissivity of bands as (n, b), the surroundings as (c,). Raises :class:`RadiosityError`
        for other shapes and numbers out of range."""
        names = ("emissivity", "temperature", "flux", "conductance", "ambient")
        values = {name: np.asarray(getattr(self, name), dtype=np.float64) for name in names}
        values["surroundings"] = np.atleast_2d(np.asarray(self.surroundings, dtype=np.float64))
        bands = None if self.edges is None else len(check_edges(self.edges)) - 1
        of_cases = [v for name, v in values.items() if bands is None or name != "emissivity"]
        cases = {v.shape[1] for v in of_cases if v.ndim == 2 and v.shape[1] > 1}
        if len(cases) > 1:
            raise RadiosityError(f"conditions are of different numbers of cases: {sorted(cases)}")
        shape = (patches, *(cases or {1}))
        made = {}
        for name, v in values.items():
            if v.ndim > 2 or (v.ndim and v.shape[0] not in (1, patches)):
                raise RadiosityError(f"{name} is a number, or has a row for each of {patches} patches, not {v.shape}")
            goal = shape
            if name == "emissivity" and bands is not None:
                goal = (patches, bands)
                if v.ndim == 2 and v.shape[1] not in (1, bands):
                    raise RadiosityError(f"emissivity has {v.shape[1]} columns for {bands} bands")
            made[name] = np.broadcast_to(v[:, None] if v.ndim == 1 else v, goal)
            bad = ~np.isfinite(made[name]) if name != "temperature" else np.isinf(made[name])
            low = made[name] < (0.0 if name != "flux" else -np.inf)
            if (bad | low).any() or (name == "emissivity" and (made[name] > 1).any()):
                range_ = {"emissivity": "in [0, 1]", "flux": "finite"}.get(name, "at least 0")
                raise RadiosityError(f"{name} must be {range_}")
        made["surroundings"] = made["surroundings"][0]
        return made


@short_repr
@dataclass(frozen=True)
class HeatBalance:
    """Temperatures and heat, (n, c) of n patches in c cases.

    ``temperature``: K; NaN where nothing tells it, as of an adiabatic patch of emissivity 0. ``heat``: W that the patch
    sends into the enclosure. ``radiosity``, ``irradiance``: W/m^2. ``to_sky``: (c,) W. ``steps``: of Newton's method.
    ``residual``: the largest difference from a balance of a patch, relative to the largest radiosity.
    """

    patches: Patches
    temperature: Array
    heat: Array
    radiosity: Array
    irradiance: Array
    to_sky: Array
    steps: int
    residual: float

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
    solver: Solver | None = None,
    tolerance: float = 1e-10,
) -> HeatBalance:
    """Temperatures and heat of patches, for all cases at once.

    solver: see :func:`solve`; by default conjugate-gradient, or gauss-seidel for form factors that are not reciprocal.
    tolerance: of its residual.

    Given temperatures and fluxes of grey patches are a linear system for sigma T^4 and are solved at once. A
    conductance makes it nonlinear: Newton's method then solves it with each patch reflecting dB/dG of its irradiance G,
    B(G) its radiosity. Temperatures to be found that join bands or patches take Newton's steps by GMRES [Saad 1986].

    Raises :class:`RadiosityError` for a flux that a patch of emissivity 0 cannot send, a temperature that would have to
    be below zero, heat that can leave by no patch, and if Newton's method does not converge.
    """
    known = conditions.arrays(len(patches))
    n, cases = known["flux"].shape
    bands = 1 if conditions.edges is None else known["emissivity"].shape[1]
    many = max(_MOST // (n * bands), 1)
    if cases <= many:
        return _balance(patches, transport, conditions, known, solver, tolerance)
    parts = []
    for first in range(0, cases, many):
        some = slice(first, first + many)
        of_cases = {
            name: x if name == "emissivity" and conditions.edges is not None else x[..., some]
            for name, x in known.items()
        }
        parts.append(_balance(patches, transport, conditions, of_cases, solver, tolerance))
    arrays = ("temperature", "heat", "radiosity", "irradiance", "to_sky")
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in arrays}
    steps, residual = (max(getattr(part, name) for part in parts) for name in ("steps", "residual"))
    return HeatBalance(patches, **joined, steps=steps, residual=residual)


def _balance(
    patches: Patches,
    transport: Transport,
    conditions: Conditions,
    known: dict[str, Array],
    solver: Solver | None,
    tolerance: float,
) -> HeatBalance:
    """The balance of cases that fit into memory."""
    edges = None if conditions.edges is None else check_edges(conditions.edges)
    nodes = Nodes(conditions.nodes, patches.areas)
    t, q, h, ambient, sky = (known[name] for name in ("temperature", "flux", "conductance", "ambient", "surroundings"))
    e = known["emissivity"][..., None] if edges is None else known["emissivity"][:, None]
    e = np.broadcast_to(e, (*t.shape, e.shape[-1]))
    given = ~np.isnan(t)
    filled = np.where(given, t, -1.0)
    if (torn := np.flatnonzero((np.abs(filled - nodes.mean(filled)) > 1e-9 * np.abs(filled)).any(axis=1))).size:
        which = named_patch(patches, torn[0])
        raise RadiosityError(f"{which} has one temperature with others: give it to all of them, or to none")
    takes = nodes.mean(e.sum(axis=-1) + h)
    impossible = np.flatnonzero((~given & (takes == 0) & (q != 0)).any(axis=1))
    if len(impossible):
        raise RadiosityError(
            f"{named_patch(patches, impossible[0])} has emissivity 0, and can neither send nor receive a heat flux: "
            "give it an emissivity above 0, or make it adiabatic"
        )
    found = ~given & (takes > 0) & (nodes.mean(np.broadcast_to(patches.areas[:, None], t.shape)) > 0)
    if found.any():
        check_ends(patches, transport, nodes, e, given, found, h)
    if solver is None:
        solver = "conjugate-gradient" if transport.exchange_weights is not None else "gauss-seidel"

    def linear(reflectance: Array, emission: Array, sky: Array) -> tuple[Array, Array]:
        return _linear(patches, transport, reflectance, emission, sky, solver, tolerance)

    light = emitted(sky, edges)[0]
    if edges is None and not nodes.shared.any():
        temperature, sent, steps = _grey(patches, linear, e[..., 0], t, q, h, ambient, light[:, 0])
        sent = sent[..., None]
    else:
        arguments = (edges, nodes, e, t, q, h, ambient, light, found)
        temperature, sent, steps = joint_balance(patches, transport, linear, *arguments)
    # The irradiance anew, so that the residual is that of the whole balance.
    arrived = transport.gather(sent.reshape(len(patches), -1), light.ravel()).reshape(sent.shape)
    off = np.abs(sent - e * emitted(np.nan_to_num(temperature), edges)[0] - (1 - e) * arrived)
    radiosity, irradiance = sent.sum(axis=-1), arrived.sum(axis=-1)
    wanted = q + h * (ambient - np.nan_to_num(temperature))
    missed = np.where(given, 0.0, np.abs(nodes.mean(radiosity - irradiance - wanted)))
    there = patches.areas > 0
    largest = max(off[there].max(initial=0.0), missed[there].max(initial=0.0))
    heat = patches.areas[:, None] * (radiosity - irradiance)
    to_sky = (patches.areas[:, None] * transport.outside[:, None] * (radiosity - light.sum(axis=-1))).sum(axis=0)
    residual = float(largest / max(np.abs(radiosity).max(initial=0.0), 1e-300))
    return HeatBalance(patches, temperature, heat, radiosity, irradiance, to_sky, steps, residual)


def _grey(
    patches: Patches, linear: Any, e: Array, t: Array, q: Array, h: Array, ambient: Array, sky: Array
) -> tuple[Array, Array, int]:
    """Temperatures and radiosities of grey patches, and Newton's steps."""
    given = ~np.isnan(t)
    coupled = ~given & (h > 0)
    reflectance = np.where(given, 1 - e, 1.0)
    emission = np.where(given, e * STEFAN_BOLTZMANN * np.where(given, t, 0.0) ** 4, q)
    # The first guess of a coupled patch: as warm as its ambient.
    temperature = np.where(given, t, ambient)
    if coupled.any():
        reflectance, emission = _tangent(coupled, temperature, e, q, h, ambient, reflectance, emission)
    for step in range(1, _STEPS + 1):
        radiosity, irradiance = linear(reflectance, emission, sky)
        found = np.where(given, t, _temperatures(patches, irradiance, e, q, h, ambient))
        change = np.abs(found - temperature)[coupled].max(initial=0.0)
        temperature = found
        if change <= _SETTLED * np.abs(temperature[coupled]).max(initial=1.0):
            return temperature, radiosity, step
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


def _temperatures(patches: Patches, irradiance: Array, e: Array, q: Array, h: Array, ambient: Array) -> Array:
    """Temperatures of patches that send q + h (ambient - T): the root of e sigma T^4 + h T = e G + q + h ambient."""
    right = e * irradiance + q + h * ambient
    if (cold := (patches.areas > 0)[:, None] & (right < -1e-9 * np.abs(q))).any():
        raise RadiosityError(too_cold(patches, cold, q))
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
    if not emission.any() and not sky.any():
        return np.zeros_like(emission), np.zeros_like(emission)
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
