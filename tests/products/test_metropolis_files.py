"""Files of Metropolis particles: traced, continued as if they had not ended, and what is missing."""

from __future__ import annotations

import numpy as np
import pytest
from support import scenes

from etendue import resume, trace_particles
from etendue.core import CheckpointError, OptionError
from etendue.particles import LAYOUT, ParticleFile
from etendue.products.particles import repack
from etendue.products.particles.tracing import state_file

CHAINS = {"chains": 256, "steps": 16, "bootstrap": 4096}
STEPS = 256 * 16


def traced(path, passes: int, **more):
    room = scenes.room("rectangle", ()).scene
    return trace_particles(
        room, save=path, paths=passes * STEPS, codec="raw", method="metropolis_particles", seed=3, **(CHAINS | more)
    )


def test_a_file_goes_on_as_if_it_had_not_ended(tmp_path):
    whole = traced(tmp_path / "whole.particles", 3)
    assert whole.counters["paths"] == 3 * STEPS and whole.passes == 3
    traced(tmp_path / "part.particles", 2)
    room = scenes.room("rectangle", ()).scene
    resume(tmp_path / "part.particles", scene=room, paths=3 * STEPS)
    a, b = (ParticleFile(tmp_path / f"{name}.particles").read() for name in ("whole", "part"))
    assert len(a) == len(b) > 3 * STEPS / 10
    for name in LAYOUT:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_compressed_copy_goes_on(tmp_path):
    traced(tmp_path / "part.particles", 1)
    repack(tmp_path / "part.particles", tmp_path / "copy.particles", "packed")
    room = scenes.room("rectangle", ()).scene
    resume(tmp_path / "copy.particles", scene=room, paths=2 * STEPS)
    traced(tmp_path / "whole.particles", 2)
    copy, whole = (ParticleFile(tmp_path / f"{name}.particles").read() for name in ("copy", "whole"))
    assert len(copy) == len(whole)
    np.testing.assert_allclose(np.sort(copy.position[:, 0]), np.sort(whole.position[:, 0]), atol=1e-3)


def test_chains_that_are_missing_are_named(tmp_path):
    path = tmp_path / "some.particles"
    traced(path, 1)
    state_file(path).unlink()
    with pytest.raises(CheckpointError, match=r"cannot go on without '.*some.particles.state'"):
        resume(path, scene=scenes.room("rectangle", ()).scene, paths=2 * STEPS)


def test_a_run_that_was_killed_between_the_chains_and_their_particles(tmp_path):
    """The chains are a pass ahead of the file, and go on. Those of an earlier pass would repeat it, and are refused."""
    path = tmp_path / "some.particles"
    traced(path, 1)
    room, particles, early = scenes.room("rectangle", ()).scene, path.read_bytes(), state_file(path).read_bytes()
    resume(path, scene=room, paths=2 * STEPS)
    late = path.read_bytes()
    path.write_bytes(particles)
    assert resume(path, scene=room, paths=2 * STEPS).passes == 2
    path.write_bytes(late)
    state_file(path).write_bytes(early)
    with pytest.raises(CheckpointError, match="has their state after pass 0, but the last pass is 1; trace a new file"):
        resume(path, scene=room, paths=3 * STEPS)


def test_a_pass_that_does_not_fit_into_memory_is_refused(tmp_path):
    with pytest.raises(OptionError, match=r"a pass of 256 chains with 65000 steps needs 1132 MB.*lower steps"):
        traced(tmp_path / "some.particles", 1, steps=65000, memory=100 << 20)
    assert not list(tmp_path.iterdir())
