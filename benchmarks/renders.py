"""Many short calls of ``mi.render``: what an integrator that keeps what it prepared saves over one made anew."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any

from etendue import scene

from .measuring import COST_SCENE, COST_SETTINGS, Record, interleaved, spread
from .options import Methods, Rounds, Size, WarmUp

_MITSUBA = "Mitsuba path"


def measure(
    methods: Methods = "bpt,vcm",
    size: Size = "256x192",
    rounds: Rounds = 100,
    warm_up: WarmUp = 2,
    source: str = COST_SCENE,
) -> Record:
    """Pictures of one sample in turn, a seed a round: Mitsuba's ``path``, then each method twice."""
    import drjit as dr
    import mitsuba as mi

    problem = scene.load(source, size=size)
    depth = COST_SETTINGS["path"]["max_depth"]

    def task(name: str, keep: bool) -> Callable[[int], Any]:
        own = mi.load_dict({"type": name, "max_depth": depth})

        def render(number: int) -> None:
            integrator = own if keep else mi.load_dict({"type": name, "max_depth": depth})
            image = mi.render(problem.scene, sensor=problem.sensor, integrator=integrator, spp=1, seed=number)
            dr.eval(image)
            dr.sync_thread()

        return render

    tasks = {_MITSUBA: task("path", True)}
    for name in methods:
        tasks |= {name: task(name, True), f"{name}, prepared anew": task(name, False)}
    times = interleaved(tasks, rounds, warm_up)
    record = Record(
        f"A picture of one sample by mi.render, {source}, {size[0]}x{size[1]}, depth {depth}", ("", "wall s", "to path")
    )
    for name, clocks in times.items():
        ratios = [own.wall / other.wall for own, other in zip(clocks, times[_MITSUBA], strict=True)]
        record.add(name, f"{statistics.median(clock.wall for clock in clocks):.4f}", spread(ratios))
    record.notes.append(
        f"median (min … max) of {rounds} rounds after {warm_up} to warm up; a ratio is that of two pictures of one "
        "round; prepared anew: a new integrator for each picture"
    )
    return record
