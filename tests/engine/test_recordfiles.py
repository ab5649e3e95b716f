"""Records beside checkpoints: written once, never half, found again bit by bit."""

from __future__ import annotations

import os
import shutil
import signal
import time

import numpy as np
import pytest

import etendue.engine.checkpoint
from etendue.core import CheckpointError, Iterations, Measurement, OutputError, Record
from etendue.engine import Checkpoint

PASSES = 20


def rows(iteration):
    return np.random.default_rng(iteration).integers(0, 1 << 30, (iteration % 5, 2), np.uint32)


def measured(iterations):
    total = None
    for i in iterations:
        records = {"hits": Record.single(rows(i), i), "paths": Record.single(np.arange(3.0) + i, i)}
        one = Measurement({}, {}, Iterations.single(i), counters={"rays": 1.0}, records=records)
        total = one if total is None else total + one
    return total


def checkpoint(measurement):
    return Checkpoint(measurement, "noise", "{}", seed=1, fingerprint="x")


def files(path):
    return {file.name: file.stat() for file in path.with_name(path.name + ".records").iterdir()}


def check(path, passes):
    found = Checkpoint.read(path).measurement
    assert len(found.iterations) == passes
    assert found.records["hits"].passes == found.records["paths"].passes == [(0, i) for i in range(passes)]
    for i in range(passes):
        np.testing.assert_array_equal(found.records["hits"][0, i], rows(i))
        np.testing.assert_array_equal(found.records["paths"][0, i], np.arange(3.0) + i)
    return found


def test_a_save_writes_what_is_new(tmp_path):
    path = tmp_path / "a"
    total = measured(range(PASSES))
    checkpoint(total).write(path)
    before = files(path)
    assert len(before) == 2
    checkpoint(total).write(path)
    assert files(path) == before  # nothing is new
    total += measured(range(PASSES, PASSES + 4))
    checkpoint(total).write(path)
    after = files(path)
    assert len(after) == 4 and {name: after[name] for name in before} == before
    found = check(path, PASSES + 4)
    # Rows lie in the files, for what was read and for what was written.
    for record in (found.records["hits"], total.records["hits"]):
        assert not any(array.flags.writeable for array in record)
    # A resumed run goes on in the same way; another name gets all.
    found += measured(range(PASSES + 4, PASSES + 6))
    checkpoint(found).write(path)
    assert before.items() < files(path).items()
    checkpoint(found).write(tmp_path / "b")
    assert len(files(tmp_path / "b")) == 2
    check(path, PASSES + 6)
    check(tmp_path / "b", PASSES + 6)


def test_many_saves_leave_few_files(tmp_path):
    """Each is mapped into memory, for which the system gives so many at a time."""
    path, total = tmp_path / "a", measured(range(1))
    saves, written, seen = 200, 0, {}
    for i in range(1, saves):
        total += measured([i])
        checkpoint(total).write(path)
        now = files(path)
        written += sum(stat.st_size for name, stat in now.items() if name not in seen)
        seen = now
    assert len(seen) <= 2 * (np.log2(saves) + 2)
    size = sum(stat.st_size for stat in seen.values())
    assert written < np.log2(saves) * size + 200 * saves * 2  # rows are written log n times, headers each time
    check(path, saves)


def test_two_runs_of_one_name(tmp_path):
    """The last one to save is what the checkpoint has, as for a picture."""
    path, first, second = tmp_path / "a", measured(range(5)), measured(range(7))
    checkpoint(first).write(path)
    checkpoint(second).write(path)  # removes the files of the first
    first += measured(range(5, 6))
    checkpoint(first).write(path)
    check(path, 6)
    shutil.rmtree(tmp_path / "a.records")
    checkpoint(first).write(path)
    check(path, 6)


def test_what_no_checkpoint_names_is_removed_by_the_next_save(tmp_path):
    path = tmp_path / "a"
    checkpoint(measured(range(9))).write(path)
    left_over = tmp_path / "a.records" / "hits-0123456789ab.npy"
    np.save(left_over, rows(4))
    mine = tmp_path / "a.records" / "mine.npy"
    np.save(mine, rows(4))
    check(path, 9)
    checkpoint(measured(range(4))).write(path)  # another run
    assert not left_over.exists() and mine.exists() and len(files(path)) == 3
    mine.unlink()
    check(path, 4)
    checkpoint(Measurement({}, {}, Iterations.single(0))).write(path)
    assert not (tmp_path / "a.records").exists()


def test_a_save_that_fails_leaves_the_checkpoint_of_before(tmp_path, monkeypatch):
    path = tmp_path / "a"
    total = measured(range(5))
    checkpoint(total).write(path)

    def full(*arguments, **named):
        raise OSError(28, "No space left on device")

    total += measured(range(5, 9))
    for part in ("write_array_header_2_0", None):
        with monkeypatch.context() as patch:
            if part is None:
                patch.setattr(etendue.engine.checkpoint.np, "savez", full)
            else:
                patch.setattr(np.lib.format, part, full)
            with pytest.raises(OutputError, match="No space left"):
                checkpoint(total).write(path)
        check(path, 5)
    checkpoint(total).write(path)
    check(path, 9)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OutputError, match=r"there is no folder .*gone"):
        checkpoint(measured(range(2))).write(tmp_path / "gone" / "a")


@pytest.mark.parametrize("damage", ["cut", "changed", "missing", "moved"])
def test_damaged_records_are_said_to_be(tmp_path, damage):
    path = tmp_path / "a"
    checkpoint(measured(range(5))).write(path)
    file = next((tmp_path / "a.records").glob("paths-*"))
    data = bytearray(file.read_bytes())
    if damage == "cut":
        file.write_bytes(data[:-8])
    elif damage == "changed":
        data[-3] ^= 1
        file.write_bytes(data)
    elif damage == "missing":
        file.unlink()
    else:
        path = shutil.move(path, tmp_path / "elsewhere")
    expected = {"missing": "is missing", "moved": "move the checkpoint and its folder"}.get(damage, "is damaged")
    with pytest.raises(CheckpointError, match=expected):
        Checkpoint.read(path)


def test_a_writer_that_is_killed_leaves_a_whole_checkpoint(tmp_path):
    """At any moment: some of 20 kills come while files are written, before or after the checkpoint."""
    path = tmp_path / "a"
    for attempt in range(20):
        ours, theirs = os.pipe()
        writer = os.fork()
        if writer == 0:  # writes files and pipes, nothing else
            try:
                total = measured(range(1))
                while True:
                    checkpoint(total).write(path)
                    os.write(theirs, b".")
                    total += measured([len(total.iterations)])
            finally:
                os._exit(1)
        os.close(theirs)
        said = 0
        while said < 1 + attempt % 3:
            got = os.read(ours, 1)
            assert got, "the writer has failed"
            said += len(got)
        time.sleep(0.002 * attempt)
        os.kill(writer, signal.SIGKILL)
        os.waitpid(writer, 0)
        said += len(os.read(ours, 1 << 20))
        os.close(ours)
        found = Checkpoint.read(path).measurement
        assert len(found.iterations) in (said, said + 1)
        check(path, len(found.iterations))
