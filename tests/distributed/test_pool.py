"""The pool of Dask's workers, in threads of this process and with passes that take no time."""

from __future__ import annotations

import itertools
import time

import pytest
from support.workers import Powers, alone, run

from etendue.distributed import Chunk, DaskPool, dask as dask_module, spread as spread_module
from etendue.distributed.gathering import Gathering
from etendue.distributed.worker import Made, introduce

distributed = pytest.importorskip("distributed")
calls = itertools.count()


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as local,
        distributed.Client(local, set_as_default=False) as client,
    ):
        yield client


def made_here(chunk: Chunk) -> Made:
    total = None
    for iteration in range(chunk.first, chunk.first + chunk.count):
        measurement = Powers().step(iteration, chunk.seed, {}).measurement
        total = measurement if total is None else total + measurement
    time.sleep(0.01)
    return Made(total, {}, chunk.count, 0.01 * chunk.count, False)


def fail(*_):
    raise MemoryError


def answered_late(is_local: bool = False):
    if next(calls) == 0:
        raise OSError("the connection broke")
    return introduce()


@pytest.fixture
def _light(monkeypatch):
    monkeypatch.setattr(dask_module, "make_passes", made_here)
    monkeypatch.setattr(spread_module, "_SHORTEST", 0.0)


def test_all_workers_are_known_before_a_run_begins(client, monkeypatch):
    """A method whose passes depend on each other has a replica for each."""
    monkeypatch.setattr(dask_module, "introduce", answered_late)
    pool = DaskPool(client)
    assert len(pool.workers()) == 2
    pool.close()


def test_sums_that_cannot_be_merged_come_one_by_one(client, monkeypatch, _light):
    monkeypatch.setattr(dask_module, "Gathering", lambda: Gathering(fan_in=2, fetches=1, least=-1.0))
    monkeypatch.setattr(dask_module, "merge_outcomes", fail)
    fetch = DaskPool._fetch
    monkeypatch.setattr(DaskPool, "_fetch", lambda pool, bundle: time.sleep(0.05) or fetch(pool, bundle))
    sent, send = [], DaskPool.send
    monkeypatch.setattr(DaskPool, "send", lambda pool, *task: sent.append(task[2].count) or send(pool, *task))
    pool = DaskPool(client)
    made = run(pool, Powers(), 40)
    assert pool._gathering.merges > 0
    assert sum(sent) < 60  # and not again and again: 115
    assert made.measurement.sums["x"] == alone(Powers(), 40).measurement.sums["x"]
    pool.close()


def test_a_run_that_ends_early_leaves_no_errors(client, caplog, _light):
    """With tasks under way, and a client that goes on."""
    pool = DaskPool(client)

    def stop(progress):
        if progress.passes > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(pool, Powers(), 1000, on_progress=stop)
    pool.close()
    time.sleep(0.3)
    assert "Error in callback" not in caplog.text
    assert client.submit(int, 3).result() == 3
