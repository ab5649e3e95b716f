r"""Ambient terms: light that is not traced any further, distributed over surfaces by the directions that they face.

Each surface i belongs to classes k of normals, with weights mu_ik that sum to 1: to a single class (``classic``), to
the nearest of the six axis directions (``crisp``), or to up to three of these, weighted by the squares of the
components of the normal (``fuzzy``). Light of the power U_i leaves the surfaces and is reflected among them any number
of times. With the sums A_k, U_k of areas and powers of a class and its mean reflectance rho_k,

.. math:: B_k = U_k / A_k + \rho_k H_k, \quad H_k = \sum_j F_{kj} B_j, \quad H_i = \sum_k \mu_{ik} H_k

is the irradiance of a surface [Castro 2002, ch. 6]. Visibility is ignored: the cost is that of sums over surfaces, and
of a 6 x 6 system for each channel.

Class form factors. In the thesis no class sees itself, and each sees the five others equally: F_kk = 0, F_kj = 1/5, as
in a cube. In a room of other proportions these factors create or lose light, since A_k F_kj is not A_j F_jk. Here
F_kj = x_k x_j / A_k for j other than k, with the x for which rows sum to 1. For equal areas these factors are 1/5; for
any areas they conserve light. A class with more than half of the area sees itself with the remaining share.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from etendue.core import Array

from .errors import SurfaceError

AmbientTerm = Literal["classic", "crisp", "fuzzy"]
AMBIENT_TERMS: tuple[AmbientTerm, ...] = ("classic", "crisp", "fuzzy")

_NO_END = "light that nothing absorbs has no end: an ambient term needs a reflectance below 1"
#: Normals of the classes: +x, -x, +y, -y, +z, -z.
CLASS_NORMALS: Array = np.stack([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)])


def class_light(
    weights: Array,
    areas: Array,
    reflectance: Array,
    power: Array,
    *,
    lost: Array | None = None,
    factors: Callable[[Array], Array] | None = None,
) -> Array:
    """Irradiance (k, c) of classes from ``power`` (n, c) that leaves surfaces with ``areas`` (n,) and ``reflectance``
    (n, c). The product of ``weights`` (n, k), of :func:`class_weights`, and the result is the irradiance of surfaces.

    lost: (n,) the share of the light leaving each surface that meets no other surface, such as light that escapes to
        the sky; none by default.
    factors: form factors (k, k) as a function of the areas (k,) of classes; :func:`class_factors` by default.

    Raises :class:`SurfaceError` if nothing absorbs light.
    """
    if (lost is None or not lost.any()) and ((reflectance >= 1).all(axis=0) & power.any(axis=0)).any():
        raise SurfaceError(_NO_END)
    by_class = weights.T @ areas
    inverse = np.divide(1.0, by_class, out=np.zeros_like(by_class), where=by_class > 0)[:, None]
    source, rho = ((weights.T @ values) * inverse for values in (power, areas[:, None] * reflectance))
    kept = np.ones_like(by_class)
    if lost is not None:
        kept = np.maximum(1 - (weights.T @ (areas * lost)) * inverse[:, 0], 0.0)
    return incoming(source, rho, kept[:, None] * (factors or class_factors)(by_class * kept))


def incoming(source: Array, reflectance: Array, factors: Array) -> Array:
    """Irradiance (k, c) of classes: F (1 - rho F)^-1 ``source`` (k, c), with ``reflectance`` (k, c) and ``factors`` (k,
    k). Raises :class:`SurfaceError` if nothing absorbs light."""
    systems = np.eye(len(factors)) - reflectance.T[:, :, None] * factors
    try:
        radiosity = np.linalg.solve(systems, source.T[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        raise SurfaceError(_NO_END) from None
    light: Array = factors @ radiosity.T
    return light


def class_weights(term: AmbientTerm, normals: Array) -> Array:
    """(n, k) shares of each class in surfaces with ``normals`` (n, 3), which sum to 1. A surface without a normal has
    equal shares of all. Raises :class:`SurfaceError` for a term that does not exist."""
    if term not in AMBIENT_TERMS:
        raise SurfaceError(f"there is no ambient term {term!r}; there are: {', '.join(AMBIENT_TERMS)}")
    if term == "classic":
        return np.ones((len(normals), 1))
    # Classes first: short last axes are slow.
    components = np.ascontiguousarray(normals.T)
    shares = np.square(components)
    length = shares[0] + shares[1] + shares[2]
    if term == "crisp":
        axis = np.where(shares[2] > np.maximum(shares[0], shares[1]), 2, shares[1] > shares[0])
        shares, length = (axis == np.arange(3)[:, None]).astype(np.float64), np.sign(length)
    shares /= np.where(length > 0, length, 1.0)
    weights = np.zeros((len(CLASS_NORMALS), len(normals)))
    weights[::2], weights[1::2] = shares * (components > 0), shares * (components < 0)
    weights[:, length == 0] = 1 / len(CLASS_NORMALS)
    return weights.T


def class_factors(areas: Array) -> Array:
    """Class form factors (k, k) that are reciprocal and whose rows sum to 1 for any ``areas`` (k,). No class sees
    itself, unless it has more than half of the area. A class without area neither emits nor receives light; its row
    is in proportion to ``areas``."""
    count, largest = len(areas), int(np.argmax(areas))
    rest = areas.sum() - areas[largest]
    exchange = np.zeros((count, count))
    if areas[largest] >= rest:
        exchange[largest] = exchange[:, largest] = areas
        exchange[largest, largest] = areas[largest] - rest
    else:
        x = _scaling(areas / areas.sum(), largest)
        exchange = np.outer(x, x) * areas.sum()
        np.fill_diagonal(exchange, 0.0)
    exchange[areas <= 0] = areas
    sums = exchange.sum(axis=1, keepdims=True)
    factors: Array = np.divide(exchange, sums, out=np.zeros_like(exchange), where=sums > 0)
    return factors


def _scaling(areas: Array, largest: int) -> Array:
    """x with x_k (X - x_k) = A_k, where X is the sum of x: by bisection of X; each x_k solves a quadratic equation."""

    def roots(total: float) -> Array:
        return (total - np.sqrt(np.maximum(total * total - 4 * areas, 0.0))) / 2

    low = 2 * float(np.sqrt(areas[largest]))
    # If the lesser roots do not add up to X at the smallest possible X, the largest class takes the greater root.
    upper = roots(low).sum() < low

    def excess(total: float) -> float:
        x = roots(total)
        return float(x.sum() - 2 * x[largest] if upper else total - x.sum())

    high = 2 * low
    while excess(high) < 0:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    x = roots(high)
    if upper:
        x[largest] = high - x[largest]
    return x
