"""Runs in the background."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from etendue.core import SceneError
from etendue.engine import Budget, Cancelled, RunError, Runner, Session


def session_of(method, budget=None, **options):
    return Session(
        lambda cancel: Runner(method, seed=0, budget=budget or Budget(), cancel=cancel, **options), lambda run: run
    )


def wait_for(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.002)


def test_it_returns_at_once_and_cancel_blocks_until_stopped(slow_noise):
    session = session_of(slow_noise)
    assert session.running
    wait_for(lambda: session.progress.passes >= 3)
    session.cancel()
    assert not session.running
    assert not any(t.name == "etendue-session" for t in threading.enumerate())
    done = session.result.passes
    assert done >= 3
    time.sleep(0.05)
    assert session.progress.passes == done
    assert session.result.stopped_by == "cancel"


def test_the_picture_so_far_is_a_copy_and_finite(slow_noise):
    slow_noise.before_pass = lambda iteration: time.sleep(0.2 if iteration == 0 else 0.005)
    session = session_of(slow_noise)
    assert session.image is None
    assert session.progress.passes == 0
    wait_for(lambda: session.image is not None)
    early = session.image
    kept = early.copy()
    wait_for(lambda: session.progress.passes >= 5)
    session.cancel()
    assert np.array_equal(early, kept)
    assert not np.array_equal(early, session.image)
    assert np.array_equal(session.image, session.result.result.image)


def test_wait_with_and_without_timeout(slow_noise):
    session = session_of(slow_noise, Budget(iterations=20))
    assert session.wait(0.02) is False
    assert session.wait() is True
    assert session.result.passes == 20


def test_errors_come_out_where_one_waits(noise):
    def build(cancel):
        raise SceneError("the scene has no sensor")

    session = Session(build, lambda run: run)
    with pytest.raises(SceneError, match="no sensor"):
        session.wait()
    with pytest.raises(SceneError, match="no sensor"):
        _ = session.result
    session.cancel()  # stops nothing, raises nothing


def test_a_failing_pass_is_saved_then_reported(noise):
    def fail(iteration):
        if iteration == 2:
            raise RuntimeError("lost")

    noise.before_pass = fail
    finished = []
    session = Session(
        lambda cancel: Runner(noise, seed=0, budget=Budget(iterations=9), cancel=cancel),
        lambda run: finished.append(run),
    )
    with pytest.raises(RunError, match="lost"):
        session.wait()
    assert [run.passes for run in finished] == [2]
    assert session.image is not None


def test_cancel_before_the_first_pass(noise):
    ready = threading.Event()

    def build(cancel):
        ready.wait(5)
        return Runner(noise, seed=0, budget=Budget(), cancel=cancel)

    session = Session(build, lambda run: run)
    session.request_stop()
    ready.set()
    session.cancel()
    with pytest.raises(Cancelled):
        session.wait()


def test_the_context_manager_stops_the_run(slow_noise):
    with session_of(slow_noise) as session:
        wait_for(lambda: session.progress.passes >= 1)
    assert not session.running
    assert session.result.passes >= 1


def test_the_context_manager_hides_no_error(noise):
    def build(cancel):
        raise SceneError("the scene has no sensor")

    with pytest.raises(SceneError, match="no sensor"), Session(build, lambda run: run):
        pass


def test_flags_of_the_creating_thread_hold(noise):
    import drjit as dr

    seen = []
    noise.before_pass = lambda iteration: seen.append(dr.flag(dr.JitFlag.OptimizeLoops))
    before = dr.flag(dr.JitFlag.OptimizeLoops)
    with dr.scoped_set_flag(dr.JitFlag.OptimizeLoops, not before):
        session_of(noise, Budget(iterations=1)).wait()
    session_of(noise, Budget(iterations=1)).wait()
    assert seen == [not before, before]
