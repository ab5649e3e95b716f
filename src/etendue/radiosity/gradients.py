"""Gradients of radiosity solutions by one adjoint solve.

For a loss L(B, H) of the solution B = E + rho H, H = F B + s S (sky share s, sky S), let y = dL/dH be the derivative by
light that is added to the irradiance, with all its further bounces, and z = dL/dE that by emission. They satisfy

    z = g + F^T y,    y = h + rho z,    with the given g and h, the partial derivatives by B and by H.

For weights r with r_i F_ij = r_j F_ji, nu = y / r solves the system of radiosities nu = (h + rho g) / r + rho F nu, and
F^T y = r F nu. Then dL/drho = z H and dL/dS = sum(s y). [Lipp 2024] has the adjoint of light tracing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, short_repr
from etendue.surfaces import STEFAN_BOLTZMANN, Patches, thermal

from .errors import RadiosityError
from .factors.formfactors import FormFactors
from .lines.segments import Segments
from .solvers.shot import FirstShot
from .solvers.system import Solution, Solver, Transport, solve

#: A solution belongs to a transport if both have the same irradiance, within this share of the largest.
_SAME = 1e-4
#: Tolerance of the solutions that have one batch of lines less; their differences are of some per cent.
_REPLICATE = 1e-7
#: Temperatures belong to patches that emit as much within this share.
_HEAT = 1e-6


@short_repr
@dataclass(frozen=True)
class Gradient:
    """Derivatives of a loss by the properties of every patch; or, from :func:`gradient_error`, their standard errors.

    ``emission``, ``reflectance``: (n, c). Emission of a patch with a first shot: by light that is added to it and sent
    along the lines, while the shot is kept; see :meth:`along` for the light of the shot.
    ``irradiance``: (n, c) by light that is added to the irradiance of each patch, such as that of another lamp.
    ``sky``: (c,).
    ``emissivity``, ``temperature``: (n,) of grey bodies, if their temperatures were given; per kelvin.
    ``dloss``: (n, c) the given partial derivative by the radiosity.
    """

    patches: Patches
    emission: Array
    reflectance: Array
    irradiance: Array
    sky: Array
    emissivity: Array | None
    temperature: Array | None
    dloss: Array

    @property
    def importance(self) -> Array:
        """(n, c) derivative by power that arrives at each patch: a map of where light helps. Zero for empty patches."""
        return np.where(self.patches.empty[:, None], 0.0, self.irradiance / self.patches.divisors[:, None])

    def along(self, shot: FirstShot) -> Array:
        """(c,) derivative by the brightness of a first shot, relative to its present one: of all its light, as its rays
        have sent it. Raises :class:`RadiosityError` for a shot of other patches."""
        if shot.irradiance.shape != self.irradiance.shape:
            raise RadiosityError("the first shot is that of other patches: shoot at the patches of the gradient")
        return (self.dloss * shot.emission + self.irradiance * shot.irradiance).sum(axis=0)


def gradient(
    solution: Solution,
    transport: Transport,
    dloss: ArrayLike | None = None,
    *,
    dirradiance: ArrayLike | None = None,
    temperatures: ArrayLike | None = None,
    tolerance: float = 1e-10,
) -> Gradient:
    """Derivatives of a loss L of a solution by emission, reflectance and sky, by one more solution of the system.

    They are those of the solution as it was computed, by the transport as it is: as exact as the solution itself.

    transport: that of the solution. Form factors that are not reciprocal are transposed.
    dloss, dirradiance: (n, c), or (n,) for one channel, of any sign: partial derivatives of L by the radiosity and by
        the irradiance of each patch. For a mean over an area they are proportional to the areas.
    temperatures: those given to :func:`thermal`, of one channel: also by emissivity and temperature, where
        E = eps sigma T^4 and rho = 1 - eps.
    tolerance: of the residual of the adjoint system, relative to its largest source.

    Raises :class:`RadiosityError` for a transport or temperatures that are not those of the solution, for a transport
    without exchange weights that is no matrix, and for derivatives that are not finite or have another shape.
    """
    patches, shot = solution.patches, solution.shot
    if dloss is None and dirradiance is None:
        raise RadiosityError("a gradient needs the derivative of a loss: give dloss (by radiosity) or dirradiance")
    g, h = _derivative("dloss", dloss, patches), _derivative("dirradiance", dirradiance, patches)
    if len(transport.outside) != len(patches):
        raise RadiosityError(f"there are {len(patches)} patches, but the transport is that of {len(transport.outside)}")
    carried = solution.radiosity if shot is None else solution.radiosity - shot.emission
    arrives = transport.gather(carried, patches.sky) + (0.0 if shot is None else shot.irradiance)
    if not np.abs(arrives - solution.irradiance).max() <= _SAME * np.abs(solution.irradiance).max():
        raise RadiosityError(
            "the transport is not that of the solution: give the segments or form factors that it was solved with, "
            "without an ambient term"
        )
    z = g + _transposed(h + patches.reflectance * g, patches, transport, tolerance)
    y = h + patches.reflectance * z
    by_reflectance = z * solution.irradiance
    emissivity = temperature = None
    if temperatures is not None:
        t = _temperatures(temperatures, patches)
        black = STEFAN_BOLTZMANN * t**4
        emissivity = z[:, 0] * black - by_reflectance[:, 0]
        temperature = z[:, 0] * (1 - patches.reflectance[:, 0]) * 4 * STEFAN_BOLTZMANN * t**3
    by_sky = (solution.sky_share[:, None] * y).sum(axis=0)
    return Gradient(patches, z, by_reflectance, y, by_sky, emissivity, temperature, g)


def gradient_error(
    solution: Solution,
    segments: Segments,
    dloss: ArrayLike | None = None,
    *,
    dirradiance: ArrayLike | None = None,
    temperatures: ArrayLike | None = None,
) -> Gradient:
    """Standard errors of :func:`gradient` on segments, for the given dloss and dirradiance.

    By the jackknife: for each batch of the lines, solution and gradient are computed again without it, so K batches
    take 2 K solutions. All bounces count, also those of the adjoint. The error of a shot counts in ``reflectance`` and
    ``emissivity``, for its first bounce. For batches of one point sequence the errors are overestimated; for replicates
    they are unbiased. Raises :class:`RadiosityError` for less than two batches, and as :func:`gradient`.
    """
    if not isinstance(segments, Segments):
        raise RadiosityError("standard errors of a gradient come from the batches of lines: give the segments")
    count = segments.batch_count
    if count < 2:
        raise RadiosityError("a standard error needs at least two batches of lines")
    found = gradient(solution, segments, dloss, dirradiance=dirradiance, temperatures=temperatures)
    parts = []
    for k in range(count):
        rest = segments.without(k)
        again = solve(solution.patches, rest, "conjugate-gradient", shot=solution.shot, tolerance=_REPLICATE)
        parts.append(
            gradient(
                *(again, rest, dloss),
                dirradiance=dirradiance,
                temperatures=temperatures,
                tolerance=_REPLICATE,
            )
        )
    errors: dict[str, Any] = {}
    for name in (field.name for field in fields(Gradient) if getattr(found, field.name) is not None):
        if name != "patches":
            errors[name] = np.sqrt((count - 1) * np.var([getattr(part, name) for part in parts], axis=0))
    if solution.shot is not None:
        by_shot = found.emission * solution.shot.error
        errors["reflectance"] = np.hypot(errors["reflectance"], by_shot)
        if temperatures is not None:
            errors["emissivity"] = np.hypot(errors["emissivity"], by_shot[:, 0])
    return replace(found, **errors)


def _transposed(source: Array, patches: Patches, transport: Transport, tolerance: float) -> Array:
    """F^T y for y = source + rho F^T y, (n, c), of any sign."""
    solver: Solver = "conjugate-gradient"
    weights = transport.exchange_weights
    if weights is None:
        if not isinstance(transport, FormFactors):
            raise RadiosityError("gradients need segments, or form factors: this transport has no exchange weights")
        # With the areas as weights, the transposed factors are those of nu.
        solver, weights, transport = "gauss-seidel", patches.areas, transport.transposed()
    r = weights[:, None]
    q = np.divide(source, r, out=np.zeros_like(source), where=r > 0)
    if not q.any():
        return np.zeros_like(source)
    # Patches have no negative emission: the parts of both signs are channels of one system.
    c, sign = patches.channels, np.array([1.0] if (q >= 0).all() else [1.0, -1.0])
    parts = np.concatenate([np.maximum(s * q, 0) for s in sign], axis=1)
    adjoint = patches.with_properties(np.tile(patches.reflectance, len(sign)), parts / np.abs(q).max(), 0.0)
    try:
        solved = solve(adjoint, transport, solver, tolerance=tolerance, max_iterations=10_000)
    except RadiosityError as error:
        raise RadiosityError(f"the adjoint of this loss has no solution: {error}") from None
    gathered = np.abs(q).max() * solved.irradiance.reshape(len(q), len(sign), c)
    return r * (sign[:, None] * gathered).sum(axis=1)


def _derivative(name: str, given: ArrayLike | None, patches: Patches) -> Array:
    """A derivative (n, c); zero where none is given."""
    shape = patches.emission.shape
    if given is None:
        return np.zeros(shape)
    try:
        x = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise RadiosityError(f"{name} is an array of numbers of shape {shape}") from None
    if x.shape == shape[:1] and shape[1] == 1:
        x = x[:, None]
    if x.shape != shape:
        raise RadiosityError(f"{name} has a row for each patch and a column for each channel, {shape}, not {x.shape}")
    bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if len(bad):
        raise RadiosityError(f"{name} of {len(bad)} patches is not finite, the first is patch {bad[0]}")
    return x


def _temperatures(given: ArrayLike, patches: Patches) -> Array:
    """(n,) temperatures, of grey patches that emit accordingly."""
    if patches.channels != 1:
        raise RadiosityError(
            f"derivatives by temperature and emissivity are those of grey bodies in one channel, not in "
            f"{patches.channels}: combine emission and reflectance of the bands"
        )
    grey = thermal(patches, given, 1 - patches.reflectance)
    if not np.allclose(grey.emission, patches.emission, rtol=_HEAT, atol=0):
        raise RadiosityError("the patches do not emit as grey bodies of these temperatures: make them by thermal()")
    return np.broadcast_to(np.asarray(given, dtype=np.float64), (len(patches),))
