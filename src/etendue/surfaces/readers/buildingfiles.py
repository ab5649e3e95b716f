"""Surfaces of buildings and cities in JSON: EnergyPlus (epJSON), CityJSON and Honeybee (HBJSON)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from etendue.core import Array, logger

from ..errors import PatchError
from .surfacefiles import MeshFile, Surface, corners_of, mesh_of

#: Surfaces of EnergyPlus with corners, and classes of surfaces without, which are given by angles.
_DETAILED = tuple(f"{kind}:Detailed" for kind in ("BuildingSurface", "Wall", "RoofCeiling", "Floor"))
_BY_ANGLES = (
    *("Wall:Exterior", "Wall:Adiabatic", "Wall:Underground", "Wall:Interzone", "Roof", "Ceiling:Adiabatic"),
    *("Ceiling:Interzone", "Floor:GroundContact", "Floor:Adiabatic", "Floor:Interzone"),
    *("Window", "Door", "GlazedDoor", "Window:Interzone", "Door:Interzone", "GlazedDoor:Interzone"),
)
#: Metres of the units of Honeybee.
_UNITS = {"Meters": 1.0, "Millimeters": 1e-3, "Centimeters": 1e-2, "Feet": 0.3048, "Inches": 0.0254}
#: Levels of lists around a surface of CityJSON, by the type of its geometry.
_DEPTHS = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}


def read_building(path: Path) -> MeshFile:
    """The surfaces of a file of EnergyPlus, CityJSON or Honeybee, told apart by their content.

    Surfaces of rooms face the room; windows and doors are cut from their walls. Groups are the ``zone`` of EnergyPlus,
    ``type`` and ``object`` of CityJSON, and the ``room`` of Honeybee. Raises :class:`PatchError` for other files.
    """
    try:
        data = json.loads(path.read_text("utf-8-sig"))
    except ValueError as error:
        raise PatchError(f"{path} is no JSON: {error}") from None
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "CityJSON":
        read = _city
    elif kind == "Model" and "rooms" in data:
        read = _honeybee
    elif isinstance(data, dict) and any(name in data for name in (*_DETAILED, *_BY_ANGLES)):
        read = _energyplus
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


def _energyplus(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    for kind in _BY_ANGLES:
        for name in data.get(kind, {}):
            raise PatchError(f"{path}: '{name}' is a {kind}, given by angles: convert it to a :Detailed surface")
    rules: dict[str, Any] = next(iter(data.get("GlobalGeometryRules", {}).values()), {})
    if "vertex_entry_direction" not in rules:
        raise PatchError(f"{path} has no GlobalGeometryRules with a vertex_entry_direction")
    # As seen from outside; the room is on the other side.
    step = {"counterclockwise": -1, "clockwise": 1}.get(rules["vertex_entry_direction"].lower())
    system = rules.get("coordinate_system", "Relative").lower()
    is_relative = system == "relative"
    if step is None or not (is_relative or system in ("world", "worldcoordinatesystem", "absolute")):
        raise PatchError(f"{path}: GlobalGeometryRules are of an unknown direction or coordinate system: {rules}")
    # EnergyPlus does not distinguish capitals in names.
    zones = {name.lower(): zone for name, zone in data.get("Zone", {}).items()}
    found: dict[str, Surface] = {}
    for kind in _DETAILED:
        for name, entry in data.get(kind, {}).items():
            rows = [[vertex[f"vertex_{axis}_coordinate"] for axis in "xyz"] for vertex in entry["vertices"]]
            corners = corners_of(rows, f"{path}: '{name}'")
            zone = entry["zone_name"]
            if is_relative:
                if zone.lower() not in zones:
                    raise PatchError(f"{path}: '{name}' is relative to zone '{zone}', which is not in the file")
                corners = _placed(corners, zones[zone.lower()])
            surface = Surface(outline=corners[::step], name=name, where=kind, groups={"zone": zone})
            found[name.lower()] = surface
    windows = []
    for name, entry in data.get("FenestrationSurface:Detailed", {}).items():
        base = found.get(entry["building_surface_name"].lower())
        if base is None:
            raise PatchError(f"{path}: the base '{entry['building_surface_name']}' of '{name}' is not in the file")
        count = next((k for k in range(4) if f"vertex_{k + 1}_x_coordinate" not in entry), 4)
        rows = [[entry[f"vertex_{k + 1}_{axis}_coordinate"] for axis in "xyz"] for k in range(count)]
        corners, zone = corners_of(rows, f"{path}: '{name}'"), base.groups["zone"]
        corners = _placed(corners, zones[zone.lower()]) if is_relative else corners
        if float(entry.get("multiplier", 1) or 1) != 1:
            raise PatchError(f"{path}: '{name}' stands for {entry['multiplier']} windows: give each its corners")
        window = Surface(
            outline=corners[::step], name=name, where="FenestrationSurface:Detailed", groups={"zone": zone}
        )
        base.inside.append(window)
        windows.append(window)
    yield from found.values()
    yield from windows


def _placed(corners: Array, zone: dict[str, Any]) -> Array:
    """Corners relative to a zone, which is turned clockwise seen from above, and moved."""
    turn = np.radians(float(zone.get("direction_of_relative_north") or 0.0))
    x, y, z = corners.T
    turned = [x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn), z]
    return np.stack(
        [v + float(zone.get(f"{axis}_origin") or 0.0) for v, axis in zip(turned, "xyz", strict=True)], axis=1
    )


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


def _honeybee(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    unit = data.get("units", "Meters")
    if unit not in _UNITS:
        raise PatchError(f"{path}: units are {', '.join(_UNITS)}, not '{unit}'")
    for kind, count in _left_out(data).items():
        logger.warning("%s: %d %s are left out: faces of rooms, their apertures and doors are read", path, count, kind)

    def polygon(entry: dict[str, Any], ring: Any) -> Array:
        return corners_of(ring, f"{path}: '{entry['identifier']}'")[::-1] * _UNITS[unit]  # normals point out of rooms

    def surface(entry: dict[str, Any], room: str) -> Surface:
        geometry = entry["geometry"]
        return Surface(
            outline=polygon(entry, geometry["boundary"]),
            holes=[polygon(entry, hole) for hole in geometry.get("holes") or []],
            name=entry["identifier"],
            where=f"room '{room}'",
            groups={"room": room},
        )

    for room in data["rooms"]:
        for face in room["faces"]:
            wall = surface(face, room["identifier"])
            wall.inside = [
                surface(entry, room["identifier"])
                for entry in [*(face.get("apertures") or []), *(face.get("doors") or [])]
            ]
            yield wall
            yield from wall.inside
