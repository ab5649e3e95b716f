"""The protocol of methods, which the engine runs, saves and resumes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .frozen import uncollected
from .measurement import Measurement
from .notebooks import InNotebooks
from .reprs import short_repr


@short_repr
@dataclass
class Result(InNotebooks):
    """A developed measurement: layers of shape (height, width, channels), float32. ``layers["image"]`` is the picture;
    other layers, if requested, are technique families, whose sum is the picture, and first-hit layers."""

    layers: dict[str, NDArray[np.float32]]
    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def image(self) -> NDArray[np.float32]:
        """The picture, (height, width, 3), linear RGB radiance."""
        return self.layers["image"]


#: State of a method between passes, by name: JSON values, and arrays on the host or the device, which are never
#: modified. Empty for methods without state.
State = Mapping[str, Any]


def on_host(state: Any) -> Any:
    """A state with arrays of the device as NumPy's."""
    if isinstance(state, np.generic):
        return state.item()
    if hasattr(state, "__array__"):
        return np.array(state)
    if isinstance(state, Mapping):
        return {name: on_host(value) for name, value in state.items()}
    if isinstance(state, (list, tuple)):
        return [on_host(value) for value in state]
    return state


@dataclass(frozen=True)
class Pass:
    """The result of one ``step``: a measurement, and the state for the next pass. Both are added, saved or dropped
    together."""

    measurement: Measurement
    state: State


class Method(ABC):
    """An estimator that runs in passes.

    ``prepare`` builds tables and may run pilot passes with a seed role of their own. ``step`` is one pass, a function
    of its arguments only: it gets the state after the previous pass, or that of ``start``, and returns a new state. If
    it raises, the previous state stays valid. If ``carries_on`` is false, iterations may run in any order on any
    machine, once each. Otherwise the iterations of a replica run one after the other; replicas, with a seed and a state
    each, may share a method object. Only ``develop`` divides, normalises or combines.

    The members after ``develop`` are hooks: the engine calls them, and a method overrides those that it needs.
    """

    name: ClassVar[str]
    Settings: ClassVar[Any]  #: the class of ``settings``
    #: Keys in ``core/bibliography.bib`` of the papers that the method implements.
    citations: ClassVar[tuple[str, ...]] = ()
    #: Whether a pass depends on the state after the previous one.
    carries_on: ClassVar[bool] = False
    #: What a budget counts beside seconds and error: camera paths per pixel, or ``passes``, or other samples.
    counts: ClassVar[str] = "spp"
    settings: Any

    @property
    @abstractmethod
    def samples_per_iteration(self) -> int:
        """Samples of one ``step``, the unit of a budget in samples; of pictures, camera paths per pixel."""

    @abstractmethod
    def prepare(self, problem: Any, seed: int) -> None:
        """Build the tables that all passes share. ``problem`` is a ``scene.Problem`` for image methods."""

    def start(self) -> State:
        """The state before the first pass of a replica, including constants measured by ``prepare``."""
        return {}

    def enter(self, state: State) -> None:  # noqa: B027 (without a state there is nothing to load)
        """Load ``state``, as ``step`` also does. Raises :class:`CheckpointError` for a state that does not fit this
        method and problem."""

    @abstractmethod
    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """One pass. ``iteration`` counts from 0."""

    @abstractmethod
    def develop(self, measurement: Measurement, state: State) -> Result:
        """The picture of the passes in ``measurement``; ``state``: the state after the last pass."""

    # ------------------------------------------------------------------ hooks

    #: Passes of a run with a budget in samples, if there are as many samples.
    least_passes: int = 1
    #: Seconds of the first ``step`` for work that later steps do not repeat (a probe); subtracted in the prediction of
    #: the next pass.
    setup_seconds: float = 0.0
    #: Whether ``noise`` is fast enough to be evaluated after each pass when a run is about to reach its error.
    has_fast_noise: ClassVar[bool] = True

    @property
    def error_cadence(self) -> float:
        """``noise`` is evaluated again after the number of passes has grown by the factor ``1 + error_cadence``."""
        return 0.05

    def samples_for(self, problem: Any) -> int | None:
        """:attr:`samples_per_iteration` before :meth:`prepare`; ``None`` if only ``prepare`` determines it."""
        return None

    def passes_for(self, problem: Any) -> int:
        """:attr:`least_passes` for a problem, which may need more."""
        return self.least_passes

    def noise(self, measurement: Measurement) -> float | None:
        """Variance of the result, which budgets and progress use; by default that of the pixels of ``image``. ``None``
        if it is not known."""
        return measurement.relative_error() if measurement.has_error() else None

    def finish_seconds(self, measurement: Measurement) -> float:
        """Seconds of the work after the last ``step``; a run with a budget in seconds ends earlier by this time."""
        return 0.0

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:  # noqa: B027
        """Called before the first ``step`` of a run with its budget, ``None`` for each quantity without a limit.
        ``passes`` are all of a run, those of a checkpoint included, so that a continued run decides as a whole one. The
        time of preparation is not subtracted from ``seconds``, so that decisions by ``seconds`` do not depend on the
        clock."""

    def for_workers(self) -> tuple[str | None, dict[str, Any]]:
        """How a worker makes the method, if its class takes more than the settings: the name ``module:name`` of a
        function of (settings, problem, **arrays), and the arrays."""
        return None, {}

    def attributes_for_workers(self) -> dict[str, Any]:
        """Attributes that are set on the prepared method in workers."""
        return {}

    @classmethod
    def plugin_name(cls) -> str:
        """Name of the Mitsuba integrator, "" if there is none."""
        return ""


