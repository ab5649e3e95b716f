"""How many threads there are; work in threads: order, and streams that are given up."""

from __future__ import annotations

import threading
from functools import partial

import drjit as dr
import pytest

from etendue.core import OptionError, in_order, set_threads, threads


def test_the_number_of_threads():
    before = dr.thread_count()
    try:
        set_threads(1)
        assert dr.thread_count() == threads() == 1
        set_threads(None)
        assert dr.thread_count() == 1
    finally:
        set_threads(before)
    for bad in (0, -2, 1.5, "four", True):
        with pytest.raises(OptionError, match="number of threads"):
            set_threads(bad)


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
