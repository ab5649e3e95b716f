"""Functions that are not traced anew."""

import gc

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.core import Frozen, IndependentSource
from etendue.core.frozen import device_parts, uncollected
from etendue.points import OwenSobolSource


class Table:
    """Stands for a prepared method."""

    def __init__(self) -> None:
        self.values = mi.Float([1.0, 2.0, 3.0])
        self.calls = 0


# device_parts enters étendue's objects only
Table.__module__ = "etendue.tests"


def test_a_frozen_function_sees_new_arguments_and_new_tables() -> None:
    table = Table()

    def scaled(x: mi.Float) -> mi.Float:
        table.calls += 1
        return table.values * x

    frozen = Frozen(scaled, lambda: table)
    for x in (2.0, 3.0, 4.0):
        assert np.array(frozen(dr.opaque(mi.Float, x))).tolist() == [x, 2 * x, 3 * x]
    table.values = mi.Float([5.0, 6.0, 7.0])
    assert np.array(frozen(dr.opaque(mi.Float, 2.0))).tolist() == [10.0, 12.0, 14.0]
    assert table.calls == frozen.recordings == 1


def test_random_numbers_are_arguments() -> None:
    """Sources of every seed are the same to a frozen function."""
    lane = dr.arange(mi.UInt32, 16)
    kinds = {
        "independent": lambda seed: IndependentSource(lane, seed, "test", 0),
        "owen": lambda seed: OwenSobolSource(mi.UInt32(0), lane, seed, "test"),
    }
    for make in kinds.values():
        frozen = Frozen(lambda source: (*source.next_2d(3, 5), source.decide(2, 1)), list)
        for seed in range(4):
            source = make(seed)
            assert np.array_equal(np.array(frozen(source)), np.array((*source.next_2d(3, 5), source.decide(2, 1))))
        assert frozen.recordings == 1


def test_a_function_that_cannot_be_frozen_is_called() -> None:
    def reads_back(x: mi.Float) -> mi.Float:
        return x * float(dr.sum(x)[0])

    frozen = Frozen(reads_back, list)
    for factor in (1.0, 2.0):
        x = mi.Float([1.0, 2.0]) * factor
        assert np.allclose(np.array(frozen(x)), np.array([3.0, 6.0]) * factor**2)
    assert frozen.recordings == 0


def test_device_parts_are_found_in_containers_once() -> None:
    table = Table()
    table.more = {"a": [mi.UInt32(1), "name"], "itself": table}  # type: ignore[attr-defined]
    assert len(device_parts((table, table))) == 2


def test_nothing_is_collected_while_a_function_is_recorded() -> None:
    """Dr.Jit aborts if a frozen function, or a scene, is deleted then."""
    threshold, collections, during = gc.get_threshold(), [], []

    def allocates(x: mi.Float) -> mi.Float:
        before = len(collections)
        parts = [[x + float(k)] for k in range(100)]
        during.append(len(collections) - before)
        return parts[-1][0]

    def count(phase: str, info: dict[str, int]) -> None:
        collections.append(phase)

    gc.callbacks.append(count)
    try:
        gc.set_threshold(10, 10, 10)
        allocates(mi.Float(1.0))
        assert np.array(Frozen(allocates, list)(dr.opaque(mi.Float, 1.0))).tolist() == [100.0]
    finally:
        gc.set_threshold(*threshold)
        gc.callbacks.remove(count)
    assert during[0] > 0 and during[1] == 0 and gc.isenabled()


def test_an_interrupt_gets_through() -> None:
    """Dr.Jit makes a RuntimeError of it."""

    def stopped(x: mi.Float) -> mi.Float:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Frozen(stopped, list)(dr.opaque(mi.Float, 1.0))


def test_collection_is_off_until_the_last_thread_is_through() -> None:
    first, second = uncollected(), uncollected()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert not gc.isenabled()
    second.__exit__(None, None, None)
    assert gc.isenabled()
