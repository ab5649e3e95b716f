"""Execution of work in this thread or in a thread of its own. If it fails, the finished passes are saved."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np

from etendue.core import EtendueError, Progress, describe, format_count, logger
from etendue.engine import RunError, Runner, RunResult, Session

if TYPE_CHECKING:
    from .pages.notebook import LiveProgress

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)
#: Called after each pass; ``False`` ends the run.
Watch = Callable[[Progress, Runner], object]


class Work(Protocol[T_co]):
    """Work that makes passes and a result. If it has a method ``observe``, the method is called with the progress after
    each pass. Work that makes no picture has a method ``told``, which returns the progress with ``made`` set, or an
    attribute ``counted``, a word for one sample. ``started_by``: the function that starts it in the background."""

    def runner(self, **options: Any) -> Runner:
        """The runner of the passes and of intermediate saves; ``options`` are further options of :class:`Runner`."""
        ...

    def keep(self, run: RunResult) -> object:
        """Save the finished passes after a failure, before its error is raised."""
        ...

    def finish(self, run: RunResult) -> T_co:
        """Make the result and write its files."""
        ...


@dataclass(frozen=True)
class Passes:
    """Only the passes of some work; its result is made and written afterwards, in the main thread, where Ctrl-C
    interrupts it."""

    work: Work[Any]

    def runner(self, **options: Any) -> Runner:
        """See :class:`Work`."""
        return self.work.runner(**options)

    def observe(self, progress: Progress) -> None:
        """See :class:`Work`."""
        _observe(self.work, progress)

    def told(self, progress: Progress) -> Progress:
        """See :class:`Work`."""
        return _told(self.work, progress)

    def keep(self, run: RunResult) -> None:
        """See :class:`Work`."""
        self.work.keep(run)

    def finish(self, run: RunResult) -> RunResult:
        """Save. A signal does not end the process here; if saving fails, ``work.finish`` tries again and reports it."""
        with suppress(EtendueError, OSError):
            self.work.keep(run)
        return run


def run_work(work: Work[T], watch: Watch | None = None) -> T:
    """Run in this thread, so that ``watch`` may plot or raise."""
    with _shown() as live:
        runner = _watched(work, threading.Event(), watch if live is None else _both(live.update, watch))
        try:
            run = runner.run()
        except RunError as failure:
            _keep(work, failure.run)
            raise
        except KeyboardInterrupt as error:
            if (done := runner.interrupted()) is not None:
                _keep(work, done)
            _advise(error, work, runner.progress)
            if live is not None:  # the traceback of a pass is long and would fill the page
                raise error.with_traceback(None) from None
            raise
        if live is not None:
            live.finishing(runner.progress)
        return work.finish(run)


def _advise(error: KeyboardInterrupt, work: Work[Any], progress: Progress) -> None:
    """Add advice to the error: after Ctrl-C the caller gets no result, a session keeps it."""
    start = getattr(work, "started_by", "")
    if start:
        error.add_note(
            f"interrupted after {format_count(progress.passes, 'pass')}; to stop a run and keep its result, begin it "
            f"by session = {start}(...), then session.cancel() and session.result"
        )


@contextmanager
def _shown() -> Iterator[LiveProgress | None]:
    """Progress below the cell of a notebook, and at the end how the run ended; ``None`` elsewhere."""
    if (live := _live()) is None:
        yield None
        return
    how = "failed"
    try:
        yield live
        how = "done"
    except KeyboardInterrupt:
        how = "interrupted"
        raise
    finally:
        live.end(how)


def _live() -> LiveProgress | None:
    """Progress below the cell of a notebook; ``None`` elsewhere."""
    if "IPython" not in sys.modules:
        return None
    from .pages.notebook import LiveProgress  # imported late: most of it is for pages and plots

    return LiveProgress.in_notebook("étendue")


def _both(show: Callable[[Progress], object], watch: Watch | None) -> Watch:
    def after_pass(progress: Progress, runner: Runner) -> object:
        show(progress)
        return None if watch is None else watch(progress, runner)

    return after_pass


def start_work(
    open_work: Callable[[], Work[T]], watch: Watch | None = None, at_end: Callable[[], object] = lambda: None
) -> Session[T]:
    """A session that opens, runs and finishes the work in its thread, and saves it if a pass fails. ``at_end`` is
    called last in any case."""
    works: list[Work[T]] = []

    def build(stop: threading.Event) -> Runner:
        works.append(open_work())
        return _watched(works[0], stop, watch)

    def finish(run: RunResult) -> Any:
        # The result of a failed run is not used: the session raises the failure.
        return works[0].keep(run) if run.stopped_by == "failure" else works[0].finish(run)

    return Session(build, finish, at_end)


def _watched(work: Work[Any], stop: threading.Event, watch: Watch | None) -> Runner:
    runner = work.runner(cancel=stop)

    def after_pass(progress: Progress) -> None:
        _observe(work, progress)
        answer = None if watch is None else watch(progress, runner)
        if isinstance(answer, (bool, np.bool_)) and not answer:
            stop.set()

    runner.on_progress = after_pass
    runner.told = partial(_told, work)
    return runner


def _told(work: Work[Any], progress: Progress) -> Progress:
    if (tell := getattr(work, "told", None)) is not None:
        return cast("Progress", tell(progress))
    one = getattr(work, "counted", "")
    return replace(progress, made=format_count(progress.samples, one)) if one else progress


def _observe(work: Work[Any], progress: Progress) -> None:
    if (observe := getattr(work, "observe", None)) is not None:
        observe(progress)


def _keep(work: Work[Any], run: RunResult) -> None:
    try:
        work.keep(run)
    except Exception as error:
        logger.warning("the finished passes could not be saved: %s", describe(error))
