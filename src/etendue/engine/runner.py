"""The loop over the passes of a method: an executor makes passes, a budget ends the run, saves happen between
passes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from etendue.core import (
    EtendueError,
    Iterations,
    Measurement,
    Method,
    OptionError,
    Pass,
    Progress,
    Result,
    State,
    describe,
)

from .budget import Budget
from .executor import Executor, InTurn, MakeExecutor, Order
from .saving import Saving
from .stopping import CancelEvent, StoppedBy, Stopping


@dataclass
class RunResult:
    """The measurement of a run, and how the run ended."""

    method: Method
    measurement: Measurement
    #: State after the last pass of the measurement.
    state: State
    #: Seconds of this run with preparation. ``measurement.counters["seconds"]`` includes earlier runs, but not the time
    #: between passes.
    elapsed: float
    stopped_by: StoppedBy
    #: Times of ``save_at`` that were reached since the last save; one pass may reach several.
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
        """The picture, developed at each call."""
        return self.method.develop(self.measurement, self.state)


class RunError(EtendueError):
    """A pass failed after others had succeeded. ``run`` holds these; the cause is chained."""

    def __init__(self, message: str, run: RunResult) -> None:
        super().__init__(message)
        self.run = run


class Cancelled(EtendueError):
    """A run was stopped before its first pass was done, so there is no picture."""


class Runner:
    """One run of a prepared method. :meth:`run` blocks; the other members may be used from other threads meanwhile.

    A pass that raises or is interrupted is not in the measurement, and the state remains that before the pass.

    Parameters
    ----------
    method, seed, budget: the prepared method, its seed, and the limits of the run.
    start, state: measurement and state of an earlier run to continue. The measurement is added to in place.
    on_progress: called after each pass.
    on_save: called with the current result every ``save_every`` seconds, after passes that reach a time of ``save_at``
        (seconds), and after passes for which ``save_if`` returns ``True``. Its exceptions are logged and the run
        continues, except after ``save_if``.
    cancel: checked between passes.
    spent: seconds of preparing the method, which count towards the budget.
    executor: makes the passes.
    watched: whether :attr:`progress` has the noise even if the budget does not limit it.
    least: passes that are made even if they exceed ``budget.seconds``, where the executor does not keep the time.
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
        least: int = 1,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if start is not None and state is None and method.carries_on:
            raise OptionError(f"passes of {method.name} carry on from each other: give the state after those of start")
        self._saving = Saving(save_every, save_at, clock)
        self._stopping = Stopping(method, budget, cancel, watched, least)
        self.method = method
        self.seed = seed
        self.budget = budget
        self.progress = Progress()
        self._measurement = start
        self._state = method.start() if state is None else state  # after the last pass of the measurement
        self.on_progress = on_progress
        #: Describes the progress in words of what the run makes.
        self.described: Callable[[Progress], Progress] = lambda progress: progress
        self._on_save, self._save_if = on_save, save_if
        self._spent = spent
        self._make_executor = executor
        self._executor: Executor | None = None  # of a run that has begun
        self._clock = clock
        self._lock = threading.Lock()
        self._begin = 0.0
        self._since = 0.0  # when the time of the next passes began
        self._adding = False  # sums and state are being changed
        method.enter(self._state)  # the samples of a pass and the noise may depend on the state
        if start is not None:
            self._stopping.look(start)

    # ------------------------------------------------------------------ for other threads

    def snapshot(self) -> Result | None:
        """The picture so far, ``None`` before the first pass is done."""
        with self._lock:
            return self.method.develop(self._measurement, self._state) if self._measurement is not None else None

    @property
    def state(self) -> State:
        """The state of the method after the last pass."""
        return self._state

    def request_save(self) -> None:
        """Save after the current pass, as at a time of ``save_at``."""
        self._saving.request()

    def interrupted(self) -> RunResult | None:
        """The result after :meth:`run` was left by Ctrl-C.

        ``None`` if no pass was done, or if a pass was being added, so that the sums are incomplete.
        """
        return None if self._measurement is None or self._adding else self._result("cancel")

    # ------------------------------------------------------------------ the loop

    def run(self) -> RunResult:
        """Make passes until the budget is used up, then return the result.

        A pass that is predicted to exceed ``budget.seconds`` is not started, except the first ``least``. Raises
        :class:`RunError` if a pass fails after others succeeded, the error of the first pass if it fails, and
        :class:`Cancelled` if the run was cancelled before its first pass.
        """
        self.begin()
        assert self._executor is not None
        try:
            while (reason := self.reason) is None:
                self.step()
            self._kept_if_it_fails(partial(self._rest, self._executor))
        finally:
            self._executor.close()
        if self._measurement is None:
            raise Cancelled("stopped before the first pass was done; there is no picture")
        # The pass that would have reached the time limit was not started: the result counts as that at the limit.
        reached = (self.budget.seconds or 0.0) if reason == "seconds" else 0.0
        return self._result(reason, self._saving.passed(reached))

    def begin(self) -> None:
        """Begin a run whose passes the caller asks for by :meth:`step`, in place of :meth:`run`."""
        self._saving.begin()
        self._since = self._clock()
        self._begin = self._since - self._spent
        self._executor = self._make_executor(self._order())

    @property
    def reason(self) -> StoppedBy | None:
        """Why the run ends now, ``None`` if another pass is to be made."""
        predicts = self._executor is not None and not self._executor.keeps_time
        return self._stopping.reason(self._measurement, self._elapsed(), predicts)

    def step(self) -> None:
        """Take the next passes, report and save. Raises as :meth:`run`."""
        assert self._executor is not None, "a run begins by begin()"
        self._kept_if_it_fails(partial(self._pass, self._executor))

    @property
    def current(self) -> RunResult | None:
        """The result so far, ``None`` before the first pass."""
        return None if self._measurement is None else self._result("running")

    def _order(self) -> Order:
        """The order for the executor."""
        done = self._measurement.iterations if self._measurement is not None else Iterations()
        most = self.budget.passes(self.method.samples_per_iteration)
        plan = self.budget.seconds, most, self.budget.error
        self.method.plan(*plan)
        return Order(self.method, self.seed, self._state, done, most, self._left, plan)

    def _left(self) -> float | None:
        """Seconds that are left for passes."""
        seconds = self.budget.seconds
        return None if seconds is None else seconds - self._elapsed() - self._stopping.finish(self._measurement)

    def _kept_if_it_fails(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:
            if self._measurement is None:
                raise
            run = self._result("failure")
            raise RunError(f"{describe(error)} (after {run.passes} passes, which are kept)", run) from error

    def _pass(self, executor: Executor) -> None:
        """Take the next passes, report and save."""
        begin = self._since
        made = executor.next()
        if made is None:
            return
        self._since = self._clock()
        self._count(made, self._since - begin)
        self._report(executor)
        if self._on_save is not None:
            assert self._measurement is not None
            must_save = self._save_if is not None and self._save_if(self._measurement)
            self._saving.after_pass(self._elapsed(), self._save, must_save)
        self._since = self._clock()

    def _rest(self, executor: Executor) -> None:
        """Take the passes that are finished at the end of the run."""
        for made in executor.rest():
            begin, self._since = self._since, self._clock()
            self._count(made, self._since - begin)
            self._report(executor)

    def _report(self, executor: Executor) -> None:
        shares = getattr(executor, "shares", None)
        if shares is not None:
            self.progress = replace(self.progress, shares=shares())
        if self.on_progress is not None:
            self.on_progress(self.progress)

    def _count(self, made: Pass, duration: float) -> None:
        """Add passes that took ``duration`` seconds together."""
        counters = made.measurement.counters
        seconds = duration if self._stopping.has_begun else self._spent + duration
        counters["seconds"] = counters.get("seconds", 0.0) + seconds
        rays, passes = counters.get("rays", 0.0), len(made.measurement.iterations)
        measurement = self._add(made)
        self._stopping.count(duration, rays, passes)
        self._stopping.look(measurement)
        progress = self._stopping.progress(measurement, self._elapsed())
        self.progress = self.described(progress)

    def _add(self, made: Pass) -> Measurement:
        """Add the measurement and the state of a pass together."""
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
