"""The one protocol that joins methods to everything that loops, saves, resumes, distributes or displays them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .measurement import Measurement
from .settings import Settings as AnySettings


@dataclass
class Result:
    """A developed measurement: layers of shape (height, width, channels), float32. ``layers["image"]`` is the picture;
    the other layers, if they were asked for, are the technique families it is the sum of and first-hit layers."""

    layers: dict[str, NDArray[np.float32]]
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def image(self) -> NDArray[np.float32]:
        """The picture, (height, width, 3), linear RGB radiance."""
        return self.layers["image"]


@runtime_checkable
class Method(Protocol):
    """An estimator that is run pass by pass.

    ``prepare`` builds tables and may run pilot passes under a seed role of its own. ``step`` is one pass and, for a
    method without state, a function of its arguments alone: iterations run in any order, anywhere, once each.
    ``develop`` is the only place that divides, normalises or combines.

    A method whose error is not one of pixels has ``noise() -> float | None``, a variance, which budgets and progress
    then take instead of the scatter of ``image``; ``error_cadence`` says by what share passes grow until it is asked
    again.

    A method whose first ``step`` also does what no later one does (a probe) says in ``setup_seconds`` how long that
    took, so that a run with a budget in seconds is not ended by it. One that leaves work for after the last ``step``
    says in ``finish_seconds`` how long that will take; a run with a budget in seconds ends so much earlier.

    A method that divides its work by what is ahead has ``plan(seconds, passes, error)``: it is called before the first
    ``step`` with what the budget has left, each ``None`` where that is not limited.
    """

    name: ClassVar[str]
    Settings: ClassVar[type[AnySettings]]
    #: Keys into ``core/bibliography.bib`` of the papers the method implements.
    citations: ClassVar[tuple[str, ...]]
    settings: AnySettings

    @property
    def samples_per_iteration(self) -> int:
        """Camera paths per pixel that one ``step`` traces (what a budget in samples is counted in)."""
        ...

    def prepare(self, problem: Any, seed: int) -> None:
        """Build what every pass shares. ``problem`` is a ``scene.Problem`` for image methods."""
        ...

    def step(self, iteration: int, seed: int) -> Measurement:
        """One pass. ``iteration`` counts from 0."""
        ...

    def develop(self, measurement: Measurement) -> Result:
        """The picture that the passes in ``measurement`` make."""
        ...

    def state(self) -> Mapping[str, Any]:
        """What ``prepare`` measured (pilot constants) or passes carry on: plain JSON values, and arrays of the host or
        of the device. No later pass changes what is in it, arrays included. It is asked for after every pass, so it
        should cost next to nothing: a method replaces its arrays where it would change them, and lends them."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Inverse of :meth:`state`, called after ``prepare`` when a run is resumed, and when a pass has failed."""
        ...
