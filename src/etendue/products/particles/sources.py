"""Particles of files, and the scenes in which they were traced."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.core import OptionError, logger
from etendue.particles import ParticleFile, Particles
from etendue.scene import Problem, SceneSource

#: Particles that are added at once.
_BATCH = 1 << 20
#: Settings with which a file has all hits on surfaces that can have a map.
_ALL = {"keep": "all", "after": 0, "max_bounces": -1}


class FileSource:
    """The particles of a file in batches, anew at each call.

    Raises :class:`ParticleError` for a file that cannot be read. Warns if the file has only a part of the light, and if
    it has no numbers of paths: each particle is then a path of its own.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.file = ParticleFile(path)
        settings = json.loads(self.file.header["settings"])
        part = [f"{name}={settings[name]}" for name, all_ in _ALL.items() if settings.get(name, all_) != all_]
        if part:
            logger.warning("%s has a part of the light (%s), and so has the map", path, ", ".join(part))
        if not self.file.has_paths:
            logger.warning(
                "%s has no numbers of paths: errors of maps are those of independent particles, which are too small "
                "where a path has several hits",
                path,
            )

    def __len__(self) -> int:
        """Number of all particles."""
        return len(self.file)

    def __call__(self) -> Iterator[Particles]:
        """The particles, a million at a time; their power is that of all paths together."""
        yield from self._batches(self.file.parts())

    def sample(self, least: int) -> Iterator[Particles]:
        """As a call, but only of evenly spaced passes, as many as are needed for ``least`` particles. Passes are whole,
        because the particles of a pass are sorted by surface, and a part of it would lack surfaces."""
        numbers = [block.head["pass"] for block in self.file.passes]
        count = min(-(-least * len(numbers) // max(len(self), 1)), len(numbers))
        chosen = {numbers[(2 * k + 1) * len(numbers) // (2 * count)] for k in range(count)}
        return self._batches(self.file.parts(passes=chosen))

    def _batches(self, parts: Iterator[Particles]) -> Iterator[Particles]:
        waiting: list[Particles] = []
        first = 0
        for part in parts:
            if not self.file.has_paths:
                path = np.arange(first, first + len(part), dtype=np.uint64).astype(np.uint32)
                part = replace(part, path=path)
            first += len(part)
            waiting.append(part)
            if sum(map(len, waiting)) >= _BATCH:
                yield Particles.joined(waiting)
                waiting = []
        if waiting:
            yield Particles.joined(waiting)

    def scene(
        self, scene: Any = None, parameters: Mapping[str, Any] | None = None, memory: int | None = None
    ) -> Problem:
        """The loaded scene of the particles: ``scene``, or by default that from which they were traced.

        Raises :class:`OptionError` if that scene was in memory, and the errors of loading. Warns if the scene has
        changed: the particles may still lie on its surfaces.
        """
        place = self.file.header["place"]
        if scene is None and not {"source", "bundled"} & place.keys():
            raise OptionError(f"'{self.file.path}' was traced in a scene in memory; give the scene")
        source = SceneSource.at(place, scene)
        problem = replace(source, parameters=parameters or source.parameters, memory=memory).open(logger.debug)
        if not self.file.is_of(problem):
            logger.warning(
                "%s: the scene '%s' has changed since its particles were traced, or is another one",
                self.file.path,
                problem.source,
            )
        return problem
