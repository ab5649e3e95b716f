"""Where sums are merged, what is kept of a lost worker, and when slow workers end."""

from __future__ import annotations

import pytest
from benchmarks.cluster.simulated import Site, simulate
from support.workers import Powers, Simulated, run

from etendue.distributed import Arrival, dispatcher as dispatcher_module
from etendue.distributed.gathering import Bundle, Gathering, held_by_others
from etendue.distributed.worker import merge_outcomes


def test_sums_of_a_level_are_merged_and_the_highest_is_fetched():
    gathering, parts = Gathering(fan_in=3, fetches=1), [Bundle((ticket,), f"w{ticket}") for ticket in range(8)]
    for part in parts:
        gathering.put(part)
    assert gathering.next() == [parts[0]]  # the client keeps up
    assert gathering.next() is None
    gathering.fetched(1.0)
    gathering.next()
    merged = []
    while (chosen := gathering.next()) is not None:
        assert len({part.level for part in chosen}) == 1
        merged.append(Bundle.of(chosen))
        gathering.put(merged[-1])
    assert [bundle.tickets for bundle in merged] == [(2, 3, 4), (5, 6, 7)]
    gathering.put(single := Bundle((8,), "w8"))
    gathering.fetched(1.0)
    assert gathering.next() == [merged[0]]
    assert gathering.drop({6, 8}) == [single, merged[1]]


def test_what_is_lost_with_a_worker():
    parts = [Bundle((0,), "a"), Bundle((1,), "b")]
    merged = Bundle.of(parts)
    assert held_by_others([merged], "b", [1, 7]) == set()  # not merged yet
    Gathering().put(merged)
    assert held_by_others([merged], "b", [1, 7]) == {1}
    assert held_by_others([merged], "a", [0]) == set()


class Leaving(Simulated):
    """Its second worker leaves when both have made a chunk, and the first one holds the sum."""

    def __init__(self) -> None:
        super().__init__(Powers, 2)
        self.firsts: list[int] = []
        self.waits = 0

    def send(self, worker, ticket, chunk):
        self.firsts.append(chunk.first)
        super().send(worker, ticket, chunk)

    def held_by_others(self, worker, tickets):
        return set(tickets)

    def wait(self, seconds):
        self.waits += 1
        if self.waits == 1:
            (one, self.ticket, chunk), (two, self.other, further) = self.sent
            self.sent.clear()
            self.sum = merge_outcomes(self.outcome(one, chunk), self.outcome(two, further))
            del self.desks[two]
        assert self.waits < 100
        # The loss is seen before the sum arrives.
        return Arrival(self.ticket, self.sum, 0.0, (self.other,)) if self.waits == 4 else None


def test_what_others_hold_of_a_lost_worker_is_not_made_again(monkeypatch):
    monkeypatch.setattr(dispatcher_module, "_LOOK", 0.0)
    pool = Leaving()
    made = run(pool, Powers(), 2)
    assert made.measurement.iterations.to_json() == [[0, 0, 2]]
    assert pool.firsts == [0, 1]


@pytest.mark.parametrize("slow", [4.0, 16.0])
def test_a_slow_worker_ends_with_the_others(slow):
    site = Site(20, 0.5, 1e5, first_seconds=0.0, spread=0.0, stragglers=0.0, losses=0.0, slow=slow, slow_ones=(3,))
    made = simulate(site, 2400)
    assert made.seconds < 2400 * 0.5 / (19 + 1 / slow) + slow * 0.5
