"""Schedules of the thesis beside that of the library: equal shares of the passes, and stealing."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from itertools import islice
from typing import ClassVar

from etendue.distributed.schedules import Next, OnDemand, Schedule
from etendue.distributed.worker import Chunk, Made
from etendue.engine import Order


class Static:
    """Equal shares of all passes from the beginning, one for each worker. The passes of a lost worker go to workers
    that have none left; workers that join later get no others."""

    in_flight: ClassVar[int] = OnDemand.in_flight

    def __init__(self, order: Order) -> None:
        assert order.most is not None, "shares are those of a number of passes"
        self._all = _ranges(islice(order.done.missing(), max(0, order.most - len(order.done))))
        self._queues: dict[str, deque[range]] = {}
        self._loose: deque[range] = deque()
        self._made: Counter[str] = Counter()
        self._begun = False

    def take(self, worker: str, count: int, workers: Collection[str]) -> Next | None:
        """See :class:`Schedule`."""
        if not self._begun:
            self._begun = True
            names = sorted(workers)
            for name, share in zip(names, _shares(self._all, len(names)), strict=True):
                self._queues[name] = share
        queue = self._queues.setdefault(worker, deque())
        if not queue:
            if self._loose:
                queue.append(self._loose.popleft())
            elif not self._refill(worker, queue):
                return None
        first = queue.popleft()
        if len(first) > count:
            queue.appendleft(first[count:])
            first = first[:count]
        return first.start, len(first), None, None

    def _refill(self, worker: str, queue: deque[range]) -> bool:
        return False

    def give_back(self, chunk: Chunk, first: int) -> None:
        """See :class:`Schedule`."""
        if first < chunk.first + chunk.count:
            self._loose.append(range(first, chunk.first + chunk.count))

    def after(self, worker: str, chunk: Chunk, made: Made) -> None:
        """See :class:`Schedule`."""
        self._made[worker] += made.passes

    def lost(self, worker: str) -> None:
        """See :class:`Schedule`."""
        self._loose.extend(self._queues.pop(worker, ()))


class Stealing(Static):
    """Equal shares at first. A worker without passes takes some from the worker with the most, in the ratio of the
    passes that both have made [Leeson 2001, sec. 5.6.4]."""

    def _refill(self, worker: str, queue: deque[range]) -> bool:
        victim = max(self._queues, key=lambda name: sum(map(len, self._queues[name])))
        rest = self._queues[victim]
        left = sum(map(len, rest))
        if not left:
            return False
        mine, other = self._made[worker] + 1, self._made[victim] + 1
        wanted = max(1, round(left * mine / (mine + other)))
        while wanted:
            last = rest.pop()  # the victim goes on at the front
            if len(last) > wanted:
                rest.append(last[:-wanted])
                last = last[-wanted:]
            queue.appendleft(last)
            wanted -= len(last)
        return True


SCHEDULES: dict[str, Callable[[Order], Schedule]] = {"demand": OnDemand, "static": Static, "stealing": Stealing}


def _ranges(numbers: Iterator[int]) -> list[range]:
    """Ascending numbers as ranges of consecutive numbers."""
    found: list[range] = []
    for number in numbers:
        if found and found[-1].stop == number:
            found[-1] = range(found[-1].start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


def _shares(ranges: list[range], parts: int) -> list[deque[range]]:
    """The numbers of ranges in ``parts`` parts whose sizes differ by at most 1."""
    total, shares = sum(map(len, ranges)), []
    rest = deque(ranges)
    for part in range(parts):
        wanted = total * (part + 1) // parts - total * part // parts
        share: deque[range] = deque()
        while wanted:
            first = rest.popleft()
            if len(first) > wanted:
                rest.appendleft(first[wanted:])
                first = first[:wanted]
            share.append(first)
            wanted -= len(first)
        shares.append(share)
    return shares
