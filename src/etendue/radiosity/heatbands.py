"""The balance of heat where unknown temperatures join wavelength bands, or several patches. Arrays are (n, c, b):
patches, cases, bands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array
from etendue.surfaces import STEFAN_BOLTZMANN, Patches, band_emission

from .errors import RadiosityError
from .factors.groups import named_patch
from .solvers.system import Transport

#: Newton's steps at most; the change of a temperature, relative, after which they end; and the last residual of GMRES.
_STEPS, _SETTLED, _RESIDUAL = 100, 1e-9, 1e-12
#: A temperature in kelvin from which a patch without any other hint starts, and one that is as good as 0.
_WARM, _COLD = 300.0, 1e-3
#: Largest share of radiation that leaves a closed part of a scene because of rounding.
_LEAK = 1e-5


def check_edges(edges: ArrayLike) -> Array:
    """Edges of bands (b + 1,), in metres. Raises :class:`RadiosityError` unless they ascend from 0 to infinity."""
    limits = np.asarray(edges, dtype=np.float64)
    if limits.ndim != 1 or len(limits) < 2 or limits[0] != 0 or not np.isinf(limits[-1]):
        raise RadiosityError("bands of heat cover all wavelengths: the first begins at 0, the last ends at infinity")
    if not (np.diff(limits[:-1]) > 0).all() or np.isinf(limits[:-1]).any():
        raise RadiosityError("edges of bands ascend")
    return limits


def emitted(temperatures: Array, edges: ArrayLike | None) -> tuple[Array, Array]:
    """(..., b) power per area of black bodies of these temperatures in the bands, and its derivative; one band without
    edges."""
    if edges is None:
        cube = STEFAN_BOLTZMANN * temperatures[..., None] ** 3
        return cube * temperatures[..., None], 4 * cube
    # Many patches have the same temperature.
    known, place = np.unique(temperatures, return_inverse=True)
    whole, slope = (x[place.reshape(temperatures.shape)] for x in band_emission(known, edges))
    return whole, slope


class Nodes:
    """Patches that have one temperature together: those of equal numbers (n,) of at least 0. ``None``: no two have."""

    def __init__(self, numbers: ArrayLike | None, areas: Array) -> None:
        n = len(areas)
        own = np.arange(n)
        if numbers is None:
            self.shared = np.zeros(n, dtype=bool)
            self._node = own
        else:
            given = np.asarray(numbers)
            if given.shape != (n,) or given.dtype.kind not in "iu":
                raise RadiosityError(f"nodes are whole numbers, one for each of {n} patches, not {given.shape}")
            _, inverse, members = np.unique(
                np.where(given < 0, given.max() + 1 + own, given), return_inverse=True, return_counts=True
            )
            self._node = inverse.reshape(-1)
            self.shared = members[self._node] > 1
        whole = np.bincount(self._node, areas)[self._node]
        self._weights = np.divide(areas, whole, out=1 / np.bincount(self._node)[self._node], where=whole > 0)

    def mean(self, values: Array) -> Array:
        """(n, c) means over the area of each node; of patches of their own the values as they are."""
        if not self.shared.any():
            return values
        sums = np.stack([np.bincount(self._node, self._weights * column) for column in values.T], axis=1)
        return np.where(self.shared[:, None], sums[self._node], values)


def joint_balance(
    patches: Patches,
    transport: Transport,
    linear: Callable[[Array, Array, Array], tuple[Array, Array]],
    edges: Array | None,
    nodes: Nodes,
    e: Array,
    t: Array,
    q: Array,
    h: Array,
    ambient: Array,
    sky: Array,
    found: NDArray[np.bool_],
) -> tuple[Array, Array, int]:
    """Temperatures (n, c) and radiosities (n, c, b) of patches with emissivities ``e`` (n, c, b), and Newton's steps.

    linear: radiosity and irradiance in channels, of reflectance, emission and sky. sky: (c, b). found: which
    temperatures are to be found; those that are neither given nor found are NaN. The other arguments are (n, c), see
    :class:`Conditions`.

    The emission of a band, p(T), is convex in T, so that Newton's steps for the balances of all patches end above the
    solution and descend to it, however far they begin. In each step, T = T' + d is eliminated:

        d = (q + h (ambient - T') - sum_b e_b (p_b - G_b)) / (sum_b e_b dp_b/dT + h),

    with the means of both over the patches of a node.
    """
    shape, given = e.shape, ~np.isnan(t)
    if given.all():
        reflectance, emission = (x.reshape(len(patches), -1) for x in (1 - e, e * emitted(t, edges)[0]))
        return t, linear(reflectance, emission, sky.ravel())[0].reshape(shape), 1
    lost = ~given & ~found
    hottest = max(_WARM, np.nan_to_num(t).max(), ambient.max(), (np.abs(q).max() / STEFAN_BOLTZMANN) ** 0.25)
    temperature = np.where(given, t, hottest)
    arrived, moved = np.zeros(shape), 1.0
    for step in range(1, _STEPS + 1):
        emission, slope = (e * x for x in emitted(temperature, edges))
        own, slope = np.where(lost[..., None], 0.0, emission), np.where(found[..., None], slope, 0.0)
        inertia = np.where(found, np.maximum(nodes.mean(slope.sum(axis=-1) + h), 1e-300), 1.0)
        missing = np.where(found, nodes.mean(q + h * (ambient - temperature) - own.sum(axis=-1)), 0.0)
        gain = slope / inertia[..., None]
        residual = np.clip(1e-4 * moved, _RESIDUAL, 1e-4)
        arrived = _gmres(transport, nodes, own + gain * missing[..., None], gain, e, sky, arrived, residual)
        missing = np.where(found, missing + nodes.mean((e * arrived).sum(axis=-1)), 0.0)
        after = np.clip(temperature + missing / inertia, temperature / 2, 2 * temperature)
        after = np.where(found, np.maximum(after, _COLD), temperature)
        moved = float(np.abs(after - temperature).max() / temperature[found].max(initial=1.0))
        temperature = after
        if moved <= _SETTLED:
            cold = found & (temperature <= _COLD)
            if (frozen := cold & (missing < -1e-9 * np.abs(q).max())).any():
                raise RadiosityError(too_cold(patches, frozen, q))
            temperature = np.where(lost, np.nan, np.where(cold, 0.0, temperature))
            return temperature, e * emitted(np.nan_to_num(temperature), edges)[0] + (1 - e) * arrived, step
    raise RadiosityError(
        f"temperatures still change by {moved:.2g} of their size after {_STEPS} steps: look for conductances and "
        "emissivities that are far too small or too large"
    )


def _gmres(
    transport: Transport,
    nodes: Nodes,
    emission: Array,
    gain: Array,
    e: Array,
    sky: Array,
    start: Array,
    residual: float,
) -> Array:
    """The irradiance G of the bands with radiosities emission + (1 - e) G + gain mean(sum(e G)) [Saad 1986]."""
    from scipy.sparse.linalg import LinearOperator, gmres

    shape = emission.shape
    dark = np.zeros(sky.size)

    def gather(values: Array, light: Array) -> Array:
        return transport.gather(values.reshape(shape[0], -1), light).reshape(shape)

    def system(flat: Array) -> Array:
        g = flat.reshape(shape)
        taken = nodes.mean((e * g).sum(axis=-1))
        return (g - gather((1 - e) * g + gain * taken[..., None], dark)).ravel()

    right = gather(emission, sky.ravel()).ravel()
    operator = LinearOperator((right.size, right.size), matvec=system, dtype=np.float64)
    found, failed = gmres(operator, right, x0=start.ravel(), rtol=residual, restart=60, maxiter=20)
    if failed and np.abs(system(found) - right).max() > max(1e-6, 10 * residual) * np.abs(right).max():
        raise RadiosityError("the exchange in bands does not converge: almost nothing absorbs, or heat cannot leave")
    return np.asarray(found.reshape(shape), np.float64)


def too_cold(patches: Patches, frozen: NDArray[np.bool_], flux: Array) -> str:
    """A message on one of the ``frozen`` patches (n, c), which take up more heat than they can: of those that are to
    take up some, if there are."""
    asked = frozen & (flux < 0)
    which = np.flatnonzero((asked if asked.any() else frozen).any(axis=1))[0]
    return (
        f"{named_patch(patches, which)} would have to be colder than 0 K to take up the heat flux that it is given: "
        "give it a smaller one, or surfaces around it that are warmer"
    )


def check_ends(
    patches: Patches,
    transport: Transport,
    nodes: Nodes,
    e: Array,
    given: NDArray[np.bool_],
    found: NDArray[np.bool_],
    h: Array,
) -> None:
    """Raise :class:`RadiosityError` if the heat of a patch whose temperature is to be ``found`` cannot get to where it
    ends: a patch with a temperature or conductance, or the outside. It goes on in the band of a reflection, in every
    band from a patch that absorbs it, and from all patches of its node."""
    # Most cases are alike in this.
    _, kept = np.unique(np.concatenate([given, found, h > 0, *np.moveaxis(e, -1, 0)]), axis=1, return_index=True)
    e, given, found, h = e[:, kept], given[:, kept], found[:, kept], nodes.mean(h)[:, kept]
    takes, out, areas = e > 0, transport.outside + transport.dark, patches.areas[:, None, None]

    def spread(reached: NDArray[np.bool_], is_open: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n, c, b) all radiation, by the patch at which it arrives, that gets to what is ``reached`` or open."""
        while True:
            values = reached.astype(np.float64).reshape(len(patches), -1)
            sent = (transport.gather(values, np.zeros(1)).reshape(e.shape) > 0) | is_open
            again = found & (nodes.mean(np.asarray((takes & sent).any(axis=-1), np.float64)) > 0)
            wider = reached | ((e < 1) & sent) | (takes & again[..., None])
            if (wider == reached).all():
                return reached
            reached = wider

    ends = spread(takes & (given | (h > 0))[..., None], np.zeros(e.shape, dtype=bool))
    # In single precision, a ray in a million passes between two faces.
    leaks = (areas * ~ends * out[:, None, None]).sum(axis=0) <= _LEAK * (areas * ~ends).sum(axis=0)
    ends = spread(ends, ~leaks & (out > 0)[:, None, None])
    sees = transport.gather(np.ones(len(patches)), np.zeros(1)) + out > 0
    stuck = np.flatnonzero((found & (h == 0) & ~(ends & takes).any(axis=-1) & sees[:, None]).any(axis=1))
    if len(stuck):
        raise RadiosityError(
            f"the heat of {named_patch(patches, stuck[0])} cannot leave: give a patch that it reaches a temperature or "
            "a conductance, and an emissivity above 0, if by bands in a band that arrives there"
        )
