"""Executors make the passes of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

from etendue.core import Iterations, Method, Pass, Replica, State


@dataclass(frozen=True)
class Order:
    """Passes that an executor is asked to make: passes of a prepared method that are not in ``done`` yet."""

    method: Method
    seed: int
    #: State after the passes in ``done``.
    state: State
    done: Iterations = field(default_factory=Iterations)
    #: Limit of all passes, those in ``done`` included; ``None`` for no limit.
    most: int | None = None
    #: Seconds that are left for passes now; ``None`` for no limit.
    left: Callable[[], float | None] = lambda: None
    #: Arguments of the method's ``plan``.
    plan: tuple[float | None, int | None, float | None] = (None, None, None)


class Executor(Protocol):
    """Makes passes of a prepared method, each iteration once.

    An executor that makes several passes at a time, in other processes, may return them in any order and several as
    one sum.
    """

    @property
    def keeps_time(self) -> bool:
        """Whether the executor makes only passes that end within ``Order.left``. Otherwise the runner predicts the time
        of a pass."""
        ...

    def next(self) -> Pass | None:
        """The next finished passes; ``None`` if none has finished for a moment, so that the run may be cancelled
        meanwhile. Raises the error of a pass."""
        ...

    def rest(self) -> Iterator[Pass]:
        """End the unfinished passes soon, and return those that are finished and were not returned yet."""
        ...

    def close(self) -> None:
        """Cancel unfinished passes."""
        ...


#: Makes the executor of a run.
MakeExecutor = Callable[[Order], Executor]


class InTurn:
    """Makes one pass after the other, in the calling thread."""

    keeps_time: ClassVar[bool] = False

    def __init__(self, order: Order) -> None:
        self._replica = Replica(order.method, order.seed, order.state)
        self._missing = order.done.missing()
        self._iteration = next(self._missing)

    def next(self) -> Pass:
        """See :class:`Executor`. A pass that raised is repeated by the next call."""
        measurement = self._replica.step(self._iteration)
        self._iteration = next(self._missing)
        return Pass(measurement, self._replica.state)

    def rest(self) -> Iterator[Pass]:
        """There are no unfinished passes."""
        return iter(())

    def close(self) -> None:
        """There are no unfinished passes."""
