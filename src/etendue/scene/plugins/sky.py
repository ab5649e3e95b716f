"""Emitter ``sky``: a CIE general sky or the all-weather sky of Perez, with the sun and the ground.

Its radiance is the luminance of :class:`etendue.lighting.Sky` over 683 lm/W, evaluated by the equation, so that the
horizon and the edge of the sun are sharp. The z axis is up, as in Mitsuba's ``sunsky``, y north and x east;
``to_world`` turns it (a rotation by -90 degrees about x makes y the vertical axis and -z north).

Parameters: ``kind``, 1 to 15 or 16 (traditional overcast), or ``perez``; the sun by ``sun_direction``, or by
``latitude``, ``longitude`` (degrees north and east) and ``time`` with its zone ("2024-06-21T12:00+02:00"). A CIE sky
has ``zenith_luminance`` (cd/m^2) or ``diffuse_illuminance`` (lux), and ``sun_illuminance`` (0), normal to the rays, in
lux; Perez's ``direct_normal`` and ``diffuse_horizontal`` in W/m^2 and ``dew_point`` (11 degrees C).
``ground_reflectance`` (0.2); ``sun`` (true): whether the sun shines, also on the ground; ``color`` (white): factor on
all radiance, of luminance 1; ``sampling_weight`` as in every emitter.

Sampling: sky, ground and sun are chosen by the integrals of their luminance over directions. Directions of the sky have
a density that is bilinear in azimuth and height, tabulated from the luminance; of the ground, a uniform one; of the
sun, one that is uniform over its projected disc. Densities are those of the mixture. Rays start on the disc of a sphere
around the scene that is perpendicular to them, uniformly: ``center`` and ``radius``, since Mitsuba tells a Python
plugin nothing of the scene. Only Mitsuba's own ``ptracer`` needs them: étendue sets them when it loads a scene, and its
methods have discs of their own.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import OptionError, is_number
from etendue.lighting import EFFICACY, GROUND, SUN_DIAMETER, Sky, cie_sky, day_of_year, perez_sky, sun_direction

from ..packet import is_spectral
from .parameters import block

#: Azimuths and heights of the table of the sky's luminance, and its least value, as a share of the largest.
_COLUMNS, _ROWS, _LEAST = 128, 64, 1e-4
#: Sine of the sun's radius.
_SUN_SINE = float(np.sin(np.deg2rad(0.5 * SUN_DIAMETER)))
#: Distance of the sky from every point: Mitsuba tells a Python plugin nothing of the scene.
_FAR = 1e8
#: Values of a sky: a, b, t; c, d, e, h; least cosine; luminances of phi f = 1, of the sun's disc and of the ground.
_VALUES = 11


def sky_of(props: mi.Properties) -> Sky:
    """The sky that the parameters of the plugin describe. Raises :class:`OptionError`, one line each."""
    given = _given(props)
    kind = given.pop("kind", None)
    if kind is None:
        raise OptionError("'sky' has no 'kind'; give 1 to 15 for a CIE sky, or perez")
    sun, day = _sun(given)
    shines = given.pop("sun", True)
    if not isinstance(shines, bool):
        raise OptionError(f"'sky': 'sun' is true or false, not {shines!r}")
    ground = _number(given, "ground_reflectance", GROUND)
    if str(kind) == "perez":
        if sun is None:
            raise OptionError("a Perez 'sky' needs 'sun_direction', or 'latitude', 'longitude' and 'time'; give them")
        direct, diffuse = _number(given, "direct_normal"), _number(given, "diffuse_horizontal")
        sky = perez_sky(sun, direct, diffuse, day=day, dew_point=_number(given, "dew_point", 11.0), ground=ground)
    else:
        if not (is_number(kind) or str(kind).isdigit()) or int(kind) != float(kind):
            raise OptionError(f"'sky': 'kind' is {kind!r}; give 1 to 15 for a CIE sky, or perez")
        values = {key: _number(given, key) for key in ("zenith_luminance", "diffuse_illuminance") if key in given}
        lux = _number(given, "sun_illuminance", 0.0)
        sky = cie_sky(int(kind), sun, sun_illuminance=lux, ground=ground, **values)
    if given:
        raise OptionError(f"a 'sky' of kind {kind} has no parameter '{min(given)}'; remove it")
    if not shines:
        sky = Sky(sky.gradation, sky.indicatrix, sky.scale, sky.sun, 0.0, sky.ground)
    if not sky.illuminance > 0.0:
        raise OptionError("'sky' gives no light; give it a luminance or an illuminance above 0")
    return sky


def _given(props: mi.Properties) -> dict[str, Any]:
    """The plugin's own parameters; reading marks them as used."""
    others = ("color", "to_world", "sampling_weight", "center", "radius")
    return {str(key): props[key] for key in props.keys() if key not in others}  # noqa: SIM118


