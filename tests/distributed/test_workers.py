"""Real worker processes: they render the picture of one process, also if they are killed."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from support.tasks import rendering
from support.workers import dask_workers

import etendue
from etendue.core import ClusterError, SceneError, kernels, optimise_kernels, own_kernels
from etendue.distributed import Cluster, DaskPool, ProcessPool, Store, recipe
from etendue.distributed.recipes import OpenRecipe
from etendue.engine import Budget, Checkpoint, Job, Replicated
from etendue.methods import get
from etendue.products import Picture, run_job, start_job

SMALL = {"scene": "caustics", "size": (24, 16)}
PASSES = 40


def task(method="path", passes=PASSES, settings=(("samples_per_pass", 1),), checkpoint=None):
    budget, product = Budget(iterations=passes), Picture.of(checkpoint=checkpoint)
    return rendering(**SMALL, method=get(method), settings=dict(settings), seed=3, budget=budget, product=product)


def rendered(task, cluster=None, watch=None):
    return run_job(lambda: Job.open(task), watch, cluster)


@pytest.fixture(scope="module")
def alone():
    return rendered(task())


@pytest.fixture(scope="module")
def processes():
    with Cluster(ProcessPool(2, threads=1)) as cluster:
        yield cluster


def kill_one(pool, source):
    """Kill a worker by SIGKILL, if one is there."""
    try:
        os.kill(source.choice(sorted(pool.pids[name] for name in pool.workers())), signal.SIGKILL)
    except (IndexError, ProcessLookupError):  # none is there, or it died a moment ago
        return False
    return True


def close(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7)


def test_the_picture_of_two_processes_is_that_of_one_and_a_kill_loses_nothing(alone, processes):
    source, killed = random.Random(1), []

    def watch(update):
        if not killed and update.progress.passes >= 3:
            killed.append(kill_one(processes.pool, source))

    made = rendered(task(), processes, watch)
    assert killed == [True]
    close(made.image, alone.image)
    assert made.metadata["passes"] == PASSES
    assert made.metadata["rays"] == alone.metadata["rays"]


def test_a_worker_compiles_as_its_client(monkeypatch, tmp_path):
    if kernels._core() is None or not mi.variant().startswith("llvm"):
        pytest.skip("kernels are not compiled by LLVM, or Dr.Jit's functions are not found")
    monkeypatch.delenv(kernels.OPTIMISE, raising=False)
    job, store = Job.open(task()), Store(tmp_path)
    for optimises in (False, True):
        with own_kernels(optimises):
            made = recipe(job.ingredients(), job.method, None)
        for piece in made.offered.pieces(made.digest):
            store.receive(made.digest, *piece)
        with own_kernels():
            OpenRecipe(store, made.digest)
            assert optimise_kernels(None) is optimises
    monkeypatch.undo()
    optimise_kernels()


@pytest.mark.slow
def test_replicas_in_processes_are_those_in_turn_and_are_resumed(processes, tmp_path):
    made = rendered(task("guided", 7, checkpoint=tmp_path / "half.checkpoint"), processes)
    assert made.metadata["replicas"] == 2
    saved = Checkpoint.read(tmp_path / "half.checkpoint")
    assert saved.measurement.iterations.to_json() == [[0, 0, 4], [1, 0, 3]]
    here = run_job(lambda: Job.resume(saved, task("guided", 11)))
    saved = Checkpoint.read(tmp_path / "half.checkpoint")
    there = run_job(lambda: Job.resume(saved, task("guided", 11)), cluster=processes)
    close(here.image, there.image)
    assert here.metadata["passes"] == there.metadata["passes"] == 11


@pytest.mark.slow
def test_chains_in_processes_are_those_in_turn(processes):
    """Their states come back from the workers."""
    small = {"samples_per_pass": 16, "bootstrap": 1 << 12}
    there = rendered(task("mmlt", 5, small), processes)
    job = Job.open(task("mmlt", 5, small))
    job.method = Replicated(job.method, job.problem, job.seed, 2)
    here = run_job(lambda: job)
    assert there.metadata["replicas"] == here.metadata["replicas"] == 2
    np.testing.assert_allclose(there.image, here.image, rtol=1e-3, atol=1e-5)


def test_a_scene_in_memory_is_refused(processes):
    import mitsuba as mi

    scene = mi.load_dict(mi.cornell_box())
    with pytest.raises(SceneError, match="a scene in memory cannot be sent to workers"):
        rendered(rendering(scene, get("path"), budget=Budget(iterations=1)), processes)


def test_what_a_session_has_opened_is_closed_also_if_its_job_fails():
    ended = []

    def fail():
        raise SceneError("no such scene")

    session = start_job(fail, at_end=lambda: ended.append(True))
    with pytest.raises(SceneError, match="no such scene"):
        session.wait()
    assert ended == [True]


@pytest.mark.slow
def test_sessions_have_workers_of_their_own(alone):
    options = {"size": SMALL["size"], "samples_per_pass": 1, "seed": 3}
    made = etendue.render(SMALL["scene"], "path", spp=PASSES, workers=1, **options, wait=False).result
    close(made.image, alone.image)
    solved = etendue.solve_radiosity("cornell-box", bundles=8, workers=1, wait=False).result
    here = etendue.solve_radiosity("cornell-box", bundles=8)
    np.testing.assert_allclose(solved.solution.radiosity, here.solution.radiosity, rtol=1e-5)


@pytest.mark.slow
def test_time_holds_for_the_sum(processes):
    made_of = replace(task(), budget=Budget(seconds=4))
    begin = time.perf_counter()
    made = rendered(made_of, processes)
    assert 3.0 < time.perf_counter() - begin < 6.0
    assert made.metadata["stopped_by"] == "seconds"
    assert made.metadata["passes"] > 1


@pytest.mark.slow
def test_processes_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import time\n"
        "from etendue.distributed import ProcessPool\n"
        "print(*ProcessPool(1, threads=1).pids.values(), flush=True)\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
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
    passes = 300  # some find no worker to kill
    expected = rendered(task(passes=passes))

    def watch(update):
        if kills[0] < 50:
            kills[0] += kill_one(cluster.pool, source)

    with dask_workers(2) as pool, Cluster(pool) as cluster:
        made = rendered(task(passes=passes), cluster, watch)
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
    expected = rendered(task(passes=60))

    def watch(update):
        if kills[0] < 4 and update.progress.passes > 10 * kills[0]:
            kills[0] += kill_one(cluster.pool, source)

    with dask_workers(3) as pool, Cluster(pool) as cluster:
        made = rendered(task(passes=60), cluster, watch)
        assert cluster.pool._gathering.merges > 0
    assert made.metadata["passes"] == 60
    assert made.metadata["rays"] == expected.metadata["rays"]
    close(made.image, expected.image)
