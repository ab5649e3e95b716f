"""Workers of a Dask cluster, local or at an address."""

from __future__ import annotations

import logging
import queue
import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from functools import partial
from typing import Any

from etendue.core import ClusterError, OptionError, describe, is_whole, library, logger

from .content import Offered
from .pool import Arrival, Lost
from .worker import Outcome, Task, end_run, introduce, make_passes, receive

#: Seconds to wait for a scheduler, for the first worker, and for an answer of a worker.
_CONNECT, _FIRST_WORKER, _ANSWER = "10s", 60.0, 60.0
_LIST_EVERY = 0.5
#: Threads for transfers and questions.
_HELPERS = 16


def dask() -> Any:
    """The library ``distributed``; raises :class:`BackendError` if it is not installed."""
    return library("distributed", "a cluster", "cluster")


class DaskPool:
    """Workers of Dask; implements :class:`Pool`.

    cluster: the address of a scheduler, or a ``distributed.Client``, which stays open. workers: number of processes of
    a local cluster instead, which share the threads of this process (or ``threads``), and which :meth:`close` ends.

    Raises :class:`ClusterError` if nothing answers, or if no worker comes.
    """

    def __init__(self, cluster: Any = None, *, workers: int | None = None, threads: int | None = None) -> None:
        self._distributed = dask()
        self._local: Any = None
        self._owns_client = True
        if (cluster is None) == (workers is None):
            raise OptionError("a cluster is given by its address or client, or by a number of workers of its own")
        if workers is not None:
            self._client, self.name = self._start(workers, threads), f"{workers} local workers"
        elif isinstance(cluster, str):
            self._client, self.name = self._connect(cluster), cluster
        elif isinstance(cluster, self._distributed.Client):
            self._client, self._owns_client = cluster, False
            self.name = str(cluster.scheduler.address)
        else:
            raise OptionError(
                f"cluster= is an address such as tcp://host:8786, or a distributed.Client, not {cluster!r}"
            )
        if self._owns_client:  # its losses are told by the executor
            for name in ("distributed", "distributed.client"):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._futures: dict[int, Any] = {}
        self._arrived: queue.SimpleQueue[Arrival] = queue.SimpleQueue()
        self._helpers = ThreadPoolExecutor(_HELPERS, thread_name_prefix="etendue-cluster")
        self._known: dict[str, int | None] = {}
        self._greetings: dict[str, Future[Any]] = {}
        #: Process ids of the workers that can be used, by address.
        self.pids: dict[str, int] = {}
        self._bad: dict[str, str] = {}
        self._listed = -1.0
        self._wait_for_workers()

    # ------------------------------------------------------------------ a pool

    def workers(self) -> dict[str, int | None]:
        """See :class:`Pool`."""
        now = time.monotonic()
        if now - self._listed < _LIST_EVERY:
            return dict(self._known)
        self._listed = now
        try:
            there: dict[str, int] = self._client.nthreads()
        except Exception as error:
            raise ClusterError(f"the scheduler of {self.name} no longer answers") from error
        self._greet(there)
        self._known = {name: threads for name, threads in there.items() if name in self.pids}
        return dict(self._known)

    def send(self, worker: str, ticket: int, task: Task) -> None:
        """See :class:`Pool`."""
        future = self._client.submit(
            make_passes, task, key=f"etendue-{task.run}-{ticket}", workers=[worker], pure=False
        )
        self._futures[ticket] = future
        # In a thread, since the transfer takes time, and does not end if the worker dies before: `forget` ends it.
        future.add_done_callback(lambda future: self._helpers.submit(self._fetch, ticket, future))

    def _fetch(self, ticket: int, future: Any) -> None:
        begin = time.perf_counter()
        try:
            outcome: Outcome | Lost = future.result()
        except BaseException as error:
            outcome = Lost(_short(error))
        self._arrived.put(Arrival(ticket, outcome, time.perf_counter() - begin))

    def wait(self, seconds: float) -> Arrival | None:
        """See :class:`Pool`."""
        try:
            arrival = self._arrived.get(timeout=seconds)
        except queue.Empty:
            return None
        if self._futures.pop(arrival.ticket, None) is None:
            return None
        if isinstance(arrival.outcome, Lost) and self._client.status != "running":
            raise ClusterError(f"the scheduler of {self.name} no longer answers")
        return arrival

    def deliver(self, worker: str, offered: Offered, digest: str) -> str | None:
        """See :class:`Pool`."""
        for offset, piece, is_last in offered.pieces(digest):
            answers = self._ask(receive, digest, offset, piece, is_last, workers=[worker])
            if (problem := answers.get(worker, "it does not answer")) is not None:
                return describe(problem) if isinstance(problem, Exception) else str(problem)
        return None

    def end_run(self, run: str) -> None:
        """See :class:`Pool`."""
        for name in self._known:  # without waiting: their sums tell that they have ended
            self._helpers.submit(self._client.run, end_run, run, workers=[name], on_error="return")

    def forget(self, tickets: list[int]) -> None:
        """See :class:`Pool`."""
        futures = [self._futures.pop(ticket) for ticket in tickets if ticket in self._futures]
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)

    def close(self) -> None:
        """End the workers that were started here."""
        self._futures.clear()
        self._helpers.shutdown(wait=False, cancel_futures=True)
        if self._owns_client:
            self._client.close(timeout=5)
        if self._local is not None:
            self._local.close(timeout=10)

    # ------------------------------------------------------------------ inside

    def _start(self, workers: int, threads: int | None) -> Any:
        """A local cluster, reachable from this machine only."""
        if not is_whole(workers) or not 1 <= workers <= 1024:
            raise OptionError(f"the number of workers is a whole number from 1 to 1024, not {workers!r}")
        import dask as settings
        import drjit as dr

        each = max(1, (threads or dr.thread_count()) // workers)
        # A killed worker is no fault of its chunk: the executor counts how often that happens.
        settings.config.set(
            {
                "distributed.scheduler.allowed-failures": 1000,
                # A worker that takes longer to come back, on a loaded machine, would be given up.
                "distributed.deploy.lost-worker-timeout": "1 day",
            }
        )
        try:
            self._local = self._distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=each,
                processes=True,
                host="127.0.0.1",
                scheduler_port=0,
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
        except Exception as error:
            raise ClusterError(
                f"local workers cannot be started ({_short(error)}); in a script, call étendue below "
                "`if __name__ == '__main__':`"
            ) from error
        return self._distributed.Client(self._local, set_as_default=False, direct_to_workers=True)

    def _connect(self, address: str) -> Any:
        try:
            return self._distributed.Client(address, timeout=_CONNECT, set_as_default=False)
        except Exception as error:
            raise ClusterError(
                f"no scheduler answers at '{address}' ({_short(error)}); start one by: dask scheduler"
            ) from error

    def _wait_for_workers(self) -> None:
        end = time.monotonic() + _FIRST_WORKER
        while True:
            self._listed = -1.0
            if self.workers():
                return
            if self._bad:
                name, why = next(iter(self._bad.items()))
                raise ClusterError(f"no worker of {self.name} can be used; {name}: {why}")
            if time.monotonic() > end:
                raise ClusterError(
                    f"{self.name} has no worker; start one by: dask worker {self._client.scheduler.address}"
                )
            time.sleep(0.1)

    def _greet(self, there: dict[str, int]) -> None:
        """Find out whether new workers can be used, without waiting: one that has just ended answers late or never."""
        for name in there:
            if name not in self.pids and name not in self._bad and name not in self._greetings:
                ask = partial(self._client.run, introduce, self._local is not None, workers=[name], on_error="return")
                self._greetings[name] = self._helpers.submit(ask)
        for name in [name for name, answer in self._greetings.items() if answer.done()]:
            asked = self._greetings.pop(name)
            answer = asked.exception() or asked.result().get(name)
            if (why := self._unfit(answer)) is not None:
                self._bad[name] = why
                if self.pids:
                    logger.warning("worker %s is left out: %s", name, why)
            elif isinstance(answer, dict):
                self.pids[name] = answer["pid"]

    @staticmethod
    def _unfit(answer: Any) -> str | None:
        """Why a worker that answers so cannot be used."""
        here = introduce()["python"]
        if isinstance(answer, dict):
            wrong = answer["python"] != here
            return f"it runs Python {answer['python']}, the client {here}; use the same version" if wrong else None
        if isinstance(answer, ModuleNotFoundError):
            return f"it has no module '{answer.name}'; install étendue there"
        if isinstance(answer, (ImportError, AttributeError, TypeError)):
            return f"{describe(answer)}; install the same version of étendue there"
        return None  # it has ended meanwhile

    def _ask(self, function: Any, *arguments: Any, workers: list[str]) -> dict[str, Any]:
        """The answers of workers, or the errors. Workers that do not answer are left out."""
        asked = {
            name: self._helpers.submit(self._client.run, function, *arguments, workers=[name], on_error="return")
            for name in workers
        }
        done, _ = wait_for(asked.values(), timeout=_ANSWER)
        if self._client.status != "running":
            raise ClusterError(f"the scheduler of {self.name} no longer answers")
        answers: dict[str, Any] = {}
        for future in asked.values():
            if future in done and future.exception() is None:
                answers |= future.result()
        return answers


def _short(error: BaseException) -> str:
    """The cause of an error of Dask as one line."""
    cause = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    text = describe(cause)
    return text if len(text) < 200 else f"{text[:200]}..."
