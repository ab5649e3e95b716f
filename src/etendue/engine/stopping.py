"""The end of a run, and its progress: by the budget, the time of passes and the noise of the picture."""

from __future__ import annotations

import math
from collections import deque
from typing import Literal, Protocol

from etendue.core import Measurement, Method, OptionError, Progress

from .budget import Budget

#: What ended a run. ``samples``: samples or passes; ``running``: it continues (an intermediate save); ``failure``: a
#: pass raised.
StoppedBy = Literal["seconds", "samples", "error", "cancel", "failure", "running"]

#: Smallest relative growth of the number of passes between two slow estimates of the noise; independent of time, so
#: that runs are reproducible.
_LEAST_GROWTH = 0.05
#: Smallest number of passes after which an estimate of the noise may end a run. With fewer passes the estimate is too
#: noisy, and all passes may miss light that is rarely found, and agree on a picture that is too dark.
LEAST_PASSES_FOR_ERROR = 16


class CancelEvent(Protocol):
    """A flag that is checked between passes; ``threading.Event`` implements it."""

    def is_set(self) -> bool:
        """Whether the run should stop."""
        ...


class Stopping:
    """Decides after each pass whether a run continues. ``watched``: whether to estimate the noise even if the budget
    does not limit it. ``least``: passes before a limit in time ends the run, unless workers keep the time."""

    def __init__(
        self, method: Method, budget: Budget, cancel: CancelEvent | None, watched: bool = True, least: int = 1
    ) -> None:
        if not budget and cancel is None:
            raise OptionError("a run needs a budget: seconds, samples, passes or error")
        self.method, self.budget = method, budget
        self._cancel = cancel
        self._least = least
        self._watched = watched or budget.error is not None
        self._durations: deque[tuple[float, float, int]] = deque(maxlen=8)  # seconds, rays, passes of the latest steps
        self._done = 0  # steps of this run, of one pass or of several that were made at the same time
        self._error: float | None = None
        self._next_error = 2
        self._finish_seconds: float | None = None  # after the latest pass, once it is estimated

    @property
    def has_begun(self) -> bool:
        """Whether this run has made a pass."""
        return self._done > 0

    def count(self, seconds: float, rays: float, passes: int = 1) -> None:
        """Count passes that took ``seconds`` together."""
        self._durations.append((seconds, rays, passes))
        self._done += 1
        self._finish_seconds = None

    def reason(self, measurement: Measurement | None, elapsed: float, predicts: bool = True) -> StoppedBy | None:
        """The reason to end the run; ``None`` to make another pass. The time of the first pass is not predicted.
        ``predicts``: whether the time of later passes is."""
        if self._cancel is not None and self._cancel.is_set():
            return "cancel"
        passes = len(measurement.iterations) if measurement is not None else 0
        allowed = self.budget.passes(self.method.samples_per_iteration)
        if allowed is not None and passes >= allowed:
            return "samples"
        reached = self.budget.error is not None and self._error is not None and self._error <= self.budget.error
        if reached and passes >= LEAST_PASSES_FOR_ERROR:
            return "error"
        if self.budget.seconds is not None and self.has_begun and not (predicts and passes < self._least):
            assert measurement is not None
            if elapsed + (self._predict() if predicts else 0.0) + self.finish(measurement) > self.budget.seconds:
                return "seconds"
        return None

    def look(self, measurement: Measurement) -> None:
        """Estimate the noise again, if the number of passes has grown enough since the last estimate."""
        passes = len(measurement.iterations)
        if passes < self._next_error or not self._watched:
            return
        self._error = error = self.method.noise(measurement)
        step = math.ceil(self.method.error_cadence * passes)
        if self.budget.error is not None and error is not None and math.isfinite(error):
            # Noise decreases as 1 / passes: estimate again when the target should be reached at the latest.
            least = 1 if self.method.has_fast_noise else math.ceil(_LEAST_GROWTH * passes)
            step = min(step, max(least, math.ceil(passes * (error / self.budget.error - 1.0))))
        self._next_error = passes + max(1, step)

    def progress(self, measurement: Measurement, elapsed: float) -> Progress:
        """The progress after a pass."""
        passes = len(measurement.iterations)
        timed = list(self._durations)[1:] if self._done == len(self._durations) > 1 else list(self._durations)
        seconds = sum(s for s, _, _ in timed)
        rays = sum(r for _, r, _ in timed)
        per_pass = seconds / sum(n for _, _, n in timed)
        left: list[float] = []
        shares: list[float] = []
        if self.budget.seconds is not None:
            left.append(max(0.0, self.budget.seconds - elapsed))
            shares.append((elapsed + self.finish(measurement)) / self.budget.seconds)
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
            rays=measurement.counters.get("rays", 0.0),
            rays_per_second=rays / seconds if rays > 0 and seconds > 0 else None,
            error=None if self._error is None else math.sqrt(self._error),
            fraction=min(1.0, max(shares)) if shares else None,
        )

    def finish(self, measurement: Measurement | None) -> float:
        """Seconds that the method needs after its last pass; estimated once for each pass."""
        if measurement is None:
            return 0.0
        if self._finish_seconds is None:
            self._finish_seconds = float(self.method.finish_seconds(measurement))
        return self._finish_seconds

    def _predict(self) -> float:
        """Predicted seconds of the next pass, an upper estimate."""
        if self._done == 1:  # the first pass includes compilation
            return 0.5 * max(0.0, self._durations[0][0] - self.method.setup_seconds)
        recent = [seconds for seconds, _, _ in self._durations][-min(len(self._durations), self._done - 1) :]
        return max(recent)
