"""Surfaces of buildings and cities: EnergyPlus (epJSON, IDF), CityJSON and Honeybee (HBJSON)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from etendue.core import Array, logger

from ..errors import PatchError
from .energyplusfiles import BY_ANGLES, DETAILED, energyplus_surfaces, idf_objects, joined
from .surfacefiles import MeshFile, Surface, corners_of, mesh_of

#: Metres of the units of Honeybee.
_UNITS = {"Meters": 1.0, "Millimeters": 1e-3, "Centimeters": 1e-2, "Feet": 0.3048, "Inches": 0.0254}
#: Levels of lists around a surface of CityJSON, by the type of its geometry.
_DEPTHS = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}


def read_building(path: Path) -> MeshFile:
    """The surfaces of a file of EnergyPlus, CityJSON or Honeybee, told apart by their content.

    Surfaces of rooms face the room; windows and doors are cut from their walls. Groups are the ``zone`` of EnergyPlus,
    ``type`` and ``object`` of CityJSON, and the ``room`` of Honeybee. Air boundaries are openings, which join zones and
    rooms. Raises :class:`PatchError` for other files.
    """
    if path.suffix.lower() == ".idf":
        raw = path.read_bytes()
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:  # of old editors for Windows
            text = raw.decode("cp1252", errors="replace")
        data = idf_objects(path, text)
    else:
        try:
            data = json.loads(path.read_text("utf-8-sig"))
        except ValueError as error:
            raise PatchError(f"{path} is no JSON: {error}") from None
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "CityJSON":
        read = _city
    elif kind == "Model" and "rooms" in data:
        read = _honeybee
    elif isinstance(data, dict) and any(name in data for name in (*DETAILED, *BY_ANGLES)):
        read = energyplus_surfaces
    else:
        raise PatchError(f"{path} has no surfaces of EnergyPlus, CityJSON or Honeybee")
    try:
        surfaces = list(read(path, data))
    except KeyError as error:
        raise PatchError(f"{path}: an entry has no {error}") from None
    except (AttributeError, TypeError, IndexError, ValueError) as error:
        raise PatchError(f"{path} is damaged: {error}") from None
    if not surfaces:
        raise PatchError(f"{path} has no surfaces")
    return mesh_of(path, surfaces)


def _city(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    vertices = corners_of(data["vertices"], f"{path}: 'vertices'")
    if "transform" in data:
        vertices = vertices * data["transform"]["scale"] + data["transform"]["translate"]
    objects: dict[str, Any] = data["CityObjects"]
    # The finest level of detail of an object and of its parts (BuildingPart, not balconies), beside which it may have a
    # footprint.
    levels = {name: max((_level(g) for g in item.get("geometry", [])), default=-1.0) for name, item in objects.items()}
    for name, item in objects.items():
        parts = [part for part in item.get("children", []) if objects[part]["type"].endswith("Part")]
        finest = max(levels[part] for part in (name, *parts))
        for geometry in item.get("geometry", []):
            if _level(geometry) < finest:
                continue
            if geometry["type"] not in _DEPTHS:
                raise PatchError(f"{path}: '{name}' is a {geometry['type']}: there are {', '.join(_DEPTHS)}")
            semantics = geometry.get("semantics") or {"surfaces": [], "values": None}
            flat = _flat(geometry["boundaries"], semantics["values"], _DEPTHS[geometry["type"]])
            for number, (rings, meaning) in enumerate(flat):
                for ring in rings:
                    bad = next((k for k in ring if not 0 <= k < len(vertices)), None)
                    if bad is not None:
                        raise PatchError(f"{path}: surface {number} of '{name}' names vertex {bad} of {len(vertices)}")
                outline, *holes = (vertices[ring] for ring in rings)
                kind = "" if meaning is None else semantics["surfaces"][meaning]["type"]
                yield Surface(
                    outline=outline,
                    holes=holes,
                    name=f"{name}:{number}",
                    where=f"'{name}'",
                    groups={"type": kind, "object": name},
                )


def _level(geometry: dict[str, Any]) -> float:
    return float(geometry.get("lod", 0))


def _flat(boundaries: list[Any], values: list[Any] | None, depth: int) -> Iterator[tuple[list[list[int]], int | None]]:
    """Rings of each surface, and the number of its meaning."""
    for k, inner in enumerate(boundaries):
        value = None if values is None else values[k]
        if depth == 0:
            yield inner, value
        else:
            yield from _flat(inner, value, depth - 1)


def _left_out(entry: dict[str, Any]) -> Counter[str]:
    """How many surfaces of Honeybee are shades or of no room, by kind, in an entry and those in it."""
    found: Counter[str] = Counter()
    for key, value in entry.items():
        if key.startswith("orphaned_") or key.endswith("_shades") or key == "shade_meshes":
            found[key.replace("_", " ")] += len(value or ())
        elif key in ("rooms", "faces", "apertures", "doors"):
            found += sum(map(_left_out, value or ()), Counter())
    return +found


def _openings(rooms: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """The rooms on both sides of each air boundary."""
    for room in rooms:
        for face in room["faces"]:
            beyond = (face.get("boundary_condition") or {}).get("boundary_condition_objects")
            if face.get("face_type") == "AirBoundary" and beyond:
                yield room["identifier"], beyond[-1]


def _honeybee(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    unit = data.get("units", "Meters")
    if unit not in _UNITS:
        raise PatchError(f"{path}: units are {', '.join(_UNITS)}, not '{unit}'")
    for kind, count in _left_out(data).items():
        logger.warning("%s: %d %s are left out: faces of rooms, their apertures and doors are read", path, count, kind)

    def polygon(entry: dict[str, Any], ring: Any) -> Array:
        return corners_of(ring, f"{path}: '{entry['identifier']}'")[::-1] * _UNITS[unit]  # normals point out of rooms

    openings = joined(_openings(data["rooms"]))
    for together in sorted({tuple(sorted(rooms)) for rooms in openings.values()}):
        logger.warning("%s: air boundaries join the rooms %s to one enclosure", path, ", ".join(together))

    def surface(entry: dict[str, Any], room: str) -> Surface:
        geometry = entry["geometry"]
        return Surface(
            outline=polygon(entry, geometry["boundary"]),
            holes=[polygon(entry, hole) for hole in geometry.get("holes") or []],
            name=entry["identifier"],
            where=f"room '{room}'",
            groups={"room": f"Enclosure of {min(openings[room])}" if room in openings else room},
        )

    for room in data["rooms"]:
        for face in room["faces"]:
            if face.get("face_type") == "AirBoundary":
                continue
            wall = surface(face, room["identifier"])
            wall.inside = [
                surface(entry, room["identifier"])
                for entry in [*(face.get("apertures") or []), *(face.get("doors") or [])]
            ]
            yield wall
            yield from wall.inside
