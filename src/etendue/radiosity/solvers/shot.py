"""First shot: the direct light of small emitters, sent by local rays, since few global lines meet a small lamp.

:func:`first_shot` sends rays from the emitters by the cosine law. :func:`shot_at_patches` aims most rays: from points
on the emitters, sampled by power, to uniform points on each patch, the same number for each patch. If m rays are aimed
at a patch of area A, each carries Phi A K / m, with K = cos cos' / (pi r^2). Where A K is small, this power is nearly
the same for all rays; near a lamp K is unbounded. Pairs of points with A K above a limit are therefore sampled by
cosine-distributed rays, each of which carries Phi / N. Each pair is sampled in one of the two ways, so no light counts
twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, seed_key, short_repr
from etendue.points import Independent, OwenSobol, PointSet
from etendue.surfaces import BATCH, Patches, Places, RayScene, RaySource, Sides, cosine_lanes, pairs_of

from ..errors import RadiosityError
from ..factors.covered import covered_lamps
from ..lines.local import Emission
from ..lines.segments import scatter

#: Number of parts of given points, whose variance gives the error.
_PARTS = 16
#: Number of independent point sequences of :class:`Shot`, whose variance gives the error.
SEQUENCES = 4
#: Smallest number of rays of a block of :class:`Shot`, and number of aimed rays per cosine-distributed ray.
_BLOCK, _AIMED = 1 << 14, 8
#: Limit of A K, the share of the light that a patch would receive if the whole patch were as close to the lamp as the
#: point. Above this limit cosine-distributed rays are better.
_NEAR = 0.3
#: Emitters are shot if this removes at least this share of the variance of direct light.
_MOST = 0.5


@short_repr
@dataclass(frozen=True)
class FirstShot:
    """Light of emitters, sent once by local lines.

    ``emission``: (n, c) emission that was sent, zero for other patches, and for lamps that are no patches.
    ``irradiance``, ``error``: (n, c) irradiance of each patch by this light, and its standard error (infinite for a
    single ray). Power (c,): ``to_sky``, and ``lost`` to backs of faces; together with the power that patches receive it
    is the power that was ``sent``. ``rays``: number of rays.
    """

    patches: Patches
    emission: Array
    irradiance: Array
    error: Array
    to_sky: Array
    lost: Array
    rays: int

    def __add__(self, other: FirstShot) -> FirstShot:
        """Two shots of the same patches, of different emitters, with independent errors."""
        sums = {
            name: getattr(self, name) + getattr(other, name)
            for name in ("emission", "irradiance", "to_sky", "lost", "rays")
        }
        return FirstShot(self.patches, error=np.hypot(self.error, other.error), **sums)

    @property
    def relative_error(self) -> float:
        """Standard error of the irradiance, mean over the surface, relative to the mean irradiance."""
        areas = self.patches.areas[:, None]
        return float((areas * self.error).sum() / max((areas * self.irradiance).sum(), 1e-300))

    @property
    def sent(self) -> Array:
        """(c,) power of this light."""
        return (self.patches.areas[:, None] * self.irradiance).sum(axis=0) + self.to_sky + self.lost

    @property
    def reflected(self) -> Array:
        """(n, c) reflected power of this light."""
        return self.patches.areas[:, None] * self.patches.reflectance * self.irradiance

    @property
    def absorbed(self) -> Array:
        """(c,) power of this light that patches and backs of faces absorb."""
        areas = self.patches.areas[:, None]
        return (areas * (1 - self.patches.reflectance) * self.irradiance).sum(axis=0) + self.lost


def first_shot(scene: RayScene, u: Array, emitters: NDArray[np.bool_] | None = None) -> FirstShot:
    """Send the emission of all patches, or of the ``emitters`` (n,), by rays of cosine density, one for each point
    ``u`` (N, 4), equal in power.

    The error is estimated from the variance of 16 parts of the points. For parts of one sequence it is an upper
    estimate. Raises :class:`RadiosityError` if no patch emits.
    """
    emission = _emission(scene.patches, emitters)
    source = Emission(scene, scene.patches.areas[:, None] * emission)
    parts = np.array_split(np.asarray(u, dtype=np.float64), min(_PARTS, len(u)))
    mean = np.zeros((len(scene.patches) + 2, scene.patches.channels))
    squares, error = np.zeros_like(mean), np.full_like(mean, np.inf)
    for part in parts:
        found = source.received(part)
        mean += len(part) / len(u) * found
        squares += len(part) / len(u) * found**2
    if len(parts) > 1:
        error = np.sqrt(np.maximum(squares - mean**2, 0) / (len(parts) - 1))
    return _shot(scene.patches, emission, mean, error, len(u))


def shot_at_patches(
    scene: RayScene, rays: float, points: PointSet | None = None, emitters: NDArray[np.bool_] | None = None
) -> FirstShot:
    """Send the emission of all patches, or of the ``emitters`` (n,), by ``rays`` rays or a few more, most of them
    aimed, the same number at each patch. The error of the irradiance is a small part of that of :func:`first_shot`.

    The received power is scaled to the sent power minus the power that leaves the scene. points: of four dimensions, by
    default a scrambled Sobol' sequence. The shot is the mean of four shots with independently randomised points, whose
    variance gives the error. Raises :class:`RadiosityError` if no patch emits.
    """
    return Shot(scene, points or OwenSobol(4), emitters).cast(rays)


class Shot:
    """:func:`shot_at_patches`, block by block. The light of a block is determined by its number."""

    def __init__(self, scene: RayScene, points: PointSet, emitters: NDArray[np.bool_] | None) -> None:
        self._lamps = _Lamps(scene, _emission(scene.patches, emitters), _replicates(points))

    @property
    def at_once(self) -> int:
        """Number of blocks that fill the device."""
        return self._lamps.at_once

    def blocks(self, rays: float) -> int:
        """Number of blocks with at least ``rays`` rays, at least one of each sequence."""
        return max(SEQUENCES, int(np.ceil(rays / self._lamps.rays)))

    def light(self, first: int, count: int) -> ShotSums:
        """The light of ``count`` blocks from ``first`` on; results can be added."""
        patches = self._lamps.scene.patches
        received = np.zeros((SEQUENCES, len(patches) + 2, patches.channels))
        blocks = np.zeros(SEQUENCES)
        for start in range(first, first + count, self.at_once):
            for block, found in self._lamps.light(start, min(self.at_once, first + count - start)):
                received[block % SEQUENCES] += found
                blocks[block % SEQUENCES] += 1
        return ShotSums(received, blocks)

    def result(self, sums: ShotSums) -> FirstShot:
        """The shot from the sums of blocks, with at least one block of each sequence."""
        blocks = sums.blocks.sum()
        mean = sums.received.sum(axis=0) / blocks
        parts = ((found, np.full(len(mean), n)) for found, n in zip(sums.received, sums.blocks, strict=True))
        emission = self._lamps.emission
        return _shot(self._lamps.scene.patches, emission, mean, scatter(parts, mean), int(blocks) * self._lamps.rays)

    def cast(self, rays: float) -> FirstShot:
        """A shot with at least ``rays`` rays."""
        return self.result(self.light(0, self.blocks(rays)))


@dataclass(frozen=True)
class ShotSums:
    """The light of blocks of rays, by sequence: power ``received`` (sequences, n + 2, c) by patches, the sky and backs
    of faces, added up over ``blocks`` (sequences,)."""

    received: Array
    blocks: Array

    def __add__(self, other: ShotSums) -> ShotSums:
        return ShotSums(self.received + other.received, self.blocks + other.blocks)


class _Lamps:
    """Emitters of a scene that send blocks of rays; consecutive blocks use the sequences in turn."""

    def __init__(self, scene: RayScene, emission: Array, sequences: list[PointSet]) -> None:
        self.scene, self.emission, self.sequences = scene, emission, sequences
        n, sides = len(emission), Sides.of(scene.patches)
        power = scene.patches.areas[:, None] * emission
        strength = power.sum(axis=1)
        lit = sides.emitting(strength)
        self._lamps, self._targets = RaySource(scene, lit), RaySource(scene, sides)
        self._covered = covered_lamps(scene, lit)
        self._whole, self._colour = lit.edges[-1], power / np.where(strength > 0, strength, 1)[:, None]
        #: Rays of a block: number of rays aimed at each patch, and number of cosine-distributed rays.
        self.each = 1 << int(np.ceil(np.log2(max(_BLOCK / n, 1))))
        self.shot = -(-n * self.each // _AIMED)
        self._areas = copied_to_device(mi.Float, np.bincount(sides.patch, sides.areas, n))
        self._colours = [copied_to_device(mi.Float64, column) for column in self._colour.T]
        # All patches use the same points, each with its own shift.
        self._shifts = Independent(4, seed=1).lanes(mi.UInt32, n)
        dr.eval(self._shifts)
        self._patches, self._bits = dr.opaque(mi.UInt32, n), dr.opaque(mi.UInt32, self.each.bit_length() - 1)

    @property
    def rays(self) -> int:
        """Number of rays of a block."""
        return self.each * len(self.emission) + self.shot

    @property
    def at_once(self) -> int:
        """Number of blocks that fill the device."""
        return max(BATCH // self.rays, 1)

    def light(self, first: int, count: int) -> list[tuple[int, Array]]:
        """Indices of ``count`` blocks, ascending in each sequence, and the power (n + 2, c) that patches, the sky and
        backs of faces receive from each block."""
        turns = [
            range(first + (k - first) % len(self.sequences), first + count, len(self.sequences))
            for k in range(len(self.sequences))
        ]
        received = self._whole / self.shot * self._shot(turns, count)
        received[:, :-2] += self._whole / self.each * self._aimed(turns, count)
        return list(zip((block for turn in turns for block in turn), received, strict=True))

    def _points(self, turns: list[range], size: int) -> list[mi.Float64]:
        """Points of blocks of ``size`` points, sequence by sequence."""
        parts = [
            points.lanes(mi.UInt32, len(turn) * size, turn.start // len(turns) * size)
            for points, turn in zip(self.sequences, turns, strict=True)
            if turn
        ]
        return [dr.concat(list(lanes)) for lanes in zip(*parts, strict=True)]

    def _shot(self, turns: list[range], count: int) -> Array:
        """Light of cosine-distributed rays, (count, n + 2, c), in units of the power of a ray."""
        scene, n = self.scene, len(self.emission)
        u = self._points(turns, self.shot)
        places, ways = self._lamps.any(u[0], u[1]), cosine_lanes(u[2], u[3])
        directions = places.directions(ways)
        hit = scene.hit(places.origin, directions)
        free = self._free(places)
        found = dr.select(free, scene.patch_of(hit, directions), self._covered.meets(places, self._patches))
        on_patch = free & (found < self._patches)
        kernel = ways.z * dr.abs(dr.dot(scene.normal_of(hit), directions)) / (dr.pi * hit.t**2)
        aimed_at = on_patch & (dr.gather(mi.Float, self._areas, found, on_patch) * kernel <= _NEAR)
        pairs = pairs_of(self._lamps.patch_of(places.side), dr.select(aimed_at, self._patches + 2, found))
        # A row of n + 3 numbers for each block, the last one for rays that do not count.
        row = pairs[:, 1] + np.repeat(np.arange(count) * (n + 3), self.shot)
        colour = self._colour[pairs[:, 0]]
        sums = [np.bincount(row, column, count * (n + 3)).reshape(count, n + 3)[:, :-1] for column in colour.T]
        return np.stack(sums, axis=2)

    def _free(self, places: Places) -> mi.Bool:
        """Whether no other face lies on places of lamps."""
        return self._covered.meets(places, self._patches + 2) == self._patches + 2

    def _aimed(self, turns: list[range], count: int) -> Array:
        """Light of aimed rays, (count, n, c); each ray adds its share A K."""
        scene, n = self.scene, len(self.emission)
        table = self._points(turns, self.each)
        dr.eval(table)
        # Lanes are ordered by block, then by patch, then by ray.
        lane = dr.arange(mi.UInt32, count * n * self.each)
        row = lane >> self._bits
        block = row // self._patches
        patch = row - block * self._patches
        point = (block << self._bits) + lane - (row << self._bits)
        u = []
        for points, shifts in zip(table, self._shifts, strict=True):
            x = dr.gather(mi.Float64, points, point) + dr.gather(mi.Float64, shifts, patch)
            u.append(dr.select(x >= 1, x - 1, x))
        target, lamp = self._targets.of(patch, u[0], u[1]), self._lamps.any(u[2], u[3])
        way = target.point - lamp.origin
        square = dr.squared_norm(way)
        way /= dr.maximum(dr.sqrt(square), 1e-30)
        cosines = dr.dot(way, lamp.normal), -dr.dot(way, target.normal)
        ahead = (cosines[0] > 0) & (cosines[1] > 0) & self._free(lamp)
        hit = scene.hit(lamp.origin, way, ahead)
        seen = ahead & hit.is_valid() & (scene.face_of(hit) == self._targets.face_of(target.side))
        share = dr.gather(mi.Float, self._areas, patch) * cosines[0] * cosines[1] / (dr.pi * square)
        share = dr.select(seen & (share <= _NEAR), share, 0)
        source = self._lamps.patch_of(lamp.side)
        brought = [share * dr.gather(mi.Float64, colour, source) for colour in self._colours]
        dr.eval(brought)
        sums = [np.array(dr.block_reduce(dr.ReduceOp.Add, x, self.each)).reshape(count, n) for x in brought]
        return np.stack(sums, axis=2)


def small_emitters(patches: Patches, rays_per_segment: float) -> NDArray[np.bool_]:
    """(n,) the emitters whose light is better sent by a shot with ``rays_per_segment`` rays for each segment of global
    lines.

    A ray from an emitter reduces the variance of its light as much as a line that meets the emitter; an aimed ray
    reduces it more. Rays are distributed by power, lines by area. So the brightest emitters are taken, as long as each
    gets more rays than lines. None are taken if the others have half of the variance, which for equal patches is
    proportional to the sum of ``E^2 A``.
    """
    strength, areas = patches.emission.sum(axis=1), patches.areas
    order = np.argsort(-strength, kind="stable")
    ranked = strength[order]
    power = np.cumsum(ranked * areas[order])
    alike = np.searchsorted(-ranked, -ranked, side="right") - 1  # the last one of equal strength
    # Of s segments, 2 s A / sum(A) meet a patch; of r s rays, r s E A / power leave it.
    taken = order[(ranked > 0) & (ranked * rays_per_segment * areas.sum() >= 2 * power[alike])]
    chosen = np.zeros(len(patches), dtype=bool)
    chosen[taken] = True
    variance = strength**2 * areas
    return chosen if variance[chosen].sum() > _MOST * variance.sum() else np.zeros_like(chosen)


def _emission(patches: Patches, emitters: NDArray[np.bool_] | None) -> Array:
    emission = patches.emission if emitters is None else np.where(emitters[:, None], patches.emission, 0.0)
    if not emission.any():
        raise RadiosityError("no patch emits light: there is no first shot")
    return emission


def _replicates(points: PointSet) -> list[PointSet]:
    """Independently randomised copies of the points; the first point determines their seeds."""
    seed = int(np.bitwise_xor.reduce(points.block(1).ravel().view(np.uint64)))
    return [points.randomised(seed_key(seed, "replicate", k)[0]) for k in range(SEQUENCES)]


def _shot(patches: Patches, emission: Array, mean: Array, error: Array, rays: int) -> FirstShot:
    """The shot from received power (n + 2, c) and its standard error."""
    areas = patches.areas[:, None]
    sent, received, leaving = (areas * emission).sum(axis=0), mean[:-2].sum(axis=0), mean[-2:].sum(axis=0)
    # Only cosine-distributed rays leave the scene. The power that leaves has the larger variance, so it is scaled.
    leaves = (leaving > 0) & (received < sent)
    outside = np.divide(sent - received, leaving, out=np.ones_like(sent), where=leaves)
    inside = np.divide(sent - outside * leaving, received, out=np.zeros_like(sent), where=received > 0)
    arrived, away = mean[:-2] * np.maximum(inside, 0), mean[-2:] * outside
    whole = patches.divisors[:, None]
    return FirstShot(patches, emission, arrived / whole, error[:-2] / whole, away[0], away[1], rays)
