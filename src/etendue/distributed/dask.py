"""Workers of a Dask cluster, local or at an address."""

from __future__ import annotations

import logging
import queue
import threading
import time
import uuid
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor, wait as wait_for
from contextlib import suppress
from functools import partial
from typing import Any

from etendue.core import ClusterError, EtendueError, OptionError, describe, library, logger

from .content import Offered
from .gathering import Bundle, Gathering, held_by_others
from .pool import Arrival, Delivered, Lost
from .worker import Chunk, WorkerTask, end_run, introduce, make_passes, merge_outcomes, receive, unfit

#: Seconds to wait for a scheduler, the first worker, further present workers, and an answer of a worker.
_CONNECT, _FIRST_WORKER, _OTHERS, _ANSWER = "10s", 60.0, 5.0, 60.0
_LIST_EVERY = 0.5
#: Size in bytes from which on workers copy a file from each other.
_SHARED = 1 << 20
#: Threads for transfers and questions.
_HELPERS = 16


def dask() -> Any:
    """The library ``distributed``; raises :class:`BackendError` if it is not installed."""
    found = library("distributed", "a cluster", "cluster")
    # Messages to parts of a scene are sent with their tasks and may be large, so Dask's warning is turned off.
    library("dask", "a cluster", "cluster").config.set({"distributed.admin.large-graph-warning-threshold": "1TB"})
    return found


