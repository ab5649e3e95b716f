"""Solutions of scenes of parts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from etendue.core import Array
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..solvers.system import Solution
from .parts import Tree


@dataclass(frozen=True)
class HierarchicalSolution:
    """Radiosities in a scene of parts, by copies.

    Power (c,): ``sent``, the emission and the light from the sky; ``absorbed``, ``to_sky``, ``lost`` to backs of faces,
    and ``residual``, still unshot. ``received``: (patches, c) power, node by node as in ``tree``; ``error``: its
    standard error, ``None`` for a single pass.
    """

    tree: Tree
    received: Array
    error: Array | None
    sent: Array
    absorbed: Array
    to_sky: Array
    lost: Array
    residual: Array

    @property
    def imbalance(self) -> float:
        """Difference of input and output power, relative to the input, see :class:`Solution`: the power lost to backs
        of faces, and the residual."""
        gone = self.absorbed + self.to_sky
        return float(np.abs(self.sent - gone).sum() / max(self.sent.sum(), 1e-300))

    def irradiance(self, node: int) -> Array:
        """(n, c) irradiance of the patches of a node."""
        return self._rows(self.received, node) / self.tree.areas(node)[:, None]

    def irradiance_error(self, node: int) -> Array | None:
        """(n, c) standard error of :meth:`irradiance`; ``None`` for a single pass."""
        return None if self.error is None else self._rows(self.error, node) / self.tree.areas(node)[:, None]

    def radiosity(self, node: int) -> Array:
        """(n, c) radiosity of the patches of a node."""
        patches = self.tree.parts[self.tree.part[node]].patches
        assert patches is not None, "the part has no patches of its own"
        return patches.emission + patches.reflectance * self.irradiance(node)

    def irradiance_on(self, patches: Patches, joined: bool = False) -> tuple[Array, Array | None]:
        """(n, c) irradiance and its standard error on the ``patches`` that the parts were made of, by the ``numbers``
        of the parts. ``joined``, and always for scenes with copies: on the patches of ``tree.joined()``."""
        parts = [self.tree.parts[k] for k in self.tree.part]
        numbers = np.concatenate([part.numbers for part in parts])
        if joined or len(np.unique(numbers)) < len(numbers):
            numbers = self.tree.numbers_in_joined
        count = np.count_nonzero(~patches.empty)
        if len(numbers) != count:
            raise RadiosityError(f"the scene of parts has {len(numbers)} patches, not {count}")
        areas = patches.divisors[:, None]

        def placed(rows: Array) -> Array:
            result = np.zeros((len(patches), rows.shape[1]))
            result[numbers] = rows
            return result / areas

        return placed(self.received), None if self.error is None else placed(self.error)

    def on(self, patches: Patches, joined: bool = False) -> Solution:
        """This solution on patches in one mesh, see :meth:`irradiance_on`. Shares of the sky are unknown (NaN), unless
        no light reaches the sky."""
        irradiance, _ = self.irradiance_on(patches, joined)
        share = np.full(len(patches), np.nan if self.to_sky.any() else 0.0)
        radiosity = patches.emission + patches.reflectance * irradiance
        left = float((self.residual / np.where(self.sent > 0, self.sent, 1)).max())
        return PartSolution(patches, radiosity, irradiance, share, (left,), whole=self)

    def _rows(self, values: Array, node: int) -> Array:
        return values[self.tree.offsets[node] : self.tree.offsets[node + 1]]


def relative_error(solution: HierarchicalSolution) -> float | None:
    """Standard error of the irradiance, averaged over the surface, relative to the mean irradiance; ``None`` for a
    single pass."""
    light = solution.received.sum()
    return None if solution.error is None or light <= 0 else float(solution.error.sum() / light)


@dataclass(frozen=True)
class PartSolution(Solution):
    """A solution on patches in one mesh, computed with the parts of the scene. Its residual is the share of the sent
    power that is still unshot."""

    whole: HierarchicalSolution | None = None

    @cached_property
    def power(self) -> dict[str, Array]:
        """See :class:`Solution`. Power lost to backs of faces and unshot power are missing, as in other solutions."""
        assert self.whole is not None
        emitted = (self.patches.areas[:, None] * self.patches.emission).sum(axis=0)
        from_sky = np.maximum(self.whole.sent - emitted, 0)
        return {"emitted": emitted, "from_sky": from_sky, "absorbed": self.whole.absorbed, "to_sky": self.whole.to_sky}