class _Prepares(Protocol):
    def prepare(self, problem: Any, seed: int) -> None: ...


M = TypeVar("M", bound=_Prepares)


def prepared(method: M, problem: Any, seed: int) -> M:
    """The method itself, after ``prepare``, during which there is no garbage collection."""
    with uncollected():
        method.prepare(problem, seed)
    return method


class Replica:
    """Runs passes of a prepared method one after the other, and keeps the state."""

    def __init__(self, method: Method, seed: int, state: State | None = None) -> None:
        self.method, self.seed = method, seed
        #: State after the last pass.
        self.state: State = method.start() if state is None else state

    def step(self, iteration: int) -> Measurement:
        """Run a pass. If it raises, the state does not change."""
        with uncollected():
            made = self.method.step(iteration, self.seed, self.state)
        self.state = made.state
        return made.measurement

    def develop(self, measurement: Measurement) -> Result:
        """The picture of passes of this replica, see :meth:`Method.develop`."""
        return self.method.develop(measurement, self.state)


class Carrying(ABC):
    """Base of methods that keep the state in device arrays of the object. ``step`` loads the given state, unless it is
    the one that the last ``step`` has returned.

    A subclass has ``_take(state)``, which copies a state to the object and raises :class:`CheckpointError` if it does
    not fit, ``_left()``, its inverse, and ``_step(iteration, seed)``. It replaces arrays instead of modifying them, so
    that earlier states stay valid. ``prepare`` begins with :meth:`_forget_states`.
    """

    _held: State | None = None  #: the current state of the object
    _first: State | None = None  #: the state after ``prepare``

    def start(self) -> State:
        """See :class:`Method`."""
        if self._first is None:
            self._first = self._held = self._left()
        return self._first

    def enter(self, state: State) -> None:
        """See :class:`Method`."""
        self.start()
        if state is not self._held:
            self._held = None  # if _take raises, the state of the object is undefined
            self._take(state)
            self._held = state

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """See :class:`Method`."""
        self.enter(state)
        try:
            measurement = self._step(iteration, seed)
            left = self._left()
        except BaseException:
            self._held = None  # the state of the object is undefined
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

    if TYPE_CHECKING:  # implemented by another base class

        def _step(self, iteration: int, seed: int) -> Measurement: ...
