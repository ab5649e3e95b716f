"""The light table: what every bidirectional technique must know of a scene's emitters and Mitsuba does not say.

Mitsuba's emitters sample rays and directions but return no densities for emission, so densities are derived here from
three kinds of emitter:

=========  ==================================  =========================================================
kind       point density p_A (per area)        direction density p_w of an emitted ray (per solid angle)
=========  ==================================  =========================================================
area       1 / A, uniform over the shape       cos(theta) / pi
delta      1, one point (point, spot)          uniform over the sphere or over the spot's cone
infinite   1 / (pi R^2), disc of the scene     the emitter's own pdf_direction (constant, envmap)
=========  ==================================  =========================================================

Each density is multiplied by the probability of picking the emitter, which is proportional to its emitted power.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import SceneError

#: Rays drawn from each emitter to estimate its power.
_POWER_SAMPLES = 256


@dataclass
class Light:
    """A picked emitter and its entries of the table, one lane each."""

    emitter: Any  #: EmitterPtr
    pick: Any  #: probability of having picked it
    area_density: Any  #: 1/A of an area emitter, 1 of a delta emitter, 1/(pi R^2) of an infinite one
    direction_density: Any  #: of a delta emitter, per solid angle; 0 for the others
    is_delta: Any  #: point and spot: no ray can hit it
    is_infinite: Any  #: constant and envmap


class LightTable:
    """Emitters of a scene as device arrays, looked up by picking one or by the emitter pointer of a hit."""

    def __init__(self, scene: Any) -> None:
        emitters = scene.emitters()
        if not emitters:
            raise SceneError("the scene has no emitter; add a light source, or every picture is black")
        sphere = scene.bbox().bounding_sphere()
        #: Centre and radius R of the sphere that bounds the scene's geometry.
        self.centre, self.radius = sphere.center, float(np.asarray(sphere.radius).ravel()[0])

        rows = [_describe(e, self.radius) for e in emitters]
        self.has_area = any(r.kind == "area" for r in rows)
        self.has_delta = any(r.kind == "delta" for r in rows)
        self.has_infinite = any(r.kind == "infinite" for r in rows)
        self.count = len(rows)

        power = np.array([r.power for r in rows])
        if not np.isfinite(power).all() or (power < 0).any():
            bad = rows[int(np.argmin(np.isfinite(power) & (power >= 0)))]
            raise SceneError(f"emitter '{bad.name}' has a negative or non-finite power; correct its radiance")
        if power.sum() <= 0:
            raise SceneError("every emitter of the scene emits nothing; give one a radiance above zero")
        self.total_power = float(power.sum())
        pick = power / power.sum()

        self._emitters = scene.emitters_dr()
        self._pick = mi.Float(pick.astype(np.float32))
        self._area_density = mi.Float(np.array([r.area_density for r in rows], np.float32))
        self._direction_density = mi.Float(np.array([r.direction_density for r in rows], np.float32))
        self._kind = mi.UInt32(np.array([_KINDS.index(r.kind) for r in rows], np.uint32))
        self._cdf = mi.DiscreteDistribution(mi.Float(pick.astype(np.float32)))
        # A hit knows its emitter only as a pointer: registry numbers lead back to rows.
        ids = np.asarray(dr.reinterpret_array(mi.UInt32, self._emitters))
        row_of = np.zeros(int(ids.max()) + 1, np.uint32)
        row_of[ids] = np.arange(len(rows))
        self._row_of = mi.UInt32(row_of)

    def pick(self, u: Any, active: Any = True) -> Light:
        """Pick an emitter with probability proportional to its power."""
        if self.count == 1:
            return self._row(dr.zeros(mi.UInt32, dr.width(u)), active)
        return self._row(self._cdf.sample(u, active), active)

    def of(self, emitter: Any, active: Any = True) -> Light:
        """The entries of the emitter that a ray has hit. Lanes without emitter must not be active."""
        if self.count == 1:
            return self._row(dr.zeros(mi.UInt32, dr.width(emitter)), active)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        return self._row(dr.gather(mi.UInt32, self._row_of, number, active), active)

    def _row(self, row: Any, active: Any) -> Light:
        kind = dr.gather(mi.UInt32, self._kind, row, active)
        return Light(
            emitter=dr.gather(mi.EmitterPtr, self._emitters, row, active),
            pick=dr.gather(mi.Float, self._pick, row, active),
            area_density=dr.gather(mi.Float, self._area_density, row, active),
            direction_density=dr.gather(mi.Float, self._direction_density, row, active),
            is_delta=kind == _KINDS.index("delta"),
            is_infinite=kind == _KINDS.index("infinite"),
        )


_KINDS = ("area", "delta", "infinite")


@dataclass
class _Row:
    name: str
    kind: str
    power: float
    area_density: float
    direction_density: float


def _describe(emitter: Any, scene_radius: float) -> _Row:
    flags = emitter.flags()
    name = emitter.id() or emitter.class_name()
    power = _power(emitter)
    if mi.has_flag(flags, mi.EmitterFlags.Infinite):
        return _Row(name, "infinite", power, 1.0 / (np.pi * scene_radius**2), 0.0)
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return _Row(name, "delta", power, 1.0, _delta_direction_density(emitter))
    area = float(np.asarray(emitter.get_shape().surface_area()).ravel()[0])
    if not area > 0:
        raise SceneError(f"area emitter '{name}' sits on a shape without area; remove it or mend the shape")
    return _Row(name, "area", power, 1.0 / area, 0.0)


def _power(emitter: Any) -> float:
    """Emitted power, the mean weight of emitted rays, averaged over the colour channels."""
    u = _weyl(_POWER_SAMPLES)
    _, weight = emitter.sample_ray(0.0, 0.5, mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3]))
    return float(np.asarray(weight, dtype=np.float64).mean())


def _weyl(n: int) -> list[Any]:
    """``n`` points of a four-dimensional Kronecker sequence."""
    i = np.arange(n) + 0.5
    return [mi.Float(np.mod(i * a, 1.0).astype(np.float32)) for a in (0.8566749, 0.7338919, 0.6287067, 0.5385973)]


def _delta_direction_density(emitter: Any) -> float:
    """Solid-angle density of the rays a point-like emitter emits: uniform over its cone, or over the sphere."""
    params = mi.traverse(emitter)
    if "cutoff_angle" in params:
        cutoff = float(np.asarray(params["cutoff_angle"]).ravel()[0])
        return 1.0 / (2.0 * np.pi * (1.0 - np.cos(np.deg2rad(cutoff))))
    return 1.0 / (4.0 * np.pi)
