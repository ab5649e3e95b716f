"""Executors make the passes of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from etendue.core import Method, Pass, Replica, State


class Executor(Protocol):
    """Makes passes of a prepared method, each iteration once.

    An executor that makes several passes at a time, in other processes, may return them in any order if the method has
    no state.
    """

    def next(self) -> Pass:
        """The next finished pass. Raises the error of the pass."""
        ...

    def close(self) -> None:
        """Cancel unfinished passes."""
        ...


#: Makes an executor for a method, a seed, the state after the existing passes, and the first iteration.
MakeExecutor = Callable[[Method, int, State, int], Executor]


class InTurn:
    """Makes one pass after the other, in the calling thread."""

    def __init__(self, method: Method, seed: int, state: State, first: int) -> None:
        self._replica, self._iteration = Replica(method, seed, state), first

    def next(self) -> Pass:
        """See :class:`Executor`. A pass that raised is repeated by the next call."""
        measurement = self._replica.step(self._iteration)
        self._iteration += 1
        return Pass(measurement, self._replica.state)

    def close(self) -> None:
        """There are no unfinished passes."""
