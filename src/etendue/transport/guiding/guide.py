r"""The guide: a learned density of directions for each cell of the scene, sampled in a mixture with the BSDF.

A cell is a range of positions and surface normals. Scattering samples the guide's density of the cell with probability
a, and the BSDF otherwise [Muller 2017]. The probability a is learned for each cell [Muller 2019]: in a cell with few
samples, or with a material that follows the light, the BSDF is better. The density of the direction is that of the
mixture,

.. math:: p(\omega) = a\, p_{guide}(\omega) + (1 - a)\, p_{BSDF}(\omega),

also in the weights of light points. Delta components are sampled by the BSDF only.

Directions are mapped to the unit square: each hemisphere around the z axis is mapped to a disc and this to half of the
square, both with equal areas [Shirley 1997].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SampleSource, copied_to_device
from etendue.density import Cells, Quadtrees, QuadtreeSampler
from etendue.scene import LightTable, Material

from .. import dimensions as dim
from ..scattering import Evaluated, Proposal, Scattered, geometric_cos, is_smooth
from .lights import MOST_LIGHTS, LightChoice, LocalLights

#: Solid-angle density of a direction over the density of its point in the square.
PER_STERADIAN = 0.25 / np.pi
#: The largest number below one.
_BELOW_ONE = 1.0 - 2.0**-24
#: Classes of directions by the density of the guide over the sum of those of guide and material, and their middles.
FITS = 16
_FITS = (np.arange(FITS) + 0.5) / FITS
#: Shares of the guide to choose from, relative to the greatest one. The first is that of a cell which has just learned
#: for the first time: how well a density fits is known only after it has been used.
_SHARES = np.linspace(0.1, 1.0, 19)
#: The ``place`` of a direction that is in no leaf.
NOWHERE = 0xFFFFFFFF


def square_of(direction: mi.Vector3f) -> mi.Point2f:
    """The point of the unit square for a direction."""
    below = direction.z < 0.0
    disc = mi.Point2f(direction.x, direction.y) * dr.rsqrt(1.0 + dr.abs(direction.z))
    half = mi.warp.uniform_disk_to_square_concentric(disc)
    x = 0.5 * (dr.clip(half.x, 0.0, _BELOW_ONE) + dr.select(below, 1.0, 0.0))
    return mi.Point2f(dr.minimum(x, _BELOW_ONE), dr.clip(half.y, 0.0, _BELOW_ONE))


def direction_of(point: mi.Point2f) -> mi.Vector3f:
    """Inverse of :func:`square_of`."""
    below = point.x >= 0.5
    half = mi.Point2f(2.0 * point.x - dr.select(below, 1.0, 0.0), point.y)
    disc = mi.warp.square_to_uniform_disk_concentric(half)
    radius_squared = dr.squared_norm(disc)
    z = 1.0 - radius_squared
    disc = disc * dr.safe_sqrt(2.0 - radius_squared)
    return mi.Vector3f(disc.x, disc.y, dr.select(below, -z, z))


@dataclass(kw_only=True)
class GuidedScattered(Scattered):
    """A direction sampled from the BSDF or the guide, one lane each."""

    place: mi.UInt32  #: leaf of the guide's quadtrees that holds the direction; NOWHERE for a delta scattering
    plain_pdf: mi.Float  #: density of the direction by the BSDF alone
    likelier: mi.Float  #: by what factor the direction is likelier than by the BSDF alone
    fit: mi.UInt32  #: class of the direction, below FITS
    glow: mi.Float  #: expected reflected luminance without that of light points; 0: unknown


class Guide:
    """Learned densities of directions by position and surface normal.

    Parameters
    ----------
    lower, upper: corners of a box that contains the scene.
    lights: the lights whose selection is learned, too; selection is not learned for one light, or for more than
        :data:`MOST_LIGHTS`.
    """

    def __init__(self, lower: Sequence[float], upper: Sequence[float], lights: LightTable | None = None) -> None:
        self._cells = Cells(lower, upper)
        if lights is not None and not 1 < lights.count <= MOST_LIGHTS:
            lights = None
        self._choice = None if lights is None else LightChoice(lights, self._cells.count)
        #: Number of lights whose selection is learned; 0 if it is not.
        self.light_count = 0 if lights is None else lights.count
        self._trees = Quadtrees.even(self._cells.count)
        self._glow = np.zeros(self._cells.count)
        self._shares = np.zeros(self._cells.count)
        self._upload()

    def _upload(self) -> None:
        self._sampler = QuadtreeSampler(self._trees)
        pairs = np.stack([self._shares, self._glow], axis=1)
        self._pairs = copied_to_device(mi.Float, pairs.astype(np.float32))

    @property
    def cells(self) -> int:
        """Cells of the scene's box."""
        return self._cells.count

    @property
    def places(self) -> int:
        """Leaves of the quadtrees of all cells."""
        return self._trees.places

    def boxes(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """(lower corner, upper corner, facing) of all cells: (cells, 3), (cells, 3), (cells,); a facing is 0 to 5 for
        +x, -x, +y, -y, +z, -z."""
        return *self._cells.boxes(), self._cells.facing

    def cell_at(self, position: Sequence[float], normal: Sequence[float]) -> int:
        """The cell of a surface point that faces along ``normal``."""
        place = mi.Point3f(*position), mi.Normal3f(*normal)
        dr.make_opaque(place)  # literals would make a kernel for each point
        cell = self._cells.find(*place)
        return int(np.asarray(cell).ravel()[0])

    def picture(self, cell: int, height: int = 64) -> Array:
        """The learned density of a cell, per steradian, over all directions: (height, 2 height), the polar angle from
        +z downwards, the azimuth from +x over +y to the right."""
        y, x = (np.arange(n) + 0.5 for n in (height, 2 * height))
        polar, azimuth = np.meshgrid(np.pi * y / height, np.pi * x / height, indexing="ij")
        sine = np.sin(polar).ravel()
        ways = [sine * np.cos(azimuth).ravel(), sine * np.sin(azimuth).ravel(), np.cos(polar).ravel()]
        direction = mi.Vector3f(*(copied_to_device(mi.Float, way.astype(np.float32)) for way in ways))
        density, _ = self._sampler.find(dr.opaque(mi.UInt32, cell, 2 * height * height), square_of(direction))
        return np.array(density, dtype=np.float64).reshape(height, 2 * height) * PER_STERADIAN

    # ------------------------------------------------------------------ on the device

    def locate(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.UInt32:
        """The cells of surface points; the normal is taken on the side of ``si.wi``."""
        facing = si.sh_frame.n * dr.sign(mi.Frame3f.cos_theta(si.wi))
        return self._cells.find(si.p, facing, active)

    def lights_at(self, cell: mi.UInt32, lights: LightTable) -> LightTable | LocalLights:
        """``lights`` with the selection probabilities of a cell."""
        return lights if self._choice is None else self._choice.at(cell)

    def scatter(
        self,
        cell: mi.UInt32,
        scatter: Proposal,
        bsdf: Material,
        si: mi.SurfaceInteraction3f,
        source: SampleSource,
        vertex: mi.UInt32,
        active: mi.Bool,
        directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
    ) -> tuple[GuidedScattered, list[Evaluated]]:
        """Sample a direction from the mixture of the guide and the proposal ``scatter`` (such as
        :func:`scatter_camera`), and evaluate the BSDF in ``directions``; densities are those of the mixture.
        ``cell``: from :meth:`locate`; other arguments as of :class:`Proposal`."""
        smooth = active & is_smooth(bsdf)
        if bsdf.in_medium is not None:  # directions of phase functions are not learned
            smooth &= ~bsdf.in_medium
        share, glow = dr.gather(mi.Vector2f, self._pairs, cell, smooth)
        trained = smooth & (share > 0.0)

        # One of the numbers decides which of the two is sampled, so that the directions of both remain stratified.
        u = mi.Point2f(*source.next_2d(vertex, dim.DIRECTION))
        by_guide = smooth & (u.x < share)
        u.x = dr.minimum(dr.select(by_guide, u.x / share, (u.x - share) / (1.0 - share)), _BELOW_ONE)
        source = _WithDirection(source, u)
        point, density, place = self._sampler.sample(cell, u, by_guide)
        toward = direction_of(point)
        wo = si.to_local(toward)
        sampled, evaluated = scatter(bsdf, si, source, vertex, active, [*directions, (wo, by_guide)])
        guided = evaluated.pop()
        for (wo, mask), value in zip(directions, evaluated, strict=True):
            there, _ = self._sampler.find(cell, square_of(si.to_world(wo)), mask & trained)
            value.plain_pdf, value.pdf = value.pdf, _mixed(share, there, value.pdf)

        by_bsdf = active & ~by_guide & sampled.active
        there, its_place = self._sampler.find(cell, square_of(sampled.direction), by_bsdf & smooth & ~sampled.is_delta)
        by_both = dr.select(by_guide, density, there), dr.select(by_guide, guided.pdf, sampled.pdf)
        pdf = _mixed(share, *by_both)
        value = dr.select(by_guide, guided.value, sampled.weight * sampled.pdf)
        is_delta = sampled.is_delta & ~by_guide
        direction = dr.select(by_guide, toward, sampled.direction)
        weight = dr.select(is_delta, sampled.weight / (1.0 - share), value / pdf)
        active = dr.select(by_guide, ~(pdf <= 0.0) & ~dr.all(value == 0.0), by_bsdf)
        return GuidedScattered(
            direction=direction,
            weight=dr.select(share > 0.0, weight, sampled.weight),
            pdf=dr.select(is_delta, sampled.pdf, pdf),
            reverse_pdf=dr.select(by_guide, guided.reverse_pdf, sampled.reverse_pdf),
            cos=geometric_cos(si, direction, bsdf.in_medium),
            eta=dr.select(by_guide, 1.0, sampled.eta),
            is_delta=is_delta,
            is_null=sampled.is_null & ~by_guide,
            active=active,
            by_guide=by_guide,
            place=dr.select(smooth & ~is_delta, dr.select(by_guide, place, its_place), NOWHERE),
            plain_pdf=by_both[1],
            likelier=dr.select(is_delta, 1.0 - share, over(pdf, by_both[1])),
            fit=_fit(*by_both),
            glow=dr.select(smooth & ~is_delta, glow, 0.0),
        ), evaluated

    # ------------------------------------------------------------------ on the host

    def learn(
        self,
        found: NDArray[np.float64],
        samples: NDArray[np.integer[Any]],
        *,
        most: float,
        leaf_share: float,
        share: float,
        fits: NDArray[np.float64] | None = None,
        brought: NDArray[np.float64] | None = None,
    ) -> NDArray[np.int64]:
        """Learn from training samples, and refine cells and quadtrees. Returns (cells,): for each new cell, the old
        cell that contains it.

        Parameters
        ----------
        found: (places,) sums of reflected light, by the direction that it comes from.
        samples: (places,) numbers of training samples.
        most: samples from which on a cell is divided.
        leaf_share: share of a cell's light from which on a leaf of its quadtree is divided.
        share: greatest probability a of the guide.
        fits: (cells, FITS) sums of reflected light by class of its direction. They determine the probability in cells
            that had learned before; without them it is ``share``.
        brought: (cells, lights) contributions of light points, if light selection is learned.
        """
        tree = self._trees.tree_of_place()
        light, count = np.bincount(tree, found, self.cells), np.bincount(tree, samples, self.cells)
        self._glow = np.where(light > 0.0, light / np.maximum(count, 1), self._glow)
        self._shares = np.where(self._glow > 0.0, _shares(self._shares, fits, share), 0.0)
        trees = self._trees.with_mass(found)
        origin = self._cells.split(count, most)
        self._glow, self._shares = self._glow[origin], self._shares[origin]
        self._trees = trees.refined(origin, leaf_share)
        if self._choice is not None and brought is not None:
            self._choice.learn(brought, origin)
        self._upload()
        return origin

    def state(self) -> dict[str, NDArray[Any]]:
        """The learned state, as arrays that are not modified later."""
        return {
            "glow": self._glow,
            "shares": self._shares,
            **self._cells.to_arrays(),
            **self._trees.to_arrays(),
            **({} if self._choice is None else {"lights": self._choice.shares}),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Set the state, as returned by :meth:`state`."""
        self._cells.set_arrays(state)
        if self._choice is not None:
            self._choice.restore(state["lights"])
        self._trees = Quadtrees.from_arrays(state)
        self._glow, self._shares = (np.asarray(state[name], np.float64) for name in ("glow", "shares"))
        self._upload()


class _WithDirection:
    """Numbers of a vertex, with other ones for the direction."""

    def __init__(self, base: SampleSource, u: mi.Point2f) -> None:
        self._base, self._u = base, u

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._base.next_1d(vertex, component)

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        if component == dim.DIRECTION:
            return self._u.x, self._u.y
        return self._base.next_2d(vertex, component)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._base.decide(vertex, component)


def over(pdf: mi.Float, plain_pdf: mi.Float) -> mi.Float:
    """By what factor a direction, or a path, is likelier than without the guide; at most 10^6, and 1 where it is
    impossible."""
    return dr.select(pdf > 0.0, pdf / dr.maximum(plain_pdf, 1e-6 * pdf), 1.0)


def _shares(before: Array, fits: Array | None, most: float) -> Array:
    """(cells,) probabilities of the guide: with a direction of density g by the guide and b by the material, and its
    light v, that of the greatest ``sum v log(a g + (1 - a) b)``, which has the least divergence from the light
    [Muller 2019]."""
    if fits is None:
        return np.full(len(before), most)
    shares = most * _SHARES
    mixed = shares * _FITS[:, None] + (1.0 - shares) * (1.0 - _FITS[:, None])
    best = shares[np.argmax(fits @ np.log(mixed), axis=1)]
    found: Array = np.where(before > 0.0, np.where(fits.any(axis=1), best, before), shares[0])
    return found


def _fit(square_density: mi.Float, pdf: mi.Float) -> mi.UInt32:
    """Class of a direction by the densities of guide and material."""
    guide = square_density * PER_STERADIAN
    return mi.UInt32(dr.clip(FITS * guide / dr.maximum(guide + pdf, 1e-30), 0.0, FITS - 1.0))


def _mixed(share: mi.Float, square_density: mi.Float, pdf: mi.Float) -> mi.Float:
    """Solid-angle density of the mixture, in which the guide has the probability ``share``."""
    return share * (square_density * PER_STERADIAN) + (1.0 - share) * pdf
