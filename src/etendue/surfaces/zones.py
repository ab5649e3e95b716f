"""Zones of a building: patches of different ones exchange no light, though their walls lie on each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .patches import Patches

Index = NDArray[np.int64]


def zone_names(patches: Patches) -> tuple[str, ...]:
    """The zones of patches, in the order of their first patches; none if a patch faces several."""
    zones = () if patches.zones is None else dict.fromkeys(patches.zones.tolist())
    return () if "" in zones else tuple(zones)


def zone_parts(patches: Patches) -> Iterator[tuple[str, Patches, Index]]:
    """Each zone, its patches with the obstacles, and the index of each of them in ``patches``; empty patches are left
    out, and zones of nothing else."""
    for name in zone_names(patches):
        ours = patches.zones == name
        if (ours & ~patches.empty).any():
            yield (name, *patches.only(ours, obstacles=True))


def face_zones(patches: Patches) -> Index:
    """(f,) a number for the zone of each face; -1 for obstacles, 0 for all if there are no zones."""
    if patches.zones is None:
        return np.zeros(len(patches.faces), np.int64)
    zone = np.unique(patches.zones, return_inverse=True)[1].reshape(-1)
    return np.where(patches.front < 0, -1, zone[patches.front])
