"""Surfaces of buildings and cities: EnergyPlus (epJSON, IDF), CityJSON and Honeybee (HBJSON)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

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
        data = _city_of_lines(path) if path.suffix.lower() == ".jsonl" else _json(path, path.read_text("utf-8-sig"))
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "CityJSON":
        read = _city
    elif kind == "Model":
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


def _json(path: Path, text: str, line: int | None = None) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        where = path if line is None else f"{path}, line {line}"
        raise PatchError(f"{where} is no JSON: {error}") from None


def _city_of_lines(path: Path) -> dict[str, Any]:
    """The sequence of a header and features with vertices of their own, a line each, as one CityJSON."""
    lines = [(number, text) for number, text in enumerate(path.read_text("utf-8-sig").splitlines(), 1) if text.strip()]
    city, *features = (_json(path, text, number) for number, text in lines)
    kinds = [feature.get("type") if isinstance(feature, dict) else None for feature in (city, *features)]
    if kinds != ["CityJSON"] + ["CityJSONFeature"] * len(features):
        raise PatchError(f"{path} is no sequence of CityJSON: a line of CityJSON, then lines of CityJSONFeature")
    objects, vertices = dict(city["CityObjects"]), list(city["vertices"])
    for feature in features:
        for item in feature["CityObjects"].values():
            for geometry in item.get("geometry", []):
                geometry["boundaries"] = _shifted(geometry["boundaries"], len(vertices))
        objects |= feature["CityObjects"]
        vertices += feature["vertices"]
    return {**city, "CityObjects": objects, "vertices": vertices}


def _shifted(boundaries: Any, start: int) -> Any:
    """The numbers of vertices, in lists of any depth, from another first one on."""
    return [_shifted(inner, start) for inner in boundaries] if isinstance(boundaries, list) else boundaries + start


def _city(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    if not data["vertices"]:
        return
    vertices = corners_of(data["vertices"], f"{path}: 'vertices'")
    if "transform" in data:
        vertices = vertices * data["transform"]["scale"] + data["transform"]["translate"]
    templates = data.get("geometry-templates") or {}
    objects: dict[str, Any] = data["CityObjects"]
    # The finest level of detail of an object and of its parts (BuildingPart, not balconies), beside which it may have a
    # footprint.
    made = {
        name: [_instanced(path, name, geometry, vertices, templates) for geometry in item.get("geometry", [])]
        for name, item in objects.items()
    }
    levels = {name: max((_level(g) for g, _ in geometries), default=-1.0) for name, geometries in made.items()}
    for name, item in objects.items():
        parts = [part for part in item.get("children", []) if objects[part]["type"].endswith("Part")]
        finest = max(levels[part] for part in (name, *parts))
        for geometry, points in made[name]:
            if _level(geometry) < finest:
                continue
            if geometry["type"] not in _DEPTHS:
                raise PatchError(f"{path}: '{name}' is a {geometry['type']}: there are {', '.join(_DEPTHS)}")
            semantics = geometry.get("semantics")
            values = semantics.get("values") if isinstance(semantics, dict) else None
            flat = _flat(geometry["boundaries"], values, _DEPTHS[geometry["type"]])
            for number, (rings, meaning) in enumerate(flat):
                for ring in rings:
                    bad = next((k for k in ring if not 0 <= k < len(points)), None)
                    if bad is not None:
                        raise PatchError(f"{path}: surface {number} of '{name}' names vertex {bad} of {len(points)}")
                outline, *holes = (points[ring] for ring in rings)
                kind = "" if semantics is None or meaning is None else semantics["surfaces"][meaning]["type"]
                yield Surface(
                    outline=outline,
                    holes=holes,
                    name=f"{name}:{number}",
                    where=f"'{name}'",
                    groups={"type": kind, "object": name},
                )


def _instanced(
    path: Path, name: str, geometry: dict[str, Any], vertices: Array, templates: dict[str, Any]
) -> tuple[dict[str, Any], Array]:
    """A geometry and its vertices: of an instance those of its template, turned and moved to a vertex."""
    if geometry["type"] != "GeometryInstance":
        return geometry, vertices
    known = templates.get("templates", [])
    if not 0 <= geometry["template"] < len(known):
        raise PatchError(f"{path}: '{name}' is of template {geometry['template']}, and there are {len(known)}")
    matrix = np.array(geometry["transformationMatrix"], dtype=np.float64).reshape(4, 4)
    points = corners_of(templates["vertices-templates"], f"{path}: 'vertices-templates'")
    (place,) = geometry["boundaries"]
    return known[geometry["template"]], points @ matrix[:3, :3].T + matrix[:3, 3] + vertices[place]


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
    if not data.get("rooms"):
        left = ", ".join(f"{count} {kind}" for kind, count in _left_out(data).items())
        raise PatchError(f"{path} has no rooms{f', only {left}' if left else ''}: make rooms of its faces")
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
