"""Hierarchical multipath whose boxes are on different workers: the solution is that of one process."""

from __future__ import annotations

import os
import signal
from contextlib import nullcontext

import numpy as np
import pytest
from support.workers import InProcess, dask_workers

import etendue
from etendue.core import OptionError
from etendue.distributed import Cluster, ProcessPool, rounds as rounds_module
from etendue.distributed.messages import PartMessages
from etendue.distributed.worker import Failed, Needs, _Desk, _Run
from etendue.engine import Job
from etendue.products import run_job, saved_task
from etendue.products.patches import SolutionRun
from etendue.radiosity import (
    DividedMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    RadiosityError,
    box,
    joined,
)
from etendue.radiosity.hierarchical_multipath.divided.units import units_of
from etendue.radiosity.hierarchical_multipath.parts import Tree

SETTINGS = {"lines": 1 << 12, "grid": 2, "residual": 1e-3}
SUMS = ("received", "sent", "absorbed", "to_sky", "lost", "residual")


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    monkeypatch.setattr(rounds_module, "_TICK", 0.0)


def moved(x, y, z=0.0, turn=0.0, scale=1.0):
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, scale, z], [0, 0, 0, 1.0]])


def block(low, high, cells=2, **properties):
    return Patches(*box(low, high, cells), **({"reflectance": [[0.6, 0.5, 0.4]]} | properties))


def hall(lamp_inside=False, sky=0.0):
    """A room of four by four with a lit ceiling; tables, of which each carries two cups; chairs; and cups on their own.
    The cup is in two parts of the root, and one itself."""
    vertices, faces = box((0, 0, 0), (4, 4, 3), 3, inward=True)
    light = (vertices[faces][:, :, 2] == 3).all(axis=1)[:, None] * np.array([[9.0, 8.0, 5.0]])
    room = Patches(vertices, faces, reflectance=[[0.5, 0.5, 0.3]], emission=light, sky=sky)
    glow = {"emission": [[1.0, 2.0, 3.0]]} if lamp_inside else {}
    cup = Part(block((-0.05, -0.05, 0), (0.05, 0.05, 0.1), 1, **glow))
    table = Part(block((-0.4, -0.3, 0), (0.4, 0.3, 0.6)), [(cup, [moved(-0.2, 0, 0.6), moved(0.2, 0.1, 0.6, 0.4)])])
    seat = Patches(
        *joined(box((0, 0, 0), (0.3, 0.3, 0.4)), box((0, 0, 0.4), (0.05, 0.3, 0.8))), reflectance=[[0.3] * 3]
    )
    copies = [
        (table, np.array([moved(1, 1), moved(3, 1, turn=1.0), moved(1, 3, scale=0.8)])),
        (Part(seat, objects=2), np.array([moved(2, 1), moved(2, 2.5, turn=-0.7)])),
        (cup, np.array([moved(3, 3), moved(3.4, 2.8, turn=0.2)])),
    ]
    return Part(room, copies)


def opened(source, divide=True, settings=None, passes=2):
    asked = {"settings": SETTINGS | (settings or {}), "limits": {"passes": passes}, "seed": 3}
    return Job.open(SolutionRun(source=source, method="boxes", divide=divide, **asked).task())


def solved(source, cluster=None, divide=True, settings=None, passes=2):
    return run_job(lambda: opened(source, divide, settings, passes), cluster=cluster)


def equal(a, b):
    for name in SUMS:
        np.testing.assert_array_equal(getattr(a.parts, name), getattr(b.parts, name))
    assert a.parts.received.any() and a.passes == b.passes
    if a.parts.error is not None:
        np.testing.assert_array_equal(a.parts.error, b.parts.error)


