"""Surfaces of EnergyPlus, from epJSON and from IDF, with the radiant enclosure that each belongs to."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from etendue.core import Array, logger

from ..errors import PatchError
from .surfacefiles import Surface, corners_of

#: Surfaces with corners, by the number of their fields in IDF before the number of corners, without that of the space,
#: and classes of surfaces without corners, which are given by angles.
_FIELDS = {
    "BuildingSurface:Detailed": ("surface_type", "construction_name", "zone_name"),
    **{f"{kind}:Detailed": ("construction_name", "zone_name") for kind in ("Wall", "RoofCeiling", "Floor")},
}
DETAILED = tuple(_FIELDS)
BY_ANGLES = (
    *("Wall:Exterior", "Wall:Adiabatic", "Wall:Underground", "Wall:Interzone", "Roof", "Ceiling:Adiabatic"),
    *("Ceiling:Interzone", "Floor:GroundContact", "Floor:Adiabatic", "Floor:Interzone"),
    *("Window", "Door", "GlazedDoor", "Window:Interzone", "Door:Interzone", "GlazedDoor:Interzone"),
)
_WINDOWS = "FenestrationSurface:Detailed"
#: Fields of other objects in IDF, from the name on, as far as they are read. A list has one field for each entry.
_OTHERS = {
    "GlobalGeometryRules": ("starting_vertex_position", "vertex_entry_direction", "coordinate_system"),
    "Zone": ("direction_of_relative_north", "x_origin", "y_origin", "z_origin"),
    "Space": ("zone_name",),
    "Construction:AirBoundary": ("solar_and_daylighting_method", "radiant_exchange_method"),
    "InternalMass": ("construction_name", "zone_or_zonelist_name"),
    "ZoneList": (),
    "SpaceList": (),
}


def energyplus_surfaces(path: Path, data: dict[str, Any]) -> Iterator[Surface]:
    """The surfaces of a model as epJSON, facing their zone; windows and doors are cut from their walls.

    The group ``zone`` is the enclosure whose surfaces exchange radiation: a space, or a zone without spaces, and those
    that air boundaries join. A wall to another zone of which only one side is in the file has the other one too, as
    EnergyPlus makes it, named ``iz-`` and its name. Air boundaries, and windows in them, are left out.
    Raises :class:`PatchError`."""
    for kind in BY_ANGLES:
        for name in data.get(kind, {}):
            raise PatchError(f"{path}: '{name}' is a {kind}, given by angles: convert it to a :Detailed surface")
    rules: dict[str, Any] = next(iter(data.get("GlobalGeometryRules", {}).values()), {})
    if "vertex_entry_direction" not in rules:
        raise PatchError(f"{path} has no GlobalGeometryRules with a vertex_entry_direction")
    # As seen from outside; the room is on the other side.
    step = {"counterclockwise": -1, "ccw": -1, "clockwise": 1, "cw": 1}.get(rules["vertex_entry_direction"].lower())
    system = (rules.get("coordinate_system") or "Relative").lower()
    is_relative = system == "relative"
    if step is None or not (is_relative or system in ("world", "wcs", "worldcoordinatesystem", "absolute")):
        raise PatchError(f"{path}: GlobalGeometryRules are of an unknown direction or coordinate system: {rules}")
    enclosures = _Enclosures(path, data)
    zones = {_key(name): zone for name, zone in data.get("Zone", {}).items()}

    def placed(corners: Array, name: str, zone: str) -> Array:
        if is_relative:
            if _key(zone) not in zones:
                raise PatchError(f"{path}: '{name}' is relative to zone '{zone}', which is not in the file")
            corners = _placed(corners, zones[_key(zone)])
        return corners[::step]

    found: dict[str, Surface] = {}
    others: dict[str, tuple[Surface, str]] = {}  # the other sides of walls, and their zones, by the key of the wall
    beyond: dict[str, Any] = {}
    for kind in DETAILED:
        for name, entry in data.get(kind, {}).items():
            rows = [[vertex[f"vertex_{axis}_coordinate"] for axis in "xyz"] for vertex in entry["vertices"]]
            zone = entry["zone_name"]
            outline = placed(corners_of(rows, f"{path}: '{name}'"), name, zone)
            inside = Surface(outline=outline, name=name, where=kind, groups={"zone": enclosures.of(entry)})
            found[_key(name)], beyond[_key(name)] = inside, (entry, zone)
            if _key(entry.get("outside_boundary_condition")) == "zone" and not enclosures.is_open(entry):
                to = enclosures.of({"zone_name": entry.get("outside_boundary_condition_object") or ""})
                made = Surface(outline=outline[::-1], name=f"iz-{name}", where=kind, groups={"zone": to})
                others[_key(name)] = made, to
    windows, lost = [], []
    for name, entry in data.get(_WINDOWS, {}).items():
        wall = _key(entry["building_surface_name"])
        base = found.get(wall)
        if base is None:
            raise PatchError(f"{path}: the base '{entry['building_surface_name']}' of '{name}' is not in the file")
        if enclosures.is_open(beyond[wall][0]):
            lost.append(name)
            continue
        count = next((k for k in range(4) if entry.get(f"vertex_{k + 1}_x_coordinate") in (None, "")), 4)
        rows = [[entry[f"vertex_{k + 1}_{axis}_coordinate"] for axis in "xyz"] for k in range(count)]
        if float(entry.get("multiplier", 1) or 1) != 1:
            raise PatchError(f"{path}: '{name}' stands for {entry['multiplier']} windows: give each its corners")
        outline = placed(corners_of(rows, f"{path}: '{name}'"), name, beyond[wall][1])
        sides = [(base, outline, name)]
        if wall in others:
            sides.append((others[wall][0], outline[::-1], f"iz-{name}"))
        for of, corners, own in sides:
            window = Surface(outline=corners, name=own, where=_WINDOWS, groups=dict(of.groups))
            of.inside.append(window)
            windows.append(window)
    if lost:
        logger.warning(
            "%s: windows or doors in air boundaries are as open as these, and left out: %s", path, ", ".join(lost)
        )
    walls = [surface for key, surface in found.items() if not enclosures.is_open(beyond[key][0])]
    every = [*walls, *(surface for surface, _ in others.values()), *windows]
    enclosures.warn(every)
    yield from every


class _Enclosures:
    """The radiant enclosures of a model: spaces, or zones without spaces, joined by air boundaries."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self._path, self._data = path, data
        self._zones = {_key(name) for name in data.get("Zone", {})}
        self._names = {_key(name): name for kind in ("Space", "Zone") for name in data.get(kind, {})}
        self._spaces: dict[str, list[str]] = {}  # of each zone, by keys
        for name, space in data.get("Space", {}).items():
            self._spaces.setdefault(_key(space.get("zone_name")), []).append(_key(name))
        # Earlier versions offer an air boundary that is a surface for radiation.
        self._open = {
            _key(name)
            for name, entry in data.get("Construction:AirBoundary", {}).items()
            if _key(entry.get("radiant_exchange_method")) != "irtsurface"
        }
        walls = {_key(name): entry for kind in DETAILED for name, entry in data.get(kind, {}).items()}
        self._divided = {_key(entry["zone_name"]) for entry in walls.values() if entry.get("space_name")}
        self._joined = joined(self._openings(walls))

    def of(self, entry: dict[str, Any]) -> str:
        """The name of the enclosure of a surface."""
        own = self._space(entry)
        if own not in self._joined:
            return self._names.get(own, entry.get("space_name") or entry["zone_name"])
        joined = self._joined[own]
        for name, members in self._lists():
            if members == joined:
                return name
        return f"Enclosure of {self._names.get(min(joined), min(joined))}"

    def is_open(self, entry: dict[str, Any]) -> bool:
        """Whether a surface is an air boundary, through which light passes."""
        return _key(entry.get("construction_name")) in self._open

    def warn(self, surfaces: list[Surface]) -> None:
        """Tell which zones are joined and not in a list, and that furniture without a place has no row."""
        unlisted = {frozenset(zones) for zones in self._joined.values()}
        for zones in sorted(unlisted, key=sorted):
            names = [self._names.get(zone, zone) for zone in sorted(zones)]
            if not any(members == zones for _, members in self._lists()):
                kind = "ZoneList" if all(_key(name) in self._zones for name in names) else "SpaceList"
                logger.warning(
                    "%s: air boundaries join %s: EnergyPlus knows their enclosure by a %s, so add one of them with the "
                    "name '%s'",
                    *(self._path, ", ".join(names), kind, self.of({"zone_name": names[0], "space_name": names[0]})),
                )
        if masses := len(self._data.get("InternalMass", {})):
            logger.warning(
                "%s: %d InternalMass have no place in their zones and are left out; EnergyPlus gives them no radiation "
                "where view factors are given",
                *(self._path, masses),
            )

    def _lists(self) -> Iterator[tuple[str, set[str]]]:
        """Names of lists, and the spaces that they have, or zones without spaces."""
        for name, members in self._data.get("SpaceList", {}).items():
            yield name, {_key(member.get("space_name")) for member in members.get("spaces", [])}
        for name, members in self._data.get("ZoneList", {}).items():
            zones = [_key(member.get("zone_name")) for member in members.get("zones", [])]
            yield name, {space for zone in zones for space in self._spaces.get(zone, [zone])}

    def _space(self, entry: dict[str, Any]) -> str:
        """The space of a surface, or its zone. If others of the zone name a space, those that name none are one more;
        otherwise they are of the last space of the zone, as EnergyPlus does it."""
        if space := entry.get("space_name"):
            return _key(space)
        zone = _key(entry["zone_name"])
        if zone in self._divided:
            self._names.setdefault(f"{zone}-remainder", f"{entry['zone_name']}-Remainder")
            return f"{zone}-remainder"
        return self._spaces.get(zone, [zone])[-1]

    def _openings(self, walls: dict[str, Any]) -> Iterator[tuple[str, str]]:
        """The spaces on both sides of each air boundary."""
        for entry in walls.values():
            if not self.is_open(entry):
                continue
            beyond = _key(entry.get("outside_boundary_condition_object"))
            if _key(entry.get("outside_boundary_condition")) == "surface":
                beyond = self._space(walls[beyond]) if beyond in walls else ""
            if beyond not in self._names:
                raise PatchError(f"{self._path}: an air boundary of '{entry['zone_name']}' leads to no other zone")
            yield self._space(entry), beyond


