"""Patches as the problem of a method."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from etendue.scene import Problem
from etendue.surfaces import Patches

from .solvers.shot import FirstShot


@dataclass(frozen=True)
class PatchProblem:
    """Patches as the problem of a job. ``source`` is the name of their source, ``scene`` the scene that they are of,
    ``lamps`` the light of its lamps that are no patches."""

    patches: Patches
    source: str = "<patches>"
    scene: Problem | None = None
    lamps: FirstShot | None = None

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the geometry, the properties and the sky; the same in every process."""
        digest = hashlib.blake2b(digest_size=16)
        p = self.patches
        arrays = [p.vertices, p.faces, p.front, p.back, p.labels, p.reflectance, p.emission, p.sky]
        if p.period is not None:
            arrays.append(np.array(p.period))
        for array in arrays if self.lamps is None else [*arrays, self.lamps.irradiance]:
            digest.update(str((array.shape, array.dtype.str)).encode() + np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()
