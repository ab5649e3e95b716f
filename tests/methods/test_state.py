"""What passes carry on and what they measured are saved as one: a pass that fails, wherever it does, leaves neither.

A pass is made to fail after its method has learned from it. The run goes on from the checkpoint that is left, and with
the very method that failed, and both measure what an uninterrupted run does.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import prepared
from support.tables import thinned
from support.tasks import job_of

from etendue.core import Measurement, Replica
from etendue.engine import Budget, Checkpoint, RunError, Runner, RunResult
from etendue.methods.adaptive.stratified import StratifiedPath
from etendue.methods.adaptive.vegas import VegasPath
from etendue.methods.auto import Auto
from etendue.methods.bidirectional import Bidirectional
from etendue.methods.guided import Guided
from etendue.methods.metropolis.method import MetropolisMethod
from etendue.methods.photon.progressive import Sppm
from etendue.methods.store import VertexRoom
from etendue.transport import ConnectionGuide, EmissionGuide, LearnedEmission, LightChoice

PASSES = 6
GUIDED = {"samples_per_pass": 16, "cell_samples": 200}
PSSMLT = {"samples_per_pass": 8, "bootstrap": 1 << 12}
BPT = {"samples_per_pass": 8, "guide_emission": "on"}
CONNECTIONS = {"samples_per_pass": 8, "guide_connections": True}
VEGAS = {"samples_per_pass": 16, "update": 2}
#: By name: method, settings, what learns, at which of its calls a pass fails, and how. Passes of ``guided`` that end a
#: generation are the first and the third.
LEARNERS: dict[str, tuple[str, dict[str, Any], type, str, int, type[BaseException]]] = {
    "guided within a generation": ("guided", GUIDED, Guided, "_learn", 5, KeyboardInterrupt),
    "guided at the end of one": ("guided", GUIDED, Guided, "_learn", 3, RuntimeError),
    "guided in the midst of that": ("guided", GUIDED, LightChoice, "learn", 2, KeyboardInterrupt),
    "auto": ("auto", {"samples_per_pass": 4}, Auto, "_decide", 2, KeyboardInterrupt),
    "vegas between two changes": ("vegas", VEGAS, VegasPath, "_learn", 5, RuntimeError),
    "vegas at a change": ("vegas", VEGAS | {"tile": 8}, VegasPath, "_learn", 4, KeyboardInterrupt),
    "stratified": ("stratified", {"samples_per_pass": 64, "update": 2}, StratifiedPath, "_plan", 2, RuntimeError),
    "sppm": ("sppm", {"samples_per_pass": 2, "radius": 0.05}, Sppm, "finish", 4, KeyboardInterrupt),
    "ppm": ("ppm", {"samples_per_pass": 2, "radius": 0.05}, Sppm, "finish", 4, RuntimeError),
    "pssmlt": ("pssmlt", PSSMLT, MetropolisMethod, "_tune", 3, KeyboardInterrupt),
    "bpt within a generation": ("bpt", BPT, LearnedEmission, "end_pass", 5, KeyboardInterrupt),
    "bpt at the end of one": ("bpt", BPT, EmissionGuide, "learn", 2, RuntimeError),
    "bpt connections": ("bpt", CONNECTIONS, ConnectionGuide, "learn", 2, KeyboardInterrupt),
}
#: Bytes: enough for the light vertices of a pass, and not for six times as many.
MEMORY = 1_200_000
#: Those of :data:`LEARNERS` that the fast tests run.
FAST = ["guided within a generation", "vegas at a change", "sppm", "pssmlt"]
#: Photons are summed in another order in each run.
IN_ANY_ORDER = {"rtol": 1e-4, "atol": 1e-6}


def failing(monkeypatch: Any, owner: type, name: str, call: int, error: type[BaseException]) -> None:
    """Make a function raise after its ``call``-th call has done all it does."""
    function, calls = getattr(owner, name), [0]

    def fails(*args: Any, **options: Any) -> Any:
        result = function(*args, **options)
        calls[0] += 1
        if calls[0] == call:
            raise error("on purpose")
        return result

    monkeypatch.setattr(owner, name, fails)


def finished(method: Any, start: Measurement | None = None, state: Any = None) -> Measurement:
    """All passes, from where ``start`` ended, in which ``state``."""
    return Runner(method, seed=1, budget=Budget(iterations=PASSES), start=start, state=state).run().measurement


def broken_off(method: Any) -> RunResult:
    """What is left by a run in which a pass fails."""
    runner = Runner(method, seed=1, budget=Budget(iterations=PASSES))
    try:
        runner.run()
    except RunError as failure:
        return failure.run
    except KeyboardInterrupt:
        left = runner.interrupted()
        assert left is not None
        return left
    raise AssertionError("no pass has failed")


def saved(left: RunResult, problem: Any, path: Path) -> Checkpoint:
    """``left`` as it is found again on disk."""
    job_of(problem, left.method, 1).checkpoint(left).write(path)
    return Checkpoint.read(path)


def assert_goes_on(new: Callable[[], Any], left: RunResult, whole: Measurement, path: Path, **near: float) -> None:
    """From the checkpoint of ``left``, and by its method, as ``whole``; bit by bit, or as ``near`` as that."""
    found = saved(left, left.method.problem, path)  # type: ignore[attr-defined]
    for method, start, state in ((new(), found.measurement, found.state), (left.method, left.measurement, left.state)):
        total = finished(method, start, state)
        assert total.iterations == whole.iterations
        np.testing.assert_allclose(total.mean(), whole.mean(), **(near or {"rtol": 0.0}))


@pytest.mark.parametrize("name", thinned(LEARNERS, FAST))
def test_a_pass_that_fails_as_it_learns(name, monkeypatch, tmp_path):
    method, settings, owner, step, call, error = LEARNERS[name]
    problem = scenes.room("mixed", scenes.FEW)
    monkeypatch.setattr("etendue.methods.auto.method.PREVIEW", 0)

    def new() -> Any:
        return prepared(problem, method, **settings).method

    whole = finished(new())
    with monkeypatch.context() as patch:
        failing(patch, owner, step, call, error)
        left = broken_off(new())
    assert 0 < left.passes < PASSES
    assert_goes_on(
        new,
        left,
        whole,
        tmp_path / "a",
        **(
            IN_ANY_ORDER
            if owner in (Sppm, MetropolisMethod, LearnedEmission, EmissionGuide, ConnectionGuide, Auto)
            else {}
        ),
    )


def grouped(problem: Any, method: str) -> Any:
    """A method that traces light paths in groups when it is told that a path stores many vertices."""
    settings = {"choice": "bpt"} if method == "auto" else {"light_paths": 1.0}
    return prepared(problem, method, samples_per_pass=16, **settings).method


@pytest.mark.parametrize("method", thinned(("bpt", "auto"), ("bpt",)))
def test_groups_of_light_paths_are_a_part_of_the_state(method, monkeypatch, tmp_path):
    """The second pass finds more vertices than there is room for; the run ends in the fourth."""
    problem = scenes.room("sphere", scenes.FEW)
    problem.memory = MEMORY

    def overflow(at: int) -> None:
        held, calls = VertexRoom.held, [0]

        def too_many(room: VertexRoom, wanted: float, paths: int) -> bool:
            calls[0] += 1
            if calls[0] == at:
                room.per_path *= 6.0
                return False
            return held(room, wanted, paths)

        monkeypatch.setattr(VertexRoom, "held", too_many)

    overflow(at=2)
    whole = finished(grouped(problem, method))
    monkeypatch.undo()
    overflow(at=2)
    failing(monkeypatch, Bidirectional, "render_pass", 4, KeyboardInterrupt)
    left = broken_off(grouped(problem, method))
    monkeypatch.undo()
    assert_goes_on(lambda: grouped(problem, method), left, whole, tmp_path / "a", **IN_ANY_ORDER)
    plain = finished(grouped(problem, method))
    assert np.abs(plain.mean() - whole.mean()).max() > 1e-3


def test_groups_that_a_failing_pass_has_made_are_given_up(monkeypatch, tmp_path):
    problem = scenes.room("sphere", scenes.FEW)
    problem.memory = MEMORY
    whole = finished(grouped(problem, "bpt"))

    def too_many(room: VertexRoom, wanted: float, paths: int) -> bool:
        if room.per_path < 20.0:
            room.per_path *= 6.0
            return False
        raise KeyboardInterrupt

    method = grouped(problem, "bpt")
    runner = Runner(method, seed=1, budget=Budget(iterations=2))
    runner.run()
    monkeypatch.setattr(VertexRoom, "held", too_many)
    begun = runner.interrupted()
    more = Runner(method, seed=1, budget=Budget(iterations=PASSES), start=begun.measurement, state=begun.state)
    with pytest.raises(KeyboardInterrupt):
        more.run()
    monkeypatch.undo()
    assert_goes_on(lambda: grouped(problem, "bpt"), more.interrupted(), whole, tmp_path / "a", **IN_ANY_ORDER)


#: Methods whose passes carry on: name, method, settings, how near replicas are.
CARRYING = {
    "guided": ("guided", GUIDED, {}),
    "vegas": ("vegas", VEGAS, {}),
    "sppm": ("sppm", {"samples_per_pass": 2, "radius": 0.05}, IN_ANY_ORDER),
    "ppm": ("ppm", {"samples_per_pass": 2, "radius": 0.05}, IN_ANY_ORDER),
    "auto": ("auto", {"samples_per_pass": 4}, IN_ANY_ORDER),
    "bpt": ("bpt", {"samples_per_pass": 4}, IN_ANY_ORDER),
    "bpt that learns": ("bpt", BPT, IN_ANY_ORDER),
    "vcm that learns": ("vcm", BPT | CONNECTIONS, IN_ANY_ORDER),
    "pssmlt": ("pssmlt", PSSMLT, IN_ANY_ORDER),
    "pssmlt bidirectional": ("pssmlt", PSSMLT | {"estimator": "bidirectional"}, IN_ANY_ORDER),
    "mmlt": ("mmlt", PSSMLT, IN_ANY_ORDER),
    "film_metropolis": ("film_metropolis", PSSMLT, IN_ANY_ORDER),
}


@pytest.mark.parametrize("name", thinned(CARRYING, ("guided", "vegas", "sppm", "pssmlt")))
def test_replicas_share_a_method(name):
    """In turn, each from its own state, as each alone; and a pass from a state that was kept is that pass again."""
    method, settings, near = CARRYING[name]
    problem = scenes.room("mixed", scenes.FEW)

    def new() -> Any:
        return prepared(problem, method, **settings).method

    def same(a: Measurement, b: Measurement) -> None:
        np.testing.assert_allclose(a.mean(), b.mean(), **(near or {"rtol": 0.0}))

    alone = {}
    for seed in (1, 2):
        replica = Replica(new(), seed)
        alone[seed] = [replica.step(iteration) for iteration in range(4)]
    shared = new()
    replicas, kept = {seed: Replica(shared, seed) for seed in alone}, {}
    for iteration in range(4):
        for seed, replica in replicas.items():
            kept[seed] = replica.state
            same(replica.step(iteration), alone[seed][iteration])
    for seed in alone:
        same(shared.step(3, seed, kept[seed]).measurement, alone[seed][3])