def test_units_are_the_parts_of_the_root_and_nobody_has_another():
    root = hall()
    method = DividedMultipath(HierarchicalMultipathSettings(**SETTINGS))
    method.prepare(PartProblem(root), 3)
    assert [len(unit.nodes) for unit in method.units] == [3, 2, 2]
    # Patches of all units and of the root are all patches, each once.
    rows = np.concatenate([np.arange(len(root)), *(unit.rows for unit in method.units)])
    np.testing.assert_array_equal(np.sort(rows), np.arange(root.total))
    for unit in method.units:
        inner = Tree(unit.problem.root)
        np.testing.assert_array_equal(inner.world[1:], method.tree.world[unit.whole])
        assert unit.problem.root.total == len(unit.rows) == sum(len(unit.nodes) * [unit.part.total])
    split = units_of(method.tree, 5)
    assert [unit.nodes.tolist() for unit in split] == [[1], [2], [3], [4, 5], [6, 7]]
    assert len(units_of(method.tree, 99)) == 7
    # The cup is in two units: in each it has the lines of the same number.
    table, _, cup = map(method.arguments, method.units)
    assert table["numbers"].tolist() == [0, 1] and cup["numbers"].tolist() == [0]
    assert table["lines"][0] == cup["lines"][0] > 0


class Echo:
    """Answers by all that it was told in a pass."""

    nbytes = 8

    def begin(self, iteration):
        self.heard = [iteration]

    def answer(self, message):
        if message["do"] == "fail":
            raise ValueError("on the way")
        self.heard.append(message["do"])
        return {"heard": tuple(self.heard)}


class OpenEcho:
    digest = "recipe"

    def method(self, seed):
        return Echo()


def test_parts_take_no_message_twice_and_none_of_another():
    desk = _Desk()
    for part in (0, 1):
        desk._runs[f"run recipe {part}"] = _Run(OpenEcho())

    def told(part, first, *words, iteration=0):
        messages = [{"do": word} for word in words]
        return desk.make(PartMessages("run", "recipe", 0, iteration, part, first, messages, kept=2))

    assert told(0, 0, "a").answer == {"heard": (0, "a")} and told(0, 0, "a").kept == 8
    assert told(1, 0, "x", "y").answer == {"heard": (0, "x", "y")}
    assert told(0, 1, "b").answer == {"heard": (0, "a", "b")}
    assert told(0, 1, "b") == Needs(state=True)  # a second time
    assert told(0, 3, "d") == told(0, 2, "c", iteration=1) == Needs(state=True)  # one is missing; another pass
    assert told(0, 2, "c").answer == {"heard": (0, "a", "b", "c")}
    assert "on the way" in told(0, 3, "fail").message
    assert told(0, 3, "d") == Needs(state=True)  # the state after an error is not known
    assert told(0, 0, "a", "b", "c", "d").answer == {"heard": (0, "a", "b", "c", "d")}
    assert told(1, 2, "z").answer == {"heard": (0, "x", "y", "z")}


@pytest.fixture(scope="module")
def alone():
    return solved(hall(), divide=False)


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_boxes_on_workers_give_the_bits_of_one_process(alone, workers, tmp_path):
    parts = solved(hall(), Cluster(InProcess(tmp_path, workers)))
    equal(parts, alone)
    told = parts.correspondence
    held = [shared.parts for shared in told.workers.values()]
    # Each unit at one worker; copies are halved where there are fewer parts than workers.
    assert sorted(k for parts in held for k in parts) == list(range(max(workers, 3)))
    assert all(shared.kept > 0 for shared in told.workers.values())
    assert len(held) == workers and all(shared.loads == len(shared.parts) for shared in told.workers.values())
    assert told.begun_anew == 0 and told.rounds >= 2 * 4
    # Of each round but the first and last of a pass: the power at the regions of the boxes around which the client is.
    per_round = 7 * 4 * 6 * 8 * 3 * 8
    exchanges = told.rounds - 2 * 2
    patches = (parts.parts.tree.root.total - len(hall())) * 3 * 8
    assert told.sent == exchanges * per_round + 2 * patches
    assert told.received > exchanges * per_round + 2 * patches


@pytest.mark.parametrize(
    ("settings", "scene"),
    [
        ({"shot": 0.0}, {"lamp_inside": True}),
        ({}, {"lamp_inside": True}),
        ({"iterations": 1, "residual": 0.0}, {}),
        ({"point_set": "halton", "generator": "sphere-pairs", "lines": 1 << 14}, {}),
    ],
)
def test_light_of_boxes_lines_and_shots(settings, scene, tmp_path):
    whole = solved(hall(**scene), divide=False, settings=settings)
    equal(solved(hall(**scene), Cluster(InProcess(tmp_path)), settings=settings), whole)


