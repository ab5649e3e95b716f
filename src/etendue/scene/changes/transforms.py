"""Transforms of scene elements: broken ones are found, and the scale of an element that can only be turned is removed.

Mitsuba 3.9 stores a transform as a matrix and its inverse, multiplied in turn. It does not normalise the axis of a
rotation and takes the transpose as inverse, so the two disagree for an axis that is not of unit length. The direction
of a light without extent is transformed by one or the other and is not normalised, so a scale changes its light
differently in each function of the emitter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import Array, SceneError, as_array

from ..parsing import read_property
from ..space import warn_once

if TYPE_CHECKING:
    import mitsuba as mi

#: Emitters of whose ``to_world`` only position and rotation (or reflection) are meant.
_TURNED = ("envmap", "sunsky", "sky", "directional", "spot", "projector", "luminaire")
#: Largest relative difference of lengths, and deviation from right angles, that counts as rounding.
_TOLERANCE = 5e-3
#: Relative difference from which on a matrix is replaced; the unit of rounding of single precision; and the product of
#: the norms of matrix and inverse from which on a matrix is singular.
_EXACT, _STEP, _FLAT = 1e-5, 2.0**-23, 1e12


def fault(kind: str, key: str, transform: Any) -> str | None:
    """Why the transform ``key`` of an element of the plugin ``kind`` cannot be used, with a remedy; None if it can."""
    part, inverse = _parts(transform)
    difference = _difference(part, inverse)
    # Of a point light only the position is used, of built textures' transforms, (2, 2), only the matrix.
    if kind == "point" or len(part) < 3 or (difference < _EXACT and kind not in _TURNED):
        return None
    if not np.isfinite(part).all():  # reported elsewhere
        return None
    size = np.linalg.norm(part) * np.linalg.norm(inverse)
    if not size < _FLAT:
        return None if key == "to_uv" else f"has a '{key}' that flattens it; give it a scale other than 0"
    if difference > _TOLERANCE + 4.0 * _STEP * size:
        return (
            f"has a '{key}' whose inverse is another transform: a rotation about an axis that is not of unit length, "
            "which Mitsuba does not normalise; divide the axis by its length"
        )
    if kind in _TURNED and np.abs(part.T @ part - np.eye(3)).max() > 2.0 * _TOLERANCE:
        return f"has a '{key}' that scales or shears, which has no meaning for this emitter; give a rotation"
    return None


def misshapen(kind: str, transform: Any) -> str | None:
    """Why a built shape is not the sphere or circular cylinder that Mitsuba intersects; None if it is."""
    if kind not in ("sphere", "cylinder"):
        return None
    part, _ = _parts(transform)
    if kind == "cylinder":  # its length may have another scale than its radius
        part[:, 2] *= np.linalg.norm(part[:, :2]) / max(np.sqrt(2.0) * np.linalg.norm(part[:, 2]), 1e-300)
    if _stretch(part) <= _TOLERANCE:
        return None
    if kind == "sphere":
        return "has a 'to_world' that makes it an ellipsoid, which Mitsuba draws as a sphere; use a mesh"
    return "has a 'to_world' that makes it oblique or elliptic, which Mitsuba does not draw; use a mesh"


def mirrors(transform: Any) -> bool:
    """Whether a transform is a reflection."""
    return bool(np.linalg.det(_parts(transform)[0]) < 0.0)


def settle_transforms(state: mi.parser.ParserState, name: str, check: bool = True) -> None:
    """Correct the transforms of a parsed scene before its objects are built: the scale of an emitter that can only be
    turned is removed, with a warning, and rounding errors are removed. ``name`` is the scene's.

    With ``check``, raises :class:`SceneError` for a transform that cannot be used.
    """
    import mitsuba as mi

    for node in state.nodes:
        for key in ("to_world", "to_uv"):
            if key not in node.props or "Transform" not in type(transform := read_property(node.props, key)).__name__:
                continue
            kind = node.props.plugin_name()
            if key == "to_world" and (matrix := _settled(kind, transform, f"{name}: {_called(node)}")) is not None:
                node.props[key] = transform = mi.ScalarTransform4d(matrix)
            if check and (why := fault(kind, key, transform)) is not None:
                raise SceneError(f"{name}: {_called(node)} {why}")


def _settled(kind: str, transform: Any, called: str) -> Array | None:
    """The matrix (4, 4) that replaces a ``to_world``; None if it stays as it is."""
    part, inverse = _parts(transform)
    difference, rounded = _difference(part, inverse), kind in (*_TURNED, "sphere")
    if difference < _EXACT and not rounded:
        return None
    if fault("", "to_world", transform) is not None or (rounded and _stretch(part) > _TOLERANCE):
        return None
    exact = part
    if rounded:
        left, sizes, right = np.linalg.svd(part)
        scale = float(sizes.mean())
        exact = left @ right * (scale if kind == "sphere" else 1.0)
        if kind != "sphere" and abs(scale - 1.0) > _TOLERANCE:
            warn_once(f"{called} has a scale of {scale:.4g}, which is left out: only its rotation has a meaning")
    if difference < _EXACT and np.abs(exact - part).max() < _EXACT * np.abs(part).max():
        return None
    matrix = as_array(transform).astype(np.float64).reshape(4, 4)
    matrix[:3, :3] = exact
    return matrix


def _parts(transform: Any) -> tuple[Array, Array]:
    """The linear parts of a transform and of its inverse, (3, 3), or (2, 2) of a built texture."""
    side = 3 if "3" in type(transform).__name__ else 4
    part, transposed = (
        as_array(matrix).astype(np.float64).reshape(side, side)[:-1, :-1]
        for matrix in (transform.matrix, transform.inverse_transpose)
    )
    return part, transposed.T


def _difference(part: Array, inverse: Array) -> float:
    """The largest entry by which the product of a matrix and its inverse differs from the identity."""
    with np.errstate(invalid="ignore"):  # a flat transform
        return float(np.abs(part @ inverse - np.eye(len(part))).max())


def _stretch(part: Array) -> float:
    """Deviation from a rotation with a uniform scale, relative to the scale."""
    square = part.T @ part
    return float(np.abs(square / max(np.trace(square) / 3.0, 1e-300) - np.eye(3)).max())


def _called(node: mi.parser.SceneNode) -> str:
    """``TYPE 'ID' of type 'PLUGIN'``, without the id if the scene gave none."""
    role, own, kind = node.type.name.lower(), str(node.props.id()), node.props.plugin_name()
    return f"{role} of type '{kind}'" if own.startswith("_unnamed") or not own else f"{role} '{own}' of type '{kind}'"
