r"""Light paths as Markov chains that change only their last edge [Leeson 2001, sec. 5.7.1].

The state of a chain is a path of l edges from a light, as numbers u of the unit cube: five of the first edge (light,
point, direction), three of each later one (component of the BSDF, direction). Its target is the luminance of the flux
that arrives at the end of the path,

.. math:: f_l(u) = \mathrm{lum}\left(\frac{L_e \cos}{p_e} \prod_j \frac{f_s \cos}{p_s}\right),

so that ends of paths are distributed as the incident flux over all surfaces, and all stand for the same luminance. A
step changes the number of edges by -1, 0 or 1, with equal probabilities:

-1  drops the last edge,
0   moves the numbers of the last edge by (2 zeta - 1) times a step size; with a given probability it draws them anew,
+1  adds an edge with uniform numbers, whose density is 1.

Each is the reverse of another with the same density, so that a step is accepted with probability min(1, f'/f). No ray
is cast for the first kind, nor for numbers outside the unit cube, and one for the others: the hits of all edges are
kept. The thesis changes l and then moves the end, a step without a reverse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, SampleSource
from etendue.transport import ones

from ..base import total
from .lightpaths import End, LightPaths, PathNumbers

#: Components of the random numbers of a step: its kind, whether it draws anew, numbers of the edge, acceptance.
_KIND, _ANEW, _NUMBERS, _ACCEPT = 0, 1, 2, 7
#: Device memory of a chain and step in a pass: four rows of four numbers, and the repeats.
SLOT_BYTES = 4 * (4 * 4 + 1)
#: Largest number below 1.
_BELOW_ONE = 1.0 - 2.0**-24


def packed(edges: mi.UInt32, bounces: mi.UInt32) -> mi.UInt32:
    """Two numbers below 2^16 as one."""
    return edges | (bounces << 16)


def unpacked(both: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """The numbers of :func:`packed`."""
    return both & 0xFFFF, both >> 16


@dataclass
class _Trail:
    """The edges of a path in local memory, one lane a path: their rays, their ends and their numbers."""

    origin: Any
    direction: Any
    place: Any  #: distance, and the two parameters on the primitive
    what: Any  #: shape and instance by their registry numbers, primitive, and index of the shape in its group
    flux: Any
    bounce: Any  #: edges up to this one; an edge that continues through a null surface is not a new one
    numbers: Any

    @classmethod
    def of(cls, edges: int) -> _Trail:
        """Empty."""
        kinds = (mi.Point3f, mi.Vector3f, mi.Vector3f, mi.Vector4u, mi.Spectrum, mi.UInt32, mi.Point3f)
        return cls(*(dr.alloc_local(kind, edges, value=dr.zeros(kind)) for kind in kinds))

    def read(self, edge: mi.UInt32, active: mi.Bool) -> tuple[mi.Ray3f, mi.PreliminaryIntersection3f, mi.Spectrum]:
        """(ray, hit, flux) of an edge, counted from 0."""
        ray = mi.Ray3f(self.origin.read(edge, active), self.direction.read(edge, active))
        hit = dr.zeros(mi.PreliminaryIntersection3f)
        hit.valid = active
        place, what = self.place.read(edge, active), self.what.read(edge, active)
        hit.t, hit.prim_uv = place.x, mi.Point2f(place.y, place.z)
        hit.shape, hit.instance = (dr.reinterpret_array(mi.ShapePtr, number) for number in (what.x, what.y))
        hit.prim_index, hit.shape_index = what.z, what.w
        return ray, hit, self.flux.read(edge, active)

    def write(self, edge: mi.UInt32, end: End, bounce: mi.UInt32, numbers: mi.Point3f, active: mi.Bool) -> None:
        """Replace an edge."""
        self.origin.write(end.ray.o, edge, active)
        self.direction.write(end.ray.d, edge, active)
        self.place.write(mi.Vector3f(end.hit.t, end.hit.prim_uv.x, end.hit.prim_uv.y), edge, active)
        shape, instance = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (end.hit.shape, end.hit.instance))
        self.what.write(mi.Vector4u(shape, instance, end.hit.prim_index, end.hit.shape_index), edge, active)
        self.flux.write(end.flux, edge, active)
        self.bounce.write(bounce, edge, active)
        self.numbers.write(numbers, edge, active)


@dataclass(kw_only=True)
class _Chain:
    """State of the loop over the steps, one lane a chain."""

    step: mi.UInt32
    missing: mi.UInt32  #: edges of the first state whose ends are to be found again, before the first step
    length: mi.UInt32
    first: list[mi.Float]
    value: mi.Float  #: the target
    place: mi.Point3f  #: end of the path
    repeats: mi.UInt32  #: steps since the state was entered
    rays: mi.UInt32
    rebuilt: mi.UInt32  #: edges found again
    accepted: mi.UInt32
    bad: mi.UInt32
    trail: _Trail


@dataclass
class Walked:
    """Results of the steps of a pass. Rows (slots, 4): a slot is a step and a chain."""

    state: PathNumbers
    counts: mi.UInt32  #: repeats of the state that a chain left at a step; 0: none was left
    position: mi.Float  #: x, y, z, and the first parameter on the primitive
    direction: mi.Float  #: x, y, z, and the second one
    flux: mi.Float  #: red, green, blue, and the bits of the index of the shape in its group
    what: mi.UInt32  #: number of the shape in Dr.Jit's registry, that of its instance, primitive, :func:`packed` edges
    traces: mi.Float  #: edges, x, y, z of the first chains after every step
    rays: float  #: of the steps
    rebuilt: float  #: rays that found the hits of the first state again
    accepted: float
    bad: float  #: values that were not finite


@dataclass(frozen=True)
class TailChains:
    """Chains of light paths in one scene.

    step: size of the moves in the unit cube. anew: probability with which a step that keeps the number of edges draws
    the numbers of the last edge anew.
    """

    paths: LightPaths
    step: float
    anew: float

    # ------------------------------------------------------------------ chains

    def walk(self, state: PathNumbers, steps: int, traced: int, seed: int, iteration: int) -> Walked:
        """``steps`` steps of all chains. ``traced``: number of chains whose states are recorded after every step."""
        n = dr.width(state.length)
        lane = dr.arange(mi.UInt32, n)
        source = IndependentSource(lane, seed, "tail mutation", iteration)
        slots = (steps + 1) * n
        rows = dr.empty(mi.Float, 4 * slots), dr.empty(mi.Float, 4 * slots), dr.empty(mi.Float, 4 * slots)
        what, counts = dr.empty(mi.UInt32, 4 * slots), dr.zeros(mi.UInt32, slots)
        traces = dr.empty(mi.Float, 4 * steps * traced)

        def leave(c: _Chain, active: mi.Bool) -> None:
            """Write the state of a chain, with its repeats."""
            ray, hit, flux = c.trail.read(c.length - 1, active)
            # A path that is traced again may miss its hits by rounding: a state without light is no particle.
            active = active & (c.value > 0.0)
            slot = c.step * n + lane
            u, v = hit.prim_uv
            index = dr.reinterpret_array(mi.Float, hit.shape_index)
            dr.scatter(rows[0], mi.Vector4f(c.place.x, c.place.y, c.place.z, u), slot, active)
            dr.scatter(rows[1], mi.Vector4f(ray.d.x, ray.d.y, ray.d.z, v), slot, active)
            dr.scatter(rows[2], mi.Vector4f(flux.x, flux.y, flux.z, index), slot, active)
            shape, instance = (dr.reinterpret_array(mi.UInt32, p) for p in (hit.shape, hit.instance))
            edges = packed(c.length, c.trail.bounce.read(c.length - 1, active))
            dr.scatter(what, mi.Vector4u(shape, instance, hit.prim_index, edges), slot, active)
            dr.scatter(counts, c.repeats, slot, active)

        def step(c: _Chain) -> tuple[_Chain]:
            stepping = self._step(c, state, lane, source, leave)
            after = mi.Vector4f(mi.Float(c.length), *c.place)
            dr.scatter(traces, after, c.step * traced + lane, stepping & (lane < traced))
            c.step += ones(stepping)
            return (c,)

        count = dr.opaque(mi.UInt32, steps)
        (chain,) = dr.while_loop((self._begun(state, lane),), lambda c: c.step < count, step, label="tail mutation")
        leave(chain, chain.repeats > 0)
        left = self._left(chain, lane, n)
        dr.eval(left.length, left.first, left.later, counts, what, traces, *rows)
        dr.eval(chain.rebuilt, chain.rays, chain.accepted, chain.bad)
        rays = total(chain.rays), total(chain.rebuilt)
        return Walked(left, counts, *rows, what, traces, *rays, total(chain.accepted), total(chain.bad))

    def _begun(self, state: PathNumbers, lane: mi.UInt32) -> _Chain:
        """The chains before the paths of ``state`` are found again."""
        n = dr.width(lane)
        none = dr.zeros(mi.UInt32, n)
        return _Chain(
            step=mi.UInt32(none),
            missing=mi.UInt32(state.length),
            length=mi.UInt32(none),
            first=[dr.gather(mi.Float, state.first, lane + i * n) for i in range(5)],
            value=dr.zeros(mi.Float, n),
            place=dr.zeros(mi.Point3f, n),
            repeats=mi.UInt32(none),
            rays=mi.UInt32(none),
            rebuilt=mi.UInt32(none),
            accepted=mi.UInt32(none),
            bad=mi.UInt32(none),
            trail=_Trail.of(self.paths.longest),
        )

    def _step(
        self,
        c: _Chain,
        state: PathNumbers,
        lane: mi.UInt32,
        source: SampleSource,
        leave: Callable[[_Chain, mi.Bool], None],
    ) -> mi.Bool:
        """One step of each chain, or one more edge of the path of ``state`` where edges are missing; both in one body,
        because materials and lights are compiled at each call. Returns the chains that have made a step.
        ``leave`` is called before the chains whose steps are accepted change their states."""
        finds = c.missing > 0
        kind = source.next_1d(c.step, _KIND)
        drops, adds = ~finds & (kind < 1.0 / 3.0), (kind >= 2.0 / 3.0) | finds
        keeps = ~drops & ~adds
        is_first = (keeps & (c.length == 1)) | (finds & (c.length == 0))
        zeta = [source.next_1d(c.step, _NUMBERS + i) for i in range(5)]

        # ---- Numbers of the proposed last edge
        size = dr.opaque(mi.Float, self.step)
        anew = source.next_1d(c.step, _ANEW) < dr.opaque(mi.Float, self.anew)
        own = c.trail.numbers.read(c.length - 1, ~finds)
        n, row = dr.width(lane), 3 * (c.length - 1)
        kept = [dr.gather(mi.Float, state.later, (row + i) * n + lane, finds & ~is_first) for i in range(3)]
        first = [dr.select(anew, z, u + (2.0 * z - 1.0) * size) for u, z in zip(c.first, zeta, strict=True)]
        later = [dr.select(anew | adds, z, u + (2.0 * z - 1.0) * size) for u, z in zip(own, zeta[:3], strict=True)]
        inside_first, inside_later = mi.Bool(True), mi.Bool(True)
        for u in first:
            inside_first &= (u >= 0.0) & (u <= _BELOW_ONE)
        for u in later:
            inside_later &= (u >= 0.0) & (u <= _BELOW_ONE)
        first = [dr.select(finds, old, u) for old, u in zip(c.first, first, strict=True)]
        later = [dr.select(finds, old, u) for old, u in zip(kept, later, strict=True)]

        # ---- The edge: from the light, or from the vertex before it
        starts = is_first & (inside_first | finds)
        scatters = (keeps & ~is_first & inside_later) | (adds & ~is_first & (c.length < self.paths.longest))
        edge = c.length - dr.select(adds, mi.UInt32(1), mi.UInt32(2))  # the one before; wraps where there is none
        shortens = drops & (c.length > 1)
        before = c.trail.read(edge, scatters | shortens)
        light_ray = self.paths.emitted(first, starts)
        ray, flux, goes, is_null = self.paths.scattered_ray(*before, later, scatters)
        bounce = c.trail.bounce.read(edge, scatters) + dr.select(is_null, mi.UInt32(0), 1)
        bounce = dr.select(starts, mi.UInt32(1), bounce)
        ray = dr.select(starts, light_ray.ray, ray)
        flux = dr.select(starts, light_ray.throughput, flux)
        casts = (starts & light_ray.active) | (scatters & goes)
        end = self.paths.cast(ray, flux, casts)

        # ---- Accept
        value = mi.luminance(dr.select(shortens, before[2], end.flux))
        proposed = shortens | casts
        accepted = finds | (proposed & (source.next_1d(c.step, _ACCEPT) * c.value < value))
        leave(c, accepted & (c.repeats > 0))
        c.repeats = dr.select(accepted, mi.UInt32(0), c.repeats) + ones(~finds)
        moved = accepted & ~shortens
        c.place = dr.select(moved, end.ray(end.hit.t), dr.select(accepted, before[0](before[1].t), c.place))
        c.value = dr.select(accepted, value, c.value)
        c.length = dr.select(accepted, c.length + ones(adds) - ones(drops), c.length)
        c.first = [dr.select(accepted & is_first, u, v) for u, v in zip(first, c.first, strict=True)]
        c.trail.write(c.length - 1, end, bounce, mi.Point3f(*later), moved)
        c.missing -= ones(finds)
        c.rays += ones(casts & ~finds)
        c.rebuilt += ones(finds)
        c.accepted += ones(accepted & ~finds)
        c.bad += ones(casts & end.bad)
        return ~finds

    def _left(self, chain: _Chain, lane: mi.UInt32, n: int) -> PathNumbers:
        """The state of chains, as arrays."""
        first, later = dr.zeros(mi.Float, 5 * n), dr.zeros(mi.Float, max(1, 3 * (self.paths.longest - 1) * n))
        for i, u in enumerate(chain.first):
            dr.scatter(first, u, lane + i * n)

        def store(number: mi.UInt32, trail: _Trail) -> tuple[mi.UInt32, _Trail]:
            for i, u in enumerate(trail.numbers.read(number)):
                dr.scatter(later, u, (3 * (number - 1) + i) * n + lane)
            return number + 1, trail

        dr.while_loop(
            (dr.full(mi.UInt32, 1, n), chain.trail), lambda number, _: number < chain.length, store, label="numbers"
        )
        return PathNumbers(mi.UInt32(chain.length), first, later)
