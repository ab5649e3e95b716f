"""Light of patches spread over all of them by an ambient term."""

from __future__ import annotations

from etendue.core import Array
from etendue.surfaces import AmbientTerm, Patches, class_light, class_weights


def spread(patches: Patches, power: Array, term: AmbientTerm, lost: Array | None = None) -> Array:
    """(n, c) irradiance from ``power`` (n, c) that leaves patches. ``lost``: (n,) the share of the light of each patch
    that meets no other patch, such as :attr:`Segments.sky`."""
    weights = class_weights(term, patches.normals)
    irradiance: Array = weights @ class_light(weights, patches.areas, patches.reflectance, power, lost=lost)
    return irradiance
