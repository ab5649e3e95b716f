"""Light paths traced without the library's walks, as something to compare with."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import IndependentSource
from etendue.scene import LightTable, Problem
from etendue.transport import emit, scatter_light

from .scenes import material


def independent(
    problem: Problem, paths: int, seed: int, longest: int, emission: Any = emit, source: Any = None, bounces: Any = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Light paths without roulette, a kernel an edge: (shape, flux in colour, position) of every end, (longest, paths,
    ...); flux zero where there is none. Fluxes are divided by the number of paths. ``bounces``: a list, to which the
    number of each end is appended, null surfaces before it left out."""
    lights, scene = LightTable(problem.scene), problem.scene
    numbers = {shape: i for i, shape in enumerate(np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr())))}
    source = source or IndependentSource(dr.arange(mi.UInt32, paths), seed, "test", 0)
    emitted = emission(lights, source, dr.full(mi.Bool, True, paths))
    ray, flux, active = emitted.ray, emitted.throughput / paths, emitted.active
    shapes, fluxes, places = [], [], []
    bounce = np.ones(paths, int)
    for edge in range(1, longest + 1):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        dr.eval(si, flux, active)
        ids = np.array(dr.reinterpret_array(mi.UInt32, si.shape))
        shapes.append([numbers.get(i, 0) for i in ids])
        fluxes.append(np.array(dr.select(active, flux, 0.0)).T)
        places.append(np.array(si.p).T)
        scattered, _ = scatter_light(material(scene, si, ray), si, source, mi.UInt32(edge), active)
        if bounces is not None:
            bounces.append(bounce)
            bounce = bounce + ~np.array(scattered.is_null & active)
        active &= scattered.active
        flux *= scattered.weight
        ray = si.spawn_ray(scattered.direction)
    return np.array(shapes), np.array(fluxes), np.array(places)
