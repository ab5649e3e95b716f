"""Irradiance caching with gradients: irradiance is computed at few points and extrapolated from them.

A record at x_i with normal n_i estimates ``E(x, n) = E_i + (n_i cross n) . rotation_i + (x - x_i) . translation_i``
near x_i. With ``w_i = 1 / (|x - x_i| / R_i + sqrt(1 - n . n_i))``, a record is used where ``accuracy w_i`` is above 1,
with the weight ``accuracy w_i - 1``. R_i is the harmonic mean distance to the surfaces that the rays of the record hit
[Ward 1988; WardHeckbert 1992].
"""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, OptionError, copied_to_device
from etendue.density import HashGrid
from etendue.integration import Integrand
from etendue.scene import RenderSpace
from etendue.surfaces import Irradiance

#: Numbers of a record: position, normal, irradiance, two gradients of three channels, radius.
_WIDTH = 28
#: Largest distance of a record in front of a point, relative to the record's radius.
_IN_FRONT = 0.05
#: Offset of ray origins from the surface, relative to the least radius; and its least value relative to the largest
#: coordinate, because single precision rounds coordinates by a few 2^-24.
_LIFT, _STEPS = 1e-3, 2.0**-20
#: Distance assumed for rays that hit nothing, relative to the greatest radius.
_FAR = 1e12
#: Most records that a map adds at once, or half as many as it has, if that is more; and most rays of these.
_FIRST, _MOST_RAYS = 64, 1 << 20


