"""Boundary corrections for the part of a kernel outside the domain.

``"reflect"`` mirrors the samples at the border. The estimate then has the right integral and zero slope at the border.
``"renormalise"`` divides by the share of the kernel inside the domain [Jones 1993]; with a surface, estimators divide
by its area within the kernel. Both leave a bias of the order of the bandwidth if the density has a slope at the
border; without a correction half of the density is missing at an edge, and three quarters in a corner.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.integration import Box, Domain

from .errors import DensityError
from .kernels import Kernel

Boundary = Literal["none", "reflect", "renormalise"]
#: Quadrature nodes along the part of a side that a kernel overlaps.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def check_boundary(boundary: str, allowed: tuple[str, ...], domain: Domain | None) -> None:
    """Raise :class:`DensityError` unless the estimator has this correction, and the domain is known."""
    if boundary not in allowed:
        raise DensityError(f"boundary {boundary!r}: this estimator has {', '.join(allowed)}")
    if boundary != "none" and domain is None:
        raise DensityError(f"boundary {boundary!r} needs the domain: domain=[(lower, upper), ...]")


def reflected(positions: Array, reach: Array, box: Box) -> tuple[Array, NDArray[np.int64]]:
    """Positions, and those of their mirror images whose kernels may overlap the box, with the indices of the originals.

    positions: (n, d). reach: (n,), of the kernels. Returns (m, d) and the indices (m,); the first n are the positions
    themselves. Images are not mirrored again, even if the reach exceeds the side of the box.
    """
    every = np.arange(len(positions))
    images, owners = [positions], [every]
    for sides in product((-1, 0, 1), repeat=box.dimension):
        if not any(sides):
            continue
        image, near = positions.copy(), np.ones(len(positions), dtype=bool)
        for axis, side in enumerate(sides):
            if side:
                border = box.lower[axis] if side < 0 else box.upper[axis]
                near &= np.abs(positions[:, axis] - border) <= reach
                image[:, axis] = 2 * border - image[:, axis]
        images.append(image[near])
        owners.append(every[near])
    return np.concatenate(images), np.concatenate(owners)


def share_inside(kernel: Kernel, point: mi.Point3f, bandwidth: mi.Float, box: Box) -> mi.Float:
    """Share of the kernel around ``point``, a ``Point3f`` in the box, that lies in it. Recorded on the device.

    On a line by the kernel's integral. In the plane as a sum over the wedges between the point and each of the four
    sides: ``int M(min(a / cos(phi), reach)) dphi / 2 pi``, where M is the kernel's share in a disc, and a the distance
    of the side. The part where the side is out of reach has a closed form; the rest is by quadrature, with an error of
    some 1e-4.
    """
    ends = [_distances(point[axis], axis, bandwidth, box) for axis in range(box.dimension)]
    if box.dimension == 1:
        return kernel.mass(ends[0][0], 1) + kernel.mass(ends[0][1], 1)
    share: mi.Float = mi.Float(0)
    for axis in (0, 1):
        left, right = ends[1 - axis]
        for distance in ends[axis]:
            share = share + _wedge(kernel, distance, left) + _wedge(kernel, distance, right)
    return share


def _distances(x: mi.Float, axis: int, bandwidth: mi.Float, box: Box) -> tuple[mi.Float, mi.Float]:
    """Distances to both ends of the box, in bandwidths."""
    low, high = (dr.opaque(mi.Float, end) for end in (box.lower[axis], box.upper[axis]))
    return dr.maximum(x - low, 0) / bandwidth, dr.maximum(high - x, 0) / bandwidth


def _wedge(kernel: Kernel, distance: mi.Float, along: mi.Float) -> mi.Float:
    """Share in the triangle of the point, its foot on a side, and a corner at the distance ``along`` from the foot."""
    angle = dr.atan2(along, distance)
    met = dr.minimum(angle, dr.acos(dr.minimum(distance / kernel.reach, 1.0)))
    total: mi.Float = angle - met
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        # For a close side 1 / cos is steep at the end, so nodes are denser there.
        s = 0.5 * (node + 1)
        phi = met * (s * (2 - s))
        radius = dr.minimum(distance / dr.maximum(dr.cos(phi), 1e-9), kernel.reach)
        total = total + float(weight * (1 - s)) * met * kernel.mass(radius, 2)
    return total * (1 / (2 * math.pi))
