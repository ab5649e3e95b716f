"""Methods that were made ready for a scene, kept until the scene is edited."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from etendue.core import Method
from etendue.engine import fit_samples, settle_samples
from etendue.scene import Parameters, Problem, check, parameters, view, warn_of_offsets

#: Sensors and sample counts that are kept at most.
_MOST = 16
#: Seed of pilots: with that of the picture, a picture would depend on the seed of the one before it.
_PILOT_SEED = 0


@dataclass
class _Kept:
    sensor: Any  #: held, so that no other has its id()
    seen: Parameters  #: its parameters, as they were
    method: Any  #: ready for passes; or not prepared, where each run needs a fresh one


class Prepared:
    """Methods of one kind and settings, ready for the passes of a picture.

    Neither they nor this hold the scene between pictures: a scene holds its integrator, and would never be freed.
    """

    def __init__(self, kind: Any, settings: Any) -> None:
        self._kind, self._settings = kind, settings
        self._scene: Parameters | None = None
        self._kept: dict[tuple[int, int], _Kept] = {}

    @contextmanager
    def ready(self, problem: Problem, seed: int) -> Iterator[Method]:
        """A method whose passes share the samples of ``problem``. Raises what ``scene.check`` does.

        Passes of one seed are the same whatever was rendered before."""
        scene = parameters(problem.scene)
        if scene != self._scene:
            self._scene, self._kept = scene, {}
        key = id(problem.sensor), problem.spp
        kept = self._kept.pop(key, None)  # gone if the passes fail, or another thread asks meanwhile
        seen = view(problem.sensor)
        if kept is None or kept.seen != seen:
            check(problem.scene, problem.sensor)
            warn_of_offsets(problem.scene, problem.sensor, "the scene")
            kept = self._prepare(problem, seed, seen)
            self._scene = parameters(problem.scene)  # an emitter that is asked first makes its scalars variables
        elif self._kind.carries_on:
            kept.method.prepare(problem, seed)
        else:
            kept.method.bind(problem.scene)
        yield kept.method
        if self._kind.carries_on:
            kept.method = self._kind(kept.method.settings)  # which say how many samples a pass has
        else:
            kept.method.bind(None)
        while len(self._kept) >= _MOST:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = kept

    def _prepare(self, problem: Problem, seed: int, seen: Parameters) -> _Kept:
        method, problem = self._kind(self._settings), replace(problem)  # the caller's keeps its scene
        if not self._kind.carries_on:
            seed = _PILOT_SEED
        method.prepare(problem, seed)
        fitted: Any = fit_samples(method, problem.spp, problem, seed)
        settle_samples(fitted)
        return _Kept(problem.sensor, seen, fitted)
