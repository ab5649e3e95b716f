"""The one protocol that joins methods to everything that loops, saves, resumes, distributes or displays them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

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


#: What passes carry on, by name: plain JSON values, and arrays of the host or of the device. A value: nobody changes
#: what is in it, arrays included. Of a method whose passes carry nothing on it is empty.
State = Mapping[str, Any]


@dataclass(frozen=True)
class Pass:
    """What one ``step`` made: a measurement, and the state for the next pass. They belong together: a measurement is
    added, saved or dropped with its state."""

    measurement: Measurement
    state: State


@runtime_checkable
class Method(Protocol):
    """An estimator that is run pass by pass.

    ``prepare`` builds tables and may run pilot passes under a seed role of its own. ``step`` is one pass, a function of
    its arguments alone: it takes the state that the pass before has left, at first that of ``start``, and returns its
    own. A pass that raises leaves the state of before. Where passes carry nothing on (``carries_on`` is false),
    iterations run in any order, anywhere, once each; else a replica's run one after the other, and replicas, which have
    a seed and a state each, may share one method. ``develop`` is the only place that divides, normalises or combines.

    A method may have these members as well:

    - ``noise(measurement) -> float | None``: its error, a variance, where that is not one of pixels; budgets and
      progress then take it in place of the scatter of ``image``. It is asked for again when the number of passes has
      grown by the share ``error_cadence``.
    - ``setup_seconds``: what its first ``step`` took for work that no later one does (a probe), so that the next pass
      is not expected to take as long.
    - ``finish_seconds(measurement) -> float``: time for the work that follows the last ``step``; a run with a budget
      in seconds ends so much earlier.
    - ``plan(seconds, passes, error)``: called before the first ``step`` with what is left of the budget, each ``None``
      where that is not limited, for a method that divides its work by what is ahead.
    """

    name: ClassVar[str]
    Settings: ClassVar[Any]  #: the class of ``settings``
    #: Keys into ``core/bibliography.bib`` of the papers the method implements.
    citations: ClassVar[tuple[str, ...]]
    #: Whether passes depend on what those before them left in the state.
    carries_on: ClassVar[bool]
    settings: AnySettings

    @property
    def samples_per_iteration(self) -> int:
        """Camera paths per pixel that one ``step`` traces (what a budget in samples is counted in)."""
        ...

    def prepare(self, problem: Any, seed: int) -> None:
        """Build what every pass shares. ``problem`` is a ``scene.Problem`` for image methods."""
        ...

    def start(self) -> State:
        """The state before the first pass of a replica, with what ``prepare`` measured (pilot constants)."""
        ...

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """One pass. ``iteration`` counts from 0."""
        ...

    def enter(self, state: State) -> None:
        """Make ready for passes from ``state`` on, as ``step`` does by itself. Raises :class:`CheckpointError` for one
        that is not of this method and problem."""
        ...

    def develop(self, measurement: Measurement, state: State) -> Result:
        """The picture that the passes in ``measurement`` make; ``state`` is that after the last of them."""
        ...


class Replica:
    """Passes of a prepared method one after the other, each from the state that the one before has left."""

    def __init__(self, method: Method, seed: int, state: State | None = None) -> None:
        self.method, self.seed = method, seed
        #: After the last pass.
        self.state: State = method.start() if state is None else state

    def step(self, iteration: int) -> Measurement:
        """The next pass. If it raises, the state is that of before."""
        made = self.method.step(iteration, self.seed, self.state)
        self.state = made.state
        return made.measurement

    def develop(self, measurement: Measurement) -> Result:
        """The picture of passes of this replica."""
        return self.method.develop(measurement, self.state)


class Carrying(ABC):
    """For methods whose arrays of the device are their state: kernels read them from the object, which each ``step``
    brings into the state that it is given, unless that is the one that it has returned last.

    A subclass has ``_take(state)``, which copies a state into the object and raises :class:`CheckpointError` if it
    does not fit, ``_left()``, its inverse, and ``_step(iteration, seed)``. It replaces its arrays where it would change
    them, so that those of earlier states stay what they were. ``prepare`` begins with :meth:`_forget_states`.
    """

    _held: State | None = None  #: the state that the object is in
    _first: State | None = None  #: that in which ``prepare`` left it

    def start(self) -> State:
        """See :class:`Method`."""
        if self._first is None:
            self._first = self._held = self._left()
        return self._first

    def enter(self, state: State) -> None:
        """See :class:`Method`."""
        self.start()
        if state is not self._held:
            self._held = None  # a state that does not fit may leave the object anywhere
            self._take(state)
            self._held = state

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """See :class:`Method`."""
        self.enter(state)
        try:
            measurement = self._step(iteration, seed)
            left = self._left()
        except BaseException:
            self._held = None  # a pass that raises may, too
            self.enter(state)
            raise
        self._held = left
        return Pass(measurement, left)

    def _forget_states(self) -> None:
        self._held = self._first = None

    @abstractmethod
    def _take(self, state: State) -> None: ...

    @abstractmethod
    def _left(self) -> State: ...

    if TYPE_CHECKING:  # that of the other base class is found behind this one

        def _step(self, iteration: int, seed: int) -> Measurement: ...