def _number(given: dict[str, Any], key: str, default: float | None = None) -> float:
    if key not in given and default is None:
        raise OptionError(f"this kind of 'sky' needs '{key}'; give a number")
    value = given.pop(key, default)
    if not is_number(value):
        raise OptionError(f"'sky': '{key}' is {value!r}; give a number")
    return float(value)


def _sun(given: dict[str, Any]) -> tuple[list[float] | None, float | None]:
    """The vector towards the sun, and the day of the year; None where they are not given."""
    place = [key for key in ("latitude", "longitude", "time") if key in given]
    if "sun_direction" in given:
        if place:
            raise OptionError(f"'sky' has both 'sun_direction' and '{place[0]}'; remove one of them")
        return [float(x) for x in np.asarray(given.pop("sun_direction")).ravel()], None
    if not place:
        return None, None
    if len(place) < 3:
        raise OptionError(f"'sky' has '{place[0]}'; give 'latitude', 'longitude' and 'time' together")
    time = str(given.pop("time"))
    towards = sun_direction(_number(given, "latitude"), _number(given, "longitude"), time)[0].tolist()
    return towards, float(day_of_year(time)[0])


def _sphere(props: mi.Properties) -> tuple[list[float], float]:
    """Centre and radius of the sphere that rays start from; radius 0 if it is not given."""
    radius, center = props.get("radius", None), props.get("center", None)
    if radius is not None and not (is_number(radius) and radius > 0.0):
        raise OptionError(f"'sky': 'radius' is {radius!r}; give that of a sphere around the scene, above 0")
    try:
        point = np.zeros(3) if center is None else np.asarray(center, np.float64).ravel()
    except ValueError:
        point = np.zeros(0)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise OptionError(f"'sky': 'center' is {center!r}; give a point")
    return point.tolist(), 0.0 if radius is None else float(radius)


