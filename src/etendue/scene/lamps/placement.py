"""Lamps that lie in a surface: whether it hides them depends on rounding, so methods differ.

Next event estimation ignores a surface that contains a point-like lamp, light paths may hit it at once. Rays that meet
a flat area light and a surface in the same plane may find either.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from etendue.core import Array, as_array, copied_to_device

from ..graph import contents, describe, described_emitter, plugin_name
from ..space import half_diagonal, warn_once

if TYPE_CHECKING:
    import mitsuba as mi

#: A lamp lies in a surface if this is their distance, as a share of half the scene's diagonal; and in steps of single
#: precision at its coordinates.
_NEAR, _STEPS = 1e-5, 8.0 * 2.0**-24
_POINTS, _GOLDEN = 16, 0.6180339887  #: of an area light, a lattice by the golden ratio
#: Three axes and four diagonals of a cube: no plane contains more than three of them.
_DIRECTIONS = np.array([d for d in product((1.0, 0.0, -1.0), repeat=3) if d > (0, 0, 0) and d.count(0.0) != 1])


def lamps_in_surfaces(scene: mi.Scene) -> list[tuple[mi.Emitter, mi.Shape]]:
    """Each lamp of a loaded scene that lies in a surface which is not invisible, with the surface's shape: point-like
    lamps, and flat area lights of which at least half lies in it."""
    import mitsuba as mi

    lamps = [(e, points) for e in scene.emitters() if (points := _points(e)) is not None]
    if not lamps:
        return []
    place = np.concatenate([points for _, points in lamps])
    reach = (_NEAR * half_diagonal(scene) + _STEPS * np.abs(place).max(axis=1))[:, None, None]
    along = _DIRECTIONS / np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
    start = (place[:, None] - reach * along).reshape(-1, 3)
    numbers = np.column_stack([start, np.tile(along, (len(place), 1)), np.repeat(2.0 * reach.ravel(), len(along))])
    x, y, z, dx, dy, dz, most = (copied_to_device(mi.Float, column) for column in numbers.astype(np.float32).T)
    ray = mi.Ray3f(mi.Point3f(x, y, z), mi.Vector3f(dx, dy, dz))
    ray.maxt = most
    hit = scene.ray_intersect_preliminary(ray)
    met, instance = (dr.reinterpret_array(mi.UInt32, s) for s in (hit.shape, hit.instance))
    met = dr.select(instance != 0, instance, met)  # an instance hides as a whole
    numbers = np.asarray(met).reshape(len(place), -1)
    if not numbers.any():
        return []
    every = np.asarray(dr.reinterpret_array(mi.UInt32, scene.shapes_dr())).tolist()
    by_number = dict(zip(every, scene.shapes(), strict=True))
    found, first = [], 0
    for lamp, points in lamps:
        rows = numbers[first : first + len(points)].tolist()
        first += len(points)
        others = [next((n for n in row if n in by_number and _hides(by_number[n], lamp)), 0) for row in rows]
        if 2 * np.count_nonzero(others) >= len(points):
            found.append((lamp, by_number[max(others, key=others.count) or max(others)]))
    return found


def _points(lamp: mi.Emitter) -> Array | None:
    """Points (n, 3) of a point-like lamp or of a flat area light; None for other emitters."""
    import mitsuba as mi

    if mi.has_flag(lamp.flags(), mi.EmitterFlags.DeltaPosition):
        values = dict(contents(lamp).values)
        if "position" in values:
            return as_array(values["position"]).astype(np.float64).reshape(1, 3)
        return as_array(values["to_world"]).astype(np.float64).reshape(4, 4)[None, :3, 3]
    shape = lamp.get_shape() if mi.has_flag(lamp.flags(), mi.EmitterFlags.Surface) else None
    if shape is None:
        return None
    k = np.arange(_POINTS) + 0.5
    u, v = k / _POINTS, k * _GOLDEN % 1.0
    kind, values = plugin_name(shape), dict(contents(shape).values)
    if kind in ("disk", "rectangle"):
        place = as_array(values["to_world"]).astype(np.float64).reshape(4, 4)
        radius, turn = np.sqrt(u), 2.0 * np.pi * v
        own = [radius * np.cos(turn), radius * np.sin(turn)] if kind == "disk" else [2.0 * u - 1.0, 2.0 * v - 1.0]
        flat: Array = np.stack(own, -1) @ place[:3, :2].T + place[:3, 3]
        return flat
    if "faces" not in values:
        return None
    faces = as_array(values["faces"]).reshape(-1, 3)
    faces = faces[np.arange(_POINTS) * len(faces) // _POINTS]
    corners = as_array(values["vertex_positions"]).reshape(-1, 3)[faces].astype(np.float64)
    weights = np.stack([1.0 - np.sqrt(u), np.sqrt(u) * (1.0 - v), np.sqrt(u) * v], -1)
    result: Array = np.einsum("pk,pkc->pc", weights, corners)
    return result


def _hides(shape: mi.Shape, lamp: mi.Emitter) -> bool:
    """Whether a shape is visible, and not that of the lamp."""
    return shape.emitter() is not lamp and (shape.bsdf() is None or plugin_name(shape.bsdf()) != "null")


def remarks_on(found: Sequence[tuple[mi.Emitter, mi.Shape]]) -> tuple[tuple[str, str], ...]:
    """(lamp, what is wrong with it, and a remedy) for each result of :func:`lamps_in_surfaces`."""
    return tuple(
        (
            described_emitter(lamp),
            f"lies in the surface of {describe(shape, 'shape')}, so it depends on method and rounding which of "
            "their sides is lit; move it off the surface, by a thousandth of the scene's size or more",
        )
        for lamp, shape in found
    )


def warn_of_lamps(remarks: Sequence[tuple[str, str]], name: str) -> None:
    """Warn, once for each text, of the lamps of a scene ``name`` that lie in surfaces."""
    for lamp, remark in remarks:
        warn_once(f"{name}: {lamp} {remark}")
