r"""Light paths as numbers of the unit cube: their edges one by one, and independent paths.

A path of l edges is five numbers of its first edge (light, point, direction) and three of each later one (component of
the BSDF, direction). Without roulette, the flux that arrives at its end,

.. math:: f_l(u) = \frac{L_e \cos}{p_e} \prod_j \frac{f_s \cos}{p_s},

is a function of these numbers, and the sum over l of its integrals is the flux that arrives on all surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import IndependentSource, SampleSource
from etendue.scene import LightTable, Material, Members, bsdfs
from etendue.transport import EmittedRay, GivenNumbers, Proposal, Vertex, dimensions as dim, emit, scatter_light

from .. import base

#: Component of the number of roulette, edges from which on it applies, and largest probability of survival.
_ROULETTE, _ROULETTE_FROM, _LIVES = 62, 4, 0.95
#: Component of the number that picks one of the edges of an independent path.
_PICK_EDGE = 63
#: Random numbers of the first edge and of a later one, by component.
FIRST = (dim.LIGHT_PICK, dim.LIGHT_POINT, dim.LIGHT_POINT + 1, dim.LIGHT_DIRECTION, dim.LIGHT_DIRECTION + 1)
LATER = (dim.LOBE, dim.DIRECTION, dim.DIRECTION + 1)


@dataclass(frozen=True)
class PathNumbers:
    """States of chains: lengths (chains,), and the numbers of the first edge (5 * chains,) and of the later edges
    ((longest - 1) * 3 * chains,), number by number."""

    length: mi.UInt32
    first: mi.Float
    later: mi.Float


@dataclass
class End:
    """The end of an edge, one lane each."""

    ray: mi.Ray3f
    hit: mi.PreliminaryIntersection3f
    flux: mi.Spectrum  #: that arrives; zero where the edge has no end
    bad: mi.Bool  #: whether the flux was not finite


@dataclass
class Independent:
    """Independent paths, one entry each."""

    total: NDArray[np.float64]  #: luminance of the flux at all their ends
    direct: NDArray[np.float64]  #: at their first one
    last: NDArray[np.float64]  #: at the end of the longest that are allowed
    edges: NDArray[np.uint32]  #: edges up to an end that was picked in proportion to the luminance there
    rays: float


@dataclass(frozen=True)
class LightPaths:
    """Light paths in one scene, of at most ``longest`` edges."""

    scene: mi.Scene
    lights: LightTable
    longest: int
    proposal: Proposal = scatter_light  #: samples directions
    _bsdfs: Members = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_bsdfs", bsdfs(self.scene))

    def independent(self, lanes: mi.UInt32, seed: int, role: str, iteration: int) -> Independent:
        """Trace paths. Russian roulette brings the luminance back to that of the first end."""
        source = IndependentSource(lanes, seed, role, iteration)
        n = dr.width(lanes)
        end = self.from_light([source.next_1d(0, c) for c in FIRST], dr.full(mi.Bool, True, n))
        direct = mi.luminance(end.flux)
        start = {
            "number": mi.UInt32(1),
            "ray": end.ray,
            "hit": end.hit,
            "flux": end.flux,
            "total": mi.Float(direct),
            "last": dr.zeros(mi.Float, n),
            "edges": mi.UInt32(1),
            "rays": mi.UInt32(1),
        }

        def going(s: dict[str, Any]) -> mi.Bool:
            return (s["number"] < self.longest) & dr.any(s["flux"] > 0.0)

        def edge(s: dict[str, Any]) -> tuple[dict[str, Any]]:
            number = s["number"]
            numbers = [source.next_1d(number, c) for c in LATER]
            end = self.onward(s["ray"], s["hit"], s["flux"], numbers, going(s))
            value = mi.luminance(end.flux)
            total = s["total"] + value
            picked = source.next_1d(number, _PICK_EDGE) * total < value
            number = number + 1
            lives = dr.minimum(value / direct, _LIVES)
            plays = number >= _ROULETTE_FROM
            survives = ~plays | (source.next_1d(number, _ROULETTE) < lives)
            flux = dr.select(plays, end.flux / dr.maximum(lives, 1e-12), end.flux)
            return (
                {
                    "number": number,
                    "ray": end.ray,
                    "hit": end.hit,
                    "flux": dr.select(survives, flux, 0.0),
                    "total": total,
                    "last": dr.select(number == self.longest, value, 0.0),
                    "edges": dr.select(picked, number, s["edges"]),
                    "rays": s["rays"] + 1,
                },
            )

        (s,) = dr.while_loop((start,), going, edge, label="independent light paths")
        dr.eval(direct, s["total"], s["last"], s["edges"], s["rays"])
        total, first, last = (np.array(x, np.float64) for x in (s["total"], direct, s["last"]))
        return Independent(total, first, last, np.array(s["edges"], np.uint32), base.total(s["rays"]))

    def from_independent(self, lanes: mi.UInt32, edges: mi.UInt32, seed: int, role: str, iteration: int) -> PathNumbers:
        """The state of the first ``edges`` edges of the independent paths ``lanes``."""
        source = IndependentSource(lanes, seed, role, iteration)
        n = dr.width(lanes)
        first, later = dr.zeros(mi.Float, 5 * n), dr.zeros(mi.Float, max(1, 3 * (self.longest - 1) * n))
        lane = dr.arange(mi.UInt32, n)
        for i, component in enumerate(FIRST):
            dr.scatter(first, source.next_1d(0, component), lane + i * n)
        for number in range(1, self.longest):
            for i, component in enumerate(LATER):
                dr.scatter(later, source.next_1d(number, component), lane + (3 * (number - 1) + i) * n)
        dr.eval(first, later, edges)
        return PathNumbers(edges, first, later)

    # ------------------------------------------------------------------ edges

    def emitted(self, numbers: Sequence[mi.Float], active: mi.Bool) -> EmittedRay:
        """The ray of the numbers of a first edge."""
        return emit(self.lights, GivenNumbers(dict(zip(FIRST, numbers, strict=True))), active)

    def from_light(self, numbers: Sequence[mi.Float], active: mi.Bool) -> End:
        """The first edge of a path."""
        emitted = self.emitted(numbers, active)
        return self.cast(emitted.ray, emitted.throughput, emitted.active)

    def onward(
        self,
        ray: mi.Ray3f,
        hit: mi.PreliminaryIntersection3f,
        flux: mi.Spectrum,
        numbers: Sequence[mi.Float],
        active: mi.Bool,
    ) -> End:
        """The edge after the hit of a ray."""
        return self.cast(*self.scattered_ray(ray, hit, flux, numbers, active)[:3])

    def scattered_ray(
        self,
        ray: mi.Ray3f,
        hit: mi.PreliminaryIntersection3f,
        flux: mi.Spectrum,
        numbers: Sequence[mi.Float],
        active: mi.Bool,
    ) -> tuple[mi.Ray3f, mi.Spectrum, mi.Bool, mi.Bool]:
        """(ray, flux, whether there is one, whether it has crossed a null surface) after the hit of a ray."""
        si = hit.compute_surface_interaction(ray, active=active)
        vertex = Vertex(si=si, bsdf=Material(si.bsdf(ray), self._bsdfs))
        source: SampleSource = GivenNumbers(dict(zip(LATER, numbers, strict=True)))
        scattered, _ = self.proposal(vertex.bsdf, si, source, mi.UInt32(0), active)
        return vertex.ray(scattered.direction), flux * scattered.weight, scattered.active, scattered.is_null

    def cast(self, ray: mi.Ray3f, flux: mi.Spectrum, active: mi.Bool) -> End:
        """The end of an edge."""
        hit = self.scene.ray_intersect_preliminary(ray, active=active)
        finite = dr.all(dr.isfinite(flux))
        arrives = active & hit.is_valid() & finite
        return End(ray, hit, dr.select(arrives, flux, 0.0), active & ~finite)
