"""The process beside a session: it answers orders about a copy of the scene, one after the other."""

from __future__ import annotations

import gc
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, BinaryIO

from etendue.core import describe, optimise_kernels, use_variant
from etendue.scene import Problem

from ..panels.parameters import Parameters
from ..refining import Refinement
from ..session import ViewerSession
from ..states import Asked
from .desk import Desk, Send
from .orders import Order, SceneCopy

#: Seconds without an order after which the process ends, so that it does not keep the memory of a scene.
_PATIENCE = 600.0
#: What the page is told.
_LOADING = "loading the scene in a process of its own"
_TRACING = "tracing; new kernels are compiled in the background, which takes seconds"


def main() -> None:
    """Read orders from the standard input, and write replies to the standard output, as pickles, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the session ends this process
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no reply
    orders: queue.SimpleQueue[Order] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, orders), daemon=True).start()
    _Worker(replies).run(orders)


def _read(source: BinaryIO, orders: queue.SimpleQueue[Order]) -> None:
    try:
        while True:
            orders.put(pickle.load(source))
    except (EOFError, OSError):
        os._exit(0)  # the session has ended: at once, also while a kernel is compiled
    except Exception:
        traceback.print_exc()
        os._exit(1)


class _Worker:
    """Answers orders. ``replies`` gets tuples: kind, number of the order, content."""

    def __init__(self, replies: BinaryIO) -> None:
        self._replies = replies
        self._scene: tuple[Problem, Desk] | None = None
        self._picture: tuple[int, Refinement] | None = None  # run in the session, and its copy

    def run(self, orders: queue.SimpleQueue[Order]) -> None:
        """Answer until there has been no order for long."""
        while True:
            busy = self._scene is not None and self._guarded(0, self._scene[1].work)
            try:
                order = orders.get(timeout=1e-3 if busy else _PATIENCE)
            except queue.Empty:
                if not busy:
                    return
            else:
                self._guarded(order.number, partial(self._answer, order))

    def _answer(self, order: Order) -> None:
        if order.scene is not None:
            self._reply("doing", order.number, _LOADING)
            try:
                self._open(order.scene)
            except Exception as error:  # the session traces by itself
                self._reply("unusable", order.number, describe(error))
                return
        assert self._scene is not None

        self._reply("doing", order.number, _TRACING)
        self._scene[1].handle(order.verb, order.message, lambda: self._refinement(order), self._send_of(order.number))
        self._reply("done", order.number, None)

    def _refinement(self, order: Order) -> Refinement:
        assert self._scene is not None and order.view is not None
        view = order.view
        earlier = self._picture[1] if self._picture is not None and self._picture[0] == view.run else None
        self._picture = view.run, view.refinement(self._scene[0], earlier)
        return self._picture[1]

    def _open(self, scene: SceneCopy) -> None:
        """Load the scene as a session does: with its lights and changes of parameters."""
        self._scene = self._picture = None
        gc.collect()
        use_variant(scene.variant)
        optimise_kernels(False)  # as those of the session

        def load(asked: Asked, changes: Mapping[str, Any]) -> Problem:
            session = ViewerSession(asked)
            session.panels = {Parameters.name: Parameters(session, changes)}
            session.open(asked)
            assert session.problem is not None
            return session.problem

        problem = scene.load(load)
        self._scene = problem, Desk(problem, self._send_of(0))

    def _send_of(self, number: int) -> Send:
        return lambda *message: self._reply("message", number, message)

    def _guarded(self, number: int, work: Callable[[], object]) -> bool:
        """Do some work; its errors are told in a reply."""
        try:
            return bool(work())
        except Exception as error:
            self._reply("failed", number, describe(error))
            return False

    def _reply(self, kind: str, number: int, content: Any) -> None:
        pickle.dump((kind, number, content), self._replies)
        self._replies.flush()
