"""View factors of points: what plane sensors, and spherical ones without a normal, see of patches, sky and ground.

A plane sensor weights directions by the cosine to its normal, so that its irradiance is E = sum F_j B_j, with the
radiosities B_j. A spherical one weights all directions alike; the same sum is then the mean irradiance of a small
sphere, a quarter of the fluence rate. Rays of these densities meet patch j with probability F_j. Those of a sensor are
nets of scrambled Sobol' points [Owen 1995], in independent replicates, whose variance gives the standard errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import (
    Array,
    copied_to_device,
    format_number,
    free_memory,
    is_whole,
    logger,
    short_repr,
    sparse,
    use_variant,
)
from etendue.lighting import Meters, compass
from etendue.points import OwenSobolSource
from etendue.surfaces import BATCH, Patches, RayScene

from .errors import RadiosityError, check_up
from .factors.groups import group_index, row_names
from .files.factorfiles import no_factors

if TYPE_CHECKING:
    import scipy.sparse

#: Rays of a point unless told, and at least; their independent replicates.
RAYS = 8192
_FEWEST, _REPLICATES = 128, 8
#: Rays of a point at most; and at first, if an error is to be reached. It falls with this power of their number.
MOST_RAYS = _REPLICATES * BATCH
_FIRST, _POWER = 1024, 0.75
#: Sky, backs of faces and ground: the columns that follow those of the patches.
_ENDS = 3
#: Points closer to a face than about this lie on it, in radii; least cosine of the normals of a sensor and its face.
_NEAR, _ALIKE = 4e-6, 0.99
#: Bytes of an entry, with those of its copies while factors are made of it; share of backs that is worth a warning.
_BYTES, _DARK = 40.0, 0.01


@short_repr
@dataclass(frozen=True)
class PointFactors:
    """F_kj, the share of what sensor k sees that is patch j, or group j.

    Of a plane sensor it is that of the hemisphere around its normal, weighted by the cosine; of a ``spherical`` one
    that of the whole sphere, 4 pi. The factors of a sensor and its shares of ``sky``, ``ground`` and ``dark`` sum to 1.

    ``meters``: the k sensors. ``names``: (m,) of patches, see :func:`row_names`, or of groups. ``rays``: of each
    sensor. ``hits``: (8 k, m + 3) CSR array of SciPy: rays of each replicate of each sensor that meet the patches, the
    sky, backs of faces, and the ground. ``irradiance``, ``irradiance_error``: (k, c), see :meth:`lit`.

    A patch that no ray has met has the factor and the error 0.
    """

    patches: Patches
    meters: Meters
    names: NDArray[np.str_]
    rays: int
    hits: scipy.sparse.csr_array
    irradiance: Array | None = None
    irradiance_error: Array | None = None

    def __len__(self) -> int:
        return len(self.meters)

    @property
    def matrix(self) -> scipy.sparse.csr_array:
        """(k, m) CSR array of SciPy: F."""
        return self._shares[0][:, : len(self.names)]

    @property
    def errors(self) -> scipy.sparse.csr_array:
        """(k, m) standard errors of the entries of ``matrix``, with the same structure."""
        return self._shares[1][:, : len(self.names)]

    @cached_property
    def ends(self) -> dict[str, Array]:
        """(k,) shares of the ``sky``, the ``ground`` and backs of faces and obstacles (``dark``), and their standard
        errors (``sky_error`` and so on)."""
        made, m = {}, len(self.names)
        for name, column in (("sky", m), ("ground", m + 2), ("dark", m + 1)):
            for suffix, of_all in zip(("", "_error"), self._shares, strict=True):
                made[name + suffix] = of_all[:, [column]].toarray()[:, 0]
        return made

    @property
    def sky(self) -> Array:
        """(k,) share of the sky."""
        return self.ends["sky"]

    @property
    def ground(self) -> Array:
        """(k,) share of what is outside of the scene downward."""
        return self.ends["ground"]

    @property
    def dark(self) -> Array:
        """(k,) share of backs of faces, and of obstacles."""
        return self.ends["dark"]

    def gather(self, values: ArrayLike, sky: ArrayLike = 0.0) -> Array:
        """F values: the mean over what each sensor sees, (k,) or (k, c), of values (m,) or (m, c); ``sky`` is the value
        of what is outside of the scene, sky and ground. Of radiosities it is the irradiance, see above."""
        return self._by_replicate(values, sky).mean(axis=1)

    def gather_error(self, values: ArrayLike, sky: ArrayLike = 0.0) -> Array:
        """The standard error of :meth:`gather`."""
        return self._by_replicate(values, sky).std(axis=1, ddof=1) / np.sqrt(_REPLICATES)

    def lit(self, radiosity: ArrayLike, sky: ArrayLike = 0.0) -> PointFactors:
        """The same with the ``irradiance`` by the radiosities (m, c) of the patches, and of the ``sky`` (c,), such as
        those of a :class:`Solution`."""
        radiosity = np.asarray(radiosity, dtype=np.float64)
        found = self.gather(radiosity, sky), self.gather_error(radiosity, sky)
        return replace(self, irradiance=found[0], irradiance_error=found[1])

    def of_groups(self, groups: ArrayLike | None = None) -> PointFactors:
        """Factors of groups of the patches, sums with errors of their own. groups: see :func:`group_index`."""
        names, group = group_index(no_factors(self.patches), groups)
        place = np.concatenate([group, len(names) + np.arange(_ENDS)])
        joins = sparse().csr_array((np.ones(len(place)), (np.arange(len(place)), place)))
        return replace(self, names=names, hits=self.hits @ joins)

    @property
    def largest_error(self) -> float:
        """The largest standard error of a factor, also of the sky, the ground and backs."""
        ends = (self.ends[f"{name}_error"].max() for name in ("sky", "ground", "dark"))
        return float(max(self.errors.max(), *ends))

    def summary(self) -> str:
        """One line: ``9 sensors see 12 % sky and 3 % ground; errors up to 0.0012, 8192 rays each``."""
        lit = self.irradiance
        light = "" if lit is None else f", irradiance {lit.min():.4g} to {lit.max():.4g} W/m^2"
        sky, ground = (format_number(100 * share.mean()) for share in (self.sky, self.ground))
        what = "sensor sees" if len(self) == 1 else "sensors see"
        seen = f"{len(self)} {what} {sky} % sky and {ground} % ground{light}"
        return f"{seen}; errors up to {self.largest_error:.2g}, {self.rays} rays each"

    def _by_replicate(self, values: ArrayLike, sky: ArrayLike) -> Array:
        """(k, 8) or (k, 8, c) means over what the rays of each replicate meet."""
        x = np.asarray(values, dtype=np.float64)
        if x.ndim not in (1, 2) or len(x) != len(self.names):
            raise RadiosityError(f"values have one row for each of {len(self.names)} patches, not shape {x.shape}")
        outside = np.broadcast_to(np.asarray(sky, dtype=np.float64), x.shape[1:])
        seen = np.concatenate([x, np.stack([outside, np.zeros_like(outside), outside])])
        means: Array = self.hits @ seen / (self.rays // _REPLICATES)
        return means.reshape(len(self), _REPLICATES, *x.shape[1:])

    @cached_property
    def _shares(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """(k, m + 3) shares of all that is met, and their standard errors."""
        rows = len(self) * _REPLICATES
        add = sparse().csr_array((np.ones(rows), np.arange(rows), np.arange(0, rows + 1, _REPLICATES)))
        shares, errors = (add @ hits for hits in (self.hits, self.hits * self.hits))
        for made in (shares, errors):
            made.sort_indices()
        # The variance of the mean, from the sums of the counts of replicates and of their squares.
        scatter = np.maximum(errors.data - shares.data**2 / _REPLICATES, 0.0)
        errors.data = np.sqrt(scatter * _REPLICATES / (_REPLICATES - 1)) / self.rays
        shares.data /= self.rays
        return shares, errors


def point_factors(
    patches: Patches,
    meters: Meters,
    *,
    up: str = "z",
    rays: int = RAYS,
    seed: int = 0,
    tell: Callable[[str], object] = lambda text: None,
) -> PointFactors:
    """View factors from sensors to patches, to the sky, and to the ground, which is what is outside of the scene
    downward.

    meters: of ``irradiance`` for plane sensors, or ``spherical``. A plane sensor may lie on a face, with its normal or
    the opposite one; rays start slightly above. up: the axis that is up, ``y`` or ``z``. rays: of each sensor, rounded
    up to 8 times a power of two. tell: receives the progress.

    Warns of sensors that see backs of faces. Raises :class:`RadiosityError` for other quantities and other numbers of
    rays, for spherical sensors and those with a slanted normal that lie on faces, and if the result does not fit into
    memory; :class:`etendue.lighting.LightingError` for another axis.
    """
    if meters.quantity not in ("irradiance", "spherical"):
        raise RadiosityError(
            f"view factors are of plane sensors (irradiance) or spherical ones, not of '{meters.quantity}' ones"
        )
    if not is_whole(rays) or not _FEWEST <= rays <= MOST_RAYS:
        raise RadiosityError(f"a sensor has {_FEWEST} to {MOST_RAYS} rays, not {rays!r}")
    check_up(patches, up)
    upward = compass(up)[2]
    use_variant()
    scene = RayScene(patches)
    each = 1 << (-(-rays // _REPLICATES) - 1).bit_length()
    cast = _Cast(scene, meters, upward, each, seed)
    rows, parts = _REPLICATES * len(meters), []
    step = max(BATCH // each, 1)
    for first in range(0, rows, step):
        tell(f"sensor {first // _REPLICATES + 1} of {len(meters)}")
        parts.append(cast.hits(first, min(step, rows - first)))
        if first == 0:
            _check_memory(parts[0].nnz * rows / parts[0].shape[0], len(meters))
    hits = sparse().vstack(parts, format="csr")
    found = PointFactors(patches, meters, row_names(no_factors(patches)), each * _REPLICATES, hits)
    _warn_of_backs(found)
    return found


def point_factors_to_error(
    patches: Patches,
    meters: Meters,
    error: float,
    *,
    groups: bool = False,
    rays: int = MOST_RAYS,
    **options: Any,
) -> PointFactors:
    """:func:`point_factors` with so many rays that no factor has a larger standard ``error``; at most ``rays``, and a
    warning if these do not reach it. groups: no factor of a group of patches. Raises :class:`RadiosityError` for an
    error that is not positive."""
    if not 0 < error < np.inf:
        raise RadiosityError(f"the error of a factor is a positive number, not {error!r}")
    count = min(_FIRST, rays)
    while True:
        found = point_factors(patches, meters, rays=count, **options)
        if (largest := (found.of_groups() if groups else found).largest_error) <= error:
            return found
        if found.rays >= rays:
            logger.warning(
                "errors of factors are up to %.2g after %d rays of each sensor, the most, and not %g: ask for a larger "
                "error, more rays, or groups",
                *(largest, found.rays, error),
            )
            return found
        count = min(int(found.rays * max((largest / error) ** (1 / _POWER), 2.0)), rays)


class _Cast:
    """Rays from sensors, in rows: the replicates of each, ``each`` rays in a row."""

    def __init__(self, scene: RayScene, meters: Meters, up: Array, each: int, seed: int) -> None:
        import mitsuba as mi

        self._scene, self._each, self._seed = scene, each, seed
        self._is_plane = meters.quantity == "irradiance"
        self._origins = copied_to_device(mi.Float, np.float32(_starts(scene, meters, self._is_plane)))
        self._normals = copied_to_device(mi.Float, np.float32(meters.directions))
        self._up = mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in up))
        self._sky = dr.opaque(mi.UInt32, len(scene.patches))

    def hits(self, first: int, rows: int) -> scipy.sparse.csr_array:
        """(rows, n + 3) what the rays of the rows from ``first`` on meet."""
        import mitsuba as mi

        lane, each = dr.arange(mi.UInt32, rows * self._each), dr.opaque(mi.UInt32, self._each)
        place = lane // each
        row = place + dr.opaque(mi.UInt32, first)
        u = mi.Point2f(OwenSobolSource(row, lane - place * each, self._seed, "point factors").next_2d(0, 0))
        sensor = row // _REPLICATES
        if self._is_plane:
            frame = mi.Frame3f(dr.gather(mi.Normal3f, self._normals, sensor))
            ways = frame.to_world(mi.warp.square_to_cosine_hemisphere(u))
        else:
            ways = mi.warp.square_to_uniform_sphere(u)
        met = self._scene.meets(dr.gather(mi.Point3f, self._origins, sensor), ways)
        met = dr.select((met == self._sky) & (dr.dot(ways, self._up) <= 0.0), self._sky + 2, met)
        seen = np.array(met).astype(np.int32)
        starts = np.arange(0, len(seen) + 1, self._each)
        shape = (rows, len(self._scene.patches) + _ENDS)
        found = sparse().csr_array((np.ones(len(seen)), seen, starts), shape=shape)
        found.sum_duplicates()
        return found


def _starts(scene: RayScene, meters: Meters, is_plane: bool) -> Array:
    """(k, 3) where rays start, in unit coordinates: the points, or slightly off the faces that plane sensors lie on.
    Faces are found by short rays along the axes. Raises :class:`RadiosityError`."""
    points = scene.local(meters.points)
    starts = points.copy()
    for way in np.concatenate([np.eye(3), -np.eye(3)]):
        found = scene.first_hits(points - _NEAR * way, np.broadcast_to(way, points.shape))
        near = found.distance <= 2 * _NEAR
        sensor, face = found.ray[near], found.face[near]
        cosine = np.abs((scene.patches.face_normals[face] * meters.directions[sensor]).sum(axis=1))
        if len(unclear := np.flatnonzero((cosine < _ALIKE) | (not is_plane))):
            k, number = sensor[unclear[0]], scene.patches.numbers[face[unclear[0]]]
            name = f" ('{meters.names[k]}')" if meters.names else ""
            why = "is slanted to it" if is_plane else "would see from one side of it only"
            raise RadiosityError(f"sensor {k}{name} at {_at(meters, k)} lies on face {number} and {why}: move it off")
        starts[sensor] = points[sensor] + 2 * _NEAR * meters.directions[sensor]
    return starts


def _check_memory(entries: float, sensors: int) -> None:
    need, free = _BYTES * entries, free_memory()
    if free is not None and need > free:
        raise RadiosityError(
            f"the factors of {sensors} sensors need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: take fewer "
            "sensors at once, or fewer rays"
        )


def _warn_of_backs(found: PointFactors) -> None:
    dark = np.flatnonzero(found.dark > _DARK)
    if len(dark):
        k = dark[np.argmax(found.dark[dark])]
        logger.warning(
            "%d of %d sensors see backs of faces or obstacles, most of all sensor %d at %s (%.3g of what it sees): it "
            "lies in a solid, faces are turned the wrong way, or there are obstacles",
            *(len(dark), len(found), k, _at(found.meters, k), found.dark[k]),
        )


def _at(meters: Meters, k: int) -> list[float]:
    """The place of a sensor, for messages."""
    return list(np.round(meters.points[k], 6).tolist())
