"""Real worker processes: they render the picture of one process, also if they are killed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from etendue.jobs import Outputs, PictureWork, run_work, start_work

import etendue
from etendue.core import ClusterError, SceneError
from etendue.distributed import Cluster, DaskPool, ProcessPool
from etendue.engine import Budget, Checkpoint, Job, Replicated, Task
from etendue.methods import get

SMALL = {"scene": "caustics", "size": (24, 16)}
PASSES = 40


def task(method="path", passes=PASSES, settings=(("samples_per_pass", 1),)):
    return Task(SMALL["scene"], get(method), dict(settings), 3, Budget(iterations=passes), SMALL["size"])


def rendered(job, cluster=None, outputs=None, watch=None):
    return run_work(PictureWork(job, outputs or Outputs(), cluster), watch)


@pytest.fixture(scope="module")
def alone():
    return rendered(Job.open(task()))


@pytest.fixture(scope="module")
def processes():
    with Cluster(ProcessPool(2, threads=1)) as cluster:
        yield cluster


def kill_one(pool, source):
    """Kill a worker of Dask or of processes by SIGKILL, if one is there."""
    if isinstance(pool, DaskPool):
        pids = [pool.pids[name] for name in pool.workers()]
    else:
        pids = [pid for process in pool._processes.values() for pid in process._processes or ()]
    try:
        os.kill(source.choice(sorted(pids)), signal.SIGKILL)
    except (IndexError, ProcessLookupError):  # none is there, or it died a moment ago
        return False
    return True


def close(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7)


def test_the_picture_of_two_processes_is_that_of_one_and_a_kill_loses_nothing(alone, processes):
    source, killed = random.Random(1), []

    def watch(progress, runner):
        if not killed and progress.passes >= 3:
            killed.append(kill_one(processes.pool, source))

    made = rendered(Job.open(task()), processes, watch=watch)
    assert killed == [True]
    close(made.image, alone.image)
    assert made.metadata["passes"] == PASSES
    assert made.metadata["rays"] == alone.metadata["rays"]


@pytest.mark.slow
def test_replicas_in_processes_are_those_in_turn_and_are_resumed(processes, tmp_path):
    job = Job.open(task("guided", 7))
    made = rendered(job, processes, Outputs(checkpoint=tmp_path / "half.checkpoint"))
    assert made.metadata["replicas"] == 2
    saved = Checkpoint.read(tmp_path / "half.checkpoint")
    assert saved.measurement.iterations.to_json() == [[0, 0, 4], [1, 0, 3]]
    more = Budget(iterations=11)
    here = rendered(Job.resume(saved, get("guided"), budget=more))
    saved = Checkpoint.read(tmp_path / "half.checkpoint")
    there = rendered(Job.resume(saved, get("guided"), budget=more), processes)
    close(here.image, there.image)
    assert here.metadata["passes"] == there.metadata["passes"] == 11


@pytest.mark.slow
def test_chains_in_processes_are_those_in_turn(processes):
    """Their states come back from the workers."""
    small = {"samples_per_pass": 16, "bootstrap": 1 << 12}
    there = rendered(Job.open(task("mmlt", 5, small)), processes)
    here = Job.open(task("mmlt", 5, small))
    here.method = Replicated(here.method, here.problem, here.seed, 2)
    here = rendered(here)
    assert there.metadata["replicas"] == here.metadata["replicas"] == 2
    np.testing.assert_allclose(there.image, here.image, rtol=1e-3, atol=1e-5)


def test_a_scene_in_memory_is_refused(processes):
    import mitsuba as mi

    scene = mi.load_dict(mi.cornell_box())
    with pytest.raises(SceneError, match="a scene in memory cannot be sent to workers"):
        rendered(Job.open(Task(scene, get("path"), budget=Budget(iterations=1))), processes)


def test_what_a_session_has_opened_is_closed_also_if_its_work_fails():
    ended = []

    def fail():
        raise SceneError("no such scene")

    session = start_work(fail, at_end=lambda: ended.append(True))
    with pytest.raises(SceneError, match="no such scene"):
        session.wait()
    assert ended == [True]


@pytest.mark.slow
def test_sessions_have_workers_of_their_own(alone):
    pytest.importorskip("distributed")
    options = {"size": SMALL["size"], "samples_per_pass": 1, "seed": 3}
    made = etendue.render(SMALL["scene"], "path", spp=PASSES, workers=1, **options, wait=False).result
    close(made.image, alone.image)
    solved = etendue.solve_radiosity("cornell-box", bundles=8, workers=1, wait=False).result
    here = etendue.solve_radiosity("cornell-box", bundles=8)
    np.testing.assert_allclose(solved.solution.radiosity, here.solution.radiosity, rtol=1e-5)


@pytest.mark.slow
def test_time_holds_for_the_sum(processes):
    job = Job.open(Task(SMALL["scene"], get("path"), {"samples_per_pass": 1}, 3, Budget(seconds=4), SMALL["size"]))
    begin = time.perf_counter()
    made = rendered(job, processes)
    assert 3.0 < time.perf_counter() - begin < 6.0
    assert made.metadata["stopped_by"] == "seconds"
    assert made.metadata["passes"] > 1


@pytest.mark.slow
def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "if __name__ == '__main__':\n"
        "    import time\n"
        "    from etendue.distributed import ProcessPool\n"
        "    (process,) = ProcessPool(1, threads=1)._processes.values()\n"
        "    print(process.submit(int).result(), *process._processes, flush=True)\n"
        "    time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline().split()[1])
    parent.kill()
    parent.wait()
    end = time.monotonic() + 30
    while os.path.exists(f"/proc/{pid}"):
        assert time.monotonic() < end, "the process stays"
        time.sleep(0.1)


# -- Dask ------------------------------------------------------------------------------------------------------------


def test_nothing_answers_at_an_address(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("etendue.distributed.dask._CONNECT", "1s")
    with pytest.raises(ClusterError, match=r"'tls://127\.0\.0\.1:9' needs certificates: name them in .*yaml"):
        DaskPool("tls://127.0.0.1:9")
    with pytest.raises(ClusterError, match=r"no scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        etendue.render("caustics", "path", spp=1, cluster="tcp://127.0.0.1:9")


@pytest.mark.slow
def test_fifty_kills_lose_nothing(monkeypatch):
    pytest.importorskip("distributed")
    # Chunks of one pass, and a kill for each that arrives, so that the workers are hardly ever whole.
    monkeypatch.setattr("etendue.distributed.spread._SHORTEST", 0.0)
    source, kills = random.Random(7), [0]
    passes = 120  # some find no worker to kill
    expected = rendered(Job.open(task(passes=passes)))

    def watch(progress, runner):
        if kills[0] < 50:
            kills[0] += kill_one(cluster.pool, source)

    with Cluster(DaskPool(workers=2, threads=2)) as cluster:
        made = rendered(Job.open(task(passes=passes)), cluster, watch=watch)
    assert kills[0] == 50
    assert made.metadata["passes"] == passes
    assert made.metadata["rays"] == expected.metadata["rays"]
    close(made.image, expected.image)


@pytest.mark.slow
def test_sums_that_are_merged_among_workers_lose_nothing(monkeypatch):
    pytest.importorskip("distributed")
    from etendue.distributed import dask
    from etendue.distributed.gathering import Gathering

    # A client that cannot keep up, whatever the machine.
    monkeypatch.setattr(dask, "Gathering", lambda: Gathering(fan_in=2, fetches=1, least=-1.0))
    fetch = dask.DaskPool._fetch
    monkeypatch.setattr(dask.DaskPool, "_fetch", lambda pool, bundle: time.sleep(0.3) or fetch(pool, bundle))
    monkeypatch.setattr("etendue.distributed.spread._SHORTEST", 0.0)
    source, kills = random.Random(5), [0]
    expected = rendered(Job.open(task(passes=60)))

    def watch(progress, runner):
        if kills[0] < 4 and progress.passes > 10 * kills[0]:
            kills[0] += kill_one(cluster.pool, source)

    with Cluster(DaskPool(workers=3, threads=3)) as cluster:
        made = rendered(Job.open(task(passes=60)), cluster, watch=watch)
        assert cluster.pool._gathering.merges > 0
    assert made.metadata["passes"] == 60
    assert made.metadata["rays"] == expected.metadata["rays"]
    close(made.image, expected.image)