def joined(pairs: Iterable[tuple[str, str]]) -> dict[str, set[str]]:
    """All names that pairs join directly or by others, by each of these names."""
    groups: dict[str, set[str]] = {}
    for first, second in pairs:
        both = groups.get(first, {first}) | groups.get(second, {second})
        groups.update(dict.fromkeys(both, both))
    return groups


def _key(name: Any) -> str:
    """A name without the difference of capitals, which EnergyPlus does not make."""
    return str(name or "").lower()


def _placed(corners: Array, zone: dict[str, Any]) -> Array:
    """Corners relative to a zone, which is turned clockwise seen from above, and moved."""
    turn = np.radians(float(zone.get("direction_of_relative_north") or 0.0))
    x, y, z = corners.T
    turned = [x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn), z]
    return np.stack(
        [v + float(zone.get(f"{axis}_origin") or 0.0) for v, axis in zip(turned, "xyz", strict=True)], axis=1
    )


# -- IDF -------------------------------------------------------------------------------------------------------------


def idf_objects(path: Path, text: str) -> dict[str, Any]:
    """What :func:`energyplus_surfaces` reads, of the text of an IDF file, as in epJSON.

    Fields of surfaces depend on the version of EnergyPlus; the number of fields tells which there are. Raises
    :class:`PatchError` for text of no objects, and a surface whose fields do not fit."""
    plain = re.sub(r"!.*", "", text)
    if (macro := re.search(r"^\s*(##\w+)", plain, re.MULTILINE)) is not None:
        raise PatchError(f"{path} has commands of EPMacro, such as {macro[1]}: run EPMacro first")
    known = {_key(kind): kind for kind in (*_FIELDS, *_OTHERS, *BY_ANGLES, _WINDOWS)}
    found: dict[str, Any] = {}
    counts: Counter[str] = Counter()
    for item in plain.split(";"):
        kind, *fields = (field.strip() for field in item.split(","))
        if not fields or (kind := known.get(_key(kind), "")) == "":
            continue
        counts[kind] += 1
        name = fields[0] if kind != "GlobalGeometryRules" else "rules"
        entries = found.setdefault(kind, {})
        if name in entries:
            raise PatchError(f"{path}: two {kind} have the name '{name}'; give each its own")
        entries[name] = _entry(path, kind, fields)
    if not found:
        raise PatchError(f"{path} has no surfaces of EnergyPlus")
    return found


