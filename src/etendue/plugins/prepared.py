"""Cache of methods prepared for a scene, until the scene is edited."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from etendue.core import Method
from etendue.engine import fit_samples, settle_samples
from etendue.scene import Parameters, Problem, check, parameters, view, warn_of_offsets

#: Largest number of cached sensors and sample counts.
_MOST = 16
#: Fixed seed of pilots: with the picture's seed, a picture would depend on the seed of the previous one.
_PILOT_SEED = 0


@dataclass
class _Kept:
    sensor: Any  #: held, so that no other has its id()
    seen: Parameters  #: its parameters, as they were
    method: Any  #: prepared for passes; or not prepared, if each run needs a new one


class Prepared:
    """Prepared methods of one class with one set of settings.

    None of them references the scene between pictures: the scene references its integrator and would never be freed.
    """

    def __init__(self, kind: Any, settings: Any) -> None:
        self._kind, self._settings = kind, settings
        self._scene: Parameters | None = None
        self._kept: dict[tuple[int, int], _Kept] = {}

    @contextmanager
    def ready(self, problem: Problem, seed: int) -> Iterator[Method]:
        """A method whose passes divide the samples of ``problem``. Errors as ``scene.check``.

        Passes of one seed are the same whatever was rendered before."""
        scene = parameters(problem.scene)
        if scene != self._scene:
            self._scene, self._kept = scene, {}
        key = id(problem.sensor), problem.spp
        kept = self._kept.pop(key, None)  # removed in case the passes fail or another thread asks meanwhile
        seen = view(problem.sensor)
        if kept is None or kept.seen != seen:
            check(problem.scene, problem.sensor)
            warn_of_offsets(problem.scene, problem.sensor, "the scene")
            kept = self._prepare(problem, seed, seen)
            self._scene = parameters(problem.scene)  # traversing an emitter turns its scalars into variables
        elif self._kind.carries_on:
            kept.method.prepare(problem, seed)
        else:
            kept.method.bind(problem.scene)
        yield kept.method
        if self._kind.carries_on:
            kept.method = self._kind(kept.method.settings)  # they determine the samples of a pass
        else:
            kept.method.bind(None)
        while len(self._kept) >= _MOST:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = kept

    def _prepare(self, problem: Problem, seed: int, seen: Parameters) -> _Kept:
        method, problem = self._kind(self._settings), replace(problem)  # the caller's object keeps its scene
        if not self._kind.carries_on:
            seed = _PILOT_SEED
        method.prepare(problem, seed)
        fitted: Any = fit_samples(method, problem.spp, problem, seed)
        settle_samples(fitted)
        return _Kept(problem.sensor, seen, fitted)
