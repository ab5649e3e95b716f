"""Kinds of parameters: their values as plain lists, ranges, and conversions for Mitsuba."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from etendue.core import Array, OptionError, is_number

#: A value as JSON holds it: a number; three numbers (colours, vectors); 9 or 16 (transforms, row by row); a file.
Value = float | list[float] | str

#: Kinds of parameters.
COLOUR: Final = "colour"
NUMBER: Final = "number"
VECTOR: Final = "vector"
TRANSFORM: Final = "transform"
TEXTURE: Final = "texture"

_COUNTS = {COLOUR: 3, VECTOR: 3}
#: Smallest determinant, relative to the largest entry, of a transform that is invertible in single precision.
_SINGULAR = 1e-12

#: Names of parameters that are shares, of light or of another quantity.
_SHARES = frozenset(
    (
        *("reflectance", "diffuse_reflectance", "specular_reflectance", "specular_transmittance", "base_color"),
        *("diffuse_transmittance", "opacity", "weight", "color0", "color1", "clearcoat", "clearcoat_gloss"),
        *("metallic", "roughness", "anisotropic", "specular", "spec_tint", "sheen", "sheen_tint", "spec_trans"),
        *("flatness", "albedo"),
    )
)
_ANGLES = frozenset({"cutoff_angle", "beam_width"})
_WIDTHS = frozenset({"alpha", "alpha_u", "alpha_v"})
_NOT_NEGATIVE = frozenset(
    ("radiance", "intensity", "irradiance", "dimming", "scale", "k", "exponent", "turbidity", "sigma_t")
)


@dataclass(frozen=True)
class Range:
    """Numbers that a parameter may have. ``above``: whether ``least`` itself is excluded."""

    least: float = -math.inf
    most: float = math.inf
    above: bool = False

    def refusal(self, number: float) -> str | None:
        """Why ``number`` is not in the range; ``None`` if it is."""
        if not math.isfinite(number):
            return f"finite, not {number}"
        if number < self.least or (self.above and number == self.least):
            return f"{'above' if self.above else 'at least'} {self.least:g}, not {number:g}"
        if number > self.most:
            return f"at most {self.most:g}, not {number:g}"
        return None


def range_of(name: str, of_light: bool) -> Range:
    """The range of a parameter by its name. ``of_light``: whether it belongs to a light."""
    if name in _SHARES:
        return Range(0.0) if of_light else Range(0.0, 1.0)
    if name in _ANGLES:
        return Range(0.0, 180.0, above=True)
    if name in _WIDTHS:
        return Range(0.0, 1.0, above=True)
    if name == "eta":
        return Range(0.0)
    if name == "flux":
        return Range(0.0, above=True)
    if name == "g":  # of a phase function
        return Range(-0.999, 0.999)
    return Range(0.0) if name in _NOT_NEGATIVE else Range()


def kind_of(value: Any) -> str | None:
    """The kind of a value that ``mi.traverse`` reports; ``None`` for one that cannot be edited."""
    name = type(value).__name__
    if name.startswith("Color3"):
        return COLOUR
    if "Transform" in name:
        return TRANSFORM
    if "Point3" in name or "Vector3" in name:
        return VECTOR
    if "Tensor" in name:
        return TEXTURE
    number = isinstance(value, float) or name in ("Float", "Float32", "Float64")
    return NUMBER if number and np.asarray(value).size == 1 else None


def plain(value: Any, kind: str) -> Value:
    """A value of Mitsuba as JSON holds it; a texture becomes the text of its size."""
    if kind == TEXTURE:
        return " x ".join(str(n) for n in value.shape[1::-1])
    array = np.asarray(value.matrix if kind == TRANSFORM else value, dtype=np.float64).ravel()
    # The shortest decimals of the same single-precision number.
    numbers = [float(str(np.float32(number))) for number in array]
    return numbers[0] if kind == NUMBER else numbers


def checked(key: str, kind: str, allowed: Range, value: Any) -> Value:
    """``value`` converted to its kind. Raises :class:`OptionError` for another type, a number that is not finite or out
    of range, a transform that cannot be inverted, and a missing file."""
    if kind == TEXTURE:
        if not isinstance(value, str) or not Path(value).is_file():
            raise OptionError(f"'{key}' needs a picture file, and there is none at {value!r}")
        return str(Path(value).absolute())
    if kind == NUMBER:
        numbers: Sequence[Any] = [value]
    else:
        numbers = value if isinstance(value, (list, tuple)) else []
        counts = (9, 16) if kind == TRANSFORM else (_COUNTS[kind],)
        if len(numbers) not in counts:
            raise OptionError(f"'{key}' needs {' or '.join(map(str, counts))} numbers, not {value!r}")
    for number in numbers:
        if not is_number(number):
            raise OptionError(f"'{key}' needs {'a number' if kind == NUMBER else 'numbers'}, not {number!r}")
        if (why := allowed.refusal(float(number))) is not None:
            raise OptionError(f"'{key}' must be {why}")
    result = [float(number) for number in numbers]
    if kind == TRANSFORM:
        _check_matrix(key, np.array(result).reshape(3 if len(result) == 9 else 4, -1))
    return result[0] if kind == NUMBER else result


def for_file(kind: str, value: Value) -> Any:
    """The property of Mitsuba's parser for a value."""
    import mitsuba as mi

    if kind == COLOUR:
        return mi.ScalarColor3d(*_numbers(value))
    if kind == VECTOR:
        return mi.ScalarPoint3d(*_numbers(value))
    if kind == TRANSFORM:
        return mi.ScalarTransform4d(_four_by_four(_numbers(value)).tolist())
    return value


def for_scene(current: Any, kind: str, value: Value) -> Any:
    """``value`` as the type that the parameter ``current`` of a built scene has."""
    import mitsuba as mi

    if kind == NUMBER:
        return type(current)(value)
    if kind == TRANSFORM:
        matrix = np.array(_numbers(value))
        return type(current)(matrix.reshape(3 if matrix.size == 9 else 4, -1).tolist())
    numbers = _numbers(value)
    return type(current)(*numbers) if kind == VECTOR else mi.Color3f(*numbers)


def _numbers(value: Value) -> list[float]:
    assert isinstance(value, list)
    return value


def _four_by_four(numbers: list[float]) -> Array:
    """The 4x4 transform for a file, also from the 3x3 transform of texture coordinates."""
    if len(numbers) == 16:
        return np.array(numbers).reshape(4, 4)
    matrix, flat = np.eye(4), np.array(numbers).reshape(3, 3)
    matrix[:2, :2], matrix[:2, 3] = flat[:2, :2], flat[:2, 2]
    return matrix


def _check_matrix(key: str, matrix: Array) -> None:
    last = np.eye(len(matrix))[-1]
    if not np.allclose(matrix[-1], last):
        raise OptionError(f"the last row of '{key}' must be {' '.join(f'{v:g}' for v in last)}")
    part = matrix[:-1, :-1]
    size = float(np.abs(part).max())
    if size == 0.0 or abs(np.linalg.det(part / size)) < _SINGULAR:
        raise OptionError(f"'{key}' would make the element flat; give a transform that can be inverted")
