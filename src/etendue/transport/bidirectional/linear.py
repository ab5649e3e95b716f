"""Sample counts that may differ from set to set, and sums of the recursion that are linear in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import mitsuba as mi


@dataclass(frozen=True)
class Counts:
    """Sample counts that may differ from set to set, raised to the exponent of the heuristic."""

    splat: mi.Float | float  #: light paths per camera path of a pixel
    connection: mi.Float | float
    merge: mi.Float | float  #: eta_vm


@dataclass
class Linear:
    """A sum of the recursion, for counts that are given later: ``end + connection n_c + merge eta_vm`` on light
    sub-paths, ``end n_s + connection n_c + merge eta_vm`` on camera sub-paths, where ``end`` belongs to the splat. In
    products with numbers, it must be the left operand."""

    end: mi.Float | float
    connection: mi.Float | float
    merge: mi.Float | float

    def __add__(self, other: Linear) -> Linear:
        return Linear(self.end + other.end, self.connection + other.connection, self.merge + other.merge)

    def __mul__(self, factor: mi.Float | float) -> Linear:
        return Linear(self.end * factor, self.connection * factor, self.merge * factor)

    def at(self, counts: Counts, end: mi.Float | float = 1.0) -> mi.Float:
        """The value for a set of counts; ``end``: count of the term ``end``."""
        return self.end * end + self.connection * counts.connection + self.merge * counts.merge


#: d_vcm or d_vc of a vertex.
Carried: TypeAlias = "mi.Float | Linear"