def make_sky() -> type:
    """The emitter class for the current variant."""

    class SkyEmitter(mi.Emitter):
        """A sky, its sun and the ground."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "sky"
            self.color = props.get_emissive_texture("color", 1.0)
            if self.color.is_spatially_varying():
                raise OptionError("'sky': 'color' varies over a surface; give one colour")
            sky = sky_of(props)
            self.m_flags = +mi.EmitterFlags.Infinite
            self.to_world = self.world_transform()
            values = (*sky.gradation, *sky.indicatrix, sky.least_cosine)
            luminances = (sky.scale, sky.sun_luminance, sky.ground_luminance)
            self.values = mi.Float([*values, *luminances])
            self.sun_direction = mi.Vector3f(*sky.sun)
            self._place_rays(*_sphere(props))
            self._make_table()

        def surround(self, box: mi.ScalarBoundingBox3f) -> None:
            """Let rays start from the sphere around a scene of this box."""
            sphere = box.bounding_sphere()
            self._place_rays([float(x) for x in np.asarray(sphere.center).ravel()], float(sphere.radius))

        def _place_rays(self, center: list[float], radius: float) -> None:
            self._emits = radius > 0.0
            self._center, self._radius = mi.Point3f(*center), mi.Float(radius)
            dr.make_opaque(self._center, self._radius)

        def _make_table(self) -> None:
            """What next event samples; from the values, which a user may have changed."""
            values = np.asarray(self.values, np.float64)
            if values.shape != (_VALUES,) or not np.isfinite(values).all() or (values[8:] < 0.0).any():
                raise OptionError(f"'sky': 'values' are {_VALUES} finite numbers, luminances at least 0")
            dr.make_opaque(self.values, self.sun_direction, self.to_world)
            a, b, t, c, d, e, h = values[:7].tolist()
            x, y, z = (float(v) for v in np.asarray(self.sun_direction).ravel())
            sky = Sky((a, b, t), (c, d, e, h), float(values[8]), (x, y, z))
            height, azimuth = np.linspace(1e-6, 1.0, _ROWS), np.linspace(0.0, 2.0 * np.pi, _COLUMNS)
            across = np.sqrt(1.0 - height**2)[:, None]
            grid = np.broadcast_arrays(across * np.cos(azimuth), across * np.sin(azimuth), height[:, None])
            table = sky.luminance(np.stack(grid, axis=-1).reshape(-1, 3)).reshape(_ROWS, _COLUMNS)
            table = np.maximum(table, _LEAST * table.max() if table.max() > 0.0 else 1.0)
            self._table = mi.MarginalContinuous2D0(np.ascontiguousarray(table, np.float32))
            power = np.array([table.mean() if values[8] > 0.0 else 0.0, values[10], 0.5 * values[9] * _SUN_SINE**2])
            #: Probabilities of sky, ground and sun, by the integrals of their luminance.
            share = power / power.sum() if power.sum() > 0.0 else np.array([1.0, 0.0, 0.0])
            self._share = mi.Float(share.tolist())
            dr.make_opaque(self._share)

        def _value(self, number: int) -> mi.Float:
            return dr.gather(mi.Float, self.values, number)

        def _towards_sun(self, d: mi.Vector3f) -> tuple[mi.Float, mi.Float, mi.Bool]:
            """Angle between a local direction and the sun, its cosine, and whether the direction is in the sun's disc,
            also below the horizon. By the sine, too: the cosine of a small angle is rounded."""
            cos, sine = dr.dot(d, self.sun_direction), dr.norm(dr.cross(d, self.sun_direction))
            return dr.atan2(sine, cos), cos, (sine < _SUN_SINE) & (cos > 0.0)

        def _luminance(self, d: mi.Vector3f) -> mi.Float:
            """That of a local direction (see :mod:`etendue.lighting.skies`)."""
            a, b, t, c, e, f, h, least, scale, disc, ground = (self._value(k) for k in range(_VALUES))
            angle, cos, in_sun = self._towards_sun(d)
            cos_zenith = dr.maximum(d.z, least)
            gradation = 1.0 + a * dr.exp(b / cos_zenith) + t * cos_zenith
            indicatrix = 1.0 + c * (dr.exp(e * angle) - h) + f * dr.square(cos)
            sky = scale * dr.maximum(gradation * indicatrix, 0.0) + dr.select(in_sun, disc, 0.0)
            return dr.select(d.z > 0.0, sky, ground)

        def _density(self, d: mi.Vector3f) -> mi.Float:
            """Of sampled local directions, per solid angle."""
            sky, ground, sun = (dr.gather(mi.Float, self._share, k) for k in range(3))
            turn = dr.atan2(d.y, d.x) * dr.inv_two_pi
            place = mi.Point2f(turn - dr.floor(turn), dr.clip(d.z, 0.0, 1.0))
            _, cos, in_sun = self._towards_sun(d)
            half = dr.select(d.z > 0.0, sky * self._table.eval(place), ground) * dr.inv_two_pi
            return half + dr.select(in_sun, sun * cos / (dr.pi * _SUN_SINE**2), 0.0)

        def _direction(self, u: mi.Point2f, active: mi.Bool | bool) -> mi.Vector3f:
            """A local direction with that density."""
            sky, ground, sun = (dr.gather(mi.Float, self._share, k) for k in range(3))
            is_sky, is_sun = u.x < sky, u.x >= sky + ground
            low = dr.select(is_sky, 0.0, dr.select(is_sun, sky + ground, sky))
            width = dr.select(is_sky, sky, dr.select(is_sun, sun, ground))
            v = mi.Point2f(dr.clip((u.x - low) / dr.maximum(width, 1e-10), 0.0, dr.one_minus_epsilon(mi.Float)), u.y)
            place, _ = self._table.sample(v, active=active)
            lower = -dr.maximum(v.x, 1e-7)
            z = dr.select(is_sky, place.y, lower)
            sin, cos = dr.sincos(dr.two_pi * dr.select(is_sky, place.x, v.y))
            across = dr.safe_sqrt(1.0 - dr.square(z))
            disc = _SUN_SINE * mi.warp.square_to_uniform_disk_concentric(v)
            in_disc = mi.Vector3f(disc.x, disc.y, dr.safe_sqrt(1.0 - dr.squared_norm(disc)))
            towards = mi.Frame3f(self.sun_direction).to_world(in_disc)
            return dr.normalize(dr.select(is_sun, towards, mi.Vector3f(across * cos, across * sin, z)))

        def _radiance(self, d: mi.Vector3f, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> mi.Spectrum:
            return self.color.eval(si, active) * (self._luminance(d) / EFFICACY)

        def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Spectrum:
            return self._radiance(self.to_world.inverse() @ -si.wi, si, active)

        def sample_ray(
            self,
            time: mi.Float,
            sample1: mi.Float,
            sample2: mi.Point2f,
            sample3: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            if not self._emits:
                raise OptionError(
                    "'sky' does not know the scene around which its rays start; give 'center' and 'radius' of a sphere "
                    "around it, or load it by étendue"
                )
            wavelengths, color = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            local = self._direction(sample3, active)
            d, pdf = -(self.to_world @ local), self._density(local)
            disc = mi.warp.square_to_uniform_disk_concentric(sample2)
            across = mi.Frame3f(d).to_world(mi.Vector3f(disc.x, disc.y, 0.0))
            ray = mi.Ray3f(self._center + (across - d) * self._radius, d, time, wavelengths)
            area = dr.pi * dr.square(self._radius)
            lit = mi.Bool(active) & (pdf > 0.0)
            return ray, color * dr.select(lit, self._luminance(local) / EFFICACY * area / pdf, 0.0)

        def sample_position(
            self, time: mi.Float, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.PositionSample3f, mi.Float]:
            """Undefined, as in Mitsuba's own skies: it is traced for emitters with a place, but never used."""
            return dr.zeros(mi.PositionSample3f), mi.Float(dr.nan)

        def sample_direction(
            self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            local = self._direction(sample, active)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.d = self.to_world @ local
            ds.dist = mi.Float(_FAR)
            ds.p, ds.n, ds.time = it.p + ds.d * ds.dist, -ds.d, it.time
            ds.uv, ds.delta = mi.Point2f(0.0), mi.Bool(False)
            ds.pdf = dr.select(active, self._density(local), 0.0)
            ds.emitter = mi.EmitterPtr(self)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = it.wavelengths
            return ds, dr.select(ds.pdf > 0.0, self._radiance(local, si, active) / ds.pdf, 0.0)

        def pdf_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Float:
            return dr.select(active, self._density(self.to_world.inverse() @ ds.d), 0.0)

        def eval_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Spectrum:
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = it.wavelengths
            return self._radiance(self.to_world.inverse() @ ds.d, si, active)

        def sample_wavelengths(
            self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool | bool = True
        ) -> tuple[Any, mi.Spectrum]:
            """Wavelengths, and the colour over their density."""
            if is_spectral():
                return self.color.sample_spectrum(si, mi.sample_shifted(sample), active)
            return dr.zeros(mi.Color0f), self.color.eval(si, active)

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback: mi.TraversalCallback) -> None:
            super().traverse(callback)
            fixed = mi.ParamFlags.NonDifferentiable
            callback.put("color", self.color, mi.ParamFlags.Differentiable)
            callback.put("values", self.values, fixed)
            callback.put("sun_direction", self.sun_direction, fixed)
            callback.put("to_world", self.to_world, fixed)

        def parameters_changed(self, keys: list[str]) -> None:
            self._make_table()
            super().parameters_changed(keys)

        def to_string(self) -> str:
            return block("sky", color=self.color, values=self.values, sun_direction=self.sun_direction)

    return SkyEmitter
