"""Meters: where light is measured, and files of their places."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array

from .errors import LightingError

Quantity = Literal["irradiance", "radiance", "cylindrical", "spherical"]
#: What meters measure: light on a plane, from a direction, and the mean on the sides of a small cylinder around the
#: direction, or on a small sphere.
QUANTITIES: tuple[Quantity, ...] = ("irradiance", "radiance", "cylindrical", "spherical")
#: Numbers of a meter: a point and a direction.
_COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
_SEPARATORS = re.compile(r"[,;\s]+")


@dataclass(frozen=True)
class Meters:
    """Points at which light is measured.

    Attributes
    ----------
    points: (n, 3), in the scene's own coordinates.
    directions: (n, 3), unit vectors: the normal of a meter of irradiance, the direction in which a meter of radiance
        looks, the axis of a cylinder; without effect for a sphere.
    quantity: ``irradiance``, all light that arrives on a plane; ``radiance``, the light from one direction; mean
        ``cylindrical`` or ``spherical`` irradiance, on the sides of a small cylinder or on a small sphere.
    names: one for each meter; empty if they have none.
    cells: numbers of meters along both edges of a grid, see :meth:`grid`.

    Raises :class:`LightingError` for arrays of other shapes, numbers that are not finite, and directions of length 0.
    """

    points: Array
    directions: Array
    quantity: Quantity = "irradiance"
    names: tuple[str, ...] = ()
    cells: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise LightingError(f"meters measure one of {', '.join(QUANTITIES)}, not {self.quantity!r}")
        points, directions = (
            _vectors(f"the {what} of meters", v)
            for what, v in (("points", self.points), ("directions", self.directions))
        )
        if not len(points):
            raise LightingError("there are no meters; give at least one point")
        if len(directions) == 1:
            directions = np.broadcast_to(directions, points.shape)
        if len(directions) != len(points):
            raise LightingError(f"there are {len(points)} points of meters, but {len(directions)} directions")
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        if not (length > 0.0).all():
            raise LightingError(f"meter {int(np.argmin(length))} has a direction of length 0; give it a normal")
        if self.names and len(self.names) != len(points):
            raise LightingError(f"there are {len(points)} meters, but {len(self.names)} names")
        if self.cells is not None:
            object.__setattr__(self, "cells", tuple(map(int, self.cells)))
            if np.prod(self.cells) != len(points):
                raise LightingError(f"there are {len(points)} meters, but {'x'.join(map(str, self.cells))} cells")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "directions", directions / length + 0.0)  # no -0 in tables

    def __len__(self) -> int:
        return len(self.points)

    def to_dict(self) -> dict[str, Any]:
        """The arguments of equal meters, ready for JSON."""
        return {
            "points": self.points.tolist(),
            "directions": self.directions.tolist(),
            "quantity": self.quantity,
            "names": list(self.names),
            "cells": self.cells and list(self.cells),
        }

    @classmethod
    def grid(
        cls,
        corner: ArrayLike,
        u: ArrayLike,
        v: ArrayLike,
        cells: Sequence[int],
        quantity: Quantity = "irradiance",
    ) -> Meters:
        """Meters in the middles of ``cells`` = (along u, along v) equal cells of the parallelogram with a ``corner``
        and edges ``u``, ``v``; row by row, u first. They face u x v. Raises :class:`LightingError`."""
        named = {"corner": corner, "u": u, "v": v}
        (origin,), (a,), (b,) = (_vectors(f"{k} of a grid", np.atleast_2d(w)) for k, w in named.items())
        if len(cells) != 2 or min(cells) < 1:
            raise LightingError(f"a grid has one cell at least along each edge, as 40x30, not {tuple(cells)}")
        normal = np.cross(a, b)
        if not np.linalg.norm(normal) > 1e-12 * np.linalg.norm(a) * np.linalg.norm(b):
            raise LightingError("the edges of a grid are parallel or of length 0; give two that span a plane")
        s, t = ((np.arange(n) + 0.5) / n for n in cells)
        points = origin + s[None, :, None] * a + t[:, None, None] * b
        return cls(points.reshape(-1, 3), normal[None], quantity, cells=(cells[0], cells[1]))

    @classmethod
    def read(cls, path: Path, quantity: Quantity = "irradiance") -> Meters:
        """Meters of a text file: a line for each, with x, y, z and the direction nx, ny, nz, separated by commas,
        semicolons or blanks, as in Radiance's files of sensors. Lines that begin with ``#`` are left out.

        A first line of names has ``x,y,z,nx,ny,nz`` in any order, and perhaps ``name``; other columns are ignored.
        Raises :class:`LightingError`, with the line, for anything else.
        """
        try:
            text = path.read_text("utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not text"
            raise LightingError(f"cannot read the meters in '{path}': {reason}") from error
        lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"]
        if not lines:
            raise LightingError(f"'{path}' has no meters; a line is x,y,z,nx,ny,nz")
        heads = [word.lower() for word in _words(lines[0][1])]
        named = set(_COLUMNS) <= set(heads)
        if named:
            lines = lines[1:]
        elif any(word.isalpha() and word not in ("nan", "inf") for word in heads):
            raise LightingError(f"the first line of '{path}' names columns, but not all of {','.join(_COLUMNS)}")
        columns = [heads.index(name) for name in _COLUMNS] if named else list(range(6))
        rows, names = [], []
        for number, line in lines:
            words = _words(line)
            try:
                rows.append([float(words[k]) for k in columns])
                if named and "name" in heads:
                    names.append(words[heads.index("name")])
            except (IndexError, ValueError):
                raise LightingError(
                    f"line {number} of '{path}' is no meter: {line.strip()[:40]!r}; it has x,y,z,nx,ny,nz"
                ) from None
        found = np.array(rows).reshape(-1, 6)
        return cls(found[:, :3], found[:, 3:], quantity, tuple(names))


def _words(line: str) -> list[str]:
    """The fields of a line; names in quotation marks may contain commas."""
    for separator in ",;":
        if separator in line:
            return [word.strip() for word in next(csv.reader([line], delimiter=separator))]
    return _SEPARATORS.split(line.strip())


def _vectors(what: str, values: ArrayLike) -> Array:
    try:
        result = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        result = np.zeros(0)
    if result.ndim != 2 or result.shape[1] != 3:
        raise LightingError(f"{what}: three numbers each, (n, 3), not an array of shape {np.shape(values)}")
    if not np.isfinite(result).all():
        raise LightingError(f"{what}: number {int(np.argmin(np.isfinite(result).all(axis=1)))} is not finite")
    return result
