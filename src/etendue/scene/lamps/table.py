"""The light table: densities of emitters that bidirectional techniques need and Mitsuba does not provide.

Mitsuba's emitters sample rays and directions but return no densities for emission, so densities are derived here from
four kinds of emitter:

=========  ==================================  ====================================================================
kind       point density p_A (per area)        direction density p_w of an emitted ray (per solid angle)
=========  ==================================  ====================================================================
area       1 / A, uniform over the shape; by   cos(theta) / pi; focusarea: (n+2) / (2 pi) cos(theta)^(n+1);
           the radiance where that varies      theta: angle to the face, also with vertex normals
point      1, one point (point, spot,          uniform over the sphere, or over the cone that holds
           projector, luminaire)               every ray; luminaire: its intensity over its flux
infinite   1 / (pi R^2), disc of the scene     the emitter's own (constant, envmap, sunsky, sky), or 1
                                               for its only direction (directional)
beam       1 / A, uniform over the shape       1, along the normal (directionalarea)
=========  ==================================  ====================================================================

Next event estimation samples a spherical light by its solid angle from the lit point; emission samples as in the table.
:meth:`LightTable.through` mixes the disc with learned places.
Each density is multiplied by the probability of picking the emitter; see :func:`shares`. The power of a texture is
measured texel by texel. A projector samples its rays by its texture, not uniformly; the weights only need a density
that all techniques share.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SceneError, as_array, copied_to_device, in_steps, on_device
from etendue.density import BoxDensity, Boxes, LineDensity

from ..bounds import corners_of
from ..graph import contents, plugin_name
from ..members import Members
from ..packet import Packet, spread_wavelengths
from ..plugins.warps import square_to_cosine_power, square_to_cosine_power_pdf
from .places import Groups, Lamp, LightsAt
from .points import LightPoints
from .radiance import RadianceCells, has_cells, is_black, is_smooth, measure
from .rays import own_ray

#: Rays from an emitter, and points of a shape, that estimate its power.
_POWER_SAMPLES = 1 << 12
#: Cells along an edge of a cube map, each of about 6 degrees, and the share of an infinite light's power in one of them
#: from which on there is a sun. A sun between four cells still has more of a clear day's power.
_CUBE, _SUN = 16, 0.1
#: Packets of wavelengths at which a uniform area light is evaluated for its power.
_WAVELENGTHS = 64
#: Smallest probability of an emitter that is not known to be black, relative to an equal share.
_LEAST_SHARE = 0.25


@dataclass
class Light:
    """A picked emitter and its entries of the table, one lane each."""

    row: mi.UInt32  #: number of the light
    emitters: dict[str, Members]  #: of the scene, by kind; ``visible``: those that a ray can hit or see
    pick: mi.Float  #: probability with which next event estimation picks the light
    emitted: mi.Float  #: probability with which emission picks the light; equal to ``pick`` unless both were learned
    area_density: mi.Float  #: 1/A of an area emitter or a beam, 1 of a point-like one, 1/(pi R^2) of an infinite one
    direction_density: mi.Float  #: of a point-like emitter, per solid angle; 0 for luminaires and for the others
    is_delta: mi.Bool  #: no ray can hit it: point-like emitters, beams, and emitters with one direction
    is_area: mi.Bool
    is_point: mi.Bool
    is_infinite: mi.Bool
    is_beam: mi.Bool
    exponent: mi.Float | None  #: focus of an area emitter around its normal; None if no light of the scene has one
    #: Centre and radius of a spherical area emitter, radius 0 for others; None if no light of the scene is spherical.
    sphere: mi.Vector4f | None
    packet: Packet  #: the wavelengths of emitted light

    def call(self, kind: str, function: Callable[..., Any], *arguments: Any, active: mi.Bool) -> Any:
        """``function(emitter, *arguments, active)`` of the emitter, zero where it is of another kind. There must be
        emitters of this kind in the scene."""
        return self.emitters[kind].call(self.row, function, *arguments, active=active)

    def sample_direction(
        self, kind: str, it: mi.Interaction3f, u: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """The emitter's own ``sample_direction``; arguments as of :meth:`call`."""
        ds, weight = self.call(kind, mi.Emitter.sample_direction, it, u, active=active)
        return ds, weight

    def radiance(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Spectrum:
        """Radiance that the emitter sends from ``si`` into the direction ``si.wi``."""
        if not self.emitters["visible"]:
            return mi.Spectrum(0.0)
        return self.call("visible", mi.Emitter.eval, si, active=active)

    def direction_pdf(self, cos: mi.Float) -> mi.Float:
        """Solid-angle density with which an area emitter's ray leaves at ``cos`` to the normal."""
        if self.exponent is None:
            return cos * dr.inv_pi
        return square_to_cosine_power_pdf(cos, self.exponent + 1.0)

    def ray_density(self, d: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Solid-angle density with which a point-like emitter's ray leaves in the world direction ``d``."""
        if not self.emitters["web"]:
            return self.direction_density
        own = self.call("web", lambda emitter, d, active: emitter.ray_pdf(d, active), d, active=active)
        return dr.select(self.direction_density > 0.0, self.direction_density, own)

    def direction(self, u: mi.Point2f) -> mi.Vector3f:
        """A direction around the z axis with the density of :meth:`direction_pdf`."""
        if self.exponent is None:
            return mi.warp.square_to_cosine_hemisphere(u)
        return square_to_cosine_power(u, self.exponent + 1.0)


class LightTable:
    """Emitters of a scene as device arrays, looked up by picking one or by the emitter pointer of a hit."""

    def __init__(self, scene: mi.Scene, packet: Packet | None = None) -> None:
        #: The wavelengths of emitted light.
        self.packet = packet or Packet()
        emitters = scene.emitters()
        if not emitters:
            raise SceneError("the scene has no emitter, so every picture would be black; add a light source")
        #: Corners of the box of the scene's geometry, on the host.
        self.box = corners_of(scene)
        sphere = mi.ScalarBoundingBox3f(*map(mi.ScalarPoint3f, self.box)).bounding_sphere()
        #: Centre and radius R of the sphere that bounds the scene's geometry.
        self.centre, self.radius = sphere.center, float(np.asarray(sphere.radius).ravel()[0])

        #: The same on the device, (x, y, z, R), and :attr:`total_power`.
        self.bound = on_device(mi.Vector4f, [*self.centre, self.radius])

        rows = [_describe(e, sphere) for e in emitters]
        self.has_area, self.has_point, self.has_infinite, self.has_beam = (
            any(r.kind == kind for r in rows) for kind in _KINDS
        )
        self.count = len(rows)

        power = np.array([r.power for r in rows])
        if not np.isfinite(power).all() or (power < 0).any():
            bad = rows[int(np.argmin(np.isfinite(power) & (power >= 0)))]
            raise SceneError(f"emitter '{bad.name}' has a negative or non-finite power; correct its radiance")
        lit = np.array([_is_lit(r, e) for r, e in zip(rows, emitters, strict=True)])
        #: Learned places of the rays of infinite lights, and their share of these rays; None: all over the disc.
        self.lines: tuple[LineDensity, mi.Float] | None = None
        #: Learned places that next event's directions to skies pass, and their share of these directions.
        self.windows: tuple[BoxDensity, mi.Float] | None = None
        #: Whether every lamp is switched off, so that every picture is black.
        self.is_black = not lit.any()
        lit |= self.is_black  # any probabilities do
        #: (count,) emitted power of each emitter, on the host, and the sum.
        self.powers = power
        self.total_power = float(power.sum()) or 1.0
        self.flux = on_device(mi.Float, [self.total_power])
        weight, infinite = np.array([r.weight for r in rows]), np.array([r.kind == "infinite" for r in rows])
        #: (count,) probability of picking each emitter, on the host.
        self.probabilities = pick = shares(power * weight, lit, infinite)

        #: Groups of the lights that are picked by the place that they light; None for a single light.
        self.groups = Groups([r.lamp(e) for r, e in zip(rows, emitters, strict=True)], pick) if len(rows) > 1 else None

        self._pick = on_device(mi.Float, pick)
        self._area_density = on_device(mi.Float, [r.area_density for r in rows])
        self._direction_density = on_device(mi.Float, [0.0 if r.is_web else r.direction_density for r in rows])
        self._kind = on_device(mi.UInt32, [_KINDS.index(r.kind) for r in rows])
        focused = any(r.exponent for r in rows)
        self._exponent = on_device(mi.Float, [r.exponent for r in rows]) if focused else None
        self._is_delta = on_device(mi.Bool, [r.is_delta for r in rows])
        #: Whether there are lights that no ray can hit.
        self.has_delta = any(r.is_delta for r in rows)
        #: Whether there is a sun: an infinite light much of whose power comes from few directions.
        self.has_sun = any(r.is_sun for r in rows)
        #: Whether a light is a mesh with vertex normals.
        self.has_smooth = any(r.cells is not None and is_smooth(e) for r, e in zip(rows, emitters, strict=True))
        skies = [n for n, r in enumerate(rows) if r.kind == "infinite" and not r.is_delta and pick[n] > 0.0]
        #: Number of the sky, of which a scene has at most one; None: next event picks no sky.
        self.sky = skies[0] if skies else None
        self.has_sphere = any(r.sphere[3] for r in rows)
        self._sphere = on_device(mi.Float, np.ravel([r.sphere for r in rows])) if self.has_sphere else None
        #: Point sampling on area lights whose radiance varies; None if the scene has no such light.
        self.points = LightPoints([r.cells for r in rows]) if any(r.cells for r in rows) else None
        self._cdf = mi.DiscreteDistribution(on_device(mi.Float, pick))
        self._emitted, self._emitted_cdf = self._pick, self._cdf
        self._flux = on_device(mi.Float, self._fluxes(pick))
        #: (count,) whether :class:`Light` has the density of a light's ray directions, so that another distribution can
        #: sample them; on the host.
        self.has_directions = np.array([r.kind in ("area", "point") and not r.is_projector for r in rows])
        #: (count,) whether a light is a sphere of uniform radiance, whose rays have uniform directions.
        self.is_round = np.array([r.sphere[3] > 0.0 and r.cells is None for r in rows])
        self._middle = on_device(mi.Float, _middles(pick))
        # A hit has only a pointer to its emitter: registry numbers map it to rows.
        ids = np.asarray(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
        row_of = np.zeros(int(ids.max()) + 1, np.uint32)
        row_of[ids] = np.arange(len(rows))
        self._row_of = on_device(mi.UInt32, row_of)
        numbers = {kind: [n for n, r in enumerate(rows) if r.kind == kind] for kind in _KINDS}
        numbers["web"] = [n for n, r in enumerate(rows) if r.is_web]
        numbers["visible"] = numbers["area"] + numbers["infinite"]
        self._emitters = {kind: Members(mi.EmitterPtr, ids[own], own) for kind, own in numbers.items()}

    def pick(self, u: mi.Float, active: mi.Bool | bool = True) -> Light:
        """Pick an emitter for next event estimation, by :attr:`probabilities`."""
        if self.count == 1:
            return self.row(dr.zeros(mi.UInt32, dr.width(u)), active)
        return self.row(self._cdf.sample(u, active), active)

    def pick_emitting(self, u: mi.Float, active: mi.Bool | bool = True) -> Light:
        """Pick an emitter for emission, by its own probabilities if they were learned."""
        if self.count == 1:
            return self.row(dr.zeros(mi.UInt32, dr.width(u)), active)
        return self.row(self._emitted_cdf.sample(u, active), active)

    def picked_by(self, direct: Array, emitted: Array, visible: Array | None = None) -> LightTable:
        """The same lights, picked with other probabilities, (count,) each: for next event estimation, and for emission.
        ``visible``: (count,) factors on what lights shine at a place; without, next event picks alike everywhere.
        Probabilities are rounded to multiples of 2^-23, as random numbers are; a positive one remains positive."""
        table = copy.copy(self)
        table.probabilities, own = in_steps(direct, 23), in_steps(emitted, 23)
        table._pick, table._emitted, table._middle, table._flux = (
            copied_to_device(mi.Float, values.astype(np.float32))
            for values in (table.probabilities, own, _middles(own), self._fluxes(own))
        )
        table.groups = None
        if self.groups is not None and visible is not None:
            table.groups = Groups(self.groups.lamps, table.probabilities, visible)
        table._cdf, table._emitted_cdf = mi.DiscreteDistribution(table._pick), mi.DiscreteDistribution(table._emitted)
        return table

    def through(self, lines: LineDensity, share: float) -> LightTable:
        """The same lights; a ``share`` of the rays of infinite lights has the places of a density, below 1."""
        table = copy.copy(self)
        table.lines = lines, dr.opaque(mi.Float, share)
        return table

    def seen_through(self, windows: Boxes) -> LightTable:
        """The same lights; a share of next event's directions to skies, below 1, passes boxes."""
        table = copy.copy(self)
        table.windows = BoxDensity(windows), dr.opaque(mi.Float, windows.share)
        return table

    def at_wavelengths_of(self, packet: Packet) -> LightTable:
        """The same lights at the wavelengths of another packet."""
        table = copy.copy(self)
        table.packet = packet
        return table

    def _fluxes(self, emitted: Array) -> Array:
        """(count,) mean flux of the rays that the lights emit."""
        known = (self.powers > 0.0) & (emitted > 0.0)
        result: Array = np.divide(self.powers, emitted, out=np.full(self.count, self.total_power), where=known)
        return result

    def flux_of(self, row: mi.UInt32, active: mi.Bool | bool = True) -> mi.Float:
        """Mean flux of the rays that the light ``row`` emits: its power over the probability of emission."""
        return dr.gather(mi.Float, self._flux, row, active)

    def at(self, p: mi.Point3f) -> LightTable | LightsAt:
        """The lights, picked by next event as it is best at a place (see :mod:`.places`)."""
        return self if self.groups is None else LightsAt(self, p)

    def alike_everywhere(self) -> LightTable:
        """The same lights, picked with the same probabilities at every place."""
        table = copy.copy(self)
        table.groups = None
        return table

    def left_by_pick(self, u: mi.Float) -> mi.Float:
        """The remainder of the number ``u`` after picking an emitter: uniform in [0, 1), independent of the emitter."""
        if self.count == 1:
            return u
        return dr.clip(self._cdf.sample_reuse(u)[1], 0.0, 1.0 - 2.0**-24)

    def number_of(self, row: mi.UInt32, active: mi.Bool | bool = True) -> mi.Float:
        """A number with which :meth:`pick_emitting` picks the light ``row``; if that is never picked, another light."""
        return dr.gather(mi.Float, self._middle, row, active)

    def of(self, emitter: mi.EmitterPtr, active: mi.Bool | bool = True) -> Light:
        """The entries of the emitter that a ray has hit. Lanes without emitter must not be active."""
        if self.count == 1:
            return self.row(dr.zeros(mi.UInt32, dr.width(emitter)), active)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        return self.row(dr.gather(mi.UInt32, self._row_of, number, active), active)

    def row(self, row: mi.UInt32 | int, active: mi.Bool | bool = True) -> Light:
        """The entries of the light with a given number."""
        kind = dr.gather(mi.UInt32, self._kind, row, active)
        return Light(
            row=row,
            emitters=self._emitters,
            pick=(pick := dr.gather(mi.Float, self._pick, row, active)),
            emitted=pick if self._emitted is self._pick else dr.gather(mi.Float, self._emitted, row, active),
            area_density=dr.gather(mi.Float, self._area_density, row, active),
            direction_density=dr.gather(mi.Float, self._direction_density, row, active),
            is_delta=dr.gather(mi.Bool, self._is_delta, row, active),
            is_area=kind == _KINDS.index("area"),
            is_point=kind == _KINDS.index("point"),
            is_infinite=kind == _KINDS.index("infinite"),
            is_beam=kind == _KINDS.index("beam"),
            exponent=None if self._exponent is None else dr.gather(mi.Float, self._exponent, row, active),
            sphere=None if self._sphere is None else dr.gather(mi.Vector4f, self._sphere, row, active),
            packet=self.packet,
        )


_KINDS = ("area", "point", "infinite", "beam")


def shares(power: Array, lit: NDArray[np.bool_], infinite: NDArray[np.bool_]) -> Array:
    """Probabilities of emitters, (count,): by power among the finite ones, and among the infinite ones.

    The power of an infinite emitter is that through the scene's bounding sphere. It grows with ground that nobody sees,
    so it says nothing about the light beside that of a lamp: n infinite emitters together have the share n / (n + 1),
    as in pbrt. An emitter that is ``lit`` has at least :data:`_LEAST_SHARE` of an equal share, before normalisation.
    """
    count = int((lit & infinite).sum())
    both = 0 < count < lit.sum()
    result = np.zeros(len(power))
    for group, share in ((lit & infinite, count / (count + 1)), (lit & ~infinite, 1 / (count + 1))):
        total = power[group].sum()
        result[group] = (share if both else 1.0) * (power[group] / total if total > 0.0 else 1.0)
    result = np.where(lit, np.maximum(result, _LEAST_SHARE / max(lit.sum(), 1)), 0.0)
    normalised: Array = result / result.sum()
    return normalised


def _is_lit(row: _Row, emitter: mi.Emitter) -> bool:
    """Whether an emitter may give light to a picture. A weight of 0 keeps Mitsuba from sampling an emitter, so that one
    that no ray can hit gives none."""
    return (row.weight > 0.0 or not row.is_delta) and (row.power > 0.0 or not is_black(emitter))


def _middles(probability: Array) -> Array:
    """For each light, the middle of the numbers that pick it."""
    result: Array = np.cumsum(probability) - 0.5 * probability
    return result


@dataclass
class _Row:
    name: str
    kind: str
    power: float
    weight: float  #: ``sampling_weight`` of the emitter
    area_density: float
    direction_density: float = 0.0  #: of a luminaire: as if it were uniform
    is_delta: bool = False
    exponent: float = 0.0
    is_projector: bool = False
    is_web: bool = False  #: whether the light is a luminaire
    cells: RadianceCells | None = None  #: of an area light whose radiance varies
    sphere: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  #: centre and radius of a spherical light
    is_sun: bool = False  #: whether narrow directions send much of an infinite light's power

    def lamp(self, emitter: mi.Emitter) -> Lamp:
        """What the light shines at a place, times its weight."""
        power = self.power * self.weight
        if self.kind == "infinite":
            return Lamp(power * self.area_density, is_infinite=True)
        if self.kind == "point":
            values = mi.traverse(emitter)
            if "to_world" not in values:
                return Lamp(power, as_array(values["position"]).ravel().tolist())
            place = as_array(values["to_world"]).astype(np.float64).reshape(4, 4)
            forward = -place[:3, 2] if self.is_web else place[:3, 2]
            axis, cosine = forward / np.linalg.norm(forward), 1.0 - 0.5 / (np.pi * self.direction_density)
            even = 4.0 * np.pi * self.direction_density
            return Lamp(power, place[:3, 3].tolist(), 0.0, axis.tolist(), even, 0.0, cosine - 1e-4)
        shape = emitter.get_shape()
        low, high = corners_of(shape)
        centre, extent = (0.5 * (low + high)).tolist(), 0.5 * float(np.linalg.norm(high - low))
        if self.kind == "area" and plugin_name(shape) in ("rectangle", "disk"):
            normal = np.asarray(shape.sample_position(0.0, mi.Point2f(0.5, 0.5)).n, np.float64).ravel()
            return Lamp(power, centre, extent, normal.tolist(), 0.0, 4.0, 0.0)
        return Lamp(0.0 if self.kind == "beam" else power, centre, extent)


def _describe(emitter: mi.Emitter, bound: mi.BoundingSphere3f) -> _Row:
    flags = emitter.flags()
    name = emitter.id() or emitter.class_name()
    weight = emitter.sampling_weight()
    one_direction = mi.has_flag(flags, mi.EmitterFlags.DeltaDirection)
    if mi.has_flag(flags, mi.EmitterFlags.Infinite):
        disc = np.pi * float(np.asarray(bound.radius).ravel()[0]) ** 2
        d, irradiance = _shone(emitter, bound.center)
        power, is_sun = disc * float(irradiance.mean()), _is_sun(d, irradiance)
        return _Row(name, "infinite", power, weight, 1.0 / disc, is_delta=one_direction, is_sun=is_sun)
    if mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        projects, is_web = "irradiance" in mi.traverse(emitter), plugin_name(emitter) == "luminaire"
        power, density = _power(emitter), _cone_density(emitter)
        return _Row(name, "point", power, weight, 1.0, density, True, is_projector=projects, is_web=is_web)
    area = float(np.asarray(emitter.get_shape().surface_area()).ravel()[0])
    if not area > 0:
        raise SceneError(f"area emitter '{name}' is on a shape without area; remove it or repair the shape")
    if one_direction:
        return _Row(name, "beam", _power(emitter), weight, 1.0 / area, is_delta=True)
    exponent = float(np.asarray(emitter.exponent).ravel()[0]) if plugin_name(emitter) == "focusarea" else 0.0
    cells = measure(emitter) if has_cells(emitter) else None
    radiance = cells.mean if cells else _radiance(emitter)
    # Focus keeps the power and increases the radiance along the normal.
    power = np.pi * area * radiance / (0.5 * exponent + 1.0)
    sphere = _sphere(emitter.get_shape())
    return _Row(name, "area", power, weight, 1.0 / area, exponent=exponent, cells=cells, sphere=sphere)


def _sphere(shape: mi.Shape) -> tuple[float, float, float, float]:
    if plugin_name(shape) != "sphere":
        return 0.0, 0.0, 0.0, 0.0
    place = as_array(dict(contents(shape).values)["to_world"]).astype(np.float64).reshape(4, 4)
    x, y, z = place[:3, 3]
    return float(x), float(y), float(z), float(np.linalg.norm(place[:3, 0]))


def _power(emitter: mi.Emitter) -> float:
    """Emitted power, the mean weight of emitted rays, averaged over the colour channels."""
    u = _weyl(_POWER_SAMPLES)
    wavelengths = spread_wavelengths(_POWER_SAMPLES)
    _, weight = own_ray(emitter, mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3]), wavelengths)
    return float(np.asarray(weight, dtype=np.float64).mean())


def _shone(emitter: mi.Emitter, point: mi.Point3f) -> tuple[Array, Array]:
    """Directions in which a point sees an infinite emitter, (n, 3), and irradiances from there that have its mean,
    (n,), means over the colour channels."""
    at = dr.zeros(mi.Interaction3f, _POWER_SAMPLES)
    at.p, at.wavelengths = mi.Point3f(point), spread_wavelengths(_POWER_SAMPLES)
    ds, irradiance = emitter.sample_direction(at, mi.Point2f(*_weyl(_POWER_SAMPLES)[:2]))
    dr.eval(ds.d, irradiance)
    d, values = (np.stack([np.broadcast_to(x, _POWER_SAMPLES) for x in value], 1) for value in (ds.d, irradiance))
    return d, values.mean(axis=1, dtype=np.float64)


def _is_sun(d: Array, irradiance: Array) -> bool:
    """Whether much of the irradiance comes from one of the cells of a cube map."""
    d = np.nan_to_num(d)  # of a black sky
    largest = np.abs(d).max(axis=1, keepdims=True)
    cell = np.floor(d / np.maximum(largest, 1e-30) * (0.5 * _CUBE)).astype(np.int64) @ [1, 4 * _CUBE, 16 * _CUBE**2]
    _, cell = np.unique(cell, return_inverse=True)
    return bool(np.bincount(cell, irradiance).max() > _SUN * irradiance.sum())


def _radiance(emitter: mi.Emitter) -> float:
    """Radiance of a uniform area light along its normal, mean over the colour channels."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    si.wavelengths = spread_wavelengths(_WAVELENGTHS)
    return float(np.asarray(emitter.eval(si), dtype=np.float64).mean())


def _weyl(n: int) -> list[mi.Float]:
    """``n`` points of a four-dimensional Kronecker sequence."""
    i = np.arange(n) + 0.5
    return [on_device(mi.Float, np.mod(i * a, 1.0)) for a in (0.8566749, 0.7338919, 0.6287067, 0.5385973)]


def _cone_density(emitter: mi.Emitter) -> float:
    """Solid-angle density of directions uniform over the cone that holds the rays of a point-like emitter."""
    parameters = mi.traverse(emitter)
    if "cutoff_angle" in parameters:
        cosine = np.cos(np.deg2rad(float(np.asarray(parameters["cutoff_angle"]).ravel()[0])))
    elif "irradiance" in parameters:
        u = _weyl(_POWER_SAMPLES)
        ray, _ = own_ray(emitter, mi.Point2f(u[0], u[1]), mi.Point2f(u[2], u[3]), spread_wavelengths())
        axis = as_array(parameters["to_world"]).astype(np.float64).reshape(4, 4)[:3, 2]
        cosine = float((axis / np.linalg.norm(axis) @ np.asarray(ray.d, np.float64)).min())
    elif plugin_name(emitter) == "luminaire":
        cosine = emitter.table.least_cosine
    else:
        cosine = -1.0
    return float(1.0 / (2.0 * np.pi * max(1.0 - cosine, 1e-6)))
