"""Surfaces of View3D's input, ``.vs3`` (formats F 3 and F 3a), and View2D's, ``.vs2``, as NIST's programs read it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from etendue.core import Array, logger

from ..errors import PatchError
from .surfacefiles import MeshFile, Surface, mesh_of

#: Keys of the record C, in lower case: they control View3D's integration and output, and change no surface.
_KEYS = ("eps", "epsu", "epso", "maxu", "maxo", "mino", "row", "col", "encl", "emit", "out", "list", "prjd", "maxv")
#: Numbers of a surface of format 3a after its place and angles, by the letter of its shape.
_SHAPES = {"R": 2, "T": 6, "Q": 8}
#: From one end of a surface of View2D to the other; lengths along its base below which a place is the same.
_ALONG, _SAME = np.array([0.0, 1.0, 0.0]), 1e-6


def read_vs3(path: Path) -> MeshFile:
    """The surfaces, with their ``emissivity``.

    A surface with a base is cut from it, one that is combined with another is the same patch, obstacles (``O``) only
    occlude; null surfaces (``N``) are cut from their base and only occlude, too. Raises :class:`PatchError` for masks
    (``M``), other geometries, and what View3D refuses.
    """
    reader = _Reader(path)
    surfaces = reader.surfaces()
    emissivity = np.array([surface.values["emissivity"] for surface in surfaces])
    return mesh_of(path, surfaces, {"reflectance": 1 - emissivity})


def read_vs2(path: Path) -> MeshFile:
    """The surfaces of the plane x, z, each a rectangle of length 1 along y, in which they are repeated without end.

    The front is to the left of the way from the first vertex to the second one. The rest is as in :func:`read_vs3`.
    Raises :class:`PatchError`, also for surfaces that another one hides from all others (the number after their
    vertices).
    """
    reader = _Reader(path, "2")
    surfaces = reader.surfaces()
    # The rest of a base in several pieces is one patch.
    surfaces += [piece for base in surfaces if base.inside for piece in _cut_along(path, base)]
    emissivity = np.array([surface.values["emissivity"] for surface in surfaces])
    mesh = mesh_of(path, surfaces, {"reflectance": 1 - emissivity})
    return replace(mesh, period=(0.0, 1.0))


def _cut_along(path: Path, base: Surface) -> list[Surface]:
    """Leave the first piece of what surfaces inside a base leave of it along x, z, and return the others."""
    a, b = base.outline[0], base.outline[1]
    along = (b - a) / np.linalg.norm(b - a)
    places = [0.0]
    for inner in sorted(base.inside, key=lambda surface: float(((surface.outline - a) @ along).min())):
        ends = (inner.outline[:2] - a) @ along
        off = np.linalg.norm(inner.outline[:2] - a - ends[:, None] * along, axis=1).max()
        slack = _SAME * np.linalg.norm(b - a)
        ends.sort()  # a null surface faces its base
        if off > slack or ends[0] < places[-1] - slack or ends[1] > np.linalg.norm(b - a) + slack:
            raise PatchError(
                f"{path}, {inner.where}: '{inner.name}' in '{base.name}' is not in its line, or not apart from others"
            )
        places += [max(ends[0], places[-1]), ends[1]]
    places.append(max(float(np.linalg.norm(b - a)), places[-1]))
    pieces = [a + np.array(ends)[:, None] * along for ends in zip(places[::2], places[1::2], strict=True)]
    outlines = [np.concatenate([ends, ends[::-1] + _ALONG]) for ends in pieces if np.ptp(ends, axis=0).max() > slack]
    # A surface of which nothing is left keeps its row, as a face without area.
    base.outline, base.inside = outlines[0] if outlines else base.outline[[0, 0, 0]], []
    return [replace(base, outline=outline, one_with=base.one_with or base) for outline in outlines[1:]]


class _Reader:
    def __init__(self, path: Path, geometry: str = "") -> None:
        self._path, self._line, self._format = path, 0, geometry
        self._is_flat = geometry == "2"
        self._program = "View2D" if self._is_flat else "View3D"
        self._points: list[list[float]] = []
        self._surfaces: list[Surface] = []
        self._lines = self._records(path.read_text("utf-8", errors="replace"))

    def _records(self, text: str) -> Iterator[list[str]]:
        """The words of each line without comments."""
        for self._line, line in enumerate(text.splitlines(), 1):
            words = line.split("!")[0].split("/")[0].split()
            if words:
                yield words

    def _error(self, what: str) -> PatchError:
        return PatchError(f"{self._path}, line {self._line}: {what}")

    def surfaces(self) -> list[Surface]:
        for words in self._lines:
            kind = words[0][0].upper()
            if kind in "E*":
                break
            try:
                self._read(kind, words[1:])
            except (ValueError, IndexError):
                raise self._error(f"record {kind} is incomplete, or has a word in place of a number") from None
        if not self._surfaces:
            raise PatchError(f"{self._path} has no surfaces of {self._program}")
        return self._surfaces

    def _read(self, kind: str, words: list[str]) -> None:
        if kind == "T":
            return
        if kind == "C":
            self._control(words)
        elif kind == "F" or (kind == "G" and self._is_flat):
            self._format = words[0].lower()
            if self._format not in (known := ("2",) if self._is_flat else ("3", "3a")):
                raise self._error(f"geometry '{words[0]}' is not known: there is {' and '.join(known)}")
        elif kind == "V":
            if int(words[0]) != len(self._points) + 1:
                raise self._error(f"vertex {words[0]} comes after vertex {len(self._points)}: number them in sequence")
            across = [float(words[1]), 0.0, float(words[2])]
            self._points.append(across if self._is_flat else [*across[::2], float(words[3])])
        elif kind in "SON":
            self._surface(kind, words)
        elif kind == "M":
            raise self._error("masks (M) are not supported: make what they hide of the base a null surface (N)")
        else:
            raise self._error(f"record '{kind}' is not known")

    def _control(self, words: list[str]) -> None:
        # View2D's numbers have no keys.
        pairs = [word.partition("=") for word in words if "=" in word or not self._is_flat]
        for key, _, value in pairs:
            if key.lower() == "maxd":
                logger.warning("%s: form factors of surfaces further apart than maxD=%s are kept", self._path, value)
            elif key.lower() not in _KEYS:
                logger.warning("%s, line %d: '%s' is no key of %s", self._path, self._line, key, self._program)

    def _surface(self, kind: str, words: list[str]) -> None:
        if not self._format:
            raise self._error("the record F, with the geometry, comes before surfaces")
        number, where = int(words[0]), f"line {self._line}"
        if number != len(self._surfaces) + 1:
            raise self._error(f"surface {number} comes after surface {len(self._surfaces)}: number them in sequence")
        rest = words[2:] if self._format == "3a" else words[5:]
        if self._is_flat:
            rest = words[4:]
            if kind == "S" and int(words[3]):
                raise self._error(f"surface {number} is hidden by obstacle {words[3]}: write 0, and the obstacle apart")
        base, combined = (int(word) for word in [*rest, "0", "0"][:2]) if kind == "O" else (int(w) for w in rest[:2])
        emissivity = float(rest[2]) if kind == "S" else 0.0
        if not 0 <= emissivity <= 1:
            raise self._error(f"surface {number} has the emissivity {emissivity:g}, which is not in [0, 1]")
        name = rest[3] if len(rest) > 3 else str(number)
        if kind == "O" and (base or combined):
            raise self._error(f"obstacle {number} has a base, or is combined with a surface")
        if kind == "N" and (base == 0 or combined):
            raise self._error(f"null surface {number} has no base, or is combined with a surface")
        outline = self._local(words[1].upper()) if self._format == "3a" else self._corners(words[1:5])
        surface = Surface(outline=outline, name=name, where=where, obstacle=kind in "ON")
        surface.values["emissivity"] = emissivity
        if base:
            self._earlier(base, number, "base").inside.append(surface)
            self._check_turn(surface, self._surfaces[base - 1], kind)
        if combined:
            surface.one_with = self._earlier(combined, number, "combined surface")
            if surface.one_with.one_with is not None:
                raise self._error(f"surface {combined}, with which {number} is combined, is combined itself")
        self._surfaces.append(surface)

    def _earlier(self, number: int, of: int, what: str) -> Surface:
        if not 1 <= number < of or self._surfaces[number - 1].obstacle:
            raise self._error(f"the {what} {number} of surface {of} is no earlier surface")
        return self._surfaces[number - 1]

    def _check_turn(self, surface: Surface, base: Surface, kind: str) -> None:
        one, other = (np.cross(s.outline[1] - s.outline[0], s.outline[2] - s.outline[0]) for s in (surface, base))
        if (one @ other > 0) != (kind == "S"):
            way = "the same way as" if kind == "S" else "its base:"
            raise self._error(
                f"surface {surface.name} faces {way} surface {base.name}, by {self._program}'s rule; turn it"
            )

    def _corners(self, words: list[str]) -> Array:
        """Of four numbers of vertices, the last 0 for a triangle; of a surface of the plane of two."""
        numbers = [int(word) for word in (words[:2] if self._is_flat else words if int(words[3]) else words[:3])]
        bad = next((k for k in numbers if not 1 <= k <= len(self._points)), None)
        if bad is not None:
            raise self._error(f"there is no vertex {bad}; there are {len(self._points)}")
        corners = np.array([self._points[k - 1] for k in numbers])
        return np.concatenate([corners, corners[::-1] + _ALONG]) if self._is_flat else corners

    def _local(self, shape: str) -> Array:
        """Corners of a surface of format 3a: place, azimuth and tilt of its plane, and a shape in it, in the next
        lines."""
        if shape not in _SHAPES:
            raise self._error(f"the shape '{shape}' is not known: there are {', '.join(_SHAPES)}")
        wanted = 5 + _SHAPES[shape]
        numbers: list[float] = []
        while len(numbers) < wanted:
            numbers += [float(word) for word in next(self._lines, ["end"])]
        place, (azimuth, tilt) = np.array(numbers[:3]), np.radians(numbers[3:5])
        rest = numbers[5:wanted]
        if shape == "R":
            width, height = rest
            rest = [0.0, height, 0.0, 0.0, width, 0.0, width, height]
        right = np.array([-np.cos(azimuth), np.sin(azimuth), 0.0])
        up = np.array([-np.cos(tilt) * np.sin(azimuth), -np.cos(tilt) * np.cos(azimuth), np.sin(tilt)])
        return place + np.array(rest).reshape(-1, 2) @ np.stack([right, up])
