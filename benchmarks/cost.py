"""Seconds of a pass, relative to Mitsuba's own ``path`` at one sample per pixel on the same scene."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import Any

from etendue import methods, scene

from .measuring import COST_SCENE, COST_SETTINGS, Record, interleaved, spread, verdict

BARS = {"bpt": 2.8, "vcm": 4.0, "sppm": 3.0}
BAR_SIZE = (512, 512)
_MITSUBA = "Mitsuba path"
#: Russian roulette as Mitsuba's ``path`` plays it by default, and no other.
ROULETTE = {"rr_depth": 5, "shadow_roulette": 0.0}


def measure(names: Sequence[str], size: tuple[int, int], rounds: int, warm_up: int, source: str = COST_SCENE) -> Record:
    """Passes in turn: Mitsuba's ``path``, then each method, again and again.

    Each method runs twice: with its own defaults where the settings of this benchmark do not speak, and with the
    roulette of Mitsuba's ``path``.
    """
    import drjit as dr
    import mitsuba as mi

    problem = scene.load(source, size=size)
    depth = COST_SETTINGS["path"]["max_depth"]
    mitsuba_path = mi.load_dict({"type": "path", "max_depth": depth})

    def mitsuba(number: int) -> None:
        # Rendering is lazy: without these two lines the clock would stop before the first ray.
        image = mi.render(problem.scene, sensor=problem.sensor, integrator=mitsuba_path, spp=1, seed=number)
        dr.eval(image)
        dr.sync_thread()

    tasks: dict[str, Callable[[int], Any]] = {_MITSUBA: mitsuba}
    bars: dict[str, float | None] = {}
    for name in names:
        method = methods.get(name)
        alike = {key: value for key, value in ROULETTE.items() if key in method.Settings.names()}
        for label, extra in ((name, {}), (f"{name}, roulette as Mitsuba", alike)):
            estimator = method(method.Settings(**(COST_SETTINGS[name] | extra)))
            estimator.prepare(problem, 0)
            tasks[label] = lambda number, estimator=estimator: estimator.step(number, 0)
            bars[label] = BARS.get(name) if size == BAR_SIZE and source == COST_SCENE else None
    times = interleaved(tasks, rounds, warm_up)

    record = Record(
        f"Cost of a pass, {source}, {size[0]}x{size[1]}, depth {depth}",
        ("", "wall s", "cpu s", "wall ratio", "cpu ratio", "bar"),
    )
    for name, clocks in times.items():
        wall = [clock.wall / own.wall for clock, own in zip(clocks, times[_MITSUBA], strict=True)]
        cpu = [clock.cpu / own.cpu for clock, own in zip(clocks, times[_MITSUBA], strict=True)]
        record.add(
            name,
            f"{statistics.median(clock.wall for clock in clocks):.3f}",
            f"{statistics.median(clock.cpu for clock in clocks):.3f}",
            spread(wall),
            spread(cpu),
            verdict(statistics.median(wall), bars.get(name)),
        )
    record.notes += [
        f"median (min … max) of {rounds} rounds after {warm_up} to warm up; a ratio is that of two passes of one round",
        "one camera path per pixel; for bpt and vcm one light path, connection and light point, for sppm as many light "
        "paths; merge and first gather radius 0.003 of half the box's diagonal (constant for vcm); a pass of ours "
        "ends with its sums on the host, in float64",
        "roulette as Mitsuba: " + ", ".join(f"{key}={value:g}" for key, value in ROULETTE.items()),
        "cpu: all threads of the process; of no meaning under CUDA",
    ]
    return record
