"""The process in which an earlier state of the library makes passes: here this state."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from benchmarks import earlier

from etendue import methods, scene
from etendue.core import Replica

ROOT = Path(__file__).parents[2]


def test_passes_of_another_process_are_those_of_the_library(tmp_path):
    process = earlier.Earlier(ROOT, mi.variant(), "cornell-box", (12, 8))
    try:
        assert process.ask("begin", "path", 3, 4) >= 0.0
        for _ in range(2):
            assert process.ask("pass", "path") > 0.0
        process.ask("picture", "path", str(tmp_path / "picture.npy"))
    finally:
        process.close()
    problem = scene.load("cornell-box", size=(12, 8))
    kind = methods.get("path")
    method = kind(kind.Settings(max_depth=problem.max_depth))
    method.prepare(problem, 3)
    replica = Replica(method, 3)
    expected = (replica.step(0) + replica.step(1)).mean()
    np.testing.assert_allclose(np.load(tmp_path / "picture.npy"), expected, rtol=1e-5)


def test_a_folder_that_is_no_checkout(tmp_path):
    with pytest.raises(SystemExit, match="is no checkout of the library"):
        earlier.Earlier(tmp_path, mi.variant(), "cornell-box", (12, 8))


def test_a_process_that_has_ended(tmp_path):
    process = earlier.Earlier(ROOT, mi.variant(), "no-such-scene", (12, 8))
    with pytest.raises(SystemExit, match="has ended"):
        process.ask("begin", "path", 3, 4)
    process.close()
