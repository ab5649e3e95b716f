"""Bandwidths of kernel maps by the rules of :mod:`etendue.density`, applied shape by shape."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from etendue.core import Array
from etendue.density import DensityError, Kernel, Samples, cross_validation, normal_reference, silverman

from ..errors import SurfaceError
from .places import MapSurfaces
from .protocol import SurfaceParticles

Rule = Literal["normal", "silverman", "cross-validation"]
#: Largest number of particles of a shape from which its bandwidth is chosen.
_SAMPLE = 1 << 17


def rule_bandwidths(
    surfaces: MapSurfaces,
    hits: SurfaceParticles,
    rule: Rule = "silverman",
    kernel: Kernel | str = "epanechnikov",
    total: int | None = None,
) -> Array:
    """(n,) bandwidths of cells: one for each shape, from its particles in their two directions of largest variance.

    The rules are :func:`normal_reference`, :func:`silverman` and :func:`cross_validation`, weighted by power. They are
    meant for flat shapes; on other shapes they give a bandwidth of the right order.

    hits: particles, such as those of a first pass. total: number of particles of the map, if it has more than ``hits``:
    bandwidths shrink by the sixth root of the ratio. A shape with fewer than three particles gets the mean bandwidth of
    the other shapes.

    Raises :class:`SurfaceError` for an unknown rule, or if no shape has enough particles.
    """
    if rule not in get_args(Rule):
        raise SurfaceError(f"a bandwidth is chosen by {', '.join(get_args(Rule))}, not {rule!r}")
    located = surfaces.located(hits)
    shapes = surfaces.shapes
    widths = {}
    for shape in np.unique(located.shape):
        own = np.flatnonzero(located.shape == shape)
        chosen = own[:: -(-len(own) // _SAMPLE)]
        weights = located.power[chosen].sum(axis=1)
        if np.count_nonzero(weights) < 3:
            continue
        samples = Samples(_flat(located.position[chosen]), weights)
        try:
            h = _chosen(samples, rule, kernel) / surfaces.space.scale
        except DensityError:  # particles that coincide, or nearly one alone that has all the power
            continue
        fewer = len(chosen) / len(own) * len(hits) / max(total or 0, len(hits))
        widths[int(shape)] = h * fewer ** (1 / 6)
    if not widths:
        raise SurfaceError("no surface has enough particles for a rule of bandwidths; give a bandwidth")
    other = float(np.mean(list(widths.values())))
    table = np.full(int(shapes.max()) + 1, other)
    for shape, h in widths.items():
        if shape < len(table):
            table[shape] = h
    result: Array = table[shapes]
    return result


def _chosen(samples: Samples, rule: Rule, kernel: Kernel | str) -> float:
    if rule == "cross-validation":
        return cross_validation(samples, kernel)[0]
    return (normal_reference if rule == "normal" else silverman)(samples, kernel)


def _flat(positions: Array) -> Array:
    """(m, 2) coordinates along the two axes of most variance."""
    offset = positions - positions.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    flat: Array = offset @ axes[:, 1:]
    return flat
