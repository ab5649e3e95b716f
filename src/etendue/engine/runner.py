"""The loop over passes, which knows no concrete method: an executor makes them, a budget ends them, saves happen
between them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from etendue.core import EtendueError, Measurement, Method, OptionError, Pass, Progress, Result, State, describe

from .budget import Budget
from .executor import InTurn, MakeExecutor
from .saving import Saving
from .stopping import CancelEvent, StoppedBy, Stopping


@dataclass
class RunResult:
    """What a run measured so far."""

    method: Method
    measurement: Measurement
    #: After the last pass of the measurement.
    state: State
    #: Seconds of this run, preparation included; ``measurement.counters["seconds"]`` also has earlier runs, without the
    #: time between passes.
    elapsed: float
    stopped_by: StoppedBy
    #: Those of ``save_at`` that were reached since the last save; one pass may reach several.
    save_times: tuple[float, ...] = ()

    @property
    def passes(self) -> int:
        """Passes in the measurement."""
        return len(self.measurement.iterations)

    @property
    def samples(self) -> int:
        """Camera paths per pixel in the measurement."""
        return self.passes * self.method.samples_per_iteration

    @property
    def result(self) -> Result:
        """The picture, developed anew at each call."""
        return self.method.develop(self.measurement, self.state)


class RunError(EtendueError):
    """A pass failed after others had been done; ``run`` holds those, and the cause is chained."""

    def __init__(self, message: str, run: RunResult) -> None:
        super().__init__(message)
        self.run = run


class Cancelled(EtendueError):
    """A run was stopped before its first pass was done, so there is no picture."""


class Runner:
    """One run of a prepared method. :meth:`run` blocks; the other members may be used from other threads meanwhile.

    ``start`` and ``state`` continue an earlier run: its measurement is taken over (added to in place), the first pass
    is the one after its last. ``on_progress`` is called after each pass, ``on_save`` with what there is so far every
    ``save_every`` seconds and after the passes that reach the seconds of ``save_at``; an exception from it is logged
    and the run goes on. ``cancel`` is looked at between passes. ``spent`` are the seconds that preparing the method
    took: they count as if :meth:`run` had begun so much earlier. ``executor`` makes the passes. ``watched``: whether
    :attr:`progress` tells the noise also where the budget has none. A pass that raises, or is interrupted, is not in
    the measurement and leaves the state as it was before.
    """

    def __init__(
        self,
        method: Method,
        *,
        seed: int,
        budget: Budget,
        start: Measurement | None = None,
        state: State | None = None,
        on_progress: Callable[[Progress], None] | None = None,
        on_save: Callable[[RunResult], None] | None = None,
        save_every: float | None = None,
        save_at: Sequence[float] = (),
        save_if: Callable[[Measurement], bool] | None = None,
        cancel: CancelEvent | None = None,
        spent: float = 0.0,
        executor: MakeExecutor = InTurn,
        watched: bool = True,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if start is not None and state is None and method.carries_on:
            raise OptionError(f"passes of {method.name} carry on from each other: give the state after those of start")
        self._saving = Saving(save_every, save_at, clock)
        self._stopping = Stopping(method, budget, cancel, watched)
        self.method = method
        self.seed = seed
        self.budget = budget
        self.progress = Progress()
        self._measurement = start
        self._state = method.start() if state is None else state  # after the last pass of the measurement
        self.on_progress = on_progress
        self._on_save, self._save_if = on_save, save_if
        self._spent = spent
        self._make_executor = executor
        self._clock = clock
        self._lock = threading.Lock()
        self._begin = 0.0
        self._adding = False  # sums and state are being changed
        method.enter(self._state)  # its samples of a pass, and its noise, may be of the state
        if start is not None:
            self._stopping.look(start)

    # ------------------------------------------------------------------ for other threads

    def snapshot(self) -> Result | None:
        """The picture so far, ``None`` before the first pass is done."""
        with self._lock:
            return self.method.develop(self._measurement, self._state) if self._measurement is not None else None

    def interrupted(self) -> RunResult | None:
        """What was done before an exception that is no ``Exception`` (Ctrl-C) left :meth:`run`.

        ``None`` if that is nothing, or if a pass was just being added, so that the sums are no longer whole.
        """
        return None if self._measurement is None or self._adding else self._result("cancel")

    # ------------------------------------------------------------------ the loop

    def run(self) -> RunResult:
        """Do passes until the budget is used up, then return what was measured.

        A pass that is predicted to overrun ``budget.seconds`` is not started; the first one always is. Raises
        :class:`RunError` if a pass fails after others were done (the failure itself if none was), and
        :class:`Cancelled` if the run was stopped before its first pass.
        """
        self._saving.begin()
        self._begin = self._clock() - self._spent
        self._plan()
        first = self._measurement.iterations.next_iteration() if self._measurement is not None else 0
        executor = self._make_executor(self.method, self.seed, self._state, first)
        try:
            while (reason := self._stopping.reason(self._measurement, self._elapsed())) is None:
                try:
                    self._pass(executor.next)
                    if self.on_progress is not None:
                        self.on_progress(self.progress)
                    if self._on_save is not None:
                        assert self._measurement is not None
                        must_save = self._save_if is not None and self._save_if(self._measurement)
                        self._saving.after_pass(self._elapsed(), self._save, must_save)
                except Exception as error:
                    if self._measurement is None:
                        raise
                    run = self._result("failure")
                    raise RunError(f"{describe(error)} (after {run.passes} passes, which are kept)", run) from error
        finally:
            executor.close()
        if self._measurement is None:
            raise Cancelled("stopped before the first pass was done; there is no picture")
        # The pass that would have reached the end of the time was not begun: what there is stands for that time.
        seconds = self.budget.seconds if reason == "seconds" else None
        return self._result(reason, self._saving.passed(seconds) if seconds is not None else ())

    def _plan(self) -> None:
        """Tell a method that asks for it how much is to be done."""
        plan = getattr(self.method, "plan", None)
        if plan is None:
            return
        done = len(self._measurement.iterations) if self._measurement is not None else 0
        passes = self.budget.passes(self.method.samples_per_iteration)
        seconds = self.budget.seconds
        plan(
            None if seconds is None else max(0.0, seconds - self._spent),
            None if passes is None else max(0, passes - done),
            self.budget.error,
        )

    def _pass(self, make: Callable[[], Pass]) -> None:
        begin = self._clock()
        made = make()
        duration = self._clock() - begin
        counters = made.measurement.counters
        seconds = duration if self._stopping.has_begun else self._spent + duration
        counters["seconds"] = counters.get("seconds", 0.0) + seconds
        rays = counters.get("rays", 0.0)
        measurement = self._add(made)
        self._stopping.count(duration, rays)
        self._stopping.look(measurement)
        self.progress = self._stopping.progress(measurement, self._elapsed())

    def _add(self, made: Pass) -> Measurement:
        """Add a pass, and what it has left behind, as one."""
        with self._lock:
            self._adding = True
            if self._measurement is None:
                self._measurement = made.measurement
            else:
                self._measurement += made.measurement
            self._state = made.state
            self._adding = False
        return self._measurement

    def _save(self, times: tuple[float, ...]) -> None:
        assert self._on_save is not None
        self._on_save(self._result("running", times))

    def _elapsed(self) -> float:
        return self._clock() - self._begin

    def _result(self, reason: StoppedBy, times: tuple[float, ...] = ()) -> RunResult:
        assert self._measurement is not None
        return RunResult(self.method, self._measurement, self._state, self._elapsed(), reason, times)
