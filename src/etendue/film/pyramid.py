"""Names of the layers of a technique pyramid: one picture for each sampling technique of paths [Veach 1997, fig. 10.3].

``s2_t3`` has 2 vertices of a light sub-path and 3 of a camera sub-path, including the light point and the sensor,
connected by an edge; ``m2_t3`` has the same sub-paths with their ends merged. Each layer exists with MIS weights, as a
part of the picture, and as ``..._unweighted``, the technique alone. ``longer`` is the rest of the picture.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

#: The layer of all paths that are longer than the depth of the pyramid, weighted.
LONGER = "longer"
_ALONE = "_unweighted"
_NAME = re.compile(rf"([sm])(\d+)_t(\d+)({_ALONE})?")


@dataclass(frozen=True, order=True)
class Technique:
    """A sampling technique: vertices of the two sub-paths, and whether their ends are merged."""

    merged: bool
    s: int  #: vertices of the light sub-path, the light point included
    t: int  #: vertices of the camera sub-path, the sensor included

    @property
    def edges(self) -> int:
        """Number of edges of the technique's paths."""
        return self.s + self.t - (2 if self.merged else 1)

    def layer(self, weighted: bool = True) -> str:
        """Name of the technique's layer."""
        return f"{'m' if self.merged else 's'}{self.s}_t{self.t}{'' if weighted else _ALONE}"

    @staticmethod
    def of_layer(name: str) -> tuple[Technique, bool] | None:
        """The technique and whether the layer is weighted; ``None`` for a layer of another kind."""
        match = _NAME.fullmatch(name)
        return (Technique(match[1] == "m", int(match[2]), int(match[3])), match[4] is None) if match else None
