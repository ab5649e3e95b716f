"""From a task or a checkpoint to a run and its product: a source and a product that no other room knows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from etendue.core import CheckpointError, Ingredients, OptionError, SceneError
from etendue.engine import Budget, Checkpoint, Job, Product, Task, remaining

#: Seconds of preparation, which are the whole budget.
PREPARATION = 0.2


@dataclass(frozen=True)
class Source:
    """A source in a file that may be gone."""

    is_there: bool = True

    def open(self, tell=print):
        if not self.is_there:
            raise SceneError("gone")
        return SimpleNamespace(source="fog", fingerprint="grey")

    def place(self):
        return {"source": "fog"}

    def ingredients(self, problem):
        return Ingredients("fog:open", {})


class Mean(Product[float]):
    """The mean of all pixels; notes what it is asked for, in order."""

    kind: ClassVar[str] = "mean"
    files = ()

    def __init__(self):
        self.calls = []

    def check(self, problem):
        self.calls.append("check")

    def default_budget(self, task, problem):
        return Budget(iterations=3)

    def make_method(self, task, settings, problem, budget):
        self.calls.append("make")
        return super().make_method(task, settings, problem, budget)

    def prepared(self, job):
        self.calls.append("prepared")

    def keep(self, job, run):
        self.calls.append("keep")

    def finish(self, job, run, tell=print):
        self.calls.append("finish")
        return float(run.measurement.mean().mean())

    def notes(self):
        return {"colour": "grey"}


def test_a_product_without_a_budget_has_its_own_and_a_resumed_one_goes_on_bit_equal(noise, tmp_path):
    kind = type(noise)
    job = Job.open(Task(Source(), kind, Mean(), {"max_depth": "4"}, seed=7))
    run = job.runner().run()
    whole = job.product.finish(job, run)
    assert run.passes == 3 and job.product.calls == ["check", "make", "prepared", "finish"]

    part = Job.open(Task(Source(), kind, Mean(), {"max_depth": 4}, 7, Budget(iterations=1)))
    part.checkpoint(part.runner().run()).write(tmp_path / "a")
    saved = Checkpoint.read(tmp_path / "a")
    assert saved.notes == {"colour": "grey"} and saved.scene == {"source": "fog"} and saved.fingerprint == "grey"
    again = Job.resume(saved, Task(Source(), kind, Mean(), {}, 7, Budget(iterations=3)))
    assert again.method.settings == job.method.settings and again.product.calls == ["check", "make", "prepared"]
    resumed = again.runner().run()
    assert again.product.finish(again, resumed) == whole
    assert np.array_equal(resumed.measurement.sums["image"], run.measurement.sums["image"])


def test_a_task_is_checked_before_its_source_is_opened(noise):
    kind, source = type(noise), Source(is_there=False)
    with pytest.raises(OptionError, match="method 'noise' has no option 'max_dept'; did you mean 'max_depth'"):
        Task(source, kind, Mean(), {"max_dept": 3})
    for seed in (-1, 0.5, True, "a"):
        with pytest.raises(OptionError, match="a seed is a whole number of at least 0, not"):
            Task(source, kind, Mean(), seed=seed)


def test_a_checkpoint_goes_on_with_its_own_source_only(noise):
    kind = type(noise)
    job = Job.open(Task(Source(), kind, Mean(), budget=Budget(iterations=1)))
    saved = job.checkpoint(job.runner().run())
    more = Budget(iterations=2)
    with pytest.raises(CheckpointError, match="the scene of the checkpoint cannot be loaded: gone"):
        Job.resume(saved, Task(Source(is_there=False), kind, Mean(), budget=more))
    saved.fingerprint = "green"
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        Job.resume(saved, Task(Source(), kind, Mean(), budget=more))


def test_the_rest_of_a_saved_budget(noise):
    job = Job.open(Task(Source(), type(noise), Mean(), budget=Budget(iterations=1)))
    saved = job.checkpoint(job.runner().run())
    with pytest.raises(CheckpointError, match="the budget of the checkpoint is used up; give a new one"):
        remaining(saved)
    saved.stopped_by, saved.budget, saved.elapsed = "cancel", {"seconds": 5.0, "samples": 40}, 2.0
    assert remaining(saved) == Budget(3.0, 40)
    saved.elapsed = 5.0
    with pytest.raises(CheckpointError, match="the time of the checkpoint is used up; give a new budget"):
        remaining(saved)


def test_seconds_count_from_when_the_source_is_opened(noise, tmp_path):
    """A budget that preparation uses up leaves time for one pass, in a resumed run, too."""

    class Slow(type(noise)):
        def prepare(self, problem, seed):
            super().prepare(problem, seed)
            self.before_pass = lambda iteration: time.sleep(0.005)
            time.sleep(PREPARATION)

    task = Task(Source(), Slow, Mean(), budget=Budget(seconds=PREPARATION))
    job = Job.open(task)
    run = job.runner().run()
    assert (run.passes, run.stopped_by) == (1, "seconds")
    assert run.elapsed >= PREPARATION + 0.005
    job.checkpoint(run).write(tmp_path / "a")
    again = Job.resume(Checkpoint.read(tmp_path / "a"), task)
    assert again.earlier == run.elapsed
    assert again.runner().run().passes == 2