class DaskPool:
    """Workers of Dask; implements :class:`Pool`.

    cluster: the address of a scheduler, or a ``distributed.Client``, which stays open.

    Raises :class:`ClusterError` if nothing answers, or if no worker comes.
    """

    def __init__(self, cluster: Any) -> None:
        self._distributed = dask()
        self._owns_client = True
        if isinstance(cluster, str):
            self._client, self.name = self._connect(cluster), cluster
        elif isinstance(cluster, self._distributed.Client):
            self._client, self._owns_client = cluster, False
            self.name = str(cluster.scheduler.address)
        else:
            raise OptionError(
                f"cluster= is an address such as tcp://host:8786, or a distributed.Client, not {cluster!r}"
            )
        if self._owns_client:  # the executor reports losses
            for name in ("distributed", "distributed.client"):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._futures: dict[int, Any] = {}
        self._gathering, self._lock = Gathering(), threading.Lock()
        self._bundles: set[Bundle] = set()  # sums of several chunks that have not arrived
        self._sharing = threading.Lock()
        self._pieces: dict[str, list[tuple[int, Any, bool]]] = {}  # of files that are being sent
        self._sending: dict[str, int] = {}  # number of workers, by digest
        self._arrived: queue.SimpleQueue[Arrival] = queue.SimpleQueue()
        self._helpers = ThreadPoolExecutor(_HELPERS, thread_name_prefix="etendue-cluster")
        self._known: dict[str, int | None] = {}
        self._greetings: dict[str, Future[Any]] = {}
        #: Process ids of the workers that can be used, by address.
        self.pids: dict[str, int] = {}
        self._bad: dict[str, str] = {}
        self._told: set[str] = set()
        self._unknown: set[str] = set()  # those that have not answered
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
        self._unknown = there.keys() - self.pids.keys() - self._bad.keys()
        for name in self._bad.keys() - self._told if self._known else ():
            self._told.add(name)
            logger.warning("worker %s is left out: %s", name, self._bad[name])
        return dict(self._known)

    def send(self, worker: str, ticket: int, task: WorkerTask) -> None:
        """See :class:`Pool`."""
        future = self._client.submit(
            make_passes, task, key=f"etendue-{task.run}-{ticket}", workers=[worker], pure=False
        )
        self._futures[ticket] = future
        self._when_done(Bundle((ticket,), worker, future), isinstance(task, Chunk) and task.may_merge)

    def _when_done(self, bundle: Bundle, merges: bool) -> None:
        # In threads, since a transfer takes time, and never ends if the worker dies before; `forget` cancels it.
        land = self._land if merges else self._fetch
        bundle.where.add_done_callback(lambda _: self._help(land, bundle))

    def _help(self, function: Callable[..., object], *arguments: Any) -> None:
        with suppress(RuntimeError):  # closed meanwhile
            self._helpers.submit(function, *arguments)

    def _land(self, bundle: Bundle) -> None:
        """A sum waits at a worker: it is fetched, or merged there with others."""
        if bundle.where.status != "finished":
            self._fetch(bundle)  # the error
            return
        with self._lock:
            known = bundle in self._bundles if len(bundle.tickets) > 1 else bundle.tickets[0] in self._futures
            if not known:  # forgotten meanwhile
                return
            self._gathering.put(bundle)
        self._advance()

    def _advance(self) -> None:
        with self._lock:
            while (chosen := self._gathering.next()) is not None:
                if len(chosen) == 1:
                    self._help(self._fetch_next, chosen[0])
                    continue
                merged, key = Bundle.of(chosen), f"etendue-sum-{uuid.uuid4().hex}"
                parts = [bundle.where for bundle in chosen]
                try:
                    merged.where = self._client.submit(
                        merge_outcomes, *parts, key=key, workers=[merged.worker], pure=False
                    )
                except Exception as error:  # one of them was cancelled a moment ago
                    self._lose(merged.tickets, _short(error))
                    continue
                self._bundles.add(merged)
                self._when_done(merged, True)

    def _fetch_next(self, bundle: Bundle) -> None:
        begin = time.perf_counter()
        self._fetch(bundle)
        with self._lock:
            self._gathering.fetched(time.perf_counter() - begin)
        self._advance()

    def _fetch(self, bundle: Bundle) -> None:
        begin = time.perf_counter()
        try:
            outcome: Any = bundle.where.result()
        except BaseException as error:
            outcome = Lost(_short(error))
        with self._lock:
            several = len(bundle.tickets) > 1
            if several and bundle not in self._bundles:  # forgotten meanwhile
                return
            self._bundles.discard(bundle)
            if several and bundle.where.status == "error":  # and merging would fail again
                self._gathering.merge_no_more()
        if several and isinstance(outcome, Lost):
            self._lose(bundle.tickets, outcome.reason)
            return
        self._arrived.put(Arrival(bundle.tickets[0], outcome, time.perf_counter() - begin, bundle.tickets[1:]))

    def _lose(self, tickets: Iterable[int], why: str) -> None:
        """A sum of several chunks is lost; nobody knows with which worker."""
        for ticket in tickets:
            self._arrived.put(Arrival(ticket, Lost(why, worker_is_there=True)))

    def wait(self, seconds: float) -> Arrival | None:
        """See :class:`Pool`."""
        try:
            arrival = self._arrived.get(timeout=seconds)
        except queue.Empty:
            return None
        if isinstance(arrival.outcome, Delivered):
            return arrival
        # The executor also gets sums of which some chunks were forgotten, and cannot use them.
        known = [self._futures.pop(ticket, None) for ticket in (arrival.ticket, *arrival.others)]
        if not any(future is not None for future in known):
            return None
        if isinstance(arrival.outcome, Lost) and self._client.status != "running":
            raise ClusterError(f"the scheduler of {self.name} no longer answers")
        return arrival

    def deliver(self, worker: str, ticket: int, offered: Offered, digest: str) -> None:
        """See :class:`Pool`. Workers take the pieces of a large file from each other."""
        self._helpers.submit(self._deliver, worker, ticket, offered, digest)

    def _deliver(self, worker: str, ticket: int, offered: Offered, digest: str) -> None:
        problem, is_lost = None, False
        try:
            if offered.size(digest) >= _SHARED:
                problem = self._from_others(worker, offered, digest)
            else:
                problem = self._directly(worker, offered, digest)
        except Exception as error:
            problem, is_lost = _short(error), not isinstance(error, EtendueError)
        self._arrived.put(Arrival(ticket, Delivered(problem, is_lost)))

    def _directly(self, worker: str, offered: Offered, digest: str) -> str | None:
        for offset, piece, is_last in offered.pieces(digest):
            answers = self._ask(receive, digest, offset, piece, is_last, workers=[worker])
            problem = answers.get(worker, TimeoutError("it does not answer"))
            if isinstance(problem, OSError):  # of the connection; a disk error comes as text
                raise problem
            if problem is not None:
                return describe(problem) if isinstance(problem, Exception) else str(problem)
        return None

    def _from_others(self, worker: str, offered: Offered, digest: str) -> str | None:
        """Send the pieces of a file once, as data of the cluster: a worker copies them from any worker that has them,
        and keeps them for others until all have the file."""
        with self._sharing:
            self._sending[digest] = self._sending.get(digest, 0) + 1
        try:
            with self._sharing:
                if digest not in self._pieces:
                    self._pieces[digest] = [
                        (offset, self._client.scatter(piece, workers=[worker], hash=False), is_last)
                        for offset, piece, is_last in offered.pieces(digest)
                    ]
                pieces = self._pieces[digest]
            for offset, piece, is_last in pieces:
                task = self._client.submit(receive, digest, offset, piece, is_last, workers=[worker], pure=False)
                if (problem := task.result(timeout=_ANSWER)) is not None:
                    return str(problem)
            return None
        except Exception:  # a worker that had a piece has ended
            with self._sharing:
                self._pieces.pop(digest, None)
            return self._directly(worker, offered, digest)
        finally:
            with self._sharing:
                self._sending[digest] -= 1
                if not self._sending[digest]:
                    self._pieces.pop(digest, None)

    def end_run(self, run: str) -> None:
        """See :class:`Pool`."""
        for name in self._known:  # without waiting: the arrival of their sums shows that they have ended
            self._help(partial(self._client.run, end_run, run, workers=[name], on_error="return"))

    def held_by_others(self, worker: str, tickets: list[int]) -> set[int]:
        """See :class:`Pool`."""
        with self._lock:
            return held_by_others(self._bundles, worker, tickets)

    def forget(self, tickets: list[int]) -> None:
        """See :class:`Pool`."""
        futures = [self._futures.pop(ticket) for ticket in tickets if ticket in self._futures]
        with self._lock:
            self._gathering.drop(set(tickets))
            for bundle in [bundle for bundle in self._bundles if set(tickets) & set(bundle.tickets)]:
                self._bundles.remove(bundle)
                futures.append(bundle.where)
                self._lose(set(bundle.tickets) - set(tickets), "it was merged with one that is lost")
        if futures and self._client.status == "running":
            self._client.cancel(futures, force=True)

    def close(self) -> None:
        """Leave the cluster."""
        self._futures.clear()
        self._helpers.shutdown(wait=False, cancel_futures=True)
        if self._owns_client:
            self._client.close(timeout=5)

    # ------------------------------------------------------------------ inside

    def _connect(self, address: str) -> Any:
        if address.startswith("tls:"):
            security = self._distributed.Security().get_connection_args("client")
            if security.get("ssl_context") is None:  # Dask would try for a minute
                raise ClusterError(
                    f"'{address}' needs certificates: name them in ~/.config/dask/distributed.yaml, below "
                    "distributed: comm: tls: (ca-file, and cert and key of client)"
                )
        try:
            return self._distributed.Client(address, timeout=_CONNECT, set_as_default=False)
        except Exception as error:
            raise ClusterError(
                f"no scheduler answers at '{address}' ({_short(error)}); start one by: dask scheduler"
            ) from error

    def _wait_for_workers(self) -> None:
        """Wait for a worker, and for all others that are present: a method whose passes depend on each other has a
        replica for each."""
        begin = time.monotonic()
        while True:
            self._listed = -1.0
            found, waited = len(self.workers()), time.monotonic() - begin
            is_known = not self._unknown and bool(found + len(self._bad))
            if found and (is_known or waited > _OTHERS):
                return
            if self._bad and (is_known or waited > _FIRST_WORKER):
                name, why = next(iter(self._bad.items()))
                raise ClusterError(f"no worker of {self.name} can be used; {name}: {why}")
            if waited > _FIRST_WORKER:
                raise ClusterError(
                    f"{self.name} has no worker; start one by: dask worker {self._client.scheduler.address}"
                )
            time.sleep(0.1)

    def _greet(self, there: dict[str, int]) -> None:
        """Ask new workers whether they can be used, without waiting: a worker that has just ended may never answer."""
        for name in there:
            if name not in self.pids and name not in self._bad and name not in self._greetings:
                ask = partial(self._client.run, introduce, workers=[name], on_error="return")
                self._greetings[name] = self._helpers.submit(ask)
        for name in [name for name, answer in self._greetings.items() if answer.done()]:
            asked = self._greetings.pop(name)
            answer = asked.exception() or asked.result().get(name)
            if (why := unfit(answer)) is not None:
                self._bad[name] = why
            elif isinstance(answer, dict):
                self.pids[name] = answer["pid"]

    def _ask(self, function: Any, *arguments: Any, workers: list[str]) -> dict[str, Any]:
        """The answers of workers, or their errors, without workers that do not answer."""
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
