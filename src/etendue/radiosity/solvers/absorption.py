"""Whether light is absorbed somewhere, in scenes with patches that reflect everything (adiabatic walls)."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.surfaces import Patches, diagnose, is_interior, surfaces_of

from ..errors import RadiosityError
from ..factors.groups import named_patch

#: Largest share of light that leaves a closed part of a scene because of rounding.
_LEAK = 1e-5
_NO_END = (
    "{} light into a closed part of the scene where all reflectances are 1: it would never be absorbed; give a "
    "patch there a smaller reflectance"
)


class Ends(Protocol):
    """A transport operator, see :class:`Transport`."""

    @property
    def outside(self) -> Array:
        """(n,) the share of the light of each patch that leaves the scene."""
        ...

    @property
    def dark(self) -> Array:
        """(n,) the share of the light of each patch that ends on backs of faces."""
        ...

    def gather(self, values: Array, sky: Array) -> Array:
        """F values plus the light of the sky; (n, c)."""
        ...


def check_absorption(patches: Patches) -> None:
    """Raise :class:`RadiosityError` if, as can be seen without lines, no light is ever absorbed: in a closed room where
    all reflectances are 1."""
    endless = (patches.reflectance >= 1).all(axis=0) & patches.emission.any(axis=0)
    if not endless.any() or (patches.back >= 0).any() or not (is_interior(patches) and diagnose(patches).is_closed):
        return
    part, corners = surfaces_of(patches), patches.vertices[patches.faces]
    for k in np.unique(part):
        ours = corners[part == k].reshape(-1, 3)
        if np.array_equal([ours.min(axis=0), ours.max(axis=0)], patches.bounds):  # around all others
            first = np.flatnonzero((patches.emission > 0)[:, endless].any(axis=1))[0]
            raise RadiosityError(_NO_END.format(f"{named_patch(patches, first)} sends"))


def absorbed(patches: Patches, transport: Ends) -> Patches:
    """The same patches, if all light that they emit can be absorbed, with reflectance 0 where there is no light. Raises
    :class:`RadiosityError` if light stays forever among patches that reflect everything."""
    ends = patches.reflectance < 1
    if ends.all():
        return patches
    ends = _seen_from(ends, transport)
    out, areas = (transport.outside + transport.dark)[:, None], patches.areas[:, None] * ~ends
    # In single precision, a ray in a million passes between two faces.
    is_open = (areas * out).sum(axis=0) > _LEAK * areas.sum(axis=0)
    ends = _seen_from(ends | (is_open & (out > 0)), transport)
    sees = transport.gather(np.ones(len(patches)), np.zeros(1)) + out[:, 0] > 0
    kept = ~ends & sees[:, None]
    lit = np.flatnonzero((kept & (patches.emission > 0)).any(axis=1))
    if len(lit):
        which = named_patch(patches, lit[0]) + (" sends" if len(lit) == 1 else f" and {len(lit) - 1} more send")
        raise RadiosityError(_NO_END.format(which))
    return patches.with_properties(reflectance=np.where(kept, 0.0, patches.reflectance)) if kept.any() else patches


def _seen_from(reached: NDArray[np.bool_], transport: Ends) -> NDArray[np.bool_]:
    """(n, c) all patches from which light gets to those that are ``reached``, over any number of bounces."""
    while True:
        wider = reached | (transport.gather(reached.astype(np.float64), np.zeros(1)) > 0)
        if (wider == reached).all():
            return reached
        reached = wider
