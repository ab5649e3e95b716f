"""Replicas: several independent runs of a method whose passes depend on each other, added up as one run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from etendue.core import CheckpointError, Measurement, Method, OptionError, Pass, Result, State, prepared, seed_key


def replica_seed(seed: int, replica: int) -> int:
    """The seed of a replica; that of replica 0 is the seed of the run."""
    if replica == 0:
        return seed
    high, low = seed_key(seed, "replica", replica)
    return (high << 32 | low) & 0x7FFFFFFFFFFFFFFF


class Replicated(Method):
    """``count`` replicas of a prepared method as one method, whose members it has.

    Its state holds the state and the number of passes of each replica. :meth:`step` makes a pass of the replica with
    the fewest passes; an executor may make passes of all replicas at the same time. The number of replicas is part of
    the identity of a run: a resumed run has the same number.
    """

    carries_on: ClassVar[bool] = True

    def __init__(self, method: Method, problem: Any, seed: int, count: int) -> None:
        if count < 1:
            raise OptionError(f"a run has at least one replica, not {count}")
        self.method, self.count = method, count
        self._problem, self._seed = problem, seed
        self._methods: dict[int, Method] = {0: method}
        self._plan: tuple[float | None, int | None, float | None] | None = None

        self.name, self.settings = method.name, method.settings  # type: ignore[misc]

    @property
    def samples_per_iteration(self) -> int:
        """See ``core.Method``."""
        return self.method.samples_per_iteration

    def prepare(self, problem: Any, seed: int) -> None:
        """Prepare the first replica; the others are prepared when they begin."""
        self.method.prepare(problem, seed)

    @classmethod
    def replicas_of(cls, state: State) -> int | None:
        """Number of replicas of a saved state; ``None`` if it is the state of a method."""
        return len(state["replicas"]) if state.keys() == {"replicas", "passes"} else None

    def start(self) -> State:
        """No replica has begun."""
        return {"replicas": [None] * self.count, "passes": [0] * self.count}

    def enter(self, state: State) -> None:
        """See ``core.Method``."""
        if self.replicas_of(state) != self.count or len(state["passes"]) != self.count:
            raise CheckpointError("the state of the replicas in the checkpoint is damaged; start a new run")
        first = state["replicas"][0]
        self.method.enter(self.method.start() if first is None else first)

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """A pass of the replica with the fewest passes."""
        states, passes = list(state["replicas"]), list(state["passes"])
        replica = passes.index(min(passes))
        method = self._of(replica)
        before = method.start() if states[replica] is None else states[replica]
        made = method.step(passes[replica], replica_seed(seed, replica), before)
        made.measurement.assign(replica)
        states[replica], passes[replica] = made.state, passes[replica] + 1
        return Pass(made.measurement, {"replicas": states, "passes": passes})

    def develop(self, measurement: Measurement, state: State) -> Result:
        """The mean of all replicas; the metadata of the method are those of the first."""
        first = state["replicas"][0]
        result = self.method.develop(measurement, self.method.start() if first is None else first)
        result.metadata["replicas"] = self.count
        return result

    @property
    def setup_seconds(self) -> float:  # type: ignore[override]
        """See ``core.Method``."""
        return self.method.setup_seconds

    @property
    def error_cadence(self) -> float:
        """See ``core.Method``."""
        return self.method.error_cadence

    def noise(self, measurement: Measurement) -> float | None:
        """See ``core.Method``."""
        return self.method.noise(measurement)

    def finish_seconds(self, measurement: Measurement) -> float:
        """See ``core.Method``."""
        return self.method.finish_seconds(measurement)

    def plan(self, seconds: float | None, passes: int | None, error: float | None) -> None:
        """See ``core.Method``."""
        self._plan = seconds, passes, error
        for method in self._methods.values():
            self._tell(method)

    def _tell(self, method: Method) -> None:
        if self._plan is not None:
            method.plan(*self._plan)

    def _of(self, replica: int) -> Method:
        if replica not in self._methods:
            kind: Any = type(self.method)
            method: Method = prepared(kind(self.method.settings), self._problem, replica_seed(self._seed, replica))
            self._tell(method)
            self._methods[replica] = method
        return self._methods[replica]


def replicated(method: Method, state: Mapping[str, Any], problem: Any, seed: int) -> Method:
    """The method of a saved state: with replicas, if the state is that of replicas."""
    count = Replicated.replicas_of(state)
    return method if count is None else Replicated(method, problem, seed, count)
