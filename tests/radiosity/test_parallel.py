"""Work in threads: order, and streams that are given up."""

from __future__ import annotations

import threading
from functools import partial

from etendue.radiosity.parallel import in_order, threads


def test_results_come_in_the_order_of_the_tasks():
    assert list(in_order(partial(pow, k, 2) for k in range(50))) == [k * k for k in range(50)]


def test_open_streams_share_their_threads():
    """None has threads that would have to be joined when the garbage collector closes it, perhaps in one of them."""
    list(in_order([int, int, int]))
    before = threading.active_count()
    streams = [in_order(partial(pow, k, 2) for k in range(40)) for _ in range(20)]
    assert [next(stream) for stream in streams] == [0] * 20
    assert threading.active_count() <= before + threads()
    del streams
    assert list(in_order([int])) == [0]
