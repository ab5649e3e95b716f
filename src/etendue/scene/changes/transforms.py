"""Transforms of scene elements: broken ones are found, and the scale of an element that can only be turned is removed.

Mitsuba 3.9 stores a transform as a matrix and its inverse, multiplied in turn. It does not normalise the axis of a
rotation and takes the transpose as inverse, so the two disagree for an axis that is not of unit length. The direction
of a light without extent is transformed by one or the other and is not normalised, so a scale changes its light
differently in each function of the emitter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import Array, SceneError

from ..parsing import read_properties
from ..space import warn_once

if TYPE_CHECKING:
    import mitsuba as mi

#: Emitters of whose ``to_world`` only position and rotation (or reflection) are meant.
_TURNED = ("envmap", "sunsky", "directional", "spot", "projector")
#: Largest relative difference of lengths, and deviation from right angles, that counts as rounding.
_TOLERANCE = 5e-3
#: Relative difference from which on a matrix is replaced; and the unit of rounding of single precision.
_EXACT, _STEP = 1e-5, 2.0**-23


def fault(kind: str, key: str, transform: Any) -> str | None:
    """Why the transform ``key`` of an element of the plugin ``kind`` cannot be used, with a remedy; None if it can."""
    part, inverse = _linear(transform.matrix), _linear(transform.inverse().matrix)
    # Of a point light only the position is used, of built textures' transforms, (2, 2), only the matrix.
    if kind == "point" or len(part) < 3 or not np.isfinite(part).all():  # what is not finite is reported elsewhere
        return None
    if _is_flat(part) or not np.isfinite(inverse).all():
        return None if key == "to_uv" else f"has a '{key}' that flattens it; give it a scale other than 0"
    rounding = 4.0 * _STEP * np.linalg.norm(part) * np.linalg.norm(inverse)
    if np.abs(part @ inverse - np.eye(len(part))).max() > _TOLERANCE + rounding:
        return (
            f"has a '{key}' whose inverse is another transform: a rotation about an axis that is not of unit length, "
            "which Mitsuba does not normalise; divide the axis by its length"
        )
    if kind in _TURNED and np.abs(part.T @ part - np.eye(3)).max() > 2.0 * _TOLERANCE:
        return f"has a '{key}' that scales or shears, which has no meaning for this emitter; give a rotation"
    return None


def misshapen(kind: str, transform: Any) -> str | None:
    """Why a built shape is not the sphere or circular cylinder that Mitsuba intersects; None if it is."""
    part = _linear(transform.matrix)
    if kind == "sphere" and _stretch(part) > _TOLERANCE:
        return "has a 'to_world' that makes it an ellipsoid, which Mitsuba draws as a sphere; use a mesh"
    if kind == "cylinder":
        # The length may have another scale than the radius.
        part[:, 2] *= np.linalg.norm(part[:, :2]) / max(np.sqrt(2.0) * np.linalg.norm(part[:, 2]), 1e-300)
        if _stretch(part) > _TOLERANCE:
            return "has a 'to_world' that makes it oblique or elliptic, which Mitsuba does not draw; use a mesh"
    return None


def mirrors(transform: Any) -> bool:
    """Whether a transform is a reflection."""
    return bool(np.linalg.det(_linear(transform.matrix)) < 0.0)


def settle_transforms(state: mi.parser.ParserState, name: str, check: bool = True) -> None:
    """Correct the transforms of a parsed scene before its objects are built: the scale of an emitter that can only be
    turned is removed, with a warning, and rounding errors are removed. ``name`` is the scene's.

    With ``check``, raises :class:`SceneError` for a transform that cannot be used.
    """
    import mitsuba as mi

    for node in state.nodes:
        values = read_properties(node.props)
        for key in ("to_world", "to_uv"):
            if "Transform" not in type(values.get(key)).__name__:
                continue
            kind, transform = node.props.plugin_name(), values[key]
            if key == "to_world" and (matrix := _settled(kind, transform, f"{name}: {_called(node)}")) is not None:
                node.props[key] = transform = mi.ScalarTransform4d(matrix)
            if check and (why := fault(kind, key, transform)) is not None:
                raise SceneError(f"{name}: {_called(node)} {why}")


def _settled(kind: str, transform: Any, called: str) -> Array | None:
    """The matrix (4, 4) that replaces a ``to_world``; None if it stays as it is."""
    matrix = np.array(transform.matrix, np.float64).reshape(4, 4)
    part = matrix[:3, :3]
    if fault("", "to_world", transform) is not None:
        return None
    if kind in (*_TURNED, "sphere"):
        if _stretch(part) > _TOLERANCE:
            return None
        left, sizes, right = np.linalg.svd(part)
        scale = float(sizes.mean())
        part = left @ right
        if kind == "sphere":
            part *= scale
        elif abs(scale - 1.0) > _TOLERANCE:
            warn_once(f"{called} has a scale of {scale:.4g}, which is left out: only its rotation has a meaning")
    exact = np.abs(part @ _linear(transform.inverse().matrix) - np.eye(3)).max() < _EXACT
    if exact and np.abs(part - matrix[:3, :3]).max() < _EXACT * np.abs(part).max():
        return None
    matrix[:3, :3] = part
    return matrix


def _linear(matrix: Any) -> Array:
    """The linear part of a transform, (3, 3), or (2, 2) of a built texture."""
    values = np.asarray(matrix, np.float64).ravel()
    side = round(values.size**0.5)
    part: Array = values.reshape(side, side)[: side - 1, : side - 1].copy()
    return part


def _is_flat(part: Array) -> bool:
    sizes = np.linalg.svd(part, compute_uv=False)
    return bool(sizes[-1] <= 1e-12 * sizes[0])


def _stretch(part: Array) -> float:
    """Deviation from a rotation with a uniform scale, relative to the scale."""
    square = part.T @ part
    return float(np.abs(square / max(np.trace(square) / 3.0, 1e-300) - np.eye(3)).max())


def _called(node: mi.parser.SceneNode) -> str:
    """``TYPE 'ID' of type 'PLUGIN'``, without the id if the scene gave none."""
    role, own, kind = node.type.name.lower(), str(node.props.id()), node.props.plugin_name()
    return f"{role} of type '{kind}'" if own.startswith("_unnamed") or not own else f"{role} '{own}' of type '{kind}'"
