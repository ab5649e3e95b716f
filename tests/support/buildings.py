"""Two rooms as a model of EnergyPlus, in epJSON and IDF."""

from __future__ import annotations

import json

#: A cube from 0 to 1, its faces counterclockwise from outside; and a window in the wall x = 1.
CUBE = {
    "Floor": [(0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)],
    "Roof": [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    "West": [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)],
    "East": [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
    "South": [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
    "North": [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
}
WINDOW = [(1, 0.25, 0.25), (1, 0.75, 0.25), (1, 0.75, 0.75), (1, 0.25, 0.75)]


def energyplus(step=1, shift=0.0, **rules):
    def rows(corners):
        return [{f"vertex_{a}_coordinate": v for a, v in zip("xyz", p, strict=True)} for p in corners[::step]]

    direction = "Counterclockwise" if step == 1 else "Clockwise"
    return {
        "Zone": {"Z1": {"x_origin": 0, "y_origin": 0, "z_origin": 0}, "Z2": {"x_origin": 1}},
        "BuildingSurface:Detailed": {
            f"{zone}:{name}": {"zone_name": zone, "vertices": rows([(x + dx * shift, y, z) for x, y, z in corners])}
            for dx, zone in enumerate(("Z1", "Z2"))
            for name, corners in CUBE.items()
        },
        "FenestrationSurface:Detailed": {
            "Z2:Win": {"building_surface_name": "z2:EAST", "number_of_vertices": 4}
            | {
                f"vertex_{k + 1}_{a}_coordinate": v
                for k, p in enumerate(WINDOW[::step])
                for a, v in zip("xyz", (p[0] + shift, *p[1:]), strict=True)
            }
        },
        "GlobalGeometryRules": {
            "G": {"vertex_entry_direction": direction, "coordinate_system": "World"} | rules,
        },
    }


def as_idf(data, version=(9, 6)):
    """A model as the text of an IDF file, in the fields of a version."""
    (rules,) = data["GlobalGeometryRules"].values()
    spaces = version >= (9, 6)
    items = [["GlobalGeometryRules", "UpperLeftCorner", rules["vertex_entry_direction"], rules["coordinate_system"]]]
    for name, zone in data["Zone"].items():
        items.append(["Zone", name, 0, *(zone.get(f"{a}_origin", 0) for a in "xyz"), 1, 1])
    for name, space in data.get("Space", {}).items():
        items.append(["Space", name, space["zone_name"]])
    for name, zones in data.get("ZoneList", {}).items():
        items.append(["ZoneList", name, *(zone["zone_name"] for zone in zones["zones"])])
    for name, spaces in data.get("SpaceList", {}).items():
        items.append(["SpaceList", name, *(space["space_name"] for space in spaces["spaces"])])
    for name in data.get("Construction:AirBoundary", {}):
        items.append(["Construction:AirBoundary", name, "None"])
    for name, wall in data["BuildingSurface:Detailed"].items():
        beyond = [wall.get(f"outside_boundary_condition{end}", "") for end in ("", "_object")]
        space = [wall.get("space_name", "")] if spaces else []
        corners = [v for vertex in wall["vertices"] for v in vertex.values()]
        head = ["BUILDINGSURFACE:DETAILED", name, "Wall", wall.get("construction_name", "c"), wall["zone_name"], *space]
        items.append([*head, *beyond, "NoSun", "NoWind", "autocalculate", len(corners) // 3, *corners])
    for name, window in data["FenestrationSurface:Detailed"].items():
        corners = [v for key, v in window.items() if key.startswith("vertex")]
        shading = [""] if version < (9, 0) else []
        head = [
            "FenestrationSurface:Detailed",
            name,
            "Window",
            "c",
            window["building_surface_name"],
            "",
            "0.5",
            *shading,
        ]
        items.append([*head, "", 1, len(corners) // 3, *corners])
    texts = (",\n  ".join(map(str, item)) for item in items)
    return "! A model; of two, rooms\n" + "".join(f"{text};  !- the last, field;\n" for text in texts)


def written(folder, name, content):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path
