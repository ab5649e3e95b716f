"""The time of the filters of pictures."""

from __future__ import annotations

import statistics
from typing import Any

import drjit as dr
import numpy as np

from etendue import display
from etendue.display.denoising import Features, Picture

from .measuring import Record, interleaved, verdict
from .options import Rounds, Size

#: Milliseconds of a component of 512x512 pixels with a radius of 5, on two cores.
BARS = {"gaussian": 30.0, "bilateral": 100.0, "guided": 100.0}
BAR_SIZE, BAR_RADIUS, BAR_CORES = (512, 512), 5, 2


def filters(size: Size = "512x512", radius: int = BAR_RADIUS, rounds: Rounds = 11) -> Record:
    """Milliseconds of each filter for one component, with and without features."""
    width, height = size
    rng = np.random.default_rng(0)
    component, albedo, normal, variance = rng.random((4, height, width, 3), dtype=np.float32)
    tasks, kinds = {}, ("gaussian", "bilateral", "guided", "nlm")
    for name in kinds:
        for with_features in (False, True):
            features = Features(albedo, normal, variance) if with_features else Features(variance=variance)
            tasks[name, with_features] = _task(name, component, features, radius)
    clocks = interleaved({str(key): task for key, task in tasks.items()}, rounds, 2)
    cores = min(dr.thread_count(), BAR_CORES)
    record = Record(
        f"Filters, one component of {width}x{height}, radius {radius}",
        ("", "features", "ms", f"CPU ms / {cores} cores", "bar"),
    )
    comparable = tuple(size) == BAR_SIZE and radius == BAR_RADIUS
    for name, with_features in tasks:
        found = clocks[str((name, with_features))]
        wall, cpu = (1e3 * statistics.median(getattr(c, kind) for c in found) for kind in ("wall", "cpu"))
        bar = verdict(cpu / cores, BARS.get(name)) if comparable else ""
        record.add(name, "albedo, normal" if with_features else "none", f"{wall:.0f}", f"{cpu / cores:.0f}", bar)
    record.notes.append(
        f"median of {rounds} rounds in turn after 2 to warm up, from arrays of the host to arrays of the host; the bar "
        "is held against CPU time, since a busy machine makes the clock longer"
    )
    return record


def _task(name: str, component: Picture, features: Features, radius: int) -> Any:
    return lambda _: display.denoiser(name).function(component, features, radius, 1.0)
