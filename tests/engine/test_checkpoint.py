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

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue import methods
from etendue.core import CheckpointError, OptionError, OutputError
from etendue.engine import Budget, Checkpoint, Runner


@pytest.fixture
def checkpoint(noise):
    noise.prepare(None, 5)
    result = Runner(noise, seed=5, budget=Budget(iterations=3)).run()
    last = noise.measured(3, 5)
    last.scale(0.5)  # so that passes differ in weight
    result.measurement += last
    return Checkpoint(
        measurement=result.measurement,
        method="noise",
        settings=noise.settings.to_json(),
        seed=5,
        fingerprint="abc",
        state=dict(noise.start()),
        scene={"source": "/somewhere/sçene.xml", "size": [4, 5]},
        budget={"seconds": 60.0},
        stopped_by="cancel",
        versions={"etendue": "1"},
        elapsed=1.5,
        earlier=2.5,
        notes={"diary": "/somewhere"},
    )


def test_round_trip(checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint")
    for name, array in checkpoint.measurement.sums.items():
        assert read.measurement.sums[name].dtype == np.float64
        assert np.array_equal(read.measurement.sums[name], array)
    assert np.array_equal(read.measurement.squares["image"], checkpoint.measurement.squares["image"])
    assert read.measurement.weights == checkpoint.measurement.weights
    assert read.measurement.squared_weights == checkpoint.measurement.squared_weights
    assert np.array_equal(read.measurement.products["image"], checkpoint.measurement.products["image"])
    assert read.measurement.counters == checkpoint.measurement.counters
    assert read.measurement.iterations == checkpoint.measurement.iterations
    assert read.state["pilot"] == 5.5
    assert np.array_equal(read.state["table"], np.arange(3.0))
    assert read.state["nested"] == {"list": [1, 2.0]}
    plain = vars(checkpoint).keys() - {"measurement", "state"}
    assert {"method", "settings", "seed", "fingerprint", "scene", "budget", "earlier", "notes"} <= plain
    for name in plain:
        assert getattr(read, name) == getattr(checkpoint, name)
    assert [p.name for p in tmp_path.iterdir()] == ["a.checkpoint"]


def test_a_resumed_run_is_bit_equal_to_an_uninterrupted_one(noise, checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint")
    resumed = Runner(noise, seed=read.seed, budget=Budget(iterations=8), start=read.measurement).run()
    whole = Runner(noise, seed=5, budget=Budget(iterations=8), start=checkpoint.measurement).run()
    for name in whole.measurement.sums:
        assert np.array_equal(resumed.measurement.sums[name], whole.measurement.sums[name])
    assert np.array_equal(resumed.measurement.squares["image"], whole.measurement.squares["image"])
    assert np.array_equal(resumed.measurement.variance_of_mean(), whole.measurement.variance_of_mean())


def test_arrays_of_the_device_come_back_as_arrays_of_the_host(checkpoint, tmp_path):
    numbers = np.arange(5, dtype=np.uint64) << np.uint64(40)
    state = {"on": mi.UInt64(numbers), "nested": {"literal": dr.full(mi.Float, 0.5, 3)}}
    replace(checkpoint, state=state).write(tmp_path / "a.checkpoint")
    read = Checkpoint.read(tmp_path / "a.checkpoint").state
    np.testing.assert_array_equal(read["on"], numbers)
    np.testing.assert_array_equal(read["nested"]["literal"], np.full(3, 0.5, np.float32))


def test_it_holds_no_pickle(checkpoint, tmp_path):
    checkpoint.write(tmp_path / "a.checkpoint")
    with zipfile.ZipFile(tmp_path / "a.checkpoint") as archive:
        for name in archive.namelist():
            np.load(io.BytesIO(archive.read(name)), allow_pickle=False)
        assert len(archive.namelist()) > 3


@pytest.mark.parametrize(
    ("given", "seed", "message"),
    [
        ({"max_depth": 3}, None, r"made with other settings \(max_depth was -1, is 3\); resume it with its own"),
        ({"samples_per_pass": "2"}, 5, r"samples_per_pass was 1, is 2"),
        ({}, 6, "made with seed 5, not 6"),
    ],
)
def test_another_setting_or_seed_is_refused(checkpoint, noise, given, seed, message):
    assert checkpoint.settings_of(type(noise)) == noise.settings
    assert checkpoint.settings_of(type(noise), {"max_depth": "-1"}, 5) == noise.settings
    with pytest.raises(CheckpointError, match=message):
        checkpoint.settings_of(type(noise), given, seed)


def test_another_method_or_scene_is_refused(checkpoint, noise):
    with pytest.raises(CheckpointError, match="made by method 'noise', not 'path'; resume it with noise"):
        checkpoint.settings_of(methods.get("path"))
    with pytest.raises(OptionError, match="method 'noise' has no option 'max_dept'; did you mean 'max_depth'"):
        checkpoint.settings_of(type(noise), {"max_dept": 3})
    checkpoint.require_scene("abc")
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        checkpoint.require_scene("xyz")


def test_a_setting_that_an_older_version_did_not_have_has_its_default(checkpoint, noise):
    old = replace(checkpoint, settings='{"max_depth": -1}')
    assert old.settings_of(type(noise)) == noise.Settings()


@pytest.mark.parametrize("settings", ['{"max_depth": "1"}', '{"max_depth": -1, "samples_per_pass": 1, "old": 2}'])
def test_settings_of_another_version_are_refused(checkpoint, noise, settings):
    with pytest.raises(CheckpointError, match=r"made by étendue 1, whose 'noise' has other settings \(.*\)"):
        replace(checkpoint, settings=settings).settings_of(type(noise))


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
    with pytest.raises(CheckpointError, match="has format 99, this étendue reads format 3"):
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


@pytest.mark.slow
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
    delays = np.random.default_rng(1).uniform(0.02, 0.15, 4)
    versions = []
    first = checkpoint.elapsed
    for delay in delays:
        process = subprocess.Popen([sys.executable, "-c", script, source, path], stdout=subprocess.PIPE)
        assert process.stdout.readline()
        while not path.exists() or (not versions and Checkpoint.read(path).elapsed < first + 2):  # written, and again
            assert process.poll() is None
            time.sleep(0.005)
        time.sleep(delay)
        process.kill()
        process.communicate()
        read = Checkpoint.read(path)
        assert np.array_equal(read.measurement.sums["image"], checkpoint.measurement.sums["image"])
        versions.append(read.elapsed)
    assert versions[0] >= first + 2
