"""Real workers that cannot be used: other versions, no variant, a full disk; and a scheduler that ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from support.tasks import rendering
from support.workers import dask_workers

from etendue.core import ClusterError
from etendue.distributed import Cluster, DaskPool
from etendue.engine import Budget, Checkpoint, Job, RunError
from etendue.methods import get
from etendue.products import Picture, run_job

pytestmark = pytest.mark.slow
distributed = pytest.importorskip("distributed")


def rendered(cluster, budget=None, checkpoint=None, watch=None):
    settings, product = {"samples_per_pass": 1}, Picture.of(checkpoint=checkpoint)
    budget = budget or Budget(iterations=6)
    task = rendering("cornell-box", get("path"), settings, 3, budget, product, size=(16, 16))
    return run_job(lambda: Job.open(task), watch, cluster)


# -- run in a worker ---------------------------------------------------------------------------------------------------


def other_version(name):
    import importlib

    if name == "etendue":
        from etendue.engine import job

        job.VERSION = "0.0.9"
    else:
        importlib.import_module(name).__version__ = "0.0.9"


def other_python():
    from etendue.distributed import worker

    worker.sys = SimpleNamespace(version_info=(3, 9, 1))


def without_variant():
    import mitsuba

    mitsuba.variants = lambda: ["scalar_rgb"]


def full_disk(folder):
    import resource

    os.environ["ETENDUE_CONTENT"] = folder
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


# ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "arguments", "message"),
    [
        (other_version, ["etendue"], "it has etendue 0.0.9, the client "),
        (other_version, ["mitsuba"], "it has mitsuba 0.0.9, the client "),
        (without_variant, [], "llvm_ad_rgb"),
        (full_disk, ["FOLDER"], "cannot hold the scene (File too large); free some room"),
    ],
)
def test_a_worker_that_cannot_be_used_is_left_out_and_the_other_goes_on(spoil, arguments, message, tmp_path, caplog):
    alone = rendered(None)
    with dask_workers(2) as pool, Cluster(pool) as cluster:
        while len(names := sorted(pool.workers())) < 2:
            time.sleep(0.1)
        given = [str(tmp_path) if a == "FOLDER" else a for a in arguments]
        pool._client.run(spoil, *given, workers=names[:1])
        made = rendered(cluster)
        assert made.metadata["passes"] == 6
        assert abs(made.image - alone.image).max() < 1e-6
        lines = [r.getMessage() for r in caplog.records if "is left out" in r.getMessage()]
        assert len(lines) == 1 and names[0] in lines[0] and message in lines[0] and "\n" not in lines[0]
        # If no other is there, that is the error.
        pool._client.run(spoil, *given, workers=names[1:])
        for name in names:
            pool._client.run(forget_scenes, workers=[name])
        with pytest.raises(ClusterError, match="no worker can be used; tcp://") as error:
            rendered(cluster)
        assert message in str(error.value)


def forget_scenes():
    from etendue.distributed import worker

    desk = worker._desk()
    desk._runs.clear()
    type(desk).store.cache_clear()


def test_a_worker_of_another_python_is_told_before_the_run():
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, host="127.0.0.1", scheduler_port=0, dashboard_address="127.0.0.1:0"
        ) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        client.run(other_python)
        with pytest.raises(
            ClusterError, match=r"no worker of .* can be used; tcp://\S+: it runs Python 3\.9, the client"
        ):
            DaskPool(client)


def test_a_scheduler_that_ends_loses_nothing_that_was_merged(tmp_path):
    scheduler_file, checkpoint = tmp_path / "scheduler.json", tmp_path / "run.checkpoint"
    run = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    scheduler = subprocess.Popen(
        [*run, "--no-dashboard", "--scheduler-file", str(scheduler_file)], stderr=subprocess.DEVNULL
    )
    worker = None
    try:
        while not scheduler_file.exists():
            time.sleep(0.1)
        run = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(scheduler_file)]
        worker = subprocess.Popen(
            [*run, "--nworkers", "1", "--nthreads", "1", "--no-nanny", "--no-dashboard"],
            stderr=subprocess.DEVNULL,
        )
        import json

        while not (text := scheduler_file.read_text()).strip():
            time.sleep(0.1)
        with Cluster(DaskPool(json.loads(text)["address"])) as cluster:

            def watch(update):
                if update.progress.passes >= 3:
                    scheduler.send_signal(signal.SIGKILL)

            with pytest.raises(RunError, match=r"no longer answers.* \(after \d+ passes, which are kept\)"):
                rendered(cluster, Budget(seconds=120), checkpoint, watch)
        assert len(Checkpoint.read(checkpoint).measurement.iterations) >= 3
    finally:
        for process in (scheduler, worker):
            if process is not None:
                process.kill()
                process.wait()
