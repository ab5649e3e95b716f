"""Times of the intermediate saves of a run."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeVar

from etendue.core import OptionError, describe, is_number, logger

T = TypeVar("T")

#: Intermediate saves may take at most this share of the time.
SAVE_SHARE = 0.1
#: Tolerance of times in seconds: the rounding of times that count from the resumption of a run.
CLOCK_GRAIN = 1e-6


def check_period(save_every: float | None) -> None:
    """Raise :class:`OptionError` unless ``save_every`` is a time between intermediate saves, or ``None``."""
    if save_every is not None and not (is_number(save_every) and save_every > 0):
        raise OptionError(f"the time between saves must be above 0 seconds, not {save_every!r}")


def check_save_times(save_at: Sequence[float]) -> None:
    """Raise :class:`OptionError` unless ``save_at`` are times above 0 seconds, each later than the one before."""
    before = 0.0
    for time_ in save_at:
        if not is_number(time_) or time_ <= before:
            raise OptionError(f"the times of saves must be above 0 seconds and grow; {time_!r} after {before:g} is not")
        before = time_


class Saving:
    """Saves every ``every`` seconds of ``clock``, and after the passes that reach the times ``at``, in seconds from the
    beginning of the run."""

    def __init__(self, every: float | None, at: Sequence[float], clock: Callable[[], float]) -> None:
        check_period(every)
        check_save_times(at)
        self._every = math.inf if every is None else every
        self._ahead = deque(at)
        self._failed: tuple[float, ...] = ()  # times whose save failed
        self._requested = False
        self._clock = clock
        self._last = clock()

    def request(self) -> None:
        """Save after the next pass."""
        self._requested = True

    def begin(self) -> None:
        """The run begins now."""
        self._last = self._clock()

    def passed(self, elapsed: float) -> tuple[float, ...]:
        """The times ``at`` up to ``elapsed``, each returned once; and those whose save failed."""
        passed, self._failed = list(self._failed), ()
        while self._reaches(elapsed):
            passed.append(self._ahead.popleft())
        return tuple(passed)

    def _reaches(self, elapsed: float) -> bool:
        return bool(self._ahead) and self._ahead[0] <= elapsed + CLOCK_GRAIN

    def after_pass(self, elapsed: float, save: Callable[[tuple[float, ...]], object], must_save: bool = False) -> None:
        """Call ``save`` with the times that were reached, if a save is due or ``must_save`` is set.

        A failed save is logged and the run continues, and the next save gets its times as well; a failed save that
        ``must_save`` demands raises.
        """
        is_due = self._requested or self._reaches(elapsed) or self._clock() - self._last >= self._every
        if not (is_due or must_save):
            return
        self._requested = False
        times = self.passed(elapsed)
        begin = self._clock()
        try:
            save(times)
        except Exception as error:
            self._failed = times
            if must_save:
                raise
            logger.warning("an intermediate save failed, the run continues: %s", describe(error))
        cost = self._clock() - begin
        # On a slow disk periodic saves become rarer, so that they do not slow down the rendering.
        self._last = self._clock() + max(0.0, cost / SAVE_SHARE - self._every)
