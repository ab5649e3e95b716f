"""Runs of jobs: in this thread, or in a thread of their own. If a pass fails, the finished passes are saved."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import EtendueError, Progress, Result, describe, format_count, logger, own_kernels
from etendue.engine import InTurn, Job, RunError, Runner, RunResult, Session

if TYPE_CHECKING:
    from etendue.distributed import Cluster

    from .pages.notebook import LiveProgress
    from .pictures import Image


@dataclass(frozen=True)
class Update:
    """The argument of a callback after each pass; ``False`` from the callback ends the run."""

    progress: Progress
    _runner: Runner = field(repr=False)

    @property
    def image(self) -> Image:
        """The current picture, developed at each access; only of methods that make pictures."""
        return self.layers["image"]

    @property
    def layers(self) -> dict[str, Image]:
        """The current picture with its layers, developed at each access."""
        return self.result.layers

    @property
    def result(self) -> Result:
        """The layers and the metadata of the current picture, developed at each access."""
        snapshot = self._runner.snapshot()
        assert snapshot is not None  # a callback follows a pass
        return snapshot


#: Called after each pass; ``False`` ends the run.
Callback = Callable[[Update], object]


@own_kernels()
def run_job(open_job: Callable[[], Job], callback: Callback | None = None, cluster: Cluster | None = None) -> Any:
    """Run in this thread, so that ``callback`` may plot or raise; ``cluster`` makes the passes. Returns the product."""
    job = open_job()
    with _shown() as live:
        runner = _watched(job, threading.Event(), callback, cluster, live)
        try:
            run = runner.run()
        except RunError as failure:
            _keep(job, failure.run)
            raise
        except KeyboardInterrupt as error:
            if (done := runner.interrupted()) is not None:
                _keep(job, done)
            error.add_note(
                f"interrupted after {format_count(runner.progress.passes, 'pass')}; to stop a run and keep its result, "
                "begin it with wait=False, then session.cancel() and session.result"
            )
            if live is not None:  # the traceback of a pass is long and would fill the page
                raise error.with_traceback(None) from None
            raise
        if live is not None:
            live.finishing(runner.progress)
        return job.product.finish(job, run)


def start_job(
    open_job: Callable[[], Job],
    callback: Callback | None = None,
    cluster: Cluster | None = None,
    *,
    finish: bool = True,
    at_end: Callable[[], object] = lambda: None,
) -> Session[Any]:
    """A session that opens a job in its thread, runs it and makes its product, and saves the passes if one fails.

    Without ``finish`` its result is (job, run): the product is made afterwards, in the main thread, where Ctrl-C
    interrupts it; passes are saved before. ``callback`` is called in the thread. ``at_end`` is called last in any case.
    """
    jobs: list[Job] = []

    def build(stop: threading.Event) -> Runner:
        jobs.append(open_job())
        return _watched(jobs[0], stop, callback, cluster)

    def end(run: RunResult) -> Any:
        job = jobs[0]
        if run.stopped_by == "failure":  # the session raises the failure
            return job.product.keep(job, run)
        if finish:
            return job.product.finish(job, run)
        with suppress(EtendueError, OSError):  # finish tries again and reports it
            job.product.keep(job, run)
        return job, run

    return Session(build, end, at_end)


def _watched(
    job: Job,
    stop: threading.Event,
    callback: Callback | None,
    cluster: Cluster | None = None,
    live: LiveProgress | None = None,
) -> Runner:
    runner = job.runner(InTurn if cluster is None else job.product.divided(job, cluster), cancel=stop)

    def after_pass(progress: Progress) -> None:
        if live is not None:
            live.update(progress)
        answer = None if callback is None else callback(Update(progress, runner))
        if isinstance(answer, (bool, np.bool_)) and not answer:
            stop.set()

    runner.on_progress = after_pass
    return runner


def _keep(job: Job, run: RunResult) -> None:
    try:
        job.product.keep(job, run)
    except Exception as error:
        logger.warning("the finished passes could not be saved: %s", describe(error))


@contextmanager
def _shown() -> Iterator[LiveProgress | None]:
    """Progress below the cell of a notebook, and at the end how the run ended; ``None`` elsewhere."""
    if "IPython" not in sys.modules:
        yield None
        return
    from .pages.notebook import LiveProgress  # imported late: most of it is for pages and plots

    if (live := LiveProgress.in_notebook("étendue")) is None:
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
