"""A small scene on a ground of growing size: neither the choice of lamps nor the merge radius may depend on what no
pixel sees."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue import film, methods, render, scene
from etendue.core import Replica, prepared
from etendue.scene import Problem

from .measuring import Record, console, verdict
from .mitsuba_pictures import picture
from .options import Methods, Seeds

#: Error of a method beside Mitsuba's ``path`` at equal samples; relative bias of a block.
LAMP_BAR, BIAS_BAR = 1.2, 0.02
_SIZE = (64, 64)
_REFERENCE, _SAMPLES, _MERGED = 4096, 64, 128
#: Half-widths of the wall beside the lamp, and of the ground below the still life.
_WALLS, _GROUNDS = (1, 3, 10, 100), (2, 20, 200)
#: A block is beyond the bar if it is so by as many standard errors.
_SIGNIFICANT = 5.0


def lamps(names: Methods = "path,bpt,vcm,guided,auto", seeds: Seeds = 3) -> Record:
    """A spot on a wall below a dim sky: error at equal samples, over that of Mitsuba's ``path``."""
    record = Record(
        f"A spot beside a sky, {_SIZE[0]}x{_SIZE[1]}, {_SAMPLES} samples",
        ("half-width of the wall", "Mitsuba path, relMSE", *names, f"worst ≤ {LAMP_BAR:g}"),
    )
    for width in _WALLS:
        problem = scene.load(_wall(width), size=_SIZE)
        reference, _, _ = picture(problem, 1000, spp=_REFERENCE, part=_REFERENCE // 4)
        errors = [
            film.relative_mse(picture(problem, s, spp=_SAMPLES, part=_SAMPLES)[0], reference) for s in range(seeds)
        ]
        mitsuba, ratios = np.mean(errors), []
        for method in names:
            ours = [render(problem.scene, method, spp=_SAMPLES, seed=s, max_depth=3).image for s in range(seeds)]
            ratios.append(float(np.mean([film.relative_mse(image, reference) for image in ours]) / mitsuba))
        record.add(f"{width}", f"{mitsuba:.5f}", *(f"{r:.2f}" for r in ratios), verdict(max(ratios), LAMP_BAR))
        console.print(f"wall {width}: {ratios}", style="dim")
    record.notes.append(
        f"mean of {seeds} seeds, noise of the reference ({_REFERENCE} samples by Mitsuba's path) included"
    )
    return record


def merging(names: Methods = "vcm,auto", seeds: Seeds = 3) -> Record:
    """A still life on a ground: blocks of 8x8 pixels beside those of ``bpt``."""
    record = Record(
        f"Bias of merging on a ground, {_SIZE[0]}x{_SIZE[1]}, {_MERGED} samples",
        ("half-width of the ground", "method", "mean", "worst block", "blocks beyond 2 %", ""),
    )
    for width in _GROUNDS:
        problem = scene.load(_still_life(width), size=_SIZE)
        reference, reference_error = _blocks(problem, "bpt", 8 * _MERGED, range(100, 100 + seeds))
        for method in names:
            mean, error = _blocks(problem, method, _MERGED, range(seeds))
            deviation = np.abs(mean - reference)
            beyond = (deviation > BIAS_BAR * reference) & (deviation > _SIGNIFICANT * np.hypot(error, reference_error))
            record.add(
                f"{width}",
                method,
                f"{mean.mean() / reference.mean() - 1.0:+.2%}",
                f"{(deviation / reference).max():.1%}",
                f"{beyond.any(-1).sum()} of {beyond[..., 0].size}",
                verdict(float(beyond.sum()), 0),
            )
    record.notes.append(
        f"mean of {seeds} seeds beside bpt with {8 * _MERGED} samples; a block is beyond if its difference is "
        f"above {_SIGNIFICANT:g} standard errors, too"
    )
    return record


def _blocks(problem: Problem, method: str, samples: int, seeds: range) -> tuple[NDArray[Any], NDArray[Any]]:
    """Mean and standard error over the seeds of blocks of 8x8 pixels, (rows, columns, 3)."""
    rows, columns = _SIZE[1] // 8, _SIZE[0] // 8
    images = np.array([_picture(problem, method, samples, seed) for seed in seeds])
    blocks = images.astype(np.float64).reshape(len(seeds), rows, 8, columns, 8, 3).mean((2, 4))
    return blocks.mean(0), blocks.std(0, ddof=1) / len(seeds) ** 0.5


def _picture(problem: Problem, name: str, samples: int, seed: int) -> NDArray[Any]:
    """A picture pass by pass, without a plan: ``auto`` would not learn in so short a run."""
    kind: Any = methods.get(name)
    replica = Replica(prepared(kind(kind.Settings(max_depth=8)), problem, seed), seed)
    passes = -(-samples // replica.method.samples_per_iteration)
    total = sum((replica.step(number) for number in range(1, passes)), replica.step(0))
    return replica.develop(total).image


def _film() -> dict[str, Any]:
    return {"type": "hdrfilm", "width": _SIZE[0], "height": _SIZE[1], "rfilter": {"type": "box"}}


def _wall(width: float) -> Mapping[str, Any]:
    import mitsuba as mi

    place = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 0, 1], [0, 1, 0])
    turned = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale([width, width, 1])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sky": {"type": "constant", "radiance": 0.1},
        "spot": {"type": "spot", "intensity": 5.0, "cutoff_angle": 20, "to_world": place},
        "sensor": {"type": "perspective", "fov": 50, "to_world": place, "film": _film()},
        "wall": {"type": "rectangle", "to_world": turned, "bsdf": {"type": "diffuse", "reflectance": 0.8}},
    }


def _still_life(ground: float) -> Mapping[str, Any]:
    import mitsuba as mi

    to = mi.ScalarTransform4f

    def diffuse(*colour: float) -> dict[str, Any]:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}

    lamp = to().translate([1.2, -1, 2]).rotate([1, 0, 0], 155).scale(0.2)
    view = to().look_at([0, -4, 1.5], [0, 0, 0.4], [0, 0, 1])
    return {
        "type": "scene",
        "sky": {"type": "constant", "radiance": 0.3},
        "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 30.0}},
        "sensor": {"type": "perspective", "fov": 30, "to_world": view, "film": _film()},
        "ground": {"type": "rectangle", "to_world": to().scale(ground), "bsdf": diffuse(0.6, 0.5, 0.4)},
        "ball": {"type": "sphere", "center": [0, 0, 0.4], "radius": 0.4, "bsdf": {"type": "dielectric"}},
        "cube": {
            "type": "cube",
            "to_world": to().translate([0.7, 0.2, 0.2]).scale(0.2),
            "bsdf": diffuse(0.8, 0.1, 0.1),
        },
    }
