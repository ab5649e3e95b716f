"""Methods whose passes are watched, slowed, tainted or made to fail, for as long as a test runs."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from etendue import methods
from etendue.core import Measurement, Pass, State
from etendue.engine import job
from etendue.engine.runner import Runner


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


class Clock:
    """What runs take for the time: it stands still but for :meth:`pass_time`."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def pass_time(self, seconds: float) -> None:
        self.now += seconds


def simulate_clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Runs, with their preparation, measure time by the clock that is returned, however busy the machine is."""
    clock = Clock()
    monkeypatch.setitem(Runner.__init__.__kwdefaults__, "clock", clock)
    monkeypatch.setattr(job, "time", SimpleNamespace(perf_counter=clock))
    return clock


def press_ctrl_c() -> None:
    """Ctrl-C during a pass: the main thread, which waits for the run, hears it before this returns. A signal to the
    process may reach another thread, and the main thread then hears it half a second later."""
    handler = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
    end = time.monotonic() + 10.0
    while getattr(handler, "received", 0) is None and time.monotonic() < end:
        time.sleep(0.005)
    time.sleep(0.3)