def _entry(path: Path, kind: str, fields: list[str]) -> dict[str, Any]:
    if kind == "GlobalGeometryRules":
        return dict(zip(_OTHERS[kind], fields, strict=False))
    if kind in ("ZoneList", "SpaceList"):
        one = kind.removesuffix("List").lower()
        return {f"{one}s": [{f"{one}_name": name} for name in fields[1:] if name]}
    if kind in _OTHERS:
        return dict(zip(_OTHERS[kind], fields[1:], strict=False))
    if kind == _WINDOWS:
        # From version 9 on without the name of a shading control.
        head = 9 if len(fields) % 3 == 0 else 10
        given = {"building_surface_name": fields[3], "multiplier": fields[head - 2]} if len(fields) >= head else {}
        return given | {
            f"vertex_{k // 3 + 1}_{'xyz'[k % 3]}_coordinate": value for k, value in enumerate(fields[head:])
        }
    if kind in BY_ANGLES:
        return {}
    names = _FIELDS[kind]
    # Then the boundary and its object, sun, wind, view factor to the ground, number of corners: in all after the name
    # six more, and from version 9.6 on the space after the zone.
    old = 1 + len(names) + 6
    has_space = (len(fields) - old) % 3 == 1
    head = old + has_space
    corners = fields[head:]
    if len(fields) < head or len(corners) % 3:
        raise PatchError(f"{path}: '{fields[0]}' has {len(fields)} fields, which is no {kind} of a known version")
    rest = fields[1 + len(names) + has_space :]
    return {
        **dict(zip(names, fields[1:], strict=False)),
        **({"space_name": fields[1 + len(names)]} if has_space else {}),
        "outside_boundary_condition": rest[0],
        "outside_boundary_condition_object": rest[1],
        "vertices": [
            {f"vertex_{axis}_coordinate": value for axis, value in zip("xyz", corners[k : k + 3], strict=True)}
            for k in range(0, len(corners), 3)
        ],
    }