def test_the_sky_is_seen_past_boxes(tmp_path):
    ground = Patches(*box((0, 0, -1), (4, 4, 0), 3), reflectance=0.5, sky=1.0)
    grey = [Part(Patches(*box((0, 0, 0), (1, 1, s)), reflectance=0.4)) for s in (1.0, 0.5)]
    root = Part(ground, [(grey[0], moved(0.5, 1, 0.01)), (grey[1], moved(2, 2, 0.01))])
    whole = solved(root, divide=False)
    assert whole.parts.to_sky.all()
    equal(solved(root, Cluster(InProcess(tmp_path))), whole)


class Watched(InProcess):
    """Keeps the tasks that its workers have begun."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.tasks = []

    def send(self, worker, ticket, task):
        self.tasks.append(task)
        super().send(worker, ticket, task)


@pytest.mark.parametrize("losses", [(1,), (4, 5), (8, 9, 13, 14, 22)])
def test_a_worker_that_dies_in_a_pass_changes_nothing(alone, losses, tmp_path):
    """Its boxes are preprocessed by another one, which takes what they were told in the pass; that counts once."""
    pool = Watched(tmp_path, 2, losses)
    parts = solved(hall(), Cluster(pool))
    equal(parts, alone)
    assert pool.done > max(losses)
    again = [
        task for task in pool.tasks if isinstance(task, PartMessages) and task.first == 0 and len(task.messages) > 1
    ]
    assert parts.correspondence.begun_anew == len(again) and (len(again) > 0) == (min(losses) > 7)


def test_a_worker_that_has_forgotten_its_boxes_is_told_all_again(alone, tmp_path):
    """As if another run had used it meanwhile."""

    class Forgetful(Watched):
        def wait(self, seconds):
            if self.done == 9:
                for desk in self._desks.values():
                    desk._runs.clear()
            return super().wait(seconds)

    pool = Forgetful(tmp_path, 2)
    parts = solved(hall(), Cluster(pool))
    equal(parts, alone)
    assert parts.correspondence.begun_anew > 0


def test_workers_that_join_take_boxes_at_the_next_pass(alone, tmp_path):
    class Growing(InProcess):
        def wait(self, seconds):
            if self.done == 5 and len(self._desks) == 1:
                self._join()
            return super().wait(seconds)

    from etendue.distributed import dispatcher

    whole = solved(hall(), divide=False, passes=4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dispatcher, "_LOOK", 0.0)
        parts = solved(hall(), Cluster(Growing(tmp_path, 1)), passes=4)
    equal(parts, whole)
    assert len(parts.correspondence.workers) == 2 and parts.correspondence.begun_anew == 0


def test_a_worker_that_is_left_out_gets_no_boxes(alone, tmp_path, caplog):
    pool = InProcess(tmp_path, 2)
    pool._desks["worker 0"].make = lambda task: Failed("it has mitsuba 3.8", "ClusterError", refused=True)
    parts = solved(hall(), Cluster(pool))
    equal(parts, alone)
    assert "worker 0 is left out: it has mitsuba 3.8" in caplog.text
    assert parts.correspondence.of("worker 0").messages == 0 < parts.correspondence.of("worker 1").messages


def test_a_checkpoint_goes_on_with_workers_or_without(tmp_path):
    patches, path = hall().joined(), tmp_path / "a.checkpoint"
    groups = {"objects": "components", "least": 1, "threshold": 0.3}
    whole = etendue.solve_radiosity(patches, "boxes", passes=3, lines=1 << 10, seed=5, **groups)

    def resumed(passes, cluster=None):
        task, saved = saved_task(path, scene=patches, limits={"passes": passes})
        return run_job(lambda: Job.resume(saved, task), cluster=cluster)

    asked = {"objects": groups.pop("objects"), "groups": groups, "settings": {"lines": 1 << 10}, "seed": 5}
    first = SolutionRun(source=patches, method="boxes", limits={"passes": 1}, divide=True, checkpoint=path, **asked)
    run_job(lambda: Job.open(first.task()), cluster=Cluster(InProcess(tmp_path / "b")))
    assert resumed(2).passes == 2
    rest = resumed(3, Cluster(InProcess(tmp_path / "c")))
    assert rest.correspondence.sent > 0
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)


def test_a_run_that_is_cancelled_has_whole_passes(alone, tmp_path):
    """The pass under way is finished, as in one process."""
    job = opened(hall(), passes=50)
    run = job.runner(job.product.divided(job, Cluster(InProcess(tmp_path))), cancel=_After(12)).run()
    assert run.stopped_by == "cancel" and 1 <= run.passes < 50
    whole = solved(hall(), divide=False, passes=run.passes)
    np.testing.assert_array_equal(job.product.finish(job, run).parts.received, whole.parts.received)


class _After:
    """Is set after it was asked so many times."""

    def __init__(self, times):
        self.times = times

    def is_set(self):
        self.times -= 1
        return self.times < 0


class Killing:
    """A pool of processes, of which one is killed each time that a worker is told so many things in a pass."""

    def __init__(self, pool, at):
        self.pool, self.at, self.told, self.kills = pool, at, 0, 0

    def __getattr__(self, name):
        return getattr(self.pool, name)

    def send(self, worker, ticket, task):
        self.pool.send(worker, ticket, task)
        self.told += task.first > 0
        if self.told in self.at:
            self.told += 1
            os.kill(self.pool.pids[worker], signal.SIGKILL)
            self.kills += 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["processes", "dask"])
def test_processes_that_are_killed_in_a_pass_change_nothing(alone, kind):
    if kind == "dask":
        pytest.importorskip("distributed")
    with dask_workers(2) if kind == "dask" else nullcontext(ProcessPool(2, threads=1)) as pool:
        with Cluster(Killing(pool, {4})) as cluster:
            parts = solved(hall(), cluster)
        assert cluster.pool.kills == 1
    equal(parts, alone)
    assert parts.correspondence.begun_anew >= 1


# ---------------------------------------------------------------------- bad input


def test_what_is_not_finite_ends_the_run(tmp_path):
    """A worker that computes nonsense is an error, never a solution."""

    class Wrong(InProcess):
        def wait(self, seconds):
            arrival = super().wait(seconds)
            answer = getattr(getattr(arrival, "outcome", None), "answer", {})
            if "outgoing" in answer:
                answer["outgoing"] = self.spoil(answer["outgoing"])
            return arrival

    for spoil, message in (
        (lambda x: np.where(x == x.max(), np.nan, x), "'outgoing' of a box is not finite"),
        (lambda x: x[:, :-1], r"'outgoing' of a box is \(3, 191, 3\), not \(3, 192, 3\)"),
    ):
        pool = Wrong(tmp_path)
        pool.spoil = spoil
        with pytest.raises(RadiosityError, match=message) as error:
            solved(hall(), Cluster(pool))
        assert "\n" not in str(error.value)


def test_too_few_lines_are_told_by_the_worker(tmp_path):
    table = hall().copies[0].part
    root = Part(hall().patches, [(table, moved(2, 2))])
    with pytest.raises(OptionError, match=r"no line crosses the box of copy \d of 2: set more lines \(on worker"):
        solved(root, Cluster(InProcess(tmp_path)), settings={"lines": 8})


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"workers": 2}, "divide puts boxes on workers: give method boxes, too"),
        ({"method": "boxes"}, "boxes are divided among workers: give workers or cluster with divide"),
    ],
)
def test_bad_options_are_one_line(asked, message):
    with pytest.raises(OptionError) as error:
        etendue.solve_radiosity(hall(), divide=True, **asked)
    assert str(error.value) == message


def test_a_scene_without_boxes_is_refused(tmp_path):
    with pytest.raises(RadiosityError, match="has no boxes that could be on different workers"):
        solved(Part(hall().patches), Cluster(InProcess(tmp_path)))
