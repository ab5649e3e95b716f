"""Lines that were cast, and their results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from etendue.core import Measurement
from etendue.surfaces import Patches

if TYPE_CHECKING:
    from .casting import LineCasting
    from .lines.segments import Segments
    from .solvers.shot import FirstShot


@dataclass(frozen=True)
class CastLines:
    """Lines that were cast: a line casting with a measurement, and their results."""

    casting: LineCasting
    measurement: Measurement

    @property
    def patches(self) -> Patches:
        """The patches that the lines went through."""
        return self.casting.patches

    @property
    def count(self) -> int:
        """Number of bundles."""
        return self.casting.bundles(self.measurement)

    def segments(self) -> Segments:
        """See :meth:`LineCasting.segments`."""
        return self.casting.segments(self.measurement)

    def shot(self) -> FirstShot | None:
        """See :meth:`LineCasting.shot`."""
        return self.casting.shot(self.measurement)
