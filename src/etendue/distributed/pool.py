"""Interface between an executor and a set of worker processes, however they are started and reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from .content import Offered
from .worker import Merged, Outcome, WorkerTask


@dataclass(frozen=True)
class Lost:
    """The end of a task that was not done, because its worker has ended or cannot be reached. ``worker_is_there``: only
    the outcome is lost, not the worker."""

    reason: str = ""
    worker_is_there: bool = False


@dataclass(frozen=True)
class Delivered:
    """A file has arrived, or there was a problem. ``is_lost``: the worker does not answer."""

    problem: str | None = None
    is_lost: bool = False


@dataclass(frozen=True)
class Arrival:
    """The end of a task. ``seconds``: transfer time of the outcome."""

    ticket: int
    outcome: Outcome | Lost | Delivered | Merged
    seconds: float = 0.0
    #: Tickets of further chunks of a :class:`Merged` outcome.
    others: tuple[int, ...] = ()


class Pool(Protocol):
    """Worker processes. A worker does one task at a time, in the order in which they were sent to it."""

    def workers(self) -> dict[str, int | None]:
        """The current workers: name, and number of threads for Dr.Jit, ``None`` for all. Workers may come and go; a new
        worker has a new name. Raises :class:`ClusterError` if the cluster is gone."""
        ...

    def send(self, worker: str, ticket: int, task: WorkerTask) -> None:
        """Send a task; its outcome arrives later, or :class:`Lost` does."""
        ...

    def wait(self, seconds: float) -> Arrival | None:
        """The next arrival; ``None`` if there is none within ``seconds``."""
        ...

    def deliver(self, worker: str, ticket: int, offered: Offered, digest: str) -> None:
        """Send a file; :class:`Delivered` arrives later."""
        ...

    def end_run(self, run: str) -> None:
        """Tell all workers to end their chunks of a run after the current pass."""
        ...

    def held_by_others(self, worker: str, tickets: list[int]) -> set[int]:
        """The tasks of a worker whose sums are in merged sums at other workers: they arrive even if it has ended."""
        ...

    def forget(self, tickets: list[int]) -> None:
        """Cancel tasks that have not begun; later arrivals of all ``tickets`` are ignored."""
        ...

    def close(self) -> None:
        """End workers that were started for this pool."""
        ...
