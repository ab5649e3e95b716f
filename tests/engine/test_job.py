"""From a task or a checkpoint to a run: what its time is counted from."""

from __future__ import annotations

import time

import pytest

from etendue.engine import Budget, Checkpoint, Job, Task

#: Seconds of preparation, which are the whole budget.
PREPARATION = 0.2


@pytest.fixture
def slow_to_prepare(noise):
    """The class of a method that compiles and pilots before its passes, which take 5 ms."""

    class Slow(type(noise)):
        def prepare(self, problem, seed):
            super().prepare(problem, seed)
            self.before_pass = lambda iteration: time.sleep(0.005)
            time.sleep(PREPARATION)

    return Slow


def test_seconds_count_from_when_the_scene_is_loaded(slow_to_prepare, tmp_path):
    """A budget that preparation uses up leaves time for one pass, in a resumed run, too."""
    job = Job.open(Task("cornell-box", slow_to_prepare, budget=Budget(seconds=PREPARATION), size=(5, 4)))
    run = job.runner().run()
    assert (run.passes, run.stopped_by) == (1, "seconds")
    assert run.elapsed >= PREPARATION + 0.005
    assert job.result(run).metadata["seconds"] >= PREPARATION
    job.checkpoint(run).write(tmp_path / "a")
    again = Job.resume(Checkpoint.read(tmp_path / "a"), slow_to_prepare, budget=Budget(seconds=PREPARATION))
    assert again.earlier == run.elapsed
    assert again.runner().run().passes == 2
