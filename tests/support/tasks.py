"""Tasks of pictures for tests of the engine and of workers."""

from __future__ import annotations

from typing import Any

from etendue.engine import Budget, Job, Task
from etendue.products import Picture, picture_task
from etendue.scene import SceneSource


def rendering(
    scene: Any,
    method: type[Any],
    settings: Any = None,
    seed: int = 0,
    budget: Budget | None = None,
    product: Picture | None = None,
    **source: Any,
) -> Task:
    """The task of a picture, without files unless a ``product`` has some; ``source``: further arguments of
    :class:`SceneSource`, such as ``size``."""
    return picture_task(SceneSource(scene, **source), method, product or Picture(), settings, seed, budget)


def job_of(problem: Any, method: Any, seed: int, budget: Budget | None = None, **options: Any) -> Job:
    """A job of a problem in memory and of a method that is prepared already."""
    return Job(rendering({}, type(method), None, seed), problem, method, budget or Budget(), **options)
