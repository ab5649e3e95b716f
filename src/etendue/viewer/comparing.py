"""The picture beside the picture: by a second method, or a reference, and the error between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.engine import Budget

from .refining import Refinement

Picture = NDArray[np.float32]


@dataclass(eq=False)
class Comparison:
    """Either a ``method`` with settings, which takes turns with the main one so that both have the same time, or a
    ``reference`` picture."""

    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""  #: file of the reference
    reference: Picture | None = None
    map: bool = False  #: show the error instead of the picture
    refinement: Refinement | None = None

    def state(self) -> dict[str, Any]:
        """For the page."""
        return {"method": self.method, "settings": dict(self.settings), "reference": self.name, "map": self.map}

    def restart(self) -> None:
        """What is rendered has changed."""
        self.refinement = None

    def turn(self, main: Refinement, budget: Budget, seed: int) -> Refinement | None:
        """The second refinement, if the next pass is its own."""
        if self.reference is not None:
            return None
        if self.refinement is None:
            if not main.passes:
                return None
            # Another seed: two methods that share paths would agree more than they should.
            self.refinement = Refinement(main.problem, self.method, self.settings, budget, seed + 1)
        if self.refinement.is_done or (self.refinement.seconds > main.seconds and not main.is_done):
            return None
        return self.refinement

    def layers(self) -> Mapping[str, Picture] | None:
        """Its layers, ``None`` before the first pass."""
        if self.reference is not None:
            return {"image": self.reference}
        result = self.refinement.result() if self.refinement is not None else None
        return None if result is None else result.layers

    def progress(self, squared: Array) -> dict[str, Any]:
        """For the page: ``relmse``, the mean of the relative squared errors, and the progress of the second method."""
        finite = squared[np.isfinite(squared)]
        relmse = float(finite.mean()) if finite.size else None
        other = self.refinement.progress() if self.refinement is not None else None
        return {"relmse": relmse, "other": other}
