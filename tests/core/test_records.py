"""Records: rows of passes, kept in order and never summed."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.core import EtendueError, Iterations, Measurement, Record


def rows(iteration, count=3, kind=np.uint32):
    return np.full((count, 2), iteration, kind)


def one(iteration, replica=0, **options):
    record = Record.single(rows(iteration, **options), iteration, replica)
    return Measurement({}, {}, Iterations.single(iteration, replica), records={"hits": record})


def test_rows_stay_those_of_their_passes_in_any_order_of_adding():
    total = one(4)
    for iteration, replica in ((0, 1), (7, 0), (2, 0)):
        total += one(iteration, replica, count=iteration + 1)
    record = total.records["hits"]
    assert record.passes == [(0, 2), (0, 4), (0, 7), (1, 0)]
    assert [array[0, 0] for array in record] == [2, 4, 7, 0]
    assert len(record) == 3 + 3 + 8 + 1 and record.nbytes == 15 * 8
    np.testing.assert_array_equal(record[0, 7], rows(7, 8))


def test_a_pass_is_in_a_record_once():
    total = one(1) + one(2)
    with pytest.raises(EtendueError, match="iteration 2 of replica 0"):
        total += one(2)
    with pytest.raises(EtendueError, match="iteration 2 of replica 0"):
        total.records["hits"] += Record.single(rows(2), 2)
    assert len(total.records["hits"]) == 6 and len(total.iterations) == 2


def test_rows_of_another_kind_are_refused_before_anything_is_added():
    total = one(1)
    with pytest.raises(EtendueError, match="different types of rows"):
        total += one(2, kind=np.float32)
    with pytest.raises(EtendueError, match="different layers"):
        total += Measurement({}, {}, Iterations.single(3))
    assert len(total.iterations) == 1 and total.records["hits"].passes == [(0, 1)]


def test_a_copy_grows_by_itself():
    first = one(1)
    both = first + one(2)
    assert len(first.records["hits"]) == 3 and len(both.records["hits"]) == 6
    both.scale(2.0)  # weighs sums, not rows
    np.testing.assert_array_equal(both.records["hits"][0, 1], rows(1))