class IrradianceCache:
    """Interpolation of irradiance between records.

    Parameters
    ----------
    accuracy: a, the allowed error; a smaller error needs more records. A record is used up to the distance a R_i.
    reach: least and greatest of these distances, in units of the scene.
    strata: rings and sectors of the hemisphere; a record casts one ray per stratum.
    gradients: extrapolate by the gradients; without, a record's irradiance is constant.
    """

    def __init__(
        self,
        reach: tuple[float, float],
        accuracy: float = 0.2,
        strata: tuple[int, int] = (16, 48),
        gradients: bool = True,
    ) -> None:
        if not 0 < reach[0] <= reach[1] < math.inf or not 0 < accuracy < math.inf:
            raise OptionError(f"reach {reach} and accuracy {accuracy} of an irradiance cache must be above zero")
        if min(strata) < 2:
            raise OptionError(f"a hemisphere has 2 rings and 2 sectors at least, not {strata}")
        self.accuracy, self.reach, self.strata, self.gradients = accuracy, reach, strata, gradients
        self.records: Array = np.empty((0, _WIDTH))
        self._levels: tuple[Array, list[_Level]] = self.records, []

    def __len__(self) -> int:
        return len(self.records)

    @property
    def rays(self) -> int:
        """Rays that were cast for the records."""
        return len(self) * self.strata[0] * self.strata[1]

    def compute(
        self,
        incident: Integrand,
        distance: Integrand,
        position: Array,
        normal: Array,
        seed: int,
        space: RenderSpace | None = None,
        scale: Array | float = 1.0,
    ) -> None:
        """Compute and add records at points, all in one launch.

        incident, distance: functions of rays (see :class:`TransportFunctions`): radiance along the ray towards its
        origin, and length of the ray, both in ``space``, by default the scene's own coordinates. position, normal:
        (n, 3), in the scene's coordinates. scale: factors (n,) on the ``reach`` at the points.
        """
        directions = stratified_hemispheres(normal, self.strata, seed)
        shape = directions.shape[:3]
        space = space or RenderSpace()
        local = space.from_scene(position)
        lift = np.maximum(_LIFT * self.reach[0] * space.scale, _STEPS * np.abs(local).max(axis=1, keepdims=True))
        origins = np.broadcast_to((local + lift * normal)[:, None, None], directions.shape)
        rays = [_column(part[..., axis]) for part in (origins, directions) for axis in range(3)]
        way = np.array(distance.evaluate(rays), dtype=np.float64).reshape(shape) / space.scale
        way = np.where(np.isfinite(way), np.maximum(way, _LIFT * self.reach[0]), _FAR * self.reach[1])
        radiance = np.stack([np.array(v, dtype=np.float64) for v in incident.parts(incident.evaluate(rays))], axis=-1)
        self.add(position, normal, np.broadcast_to(radiance, (len(radiance), 3)).reshape(*shape, 3), way, scale)

    def add(self, position: Array, normal: Array, radiance: Array, distance: Array, scale: Array | float = 1.0) -> None:
        """Add records at points (n, 3), from incident radiance (n, rings, sectors, 3) and distances (n, rings,
        sectors). scale: see :meth:`compute`."""
        irradiance, rotation, translation = irradiance_gradients(radiance, distance, normal)
        harmonic = 1 / (1 / distance).mean(axis=(1, 2))
        # The radius is smaller where the extrapolated irradiance would become zero within the mean distance.
        slope = np.linalg.norm(translation.mean(axis=1), axis=1) / np.maximum(irradiance.mean(axis=1), 1e-30)
        wanted = np.minimum(harmonic, 1 / np.maximum(slope, 1e-30)) * self.accuracy
        reach = np.clip(wanted, *(bound * np.asarray(scale) for bound in self.reach))
        # A gradient is reduced where the least radius is larger than the wanted one.
        translation *= np.minimum(wanted / reach, 1.0)[:, None, None]
        columns = (position, normal, irradiance, rotation, translation, reach)
        self.records = np.concatenate([self.records, np.concatenate([c.reshape(len(reach), -1) for c in columns], 1)])

    def __call__(self, position: Array, normal: Array) -> tuple[Array, Array]:
        """(irradiance (m, 3) at points (m, 3), sum of the weights of the records (m,)); the sum is 0 where no record is
        used."""
        if not len(self) or not len(position):
            return np.zeros((len(position), 3)), np.zeros(len(position))
        if self._levels[0] is not self.records:
            # Single precision near the records, which may be few and far from the origin.
            self._centre = self.records[:, :3].mean(axis=0)
            octave = np.floor(np.log2(self.records[:, -1]))
            self._levels = self.records, [_Level(self.records[octave == k], self._centre) for k in np.unique(octave)]
        lanes = _two(len(position))
        p, n = (mi.Vector3f(*(_column(x[lanes, axis]) for axis in range(3))) for x in (position - self._centre, normal))
        total, weight = dr.zeros(mi.Vector3f, len(lanes)), dr.zeros(mi.Float, len(lanes))
        for level in self._levels[1]:
            total, weight = level.add_to(total, weight, p, n, self.accuracy, self.gradients)
            dr.eval(total, weight)  # so that all levels share a kernel
        values = total / dr.maximum(weight, 1e-20)
        dr.eval(values, weight)
        # By columns: together they would be copied by a kernel for each number of points.
        columns = [np.array(v, dtype=np.float64)[: len(position)] for v in (*values, weight)]
        return np.stack(columns[:3], axis=1), columns[3]


