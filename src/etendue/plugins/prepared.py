"""Cache of methods prepared for a scene, until the scene is edited."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import mitsuba as mi

from etendue.core import Method, prepared
from etendue.engine import fit_samples, settle_samples
from etendue.methods import ImageMethod, ImageSettings
from etendue.scene import (
    Parameters,
    Problem,
    check,
    is_dark,
    lamps_in_surfaces,
    parameters,
    remarks_on,
    view,
    warn_of_lamps,
    warn_of_offsets,
)

#: Largest number of cached methods, one for each pair of sensor and sample count.
_MOST = 16
#: Seed of pilots. With the seed of the picture, cached methods would depend on the seed of the first picture.
_PILOT_SEED = 0


@dataclass
class _Kept:
    sensor: mi.Sensor  #: referenced, so that its id() is not used again
    seen: Parameters  #: parameters of the sensor at the time of the preparation
    method: ImageMethod  #: prepared, unless each run needs a new preparation
    carries_on: bool  #: whether its passes depend on each other; for some methods this depends on the scene


class Prepared:
    """Prepared methods of one class with one set of settings.

    None of them references the scene between pictures: the scene references its integrator and would never be freed.
    """

    def __init__(self, kind: type[ImageMethod], settings: ImageSettings) -> None:
        self._kind, self._settings = kind, settings
        self._scene: Parameters | None = None
        self._kept: dict[tuple[int, int], _Kept] = {}

    @contextmanager
    def ready(self, problem: Problem, seed: int) -> Iterator[Method]:
        """A prepared method; its ``samples_per_iteration`` divides the samples of ``problem``. Errors as
        ``scene.check``. Passes depend on the seed, but not on earlier pictures."""
        scene = parameters(problem.scene)
        if scene != self._scene:
            self._scene, self._kept = scene, {}
        key = id(problem.sensor), problem.spp
        kept = self._kept.pop(key, None)  # removed, in case the passes fail or another thread uses the cache
        seen = view(problem.sensor)
        if kept is None or kept.seen != seen:
            check(problem.scene, problem.sensor)
            warn_of_offsets(problem.scene, problem.sensor, "the scene")
            warn_of_lamps(remarks_on(lamps_in_surfaces(problem.scene)), "the scene")
            kept = self._prepare(problem, seed, seen)
            self._scene = parameters(problem.scene)  # traversing an emitter turns its scalars into variables
        elif kept.carries_on:
            prepared(kept.method, problem, _pilot_seed(kept.method, seed))
        else:
            kept.method.bind(problem.scene)
        yield kept.method
        if kept.carries_on:
            kept.method = self._kind(kept.method.settings)  # the settings contain the samples of a pass
        else:
            kept.method.bind(None)
        while len(self._kept) >= _MOST:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = kept

    def _prepare(self, problem: Problem, seed: int, seen: Parameters) -> _Kept:
        method, problem = self._kind(self._settings), replace(problem)  # a copy, because bind() changes its scene
        if method.in_the_dark is not None and is_dark(problem.scene):
            shared = {name: getattr(self._settings, name) for name in ImageSettings.names()}
            method = method.in_the_dark(method.in_the_dark.Settings(**shared))
        seed = _pilot_seed(method, seed)
        fitted: Any = fit_samples(method, problem.spp, problem, seed)
        settle_samples(fitted)
        return _Kept(problem.sensor, seen, fitted, bool(fitted.carries_on))


def _pilot_seed(method: Method, seed: int) -> int:
    """The seed with which a method is prepared for a picture of the given seed; asked before it is prepared."""
    return seed if method.carries_on else _PILOT_SEED
