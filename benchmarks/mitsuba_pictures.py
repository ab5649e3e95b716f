"""A picture by an integrator of Mitsuba, in parts that fit its sampler, by samples or by time."""

from __future__ import annotations

import math
import time

import mitsuba as mi
import numpy as np

from etendue.scene import Problem


def picture(
    problem: Problem,
    seed: int,
    *,
    samples: float = math.inf,
    seconds: float = math.inf,
    part: int = 1,
    part_seconds: float = 0.0,
    integrator: str = "path",
) -> tuple[np.ndarray, float, float]:
    """Picture (height, width, 3), samples of a pixel and seconds; at least one part.

    It ends with ``samples``, or where the next part would end after ``seconds``. A part has ``part`` samples of a
    pixel; it is doubled as long as it takes less than half of ``part_seconds``.
    """
    plugin = mi.load_dict({"type": integrator, "max_depth": problem.max_depth})
    total, done, count, taken = np.zeros((*problem.size[::-1], 3)), 0, 0, 0.0
    begin = time.perf_counter()
    while True:
        spp = part if math.isinf(samples) else min(part, int(samples) - done)
        image = mi.render(problem.scene, sensor=problem.sensor, integrator=plugin, spp=spp, seed=100_000 * seed + count)
        total += spp * np.array(image, np.float64)[:, :, :3]
        done, count = done + spp, count + 1
        before, taken = taken, time.perf_counter() - begin
        if done >= samples or 2.0 * taken - before > seconds:
            return total / done, float(done), taken
        if count > 1 and taken - before < part_seconds / 2.0:  # the first part compiles
            part *= 2