class _Level:
    """Records (n, 28) of similar reach in a grid, relative to ``centre``."""

    def __init__(self, records: Array, centre: Array) -> None:
        rows = records.astype(np.float64)
        rows[:, :3] -= centre
        self._radius = float(rows[:, -1].max()) * (1 + 1e-6)
        lanes = _two(len(rows))
        points = mi.Point3f(*(_column(rows[lanes, axis]) for axis in range(3)))
        there = copied_to_device(mi.UInt32, (np.arange(len(lanes)) < len(rows)).astype(np.uint32)) != 0
        self._grid = HashGrid(points, self._radius, rows[:, :3].min(axis=0), rows[:, :3].max(axis=0), there)
        order = np.empty(len(rows), np.int64)
        order[np.array(self._grid.destination)[: len(rows)]] = np.arange(len(rows))
        self._table = _column(rows[order])

    def add_to(
        self, total: mi.Vector3f, weight: mi.Float, p: mi.Vector3f, n: mi.Vector3f, accuracy: float, gradients: bool
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Sums of weighted irradiance and of weights at points, with those of the records added."""
        table, inverse = self._table, dr.opaque(mi.Float, 1 / accuracy)

        def vector(i: mi.UInt32, k: int) -> mi.Vector3f:
            return mi.Vector3f(*(dr.gather(mi.Float, table, i * _WIDTH + k + axis) for axis in range(3)))

        def visit(i: mi.UInt32, sums: tuple[mi.Vector3f, mi.Float]) -> tuple[mi.Vector3f, mi.Float]:
            offset, other, reach = p - vector(i, 0), vector(i, 3), dr.gather(mi.Float, table, i * _WIDTH + 27)
            # Inverse weight, relative to the accuracy: a record is used below 1.
            far = dr.norm(offset) / reach + dr.sqrt(dr.maximum(1 - dr.dot(n, other), 0)) * inverse
            # A record in front of a point does not contain the light from surfaces between the two.
            used = (far < 1) & (dr.dot(offset, n + other) > -2 * _IN_FRONT * reach)
            value = vector(i, 6)
            if gradients:
                turn = dr.cross(other, n)
                value += mi.Vector3f(*(dr.dot(turn, vector(i, k)) for k in (9, 12, 15)))
                value += mi.Vector3f(*(dr.dot(offset, vector(i, k)) for k in (18, 21, 24)))
            # The weight is zero where the record ends, so that the irradiance is continuous there.
            w = dr.select(used, dr.rcp(dr.maximum(far, 1e-4)) - 1, 0)
            return sums[0] + w * dr.maximum(value, 0), sums[1] + w

        def read(i: mi.UInt32) -> tuple[mi.Point3f, mi.Bool]:
            return mi.Point3f(vector(i, 0)), mi.Bool(True)

        return self._grid.within(mi.Point3f(p), read, visit, (total, weight), mi.Bool(True))


class CacheMap:
    """A cache as a map of irradiance; records are added where paths need them.

    Parameters
    ----------
    cache: its records may be those of earlier pictures; they are in the scene's own coordinates.
    incident, distance: as for :meth:`IrradianceCache.compute`, of all light that the map is to have.
    space: that of the loaded scene, in which ``incident`` and ``distance`` take rays.
    scale: factor on the reach of a record at a point of ``space``.
    """

    kind = "cache"

    def __init__(
        self,
        cache: IrradianceCache,
        incident: Integrand,
        distance: Integrand,
        space: RenderSpace | None = None,
        scale: Callable[[mi.Point3f], mi.Float] | None = None,
    ) -> None:
        self.cache, self.space = cache, space or RenderSpace()
        self._light, self._scale = (incident, distance), scale

    def irradiance(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> Irradiance:
        """See :class:`etendue.surfaces.SurfaceMap`; the standard error of a record is not known."""
        count = max(dr.width(p), dr.width(n), dr.width(active))
        lanes = np.flatnonzero(np.broadcast_to(np.array(active & dr.full(mi.Bool, True, count)), (count,)))
        position, normal = (
            np.broadcast_to(np.array(x, dtype=np.float64).reshape(3, -1), (3, count)).T[lanes] for x in (p, n)
        )
        if self._scale is None:
            scale = np.ones(len(lanes))
        else:
            scale = np.broadcast_to(np.array(self._scale(p), dtype=np.float64), (count,))[lanes]
        position = self.space.to_scene(position)
        found, weight = self.cache(position, normal)
        before, missing = len(self.cache), np.flatnonzero(weight == 0)
        while len(missing):
            # From coarse to fine: records between the first ones are needed less often.
            most = min(max(_FIRST, len(self.cache) // 2), max(_MOST_RAYS // math.prod(self.cache.strata), 1))
            chosen = missing[:: -(-len(missing) // most)]
            at = position[chosen], normal[chosen]
            self.cache.compute(*self._light, *at, len(self.cache), self.space, scale[chosen])
            _, weight = self.cache(position[missing], normal[missing])
            # A record is valid at its own point; a point where even its own record is not used is given up.
            missing = np.setdiff1d(missing[weight == 0], chosen)
        if len(self.cache) > before:
            found, weight = self.cache(position, normal)  # all points by the same records
        rows = np.zeros((count, 3), np.float32)
        rows[lanes] = found
        value = mi.Spectrum(*(_column(column) for column in rows.T))
        known = np.zeros(count, bool)
        known[lanes] = weight > 0
        return Irradiance(value, mi.Spectrum(dr.nan), mi.Bool(known))


def stratified_hemispheres(normal: Array, strata: tuple[int, int], seed: int) -> Array:
    """A cosine-distributed direction in each of (rings, sectors) strata around normals (n, 3): (n, rings, sectors,
    3)."""
    rings, sectors = strata
    u = np.random.default_rng(seed).random((2, len(normal), rings, sectors))
    sine = np.sqrt((np.arange(rings)[:, None] + u[0]) / rings)
    azimuth = 2 * math.pi * (np.arange(sectors) + u[1]) / sectors
    parts = sine * np.cos(azimuth), sine * np.sin(azimuth), np.sqrt(1 - sine**2)
    axes = (*_tangents(normal), normal)
    found: Array = sum(p[..., None] * a[:, None, None, :] for p, a in zip(parts, axes, strict=True))
    return found


def irradiance_gradients(radiance: Array, distance: Array, normal: Array) -> tuple[Array, Array, Array]:
    """Irradiance (n, 3) and its rotation and translation gradients, (n, 3 channels, 3 axes) [WardHeckbert 1992].

    radiance: (n, rings, sectors, 3), along directions of :func:`stratified_hemispheres`; distance: (n, rings, sectors).
    """
    rings, sectors = distance.shape[1:]
    tangent, bitangent = _tangents(normal)

    def along(azimuth: Array) -> Array:
        """Tangent vectors of azimuths: (n, sectors, 3)."""
        vectors: Array = np.cos(azimuth)[:, None] * tangent[:, None] + np.sin(azimuth)[:, None] * bitangent[:, None]
        return vectors

    edge = 2 * math.pi * np.arange(sectors) / sectors
    centre = edge + math.pi / sectors
    irradiance = radiance.mean(axis=(1, 2)) * math.pi
    # Derivative of cos t by the rotation of the normal, over cos t, is tan t.
    tilt = np.tan(np.arcsin(np.sqrt((np.arange(rings) + 0.5) / rings)))
    leaning = np.einsum("j,njkc->nkc", tilt, radiance) * (math.pi / (rings * sectors))
    rotation = np.einsum("nkc,nka->nca", leaning, along(centre + math.pi / 2))
    # A translation moves the borders between strata, at a rate given by the nearer of the two surfaces.
    sine = np.sqrt(np.arange(rings + 1) / rings)
    between_rings = (radiance[:, 1:] - radiance[:, :-1]) / np.minimum(distance[:, 1:], distance[:, :-1])[..., None]
    shifted = sine[1:-1] * (1 - sine[1:-1] ** 2) * (2 * math.pi / sectors)
    translation = np.einsum("j,njkc,nka->nca", shifted, between_rings, along(centre), optimize=True)
    before, way = np.roll(radiance, 1, axis=2), np.roll(distance, 1, axis=2)
    between_sectors = (radiance - before) / np.minimum(distance, way)[..., None]
    translation += np.einsum(
        "j,njkc,nka->nca", np.diff(sine), between_sectors, along(edge + math.pi / 2), optimize=True
    )
    return irradiance, rotation, translation


def _tangents(normal: Array) -> tuple[Array, Array]:
    helper = np.where(np.abs(normal[:, :1]) > 0.7, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    tangent = np.cross(helper, normal)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return tangent, np.cross(normal, tangent)


def _two(count: int) -> NDArray[np.int64]:
    """Indices of rows, of a single one twice: a kernel for one lane would be another one."""
    return np.arange(max(count, 2)) % count


def _column(values: Array) -> mi.Float:
    return copied_to_device(mi.Float, np.asarray(values, dtype=np.float32))
