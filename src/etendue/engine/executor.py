"""What makes the passes of a run, in the order in which they are added."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from etendue.core import Method, Pass, Replica, State


class Executor(Protocol):
    """Makes passes of a prepared method, each iteration once.

    One that has several passes under way, in other processes, gives them in any order if the method carries nothing on
    from pass to pass.
    """

    def next(self) -> Pass:
        """The next pass that is done. Raises what the pass has raised."""
        ...

    def close(self) -> None:
        """Give up what is under way."""
        ...


#: Makes an executor for a method, a seed, the state after the passes that there are, and the first iteration.
MakeExecutor = Callable[[Method, int, State, int], Executor]


class InTurn:
    """Passes one after the other, in the thread that asks for them."""

    def __init__(self, method: Method, seed: int, state: State, first: int) -> None:
        self._replica, self._iteration = Replica(method, seed, state), first

    def next(self) -> Pass:
        """See :class:`Executor`. If the pass raises, it is made again the next time."""
        measurement = self._replica.step(self._iteration)
        self._iteration += 1
        return Pass(measurement, self._replica.state)

    def close(self) -> None:
        """Nothing is under way."""
