"""The loop over passes: budgets, progress, intermediate saves, cancellation. Knows no concrete method."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from etendue.core import (
    EtendueError,
    Measurement,
    Method,
    OptionError,
    Pass,
    Progress,
    Result,
    State,
    describe,
    is_number,
    logger,
)

from .budget import Budget

#: What ended a run. ``running``: it goes on (an intermediate save); ``failure``: a pass raised.
StoppedBy = Literal["seconds", "samples", "error", "cancel", "failure", "running"]

#: An intermediate save may take at most this share of the time.
SAVE_SHARE = 0.1
#: Seconds that are nothing: what rounding makes of a time that is counted from the resumption of a run.
CLOCK_GRAIN = 1e-6
#: Passes between two estimates of the noise, as a share of the passes done: cheap, and the same in every run.
ERROR_CADENCE = 0.05
#: Passes before an estimate of the noise may end a run. With fewer it is itself noise, and where light is found rarely
#: the first passes may all miss it and agree on a picture that is too dark.
LEAST_PASSES_FOR_ERROR = 16


def check_period(save_every: float | None) -> None:
    """Raise :class:`OptionError` if ``save_every`` is no time between intermediate saves."""
    if save_every is not None and not (is_number(save_every) and save_every > 0):
        raise OptionError(f"the time between saves must be above 0 seconds, not {save_every!r}")


def check_save_times(save_at: Sequence[float]) -> None:
    """Raise :class:`OptionError` unless ``save_at`` are times above 0 seconds, each later than the one before."""
    before = 0.0
    for time_ in save_at:
        if not is_number(time_) or time_ <= before:
            raise OptionError(f"the times of saves must be above 0 seconds and grow; {time_!r} after {before:g} is not")
        before = time_


class CancelEvent(Protocol):
    """What the loop asks between passes; a ``threading.Event`` is one."""

    def is_set(self) -> bool:
        """Whether the run should stop."""
        ...


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
    #: The times of ``save_at`` that a save is for; a pass may have passed several of them.
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
    took: they count as if :meth:`run` had begun so much earlier. A pass that raises, or is interrupted, is not in the
    measurement and leaves the state as it was before.
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
        cancel: CancelEvent | None = None,
        spent: float = 0.0,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        check_period(save_every)
        check_save_times(save_at)
        if not budget and cancel is None:
            raise OptionError("a run needs a budget: seconds, samples, passes or error")
        if start is not None and state is None and method.carries_on:
            raise OptionError(f"passes of {method.name} carry on from each other: give the state after those of start")
        self.method = method
        self.seed = seed
        self.budget = budget
        self.progress = Progress()
        self._measurement = start
        self._state = method.start() if state is None else state  # after the last pass of the measurement
        self.on_progress = on_progress
        self._on_save = on_save
        self._save_every = save_every
        self._save_at = deque(save_at)  # those to come
        self._cancel = cancel
        self._spent = spent
        self._clock = clock
        self._lock = threading.Lock()
        self._begin = 0.0
        self._durations: deque[tuple[float, float]] = deque(maxlen=8)  # (seconds, rays) of the latest passes
        self._adding = False  # sums and state are being changed
        self._done = 0  # passes of this run
        self._error: float | None = None
        self._next_error = 2
        method.enter(self._state)  # its samples of a pass, and its noise, may be of the state
        if start is not None:
            self._update_error(len(start.iterations))

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
        saved = self._clock()
        self._begin = saved - self._spent
        self._plan()
        while (reason := self._reason_to_stop()) is None:
            try:
                self._pass()
                if self.on_progress is not None:
                    self.on_progress(self.progress)
            except Exception as error:
                if self._measurement is None:
                    raise
                run = self._result("failure")
                raise RunError(f"{describe(error)} (after {run.passes} passes, which are kept)", run) from error
            if self._on_save is not None:
                now = self._clock()
                times = self._passed_save_times(now - self._begin)
                period = math.inf if self._save_every is None else self._save_every
                if times or now - saved >= period:
                    cost = self._save(times)
                    # A slow disk makes periodic saves rarer, never the rendering slow.
                    saved = self._clock() + max(0.0, cost / SAVE_SHARE - period)
        if self._measurement is None:
            raise Cancelled("stopped before the first pass was done; there is no picture")
        # The pass that would have reached the end of the time was not begun: what there is stands for that time.
        seconds = self.budget.seconds if reason == "seconds" else None
        return self._result(reason, self._passed_save_times(seconds) if seconds is not None else ())

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

    def _passed_save_times(self, elapsed: float) -> tuple[float, ...]:
        """The times of ``save_at`` up to ``elapsed``; each is given once."""
        passed = []
        while self._save_at and self._save_at[0] <= elapsed + CLOCK_GRAIN:
            passed.append(self._save_at.popleft())
        return tuple(passed)

    def _pass(self) -> None:
        iteration = self._measurement.iterations.next_iteration() if self._measurement is not None else 0
        begin = self._clock()
        made = self.method.step(iteration, self.seed, self._state)
        duration = self._clock() - begin
        seconds, measured = duration if self._done else self._spent + duration, made.measurement
        measured.counters["seconds"] = measured.counters.get("seconds", 0.0) + seconds
        self._add(made)
        self._durations.append((duration, measured.counters.get("rays", 0.0)))
        self._done += 1
        assert self._measurement is not None
        self._update_error(len(self._measurement.iterations))
        self.progress = self._describe()

    def _add(self, made: Pass) -> None:
        """Add a pass, and what it has left behind, as one."""
        with self._lock:
            self._adding = True
            if self._measurement is None:
                self._measurement = made.measurement
            else:
                self._measurement += made.measurement
            self._state = made.state
            self._adding = False

    def _save(self, times: tuple[float, ...]) -> float:
        """An intermediate save; its failure, whatever it is, is reported and costs no work. Returns its seconds."""
        assert self._on_save is not None
        begin = self._clock()
        try:
            self._on_save(self._result("running", times))
        except Exception as error:
            logger.warning("intermediate save failed, rendering goes on: %s", describe(error))
        return self._clock() - begin

    def _result(self, reason: StoppedBy, times: tuple[float, ...] = ()) -> RunResult:
        assert self._measurement is not None
        return RunResult(self.method, self._measurement, self._state, self._clock() - self._begin, reason, times)

    # ------------------------------------------------------------------ predictions

    def _reason_to_stop(self) -> StoppedBy | None:
        if self._cancel is not None and self._cancel.is_set():
            return "cancel"
        passes = len(self._measurement.iterations) if self._measurement is not None else 0
        allowed = self.budget.passes(self.method.samples_per_iteration)
        if allowed is not None and passes >= allowed:
            return "samples"
        reached = self.budget.error is not None and self._error is not None and self._error <= self.budget.error
        if reached and passes >= LEAST_PASSES_FOR_ERROR:
            return "error"
        if self.budget.seconds is not None and self._done > 0:
            elapsed = self._clock() - self._begin
            if elapsed + self._predict() + self._finish() > self.budget.seconds:
                return "seconds"
        return None

    def _finish(self) -> float:
        """Seconds that the method needs after its last pass."""
        return float(getattr(self.method, "finish_seconds", 0.0))

    def _predict(self) -> float:
        """Seconds that the next pass will take, on the safe side."""
        if self._done == 1:  # the first pass compiles; the second tells
            return 0.5 * max(0.0, self._durations[0][0] - getattr(self.method, "setup_seconds", 0.0))
        recent = [seconds for seconds, _ in self._durations][-min(len(self._durations), self._done - 1) :]
        return max(recent)

    def _update_error(self, passes: int) -> None:
        assert self._measurement is not None
        # A method whose error is not one of pixels estimates it by itself, and says how often that is worth its time.
        estimate = getattr(self.method, "noise", None)
        if passes < self._next_error or (estimate is None and "image" not in self._measurement.squares):
            return
        self._error = error = self._measurement.relative_error() if estimate is None else estimate()
        step = math.ceil(getattr(self.method, "error_cadence", ERROR_CADENCE) * passes)
        if self.budget.error is not None and error is not None and math.isfinite(error):
            # Noise falls as 1/passes: look again no later than where the target should be reached.
            least = 1 if estimate is None else math.ceil(ERROR_CADENCE * passes)
            step = min(step, max(least, math.ceil(passes * (error / self.budget.error - 1.0))))
        self._next_error = passes + max(1, step)

    def _describe(self) -> Progress:
        assert self._measurement is not None
        passes = len(self._measurement.iterations)
        elapsed = self._clock() - self._begin
        timed = list(self._durations)[1:] if self._done == len(self._durations) > 1 else list(self._durations)
        seconds = sum(s for s, _ in timed)
        rays = sum(r for _, r in timed)
        per_pass = seconds / len(timed)
        left: list[float] = []
        shares: list[float] = []
        if self.budget.seconds is not None:
            left.append(max(0.0, self.budget.seconds - elapsed))
            shares.append((elapsed + self._finish()) / self.budget.seconds)
        if (allowed := self.budget.passes(self.method.samples_per_iteration)) is not None:
            left.append(max(0, allowed - passes) * per_pass)
            shares.append(passes / allowed)
        if self.budget.error is not None and self._error:
            needed = max(passes * self._error / self.budget.error, LEAST_PASSES_FOR_ERROR)
            left.append(max(0.0, needed - passes) * per_pass)
            shares.append(passes / needed)
        return Progress(
            passes=passes,
            samples=passes * self.method.samples_per_iteration,
            elapsed=elapsed,
            eta=min(left, default=None),
            rays_per_second=rays / seconds if rays > 0 and seconds > 0 else None,
            relative_error=self._error,
            fraction=min(1.0, max(shares)) if shares else None,
        )
