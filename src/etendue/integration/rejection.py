"""Rejection sampling: independent points distributed as any bounded non-negative function [Neumann 1951].

With ``f = c h g``, h a density that can be sampled and 0 <= g <= 1, a point Y ~ h is accepted if a uniform X <= g(Y).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from etendue.core import Array, is_number, logger

from .densities import Density
from .errors import IntegrationError
from .estimate import Work
from .functions import Box, Integrand

#: Points of the first batch, which gives the first bound if none is given; least number of points of later batches.
_PILOT = 1 << 12


@dataclass(frozen=True)
class Accepted:
    """Independent points.

    Attributes
    ----------
    domain: of the target.
    points: (d, n).
    acceptance: share of the proposals that were accepted.
    tried: number of proposals.
    bound: c, the upper bound of the ratio of target to density that was used.
    rejected: evaluations of the target that were not finite; taken as zero, so never accepted.
    """

    domain: Box
    points: Array
    acceptance: float
    tried: int
    bound: float
    rejected: int

    def __len__(self) -> int:
        return int(self.points.shape[1])


class Rejection:
    """Samples independent points in proportion to a function.

    Parameters
    ----------
    density: h, from which points are proposed, by default uniform. It must be positive where the target is.
    bound: c, an upper bound of the ratio of target to ``density``. ``None`` takes it from the target's range if the
        density is uniform. Otherwise it is the largest ratio so far; when it grows, the points accepted before are
        tested again with their own random numbers, so that all points have the same bound. If a narrow peak is never
        hit, the points are distributed as the target cut off at ``bound``.
    tries: proposals per wanted point, on average, after which sampling is given up.
    """

    def __init__(self, density: Density | None = None, bound: float | None = None, tries: int = 10_000) -> None:
        if bound is not None and not (is_number(bound) and 0 < bound < math.inf):
            raise IntegrationError(f"the bound of a rejection sampler must be positive and finite, not {bound}")
        if tries < 1:
            raise IntegrationError(f"tries must be 1 or more, not {tries}")
        self.density, self.bound, self.tries = density, bound, tries

    def sample(self, target: Integrand, samples: int, seed: int = 0) -> Accepted:
        """``samples`` independent points distributed as ``target``.

        Raises :class:`IntegrationError` if the target is negative somewhere, exceeds a given bound or its declared
        range, or is zero or tiny almost everywhere, so that too few points are accepted.
        """
        if not is_number(samples) or int(samples) != samples or samples < 1:
            raise IntegrationError(f"a sampler needs a whole number of points, at least 1, not {samples}")
        work = Work(target, seed)
        if self.density is not None and self.density.domain != work.box:
            raise IntegrationError(f"the density is on {self.density.domain}, the target on {work.box}")
        given, bound = self._given(work)
        x, ratio, u = np.empty((work.dimension, 0)), np.empty(0), np.empty(0)
        number = np.empty(0, np.int64)
        tried = 0
        while len(u) < samples:
            if tried >= self.tries * samples:
                raise IntegrationError(
                    f"{len(u)} of {tried} points were accepted with the bound {bound:g}, {samples} are wanted: propose "
                    "from a density more like the target, or narrow the domain"
                )
            # As many proposals as needed at the acceptance so far.
            wanted = (samples - len(u)) * max(tried, 1) / max(len(u), 1)
            count = int(min(max(1.1 * wanted, _PILOT), work.backend.batch, self.tries * samples))
            new_x, new_ratio, new_u = self._propose(work, count)
            greatest = float(new_ratio.max())
            if given and greatest > bound * (1 + 1e-6):
                raise IntegrationError(
                    f"the target over the density reaches {greatest:g}, above the bound {bound:g}: raise the bound"
                )
            bound = bound if given else max(bound, greatest)
            x, ratio = np.concatenate([x, new_x], axis=1), np.concatenate([ratio, new_ratio])
            u, number = np.concatenate([u, new_u]), np.concatenate([number, np.arange(tried, tried + count)])
            tried += count
            kept = (u * bound < ratio).nonzero()[0]
            x, ratio, u, number = x[:, kept], ratio[kept], u[kept], number[kept]
        rejected = work.backend.rejected()
        if rejected:
            logger.warning("%d values of the target were not finite; they count as zero", rejected)
        needed = int(number[samples - 1]) + 1
        return Accepted(work.box, x[:, :samples], samples / needed, needed, bound, rejected)

    def _given(self, work: Work) -> tuple[bool, float]:
        """Whether the bound is known, and the bound; 0 if it is not known."""
        if self.bound is not None:
            return True, float(self.bound)
        greatest = work.f.range[1]
        if self.density is None and 0 < greatest < math.inf:
            return True, greatest * work.box.volume
        return False, 0.0

    def _propose(self, work: Work, count: int) -> tuple[Array, Array, Array]:
        """``count`` points of the domain from the density; target over density there; uniform numbers."""
        backend, d = work.backend, work.dimension
        random = backend.uniform(count, d + 1)
        if self.density is None:
            x = work.box.from_unit(random[:d])
            ratio = work.values_at(x, work.box.volume)
        else:
            x, p = self.density.sample(backend, random[:d])
            ratio = work.values_at(x, backend.where(p > 0, 1.0 / backend.where(p > 0, p, 1.0), 0.0))
        backend.compute(ratio, *x)
        values = np.asarray(backend.host(ratio))
        if values.min() < 0:
            raise IntegrationError("the target of a sampler is negative somewhere: it is no density")
        return np.stack([backend.host(v) for v in x]), values, np.asarray(backend.host(random[d]))
