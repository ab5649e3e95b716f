"""Textures averaged over the footprint of a pixel (``mipmap``) beside sharp ones (``bitmap``): error and time."""

from __future__ import annotations

import statistics
from typing import Annotated, Any

import mitsuba as mi
import numpy as np
import typer

from etendue import film, render
from etendue.core import Replica
from etendue.scene import load

from .measuring import Record, interleaved
from .options import Rounds, Seeds, WarmUp, whole_numbers
from .racing import Entrant

_KINDS, _SIZE = ("bitmap", "mipmap"), (128, 96)


def measure(
    samples: Annotated[Any, typer.Option(parser=whole_numbers, metavar="N,...")] = "1,4,16,64",
    seeds: Seeds = 3,
    reference: Annotated[int, typer.Option(min=1, help="Samples of the reference.")] = 4096,
    rounds: Rounds = 9,
    warm_up: WarmUp = 2,
) -> Record:
    """A row for each number of samples a pixel, and the time of a pass."""
    record = Record(
        "mipmap beside bitmap: relMSE of a speckled floor up to the horizon by path", ("", *_KINDS, "ratio")
    )
    truth = render(_floor("bitmap"), "path", spp=reference, size=_SIZE, seed=99).image
    for count in samples:
        errors = [
            float(np.mean([film.relative_mse(_picture(kind, count, seed), truth) for seed in range(seeds)]))
            for kind in _KINDS
        ]
        record.add(f"{count} samples", *(f"{error:.3g}" for error in errors), f"{errors[1] / errors[0]:.2f}")
    tasks = {}
    for kind in _KINDS:
        problem = load(_floor(kind), size=_SIZE)
        tasks[kind] = Replica(Entrant(kind, "path", {"samples_per_pass": 16}).prepared(problem, 0), 0).step
    clocks = interleaved(tasks, rounds, warm_up)
    wall = [statistics.median(clock.wall for clock in clocks[kind]) for kind in _KINDS]
    record.add("ms of a pass of 16", *(f"{1000 * seconds:.1f}" for seconds in wall), f"{wall[1] / wall[0]:.2f}")
    record.notes.append(
        f"means of {seeds} seeds, box filter; reference: bitmap, {reference} samples. The error of mipmap stops at "
        "that of its blur; time: median, in turn"
    )
    return record


def _picture(kind: str, samples: int, seed: int) -> Any:
    return render(_floor(kind), "path", spp=samples, size=_SIZE, seed=seed).image


def _floor(kind: str) -> dict[str, Any]:
    """A floor of random black and coloured texels, a few of them a pixel in front and hundreds at the horizon."""
    texels = (np.random.default_rng(1).random((512, 512, 1)) < 0.5) * np.array([0.9, 0.7, 0.5])
    repeat = mi.ScalarTransform3f().scale([8, 8])
    texture = {"type": kind, "bitmap": mi.Bitmap(texels.astype(np.float32)), "raw": True, "to_uv": repeat}
    camera = mi.ScalarTransform4f().look_at([0, 1, 4], [0, 0.2, 0], [0, 1, 0])
    box = {"type": "hdrfilm", "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 45, "to_world": camera, "film": box},
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(20),
            "bsdf": {"type": "diffuse", "reflectance": texture},
        },
        "sky": {"type": "constant"},
    }
