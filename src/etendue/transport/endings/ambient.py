r"""The ambient term of a scene: light after several reflections, by the normal of the surface at which it arrives.

Surfaces are represented by a few thousand vertices of random walks from the camera that scatter without being absorbed.
Such walks visit surfaces by their area and directions by their cosine, as far as paths from the camera can come. For
the classes of :mod:`etendue.surfaces` they give the quantities that the classical term takes from patches: the mean
radiosity by direct light, the mean albedo, and form factors, here the shares of walks from one class to another.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SampleSource, copied_to_device
from etendue.surfaces import AmbientTerm, class_weights, incoming

from ..direct import DirectWeights
from ..vertex import WalkVertex
from ..walk import CameraPath, Walker, ones

Mask = NDArray[np.bool_]

#: Number of walks, edges per walk, and last edges that are not used: these only find the surfaces that earlier vertices
#: see, also through mirrors and glass. The end of the first edge is not used either, because it lies where the camera
#: looks.
AMBIENT_WALKS, _EDGES, _LEADING = 2048, 10, 3


@dataclass(frozen=True)
class AmbientScene:
    """Means by classes of normals. ``direct``: (k, 3) radiosity by light that is reflected once. ``albedo``: (k, 3).
    ``factors``: (k, k) share of the walks leaving a class that reach another; the rest leaves the scene."""

    direct: Array
    albedo: Array
    factors: Array

    def irradiance(self, reflected: int = 1) -> Array:
        """Irradiance (k, 3) by light that was reflected at least ``reflected`` times before it arrives."""
        source = self.direct
        for _ in range(1, reflected):
            source = self.albedo * (self.factors @ source)
        return incoming(source, self.albedo, self.factors)


class AmbientTable:
    """Radiance of a perfectly white surface in ambient light, on the device: ``irradiance`` (k, 3) over pi."""

    def __init__(self, term: AmbientTerm, irradiance: Array) -> None:
        self._term = term
        self._radiance = copied_to_device(mi.Float, (irradiance / np.pi).astype(np.float32))

    def at(self, vertex: WalkVertex, active: mi.Bool) -> mi.Spectrum:
        """The radiance for the shading normal on the side from which a vertex was reached."""
        if self._term == "classic":
            return dr.gather(mi.Spectrum, self._radiance, mi.UInt32(0), active)
        normal = facing(vertex)
        shares = [dr.square(component) for component in normal]
        if self._term == "crisp":
            is_z = shares[2] > dr.maximum(shares[0], shares[1])
            is_y = ~is_z & (shares[1] > shares[0])
            shares = [dr.select(is_axis, mi.Float(1.0), 0.0) for is_axis in (~is_z & ~is_y, is_y, is_z)]
        light = mi.Spectrum(0.0)
        for axis, share in enumerate(shares):
            number = mi.UInt32(2 * axis) + ones(normal[axis] < 0.0)
            light += share * dr.gather(mi.Spectrum, self._radiance, number, active)
        return light


def facing(vertex: WalkVertex) -> mi.Normal3f:
    """The shading normal on the side from which a vertex was reached."""
    normal = vertex.si.sh_frame.n
    return dr.select(dr.dot(normal, vertex.incoming) > 0.0, -normal, normal)


@dataclass
class _Found:
    """The ends of one edge of all walks, on the host: a row for each walk."""

    normal: Array
    smooth: Mask  #: whether the end counts in the means; other ends transmit or mirror light
    albedo: Array
    direct: Array  #: reflected radiance of a light point
    hit: Array  #: radiance of a light that the edge has hit, reflected by the last vertex
    carried: Array  #: throughput of the mirrors and glass between the last vertex and this one
    goes_on: Mask


def ambient_scene(walker: Walker, ray: mi.Ray3f, source: SampleSource, term: AmbientTerm) -> AmbientScene:
    """Walk from the camera rays ``ray`` (a lane for each walk) with the numbers of ``source``."""
    path = CameraPath.start(ray, mi.UInt32(_EDGES))
    carried = dr.full(mi.Spectrum, 1.0, dr.width(ray))
    edges = []
    for edge in range(1, _EDGES + 1):
        path.depth = dr.full(mi.UInt32, edge, dr.width(ray))
        # Opaque, so that all edges use the same kernel.
        dr.make_opaque(path, carried)
        carried, found = _edge(path, carried, walker, source)
        edges.append(found)
    return _means(term, edges)


def _edge(s: CameraPath, carried: mi.Spectrum, walker: Walker, source: SampleSource) -> tuple[mi.Spectrum, _Found]:
    """Trace an edge and scatter at its end. The throughput counts from the last smooth vertex."""
    weights = DirectWeights()
    vertex = walker.arrive(s)
    hit = walker.emission(s, vertex)
    emitted = (s.throughput * hit.radiance * weights.hit(s.pdf, hit.direct_pdf)) & hit.active
    s.active &= vertex.valid
    smooth = s.active & vertex.smooth
    light = walker.light_point(vertex, source, smooth)
    scattered, (f,) = vertex.sample(source, s.active, [light])
    s.throughput = dr.select(smooth, mi.Spectrum(1.0), s.throughput)
    contribution, visible = walker.next_event(s, vertex, light, f, weights)
    s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
    through = dr.select(smooth, mi.Spectrum(1.0), carried * scattered.weight)
    found = [facing(vertex), smooth, scattered.weight & scattered.active, contribution & visible, emitted, carried]
    walker.advance(s, vertex, scattered, source)
    dr.eval(s, through, found)
    # Numbers that are not finite would spread to all classes.
    rows = [np.array(values).T for values in (*found, s.active)]
    for row in rows:
        row[~np.isfinite(row)] = 0
    return through, _Found(*rows)


def _means(term: AmbientTerm, edges: list[_Found]) -> AmbientScene:
    """Means over the vertices of all walks that are used."""
    shape = len(edges), len(edges[0].smooth)
    normals, albedo, direct = (np.stack([getattr(e, name) for e in edges]) for name in ("normal", "albedo", "direct"))
    classes = class_weights(term, normals.reshape(-1, 3).astype(np.float64)).reshape(*shape, -1)
    used = np.stack([edge.smooth for edge in edges])
    used[0], used[-_LEADING:] = False, False
    count = classes.shape[2]
    between, left = np.zeros((count, count)), np.zeros(count)
    last = np.full(shape[1], -1)  # the vertex of each walk whose incident light is followed; -1: none
    walks = np.arange(shape[1])
    for number, edge in enumerate(edges):
        follows = last >= 0
        direct[last[follows], follows] += edge.hit[follows]
        meets, ends = follows & edge.smooth, follows & ~edge.smooth & ~edge.goes_on
        start = classes[last, walks]
        share = edge.carried[meets].mean(axis=1, keepdims=True)
        between += (start[meets] * share).T @ classes[number, meets]
        left += start[meets].sum(axis=0) + start[ends].sum(axis=0)
        last[meets | ends] = -1
        last[used[number] & edge.goes_on] = number
    weights = classes[used]
    seen = weights.sum(axis=0)[:, None]
    inverse = np.divide(1.0, seen, out=np.zeros_like(seen), where=seen > 0)
    factors = np.divide(between, left[:, None], out=np.zeros_like(between), where=left[:, None] > 0)
    radiosity, reflectance = (weights.T @ x[used].astype(np.float64) * inverse for x in (np.pi * direct, albedo))
    return AmbientScene(radiosity, reflectance, factors)
