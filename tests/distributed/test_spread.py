"""The executor of worker processes, on workers that are simulated: they die, hesitate, lack things and join late."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.cluster.schedules import SCHEDULES
from support.workers import Chain, Powers, Simulated, alone, run

from etendue.core import ClusterError, Iterations, SceneError
from etendue.distributed import (
    Arrival,
    Lost,
    Recipe,
    Spread,
    dispatcher as dispatcher_module,
    spread as spread_module,
    worker as worker_module,
)
from etendue.distributed.content import Offered
from etendue.distributed.worker import Failed
from etendue.engine import Budget, Order, Replicated, RunError, Runner


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    monkeypatch.setattr(dispatcher_module, "_LOOK", 0.0)
    monkeypatch.setattr(spread_module, "_TICK", 0.0)
    monkeypatch.setattr(spread_module, "_SHORTEST", 1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_each_pass_is_in_the_sum_exactly_once_whatever_workers_do(seed):
    pool = Simulated(Powers, 1 + seed % 5, seed, faults=0.4)
    made = run(pool, Powers(), 200)
    assert made.measurement.iterations.to_json() == [[0, 0, 200]]
    assert made.measurement.sums["x"] == alone(Powers(), 200).measurement.sums["x"]
    assert made.measurement.counters["rays"] == 200
    assert pool.deaths > 0


def test_large_sums_travel_in_single_precision_and_are_added_in_double(monkeypatch):
    monkeypatch.setattr(worker_module, "_LARGE", 0)
    made, expected = run(Simulated(Powers, 3), Powers(), 60).measurement, alone(Powers(), 60).measurement
    for found, known in ((made.sums["x"], expected.sums["x"]), (made.squares["x"], expected.squares["x"])):
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, known, rtol=1e-6)
    plain = replace(expected, sums={"a": np.ones(2), "b": np.array([1e31, 1.0]), "c": np.array([np.nan])})
    sent = worker_module.narrowed(plain).sums
    assert {name: array.dtype for name, array in sent.items()} == {"a": np.float32, "b": np.float64, "c": np.float64}


@pytest.mark.parametrize("seed", range(20))
def test_replicas_go_on_where_they_were_when_their_worker_dies(seed):
    pool, count = Simulated(Chain, 1 + seed % 3, seed, faults=0.3), 1 + seed % 4
    made = run(pool, Replicated(Chain(), None, 5, count), 50)
    expected = alone(Replicated(Chain(), None, 5, count), 50)
    assert made.measurement.iterations == expected.measurement.iterations
    assert made.measurement.sums["x"] == expected.measurement.sums["x"]
    assert made.state == expected.state


def test_replicas_send_their_state_seldom(monkeypatch):
    """A replica makes all of its passes where it is: it takes none from others, so its last chunks are as long as the
    first ones."""
    monkeypatch.setattr(spread_module, "_SHORTEST", 10.0)
    lengths = []

    class Watched(Simulated):
        def outcome(self, worker, chunk):
            lengths.append(chunk.count)
            return super().outcome(worker, chunk)

    run(Watched(Chain, 2), Replicated(Chain(), None, 5, 2), 100)
    assert sorted(lengths) == [1, 1, 49, 49]


def test_a_run_with_gaps_is_resumed_without_making_a_pass_twice():
    begun = run(Simulated(Powers, 2), Powers(), 10)
    gaps = Iterations({0: [(0, 2), (5, 7)]})
    start = sum(
        (Powers().step(i, 5, {}).measurement for _, i in list(gaps)[1:]), Powers().step(0, 5, {}).measurement.copy()
    )
    for continued in (
        run(Simulated(Powers, 3, faults=0.3), Powers(), 10, start.copy()),
        Runner(Powers(), seed=5, budget=Budget(iterations=10), start=start.copy()).run(),
    ):
        assert continued.measurement.iterations.to_json() == [[0, 0, 10]]
        assert continued.measurement.sums["x"] == begun.measurement.sums["x"]


def test_chunks_are_no_longer_than_the_work_that_is_left_and_shares_add_up():
    pool = Simulated(Powers, 3)
    seen = []
    method = Powers()
    method.prepare(None, 5)
    runner = Runner(
        method,
        seed=5,
        budget=Budget(iterations=100),
        executor=lambda order: Spread(pool, Recipe("recipe", Offered()), order),
        on_progress=seen.append,
    )
    runner.run()
    assert sum(seen[-1].shares.values()) == 100
    assert len(seen[-1].shares) == 3
    assert max(seen[-1].shares.values()) < 60


@pytest.mark.parametrize("schedule", SCHEDULES.values())
def test_every_schedule_makes_each_pass_once(schedule):
    for seed in range(5):
        made = run(Simulated(Powers, 3, seed, faults=0.3), Powers(), 90, schedule=schedule)
        assert made.measurement.iterations.to_json() == [[0, 0, 90]]


def hundred():
    return Order(Powers(), 0, {}, most=100)


def test_a_worker_with_nothing_left_steals_in_the_ratio_of_what_was_made():
    work = SCHEDULES["stealing"](hundred())
    names = ["fast", "slow"]

    def make(name, count):
        first, n, *_ = work.take(name, count, names)
        chunk = SimpleNamespace(first=first, count=n)
        work.after(name, chunk, SimpleNamespace(passes=n))
        return first, n

    assert make("slow", 9) == (50, 9)
    assert [make("fast", 25) for _ in range(2)] == [(0, 25), (25, 25)]
    # 41 are left to the slow one, which has made 9 and the fast one 50.
    first, _ = make("fast", 100)
    assert first == 100 - round(41 * 51 / 61)
    static = SCHEDULES["static"](hundred())
    assert static.take("fast", 100, names)[:2] == (0, 50) and static.take("fast", 1, names) is None


class Refusing(Simulated):
    def outcome(self, worker, chunk):
        if worker == "worker 0":
            return Failed("it has mitsuba 3.8", "ClusterError", refused=True)
        return super().outcome(worker, chunk)


def test_a_worker_that_cannot_be_used_is_left_out_and_named(caplog):
    made = run(Refusing(Powers, 2), Powers(), 20)
    assert made.passes == 20
    assert "worker 0 is left out: it has mitsuba 3.8" in caplog.text
    with pytest.raises(ClusterError, match=r"no worker can be used; worker 0: it has mitsuba 3\.8"):
        run(Refusing(Powers, 1), Powers(), 20)


def test_the_error_of_a_pass_names_the_worker_and_keeps_what_was_merged():
    class Failing(Simulated):
        def outcome(self, worker, chunk):
            if chunk.first > 5:
                return Failed("a NaN vertex", "SceneError")
            return super().outcome(worker, chunk)

    with pytest.raises(
        RunError, match=r"a NaN vertex \(on worker worker 0\) \(after \d+ passes, which are kept\)"
    ) as e:
        run(Failing(Powers, 1), Powers(), 50)
    assert isinstance(e.value.__cause__, SceneError)
    kept = e.value.run.measurement
    assert kept.sums["x"] == sum(Powers().value(i, 5, {}) for _, i in kept.iterations)


def test_a_run_whose_workers_always_die_ends():
    class Deadly(Simulated):
        def wait(self, seconds):
            _, ticket, _ = self.sent.popleft()
            return Arrival(ticket, Lost("memory"))

    with pytest.raises(ClusterError, match=r"without finishing a pass; the last was worker .* its memory may be too"):
        run(Deadly(Powers, 2), Powers(), 50)


def test_one_pass_is_made_where_preparation_takes_all_of_the_time():
    """A run without a pass does not end, and workers must not wait for it, nor it for workers."""

    class Slow(Powers):
        def prepare(self, problem: Any, seed: int) -> None:
            super().prepare(problem, seed)
            time.sleep(0.05)

    class Watched(Simulated):
        idle = 0

        def outcome(self, worker, chunk):
            if chunk.left is not None:
                self.desks[worker].end(chunk.run, chunk.left)
            return super().outcome(worker, chunk)

        def wait(self, seconds):
            self.idle += 1
            assert self.idle < 1000, "the run waits for ever"
            return super().wait(seconds)

    method, pool = Powers(), Watched(Slow, 2)
    method.prepare(None, 5)
    make = lambda order: Spread(pool, Recipe("recipe", Offered(), False), order)  # noqa: E731
    made = Runner(method, seed=5, budget=Budget(seconds=0.02), executor=make).run()
    assert 1 <= made.passes <= 4 and made.stopped_by == "seconds"  # each worker has two chunks at a time


def test_an_interrupted_run_keeps_what_has_arrived():
    pool = Simulated(Powers, 2)

    def stop(progress):
        if progress.passes > 10:
            raise KeyboardInterrupt

    method = Powers()
    method.prepare(None, 5)
    runner = Runner(
        method,
        seed=5,
        budget=Budget(iterations=100),
        executor=lambda order: Spread(pool, Recipe("recipe", Offered()), order),
        on_progress=stop,
    )
    with pytest.raises(KeyboardInterrupt):
        runner.run()
    kept = runner.interrupted().measurement
    assert kept.sums["x"] == sum(Powers().value(i, 5, {}) for _, i in kept.iterations)
    assert run(pool, Powers(), 100, kept).measurement.iterations.to_json() == [[0, 0, 100]]
