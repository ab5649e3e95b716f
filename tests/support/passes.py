"""Methods whose passes are watched, slowed, tainted or made to fail, for as long as a test runs."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from etendue import methods
from etendue.core import Measurement, Pass, State


def watch(
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    before: Callable[[Any, int], object] = lambda method, iteration: None,
    after: Callable[[Measurement], object] = lambda measured: None,
) -> None:
    """From now on each pass of the method ``name`` begins with ``before(method, iteration)``, ends with ``after``."""
    method = methods.get(name)
    step = method.step

    def watched(self: Any, iteration: int, seed: int, state: State) -> Pass:
        before(self, iteration)
        made = step(self, iteration, seed, state)
        after(made.measurement)
        return made

    monkeypatch.setattr(method, "step", watched)


def fail(monkeypatch: pytest.MonkeyPatch, name: str, at: int) -> None:
    """Pass ``at`` of the method raises, as if the device had no memory left."""

    def before(method: Any, iteration: int) -> None:
        if iteration == at:
            raise RuntimeError("out of memory")

    watch(monkeypatch, name, before)


def taint(monkeypatch: pytest.MonkeyPatch, name: str, count: float) -> None:
    """Each pass of the method reports ``count`` contributions that are not finite."""
    watch(monkeypatch, name, after=lambda measured: measured.counters.update(nonfinite=count))


def press_ctrl_c() -> None:
    """Ctrl-C during a pass: the main thread, which waits for the run, hears it before this returns. A signal to the
    process may reach another thread, and the main thread then hears it half a second later."""
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
    time.sleep(0.3)
