"""What workers, pools and runs before leave behind: nothing is counted twice, nothing is waited for in vain."""

from __future__ import annotations

import itertools

import pytest
from support.workers import Chain, Powers, Simulated, alone, run

from etendue.core import ClusterError, SceneError
from etendue.distributed import Arrival, Lost, dispatcher as dispatcher_module, spread as spread_module
from etendue.distributed.pool import Delivered
from etendue.distributed.worker import Failed, Needs
from etendue.engine import Replicated


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    monkeypatch.setattr(dispatcher_module, "_LOOK", 0.0)
    monkeypatch.setattr(spread_module, "_TICK", 0.0)
    monkeypatch.setattr(spread_module, "_SHORTEST", 1e-4)


class Patient(Simulated):
    """Fails instead of waiting for ever."""

    waits = 0

    def wait(self, seconds):
        self.waits += 1
        assert self.waits < 5000, "the run waits for ever"
        return super().wait(seconds)


def test_sums_of_a_run_that_failed_are_not_those_of_the_next():
    """As in `compare`: two methods, one after the other, on the same workers. Sums that are on their way when a run
    ends arrive during the next one."""

    class Other(Powers):
        def value(self, iteration, seed, state):
            return -1.0

    class Late(Simulated):
        fails = True

        def send(self, worker, ticket, chunk):
            outcome = Failed("a NaN vertex", "SceneError") if self.fails else self.outcome(worker, chunk)
            self.fails = False
            self.sent.append((ticket, outcome))

        def wait(self, seconds):
            return Arrival(*self.sent.popleft()) if self.sent else None

        def forget(self, tickets): ...

    pool = Late(Other, 2)
    with pytest.raises(SceneError, match="a NaN vertex"):
        run(pool, Other(), 20)
    pool.kind = Powers
    made = run(pool, Powers(), 20)
    assert made.measurement.sums["x"] == alone(Powers(), 20).measurement.sums["x"]


def test_a_cluster_whose_workers_die_of_every_pass_is_an_error():
    """Dask tells no loss: a worker is no longer in the list, and another one takes its place."""

    class Deadly(Patient):
        def wait(self, seconds):
            self.waits += 1
            assert self.waits < 5000, "the run waits for ever"
            self.desks.clear()
            self.join()

    with pytest.raises(ClusterError, match="without finishing a pass; the last was worker"):
        run(Deadly(Powers, 1), Powers(), 20)


def test_many_workers_may_end_at_once():
    class Preempted(Patient):
        def wait(self, seconds):
            if self.waits == 30:
                self.desks.clear()
                for _ in range(40):
                    self.join()
            return super().wait(seconds)

    made = run(Preempted(Powers, 40), Powers(), 200)
    assert made.measurement.sums["x"] == alone(Powers(), 200).measurement.sums["x"]


def test_a_lost_worker_is_waited_for_also_if_another_one_was_left_out():
    class Restarting(Patient):
        def outcome(self, worker, chunk):
            if worker == "worker 0":
                return Failed("it has mitsuba 3.8", "ClusterError", refused=True)
            return super().outcome(worker, chunk)

        def wait(self, seconds):
            if self.waits == 20:
                del self.desks["worker 1"]
                self.sent.clear()
            if self.waits == 30:
                self.join()
            return super().wait(seconds)

    made = run(Restarting(Powers, 2), Powers(), 200)
    assert made.measurement.sums["x"] == alone(Powers(), 200).measurement.sums["x"]


def test_a_worker_that_ends_while_it_is_sent_a_file_is_not_left_out():
    class Dying(Patient):
        times = 0

        def outcome(self, worker, chunk):
            return super().outcome(worker, chunk) if self.times > 2 else Needs(("scene",))

        def deliver(self, worker, ticket, offered, digest):
            self.times += 1
            lost = Delivered("it does not answer", is_lost=True)
            self.sent.append((worker, ticket, lost if self.times < 3 else Delivered()))

    assert run(Dying(Powers, 1), Powers(), 20).passes == 20


def test_a_replica_whose_first_passes_did_not_arrive_begins_anew():
    """Its worker is ahead of it, and there is no state to send."""

    class Forgetful(Patient):
        lost = False

        def outcome(self, worker, chunk):
            made = super().outcome(worker, chunk)
            if self.lost:
                return made
            self.lost = True
            return Lost("the connection broke")

    made = run(Forgetful(Chain, 2), Replicated(Chain(), None, 5, 2), 20)
    expected = alone(Replicated(Chain(), None, 5, 2), 20)
    assert made.measurement.sums["x"] == expected.measurement.sums["x"]
    assert made.state == expected.state


def test_passes_that_are_wanted_one_by_one_are_not_merged_among_workers():
    """A file of particles has passes one by one."""

    class Merging(Simulated):
        def wait(self, seconds):
            if not self.sent:
                return None
            worker, ticket, chunk = self.sent.popleft()
            if not chunk.may_merge:
                return Arrival(ticket, self.outcome(worker, chunk))
            return self.bundle(worker, ticket, chunk, 5)

    sizes = []
    for longest in (1, None):
        counts = [0]
        pool = Merging(Powers, 3)
        made = run(pool, Powers(), 30, longest=longest, on_progress=lambda p, c=counts: c.append(p.passes))
        assert made.measurement.sums["x"] == alone(Powers(), 30).measurement.sums["x"]
        sizes.append(max(b - a for a, b in itertools.pairwise(counts)))
    assert sizes[0] == 1 < sizes[1]
