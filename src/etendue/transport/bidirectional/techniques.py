"""Which techniques sample paths, and how often."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Techniques:
    """Samples that each technique takes at a vertex (0: not used), and the exponent of the heuristic."""

    emission: int = 1  #: the camera sub-path hits a light (s = 0)
    next_event: int = 1  #: a camera vertex is connected to light points (s = 1)
    connection: int = 1  #: a camera vertex is connected to stored light vertices (s >= 2, t >= 2)
    splat: bool = True  #: a light vertex is connected to the camera (t = 1)
    merge: bool = True  #: a camera vertex is merged with stored light vertices around it
    merge_first: bool = True  #: merging at the first camera vertex, too
    direct: bool = True  #: also splats and merges of a light path's first vertex, where next event finds the light
    diffuse: float = 1.0  #: share of the light vertices of :attr:`Kind.DIFFUSE` that are merged
    beta: int = 1  #: 1 balance heuristic, 2 power heuristic

    @property
    def connects(self) -> bool:
        """Whether any technique connects two vertices by an edge (the report's VC)."""
        return bool(self.next_event or self.connection or self.splat)

    @property
    def leaves_direct(self) -> bool:
        """Whether direct light that next event finds is neither splatted nor merged."""
        return not self.direct and self.next_event > 0

    @property
    def thins(self) -> bool:
        """Whether some light vertices are drawn not to be merged."""
        return self.merge and self.diffuse < 1.0

    @property
    def waits(self) -> bool:
        """Whether what a camera vertex adds to the weights depends on the next vertex."""
        return self.leaves_direct or self.thins
