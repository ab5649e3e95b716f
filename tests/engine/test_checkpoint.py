"""Checkpoints: whole or not there, exact, and particular about what they go on with."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from etendue.core import CheckpointError, OutputError
from etendue.engine import Budget, Checkpoint, Runner


@pytest.fixture
def checkpoint(noise):
    noise.prepare(None, 5)
    result = Runner(noise, seed=5, budget=Budget(iterations=3)).run()
    return Checkpoint(
        measurement=result.measurement,
        method="noise",
        settings=noise.settings.to_json(),
        seed=5,
        fingerprint="abc",
        state=noise.state(),
        scene={"source": "/somewhere/sçene.xml", "size": [4, 5]},
        budget={"seconds": 60.0},
        stopped_by="cancel",
        versions={"etendue": "1"},
        elapsed=1.5,
    )


def test_round_trip(checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint")
    for name, array in checkpoint.measurement.sums.items():
        assert read.measurement.sums[name].dtype == np.float64
        assert np.array_equal(read.measurement.sums[name], array)
    assert np.array_equal(read.measurement.squares["image"], checkpoint.measurement.squares["image"])
    assert read.measurement.weights == checkpoint.measurement.weights
    assert read.measurement.counters == checkpoint.measurement.counters
    assert read.measurement.iterations == checkpoint.measurement.iterations
    assert read.state["pilot"] == 5.5
    assert np.array_equal(read.state["table"], np.arange(3.0))
    assert read.state["nested"] == {"list": [1, 2.0]}
    for name in ("method", "settings", "seed", "fingerprint", "scene", "budget", "stopped_by", "versions", "elapsed"):
        assert getattr(read, name) == getattr(checkpoint, name)
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]


def test_a_resumed_run_is_bit_equal_to_an_uninterrupted_one(noise, checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint")
    resumed = Runner(noise, seed=read.seed, budget=Budget(iterations=8), start=read.measurement).run()
    whole = Runner(noise, seed=5, budget=Budget(iterations=8)).run()
    for name in whole.measurement.sums:
        assert np.array_equal(resumed.measurement.sums[name], whole.measurement.sums[name])
    assert np.array_equal(resumed.measurement.squares["image"], whole.measurement.squares["image"])


def test_it_holds_no_pickle(checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    with zipfile.ZipFile(tmp_path / "a.checkpoint") as archive:
        for name in archive.namelist():
            np.load(io.BytesIO(archive.read(name)), allow_pickle=False)
        assert len(archive.namelist()) > 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fingerprint": "xyz"}, "the scene is not the one"),
        ({"method": "path"}, "made by method 'noise', not 'path'"),
        ({"settings": '{"max_depth": 3, "samples_per_pass": 1}'}, r"max_depth was -1, is 3"),
        ({"seed": 6}, "made with seed 5, not 6"),
    ],
)
def test_another_scene_method_setting_or_seed_is_refused(checkpoint, change, message):
    same = {"fingerprint": "abc", "method": "noise", "settings": checkpoint.settings, "seed": 5}
    checkpoint.require(**same)
    with pytest.raises(CheckpointError, match=message):
        checkpoint.require(**(same | change))


def test_missing_file(tmp_path):
    with pytest.raises(CheckpointError, match="there is no checkpoint"):
        Checkpoint.read(tmp_path / "a.checkpoint")


def test_something_else(tmp_path):
    (tmp_path / "text").write_text("hello")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    (tmp_path / "empty").write_bytes(b"")
    for name in ("text", "other.npz", "empty", "."):
        with pytest.raises(CheckpointError):
            Checkpoint.read(tmp_path / name)


def test_every_kind_of_damage_is_noticed(checkpoint, tmp_path):
    path = tmp_path / "a.checkpoint"
    checkpoint.write(path)
    whole = path.read_bytes()
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        with pytest.raises(CheckpointError):
            Checkpoint.read(path)
    expected = checkpoint.measurement.sums["image"]
    noticed = 0
    for position in range(0, len(whole), 31):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0xFF]) + whole[position + 1 :])
        try:
            # A byte that nothing depends on (a date in the archive's directory) may change.
            assert np.array_equal(Checkpoint.read(path).measurement.sums["image"], expected)
        except CheckpointError:
            noticed += 1
    assert noticed > 0.7 * len(whole) / 31


def test_another_format_says_which(checkpoint, tmp_path, monkeypatch):
    monkeypatch.setattr("etendue.engine.checkpoint.FORMAT", 99)
    checkpoint.write(tmp_path / "a")
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="has format 99, this étendue reads format 1"):
        Checkpoint.read(tmp_path / "a")


def test_unwritable_place(checkpoint, tmp_path):
    with pytest.raises(OutputError, match="cannot write"):
        checkpoint.write(tmp_path / "missing" / "a")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="resource limits are a thing of Unix")
def test_a_full_disk_is_one_error_and_keeps_the_old_file(checkpoint, tmp_path):
    path = tmp_path / "a.checkpoint"
    replace(checkpoint, fingerprint="old").write(path)
    checkpoint.measurement.sums["image"] = np.ones((200, 200, 3))
    checkpoint.write(tmp_path / "big")
    script = """
import resource, signal, sys
from etendue.core import OutputError
from etendue.engine import Checkpoint
c = Checkpoint.read(sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    c.write(sys.argv[2])
except OutputError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "big", path], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cannot write")
    assert Checkpoint.read(path).fingerprint == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.checkpoint", "big"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_killed_process_leaves_a_whole_checkpoint(checkpoint, tmp_path):
    path, source = tmp_path / "a.checkpoint", tmp_path / "source"
    checkpoint.measurement.sums["image"] = np.random.default_rng(0).random((256, 256, 3))
    checkpoint.write(source)
    script = """
import sys
from etendue.engine import Checkpoint
c = Checkpoint.read(sys.argv[1])
print("ready", flush=True)
while True:
    c.elapsed += 1
    c.write(sys.argv[2])
"""
    delays = np.random.default_rng(1).uniform(0.02, 0.15, 6)
    versions = []
    for delay in delays:
        process = subprocess.Popen([sys.executable, "-c", script, source, path], stdout=subprocess.PIPE)
        assert process.stdout.readline()
        while not path.exists():
            time.sleep(0.005)
        time.sleep(delay)
        process.kill()
        process.communicate()
        read = Checkpoint.read(path)
        assert np.array_equal(read.measurement.sums["image"], checkpoint.measurement.sums["image"])
        versions.append(read.elapsed)
    assert max(versions) > 2.5  # written, and written again
