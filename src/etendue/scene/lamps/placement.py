"""Point-like lamps that lie in a surface: whether the surface hides them depends on rounding, so methods differ."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from etendue.core import Array

from ..graph import as_array, contents, describe, plugin_name, shapes
from ..space import half_diagonal, warn_once

if TYPE_CHECKING:
    import mitsuba as mi

#: A lamp lies in a surface if this is their distance, as a share of half the scene's diagonal; and in steps of single
#: precision at its coordinates.
_NEAR, _STEPS = 1e-5, 8.0 * 2.0**-24
#: Three axes and four diagonals of a cube: no plane contains more than three of them.
_DIRECTIONS = np.array([d for d in product((1.0, 0.0, -1.0), repeat=3) if d > (0, 0, 0) and d.count(0.0) != 1])


def lamps_in_surfaces(scene: mi.Scene) -> list[tuple[mi.Emitter, mi.Shape]]:
    """Each point-like lamp of a loaded scene that lies in a visible surface, with the surface's shape."""
    import mitsuba as mi

    lamps = [e for e in scene.emitters() if mi.has_flag(e.flags(), mi.EmitterFlags.DeltaPosition)]
    if not lamps:
        return []
    place = np.array([_position(lamp) for lamp in lamps])
    reach = (_NEAR * half_diagonal(scene) + _STEPS * np.abs(place).max(axis=1))[:, None, None]
    along = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    start = (place[:, None] - reach * along).reshape(-1, 3).T
    ray = mi.Ray3f(mi.Point3f(np.ascontiguousarray(start, np.float32)), mi.Vector3f(0.0))
    ray.d = mi.Vector3f(np.ascontiguousarray(np.tile(along, (len(lamps), 1)).T, np.float32))
    ray.maxt = mi.Float(np.repeat(2.0 * reach.ravel(), len(along)).astype(np.float32))
    hit = scene.ray_intersect_preliminary(ray)
    met, instance = (dr.reinterpret_array(mi.UInt32, s) for s in (hit.shape, hit.instance))
    met = dr.select(met == 0, instance, met)  # the shape within an instance is not known
    numbers = np.asarray(met).reshape(len(lamps), -1)
    if not numbers.any():
        return []
    by_number = {int(np.asarray(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))).item()): s for s in shapes(scene)}
    found = []
    for lamp, row in zip(lamps, numbers, strict=True):
        near = [by_number[n] for n in row.tolist() if n in by_number]
        near = [s for s in near if s.bsdf() is None or plugin_name(s.bsdf()) != "null"]
        found += [(lamp, near[0])] if near else []
    return found


def remarks_on(found: Sequence[tuple[mi.Emitter, mi.Shape]]) -> tuple[tuple[str, str], ...]:
    """(lamp, what is wrong with it, and a remedy) for each result of :func:`lamps_in_surfaces`."""
    return tuple(
        (
            describe(lamp, "emitter"),
            f"lies in the surface of {describe(shape, 'shape')}, so it depends on method and rounding which side it "
            "lights; move it off the surface, by a thousandth of the scene's size or more",
        )
        for lamp, shape in found
    )


def warn_of_lamps(remarks: Sequence[tuple[str, str]], name: str) -> None:
    """Warn, once for each text, of the lamps of a scene ``name`` that lie in surfaces."""
    for lamp, remark in remarks:
        warn_once(f"{name}: {lamp} {remark}")


def _position(lamp: mi.Emitter) -> Array:
    values = dict(contents(lamp).values)
    if "position" in values:
        return as_array(values["position"]).astype(np.float64).ravel()
    place: Array = as_array(values["to_world"]).astype(np.float64).reshape(4, 4)[:3, 3]
    return place
