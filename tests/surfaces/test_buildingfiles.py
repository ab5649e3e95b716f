"""Surfaces of EnergyPlus, CityJSON, Honeybee and Radiance, against closed forms."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from support.buildings import CUBE, WINDOW, as_idf, energyplus, written

from etendue.radiosity import PatchError, PatchSource, diagnose, exact_form_factors, orientation, read_patches
from etendue.surfaces import zone_names

PLATES, BESIDE = 0.19982490, 0.20004378


def city(kind="Solid"):
    points = sorted({p for corners in CUBE.values() for p in corners})
    rings = [[[points.index(p) for p in corners]] for corners in CUBE.values()]
    values = [0, 1, 2, 2, 2, 2]
    vertices = [[1000 * v for v in p] for p in points]
    vertices += [[1000 * v for v in p] for p in WINDOW[::-1]]
    rings[3].append([8, 9, 10, 11])
    meanings = [{"type": "GroundSurface"}, {"type": "RoofSurface"}, {"type": "WallSurface"}]
    boundaries, values = ([rings], [values]) if kind == "Solid" else (rings, values)
    geometry = {"type": kind, "boundaries": boundaries, "semantics": {"surfaces": meanings, "values": values}}
    coarse = {"type": "MultiSurface", "lod": "1", "boundaries": [[[0, 1, 2]]]}
    return {
        "type": "CityJSON",
        "version": "2.0",
        "transform": {"scale": [0.001] * 3, "translate": [448000.25, 5411000.5, 0]},
        "CityObjects": {"b1": {"type": "Building", "geometry": [coarse, geometry | {"lod": "2"}]}, "g": {}},
        "vertices": vertices,
    }


def honeybee():
    def face(name, corners, **more):
        return {
            "identifier": name,
            "geometry": {"type": "Face3D", "boundary": [[10 * v for v in p] for p in corners]},
        } | more

    faces = [face(name, corners) for name, corners in CUBE.items()]
    faces[3]["apertures"] = [face("Window", WINDOW)]
    return {"type": "Model", "units": "Feet", "rooms": [{"identifier": "R1", "faces": faces}], "orphaned_shades": [{}]}


def check_room(patches, window=True):
    """A cube whose east wall has a window: known factors, rows that sum to one."""
    names = [name.split(":")[-1] for name in patches.names]
    factors = exact_form_factors(patches)
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-7)
    place = {name: k for k, name in enumerate(names)}
    assert factors.matrix[place["Floor"], place["Roof"]] == pytest.approx(PLATES, abs=1e-7)
    assert factors.matrix[place["Floor"], place["West"]] == pytest.approx(BESIDE, abs=1e-7)
    east = factors.matrix[place["Floor"], place["East"]] + factors.matrix[place["Floor"], place["Win"]]
    assert east == pytest.approx(BESIDE, abs=1e-7)


@pytest.mark.parametrize("step", [1, -1])
def test_zones_of_energyplus_face_inwards(tmp_path, step):
    """Two rooms with a common wall: neither sees the other, and each is a cube."""
    patches = read_patches(written(tmp_path, "a.epJSON", energyplus(step, shift=1.0)))
    assert len(patches) == 13
    assert patches.names[0] == "Z1:Floor"
    assert patches.normals[0, 2] == pytest.approx(1)
    zone = np.array([name.startswith("Z2") for name in patches.names])
    other = {"Z1:West", "Z2:East", "Z2:Win"}  # faces in x
    assert {n for n, (x, _, _) in zip(patches.names, patches.normals, strict=True) if x} >= other
    first, _ = patches.only(zone)
    check_room(first)
    from etendue.radiosity import ABuffer, form_factors

    factors = form_factors(ABuffer(patches).cast(64))
    assert factors.matrix[~zone][:, zone].nnz == 0
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-12)


def test_a_wall_that_its_windows_cover_keeps_its_row(tmp_path, caplog):
    data = energyplus(shift=1.0)
    wall = data["BuildingSurface:Detailed"]["Z2:East"]["vertices"]
    window = {name.replace("vertex", f"vertex_{k + 1}"): v for k, p in enumerate(wall) for name, v in p.items()}
    data["FenestrationSurface:Detailed"]["Z2:Win"].update(window)
    patches = read_patches(written(tmp_path, "a.epJSON", data))
    assert len(patches) == 13
    assert list(patches.names[patches.empty]) == ["Z2:East"]
    assert "1 have no area" in caplog.text


def test_relative_coordinates_of_energyplus(tmp_path):
    """Zone 2 begins at x = 1; turned by 90 degrees clockwise, its y points along x."""
    data = energyplus(coordinate_system="Relative")
    patches = read_patches(written(tmp_path, "a.epJSON", data))
    np.testing.assert_allclose(patches.bounds, [[0, 0, 0], [2, 1, 1]])
    data["Zone"]["Z2"]["direction_of_relative_north"] = 90
    patches = read_patches(written(tmp_path, "a.epJSON", data))
    north = list(patches.names).index("Z2:North")
    np.testing.assert_allclose(patches.centres[north], [2, -0.5, 0.5], atol=1e-12)
    np.testing.assert_allclose(patches.normals[north], [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("version", [(8, 9), (9, 4), (9, 6)])
@pytest.mark.parametrize("system", ["World", "Relative"])
def test_idf_is_the_same_model(tmp_path, version, system):
    data = energyplus(shift=float(system == "World"), coordinate_system=system)
    json_, idf = (written(tmp_path, name, x) for name, x in (("a.epJSON", data), ("a.idf", as_idf(data, version))))
    expected, found = read_patches(json_), read_patches(idf)
    assert list(found.names) == list(expected.names)
    np.testing.assert_array_equal(found.zones, expected.zones)
    np.testing.assert_allclose(found.centres, expected.centres)
    np.testing.assert_allclose(found.normals, expected.normals)


def test_zones_are_apart(tmp_path, variant):
    """The walls between two rooms lie on each other; neither is a fault, and each room is a whole one."""
    path = written(tmp_path, "a.epJSON", energyplus(shift=1.0))
    patches = read_patches(path)
    assert list(patches.zones) == 6 * ["Z1"] + 6 * ["Z2"] + ["Z2"]
    assert zone_names(patches) == ("Z1", "Z2")
    found = diagnose(patches)
    assert found.is_closed and len(found.overlaps) == 0
    assert len(orientation(patches, inward=True).wrong) == 0 and len(orientation(patches).wrong) == 13
    room = read_patches(path, zone="z2")
    check_room(room)
    assert list(room.zones) == 7 * ["Z2"] and list(room.face) == list(range(6, 13))
    with pytest.raises(PatchError, match="has no zone 'Z3'; there are: Z1, Z2"):
        read_patches(path, zone="Z3")
    with pytest.raises(PatchError, match="it has no zones"):
        read_patches(written(tmp_path, "a.city.json", city()), zone="Z3")


def test_a_turned_wall_of_a_room_whose_roof_has_a_window(tmp_path, variant):
    """Cut around its window, the roof shares no edge with a wall; it is no open sheet yet."""
    data = energyplus(shift=1.0)
    (window,) = data["FenestrationSurface:Detailed"].values()
    window["building_surface_name"] = "Z2:Roof"
    for k, (x, y) in enumerate([(0.2, 0.3), (0.6, 0.3), (0.6, 0.9), (0.2, 0.9)]):
        window |= {f"vertex_{k + 1}_{a}_coordinate": v for a, v in zip("xyz", (1 + x, y, 1), strict=True)}
    data["BuildingSurface:Detailed"]["Z2:South"]["vertices"].reverse()
    path = written(tmp_path, "a.epJSON", data)
    wrong = orientation(read_patches(path), inward=True).wrong
    assert list(read_patches(path).names[wrong]) == ["Z2:South"]
    assert diagnose(read_patches(path, orient="inward")).is_closed


def test_the_other_side_of_a_wall_to_a_zone(tmp_path):
    """EnergyPlus makes the side in the other zone of a wall, and of a window in it, if the file has only one."""
    data = energyplus(shift=1.0)
    walls, (window,) = data["BuildingSurface:Detailed"], data["FenestrationSurface:Detailed"].values()
    del walls["Z2:West"]
    walls["Z1:East"] |= {"outside_boundary_condition": "Zone", "outside_boundary_condition_object": "z2"}
    window["building_surface_name"] = "Z1:East"
    for k, (_, y, z) in enumerate(WINDOW):
        window |= {f"vertex_{k + 1}_{a}_coordinate": v for a, v in zip("xyz", (1, y, z), strict=True)}
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        patches = read_patches(path)
        found = zip(patches.zones, patches.areas, patches.normals[:, 0], strict=True)
        sides = dict(zip(patches.names, found, strict=True))
        assert sides["Z1:East"] == ("Z1", pytest.approx(0.75), pytest.approx(-1))
        assert sides["iz-Z1:East"] == ("Z2", pytest.approx(0.75), pytest.approx(1))
        assert sides["iz-Z2:Win"] == ("Z2", pytest.approx(0.25), pytest.approx(1))
        assert diagnose(patches).is_closed


def test_air_boundaries_join_zones(tmp_path, caplog):
    data = energyplus(shift=1.0)
    data["Construction:AirBoundary"] = {"Air": {}}
    walls = data["BuildingSurface:Detailed"]
    for name, other in (("Z1:East", "Z2:West"), ("Z2:West", "Z1:EAST")):
        walls[name] |= {"construction_name": "air", "outside_boundary_condition": "Surface"}
        walls[name]["outside_boundary_condition_object"] = other
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        caplog.clear()
        patches = read_patches(path)
        assert zone_names(patches) == ("Enclosure of Z1",) and len(patches) == 11
        assert "air boundaries join Z1, Z2: EnergyPlus knows their enclosure by a ZoneList" in caplog.text
        factors = exact_form_factors(patches)
        np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-4)
        place = {name: k for k, name in enumerate(patches.names)}
        assert factors.matrix[place["Z1:West"], place["Z2:East"]] > 0.03  # through the opening
    data["ZoneList"] = {"Both": {"zones": [{"zone_name": "Z1"}, {"zone_name": "z2"}]}}
    caplog.clear()
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        assert zone_names(read_patches(path)) == ("Both",)
    assert not caplog.text
    data["Construction:AirBoundary"]["Air"] = {"radiant_exchange_method": "IRTSurface"}
    assert zone_names(read_patches(written(tmp_path, "a.epJSON", data))) == ("Z1", "Z2")


def test_an_air_boundary_to_a_zone_is_open(tmp_path, caplog):
    """EnergyPlus makes no other side of it, and a window in it closes nothing."""
    data = energyplus(shift=1.0)
    data["Construction:AirBoundary"] = {"Air": {}}
    walls, (window,) = data["BuildingSurface:Detailed"], data["FenestrationSurface:Detailed"].values()
    del walls["Z2:West"]
    walls["Z1:East"] |= {"construction_name": "Air", "outside_boundary_condition": "Zone"}
    walls["Z1:East"]["outside_boundary_condition_object"] = "Z2"
    window["building_surface_name"] = "Z1:East"
    for k, (_, y, z) in enumerate(WINDOW):
        window |= {f"vertex_{k + 1}_{a}_coordinate": v for a, v in zip("xyz", (1, y, z), strict=True)}
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        caplog.clear()
        patches = read_patches(path)
        names = [f"{zone}:{side}" for zone in ("Z1", "Z2") for side in CUBE]
        assert list(patches.names) == [name for name in names if name not in ("Z1:East", "Z2:West")]
        assert diagnose(patches).is_closed and zone_names(patches) == ("Enclosure of Z1",)
        assert "in air boundaries are as open as these, and left out: Z2:Win" in caplog.text


def test_spaces_are_enclosures(tmp_path):
    """Surfaces without a space in a zone with spaces are one more space."""
    data = energyplus(shift=1.0)
    data["Space"] = {"Lab": {"zone_name": "Z1"}}
    walls = data["BuildingSurface:Detailed"]
    for name in list(walls)[:5]:
        walls[name]["space_name"] = "lab"
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        assert list(read_patches(path).zones) == 5 * ["Lab"] + ["Z1-Remainder"] + 7 * ["Z2"]
    for name in list(walls)[:5]:
        del walls[name]["space_name"]
    data["Space"]["Store"] = {"zone_name": "z1"}
    assert list(read_patches(written(tmp_path, "a.epJSON", data)).zones) == 6 * ["Store"] + 7 * ["Z2"]  # the last


def test_air_boundaries_join_spaces(tmp_path, caplog):
    """Of the same zone: their list is one of spaces."""
    data = energyplus(shift=1.0)
    data["Construction:AirBoundary"] = {"Air": {}}
    data["Space"] = {name: {"zone_name": "Z1"} for name in ("Lab", "Store")}
    for name, wall in data["BuildingSurface:Detailed"].items():
        wall |= {"zone_name": "Z1", "space_name": "Lab" if name.startswith("Z1") else "Store"}
        if name in ("Z1:East", "Z2:West"):
            other = {"Z1:East": "Z2:West", "Z2:West": "Z1:East"}[name]
            wall |= {"construction_name": "Air", "outside_boundary_condition": "Surface"}
            wall["outside_boundary_condition_object"] = other
    assert zone_names(read_patches(written(tmp_path, "a.idf", as_idf(data)))) == ("Enclosure of Lab",)
    assert "join Lab, Store: EnergyPlus knows their enclosure by a SpaceList" in caplog.text
    caplog.clear()
    data["SpaceList"] = {"Both": {"spaces": [{"space_name": "store"}, {"space_name": "Lab"}]}}
    for path in (written(tmp_path, "a.epJSON", data), written(tmp_path, "a.idf", as_idf(data))):
        assert zone_names(read_patches(path)) == ("Both",)
    assert not caplog.text


@pytest.mark.parametrize("kind", ["Solid", "MultiSurface"])
def test_cityjson(tmp_path, kind):
    path = written(tmp_path, "a.city.json", city(kind))
    patches = read_patches(path)
    np.testing.assert_allclose(patches.areas, [1, 1, 1, 0.75, 1, 1], rtol=1e-6)
    np.testing.assert_allclose(patches.bounds[0], [448000.25, 5411000.5, 0])
    np.testing.assert_allclose(patches.normals[:2], [[0, 0, -1], [0, 0, 1]], atol=1e-9)
    assert patches.names[1] == "b1:1"
    groups = read_patches(path, ids="groups")
    assert list(groups.names) == ["GroundSurface", "RoofSurface", "WallSurface"]
    np.testing.assert_allclose(groups.areas, [1, 1, 3.75], rtol=1e-6)
    assert list(read_patches(path, ids="object").names) == ["b1"]


def test_a_sequence_of_cityjson(tmp_path):
    """A header, then a feature in each line, with vertices of its own, as tiles of 3D BAG come."""
    whole = city()
    header = {**{k: whole[k] for k in ("type", "version", "transform")}, "CityObjects": {}, "vertices": []}
    features = []
    for name in ("b1", "b2"):
        item = copy.deepcopy(whole["CityObjects"]["b1"])
        vertices = [[x + 5000 * (name == "b2"), y, z] for x, y, z in whole["vertices"]]
        features.append({"type": "CityJSONFeature", "id": name, "CityObjects": {name: item}, "vertices": vertices})
    lines = [json.dumps(line) for line in (header, *features)]
    patches = read_patches(written(tmp_path, "a.city.jsonl", "\n".join([*lines, ""])))
    assert list(patches.names[[0, 6]]) == ["b1:0", "b2:0"] and len(patches) == 12
    np.testing.assert_allclose(patches.centres[6:] - patches.centres[:6], 6 * [[5, 0, 0]], atol=1e-6)
    with pytest.raises(PatchError, match="is no sequence of CityJSON"):
        read_patches(written(tmp_path, "a.jsonl", lines[1]))
    with pytest.raises(PatchError, match="line 3 is no JSON"):
        read_patches(written(tmp_path, "a.jsonl", "\n".join([*lines[:2], "{"])))


def test_templates_of_cityjson(tmp_path):
    """Half as large, turned by 90 degrees about z, at a vertex."""
    data = city()
    house = data["CityObjects"].pop("b1")["geometry"][1]
    vertices = [[x / 1000 for x in p] for p in data["vertices"]]
    data["geometry-templates"] = {"templates": [house], "vertices-templates": vertices}
    matrix = [0, -0.5, 0, 0, 0.5, 0, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1]
    tree = {"type": "GeometryInstance", "template": 0, "boundaries": [1], "transformationMatrix": matrix}
    data["CityObjects"]["t"] = {"type": "SolitaryVegetationObject", "geometry": [tree]}
    data["vertices"] = [[0, 0, 0], [3000, 4000, 0]]
    patches = read_patches(written(tmp_path, "a.city.json", data))
    np.testing.assert_allclose(patches.areas.sum(), 5.75 / 4, rtol=1e-6)
    place = np.array([448000.25 + 3, 5411000.5 + 4, 0])
    np.testing.assert_allclose(patches.bounds, np.add(place, [[-0.5, 0, 0], [0, 0.5, 0.5]]), atol=1e-9)
    np.testing.assert_allclose(patches.normals[:2], [[0, 0, -1], [0, 0, 1]], atol=1e-9)
    tree["template"] = 1
    with pytest.raises(PatchError, match="'t' is of template 1, and there are 1"):
        read_patches(written(tmp_path, "a.city.json", data))


def test_rings_of_cityjson(tmp_path):
    """Some programs repeat the first vertex of a ring at its end, and vertices that rounding has joined."""
    data = city()
    solid = data["CityObjects"]["b1"]["geometry"][1]["boundaries"][0]
    solid[0][0] = [*solid[0][0], solid[0][0][0]]
    solid[1][0] = [k for k in solid[1][0] for _ in range(2)]
    np.testing.assert_allclose(read_patches(written(tmp_path, "a.json", data)).areas, [1, 1, 1, 0.75, 1, 1], rtol=1e-6)
    data["vertices"] += [[0, 1000, 3000], [0, 2000, 0]]
    solid[2][0] = [solid[2][0][0], 12, solid[2][0][1], 13]
    with pytest.raises(PatchError, match="'b1:2' crosses itself"):
        read_patches(written(tmp_path, "a.json", data))


def test_a_building_of_cityjson_is_made_of_its_parts(tmp_path):
    """The footprint of the building has a coarser level than its part."""
    data = city("Solid")
    part, footprint = (
        data["CityObjects"].pop("b1"),
        {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 1, 2, 3]]]},
    )
    data["CityObjects"] = {"b": {"type": "Building", "geometry": [footprint], "children": ["p"]}, "p": part}
    for kind, names in (("BuildingPart", ["p"]), ("BuildingInstallation", ["b", "p"])):
        part["type"] = kind
        assert list(read_patches(written(tmp_path, "a.city.json", data), ids="object").names) == names


def test_honeybee(tmp_path, caplog):
    data = honeybee()
    data["rooms"][0]["faces"][0]["indoor_shades"] = data["rooms"][0]["indoor_shades"] = [{}]
    path = written(tmp_path, "a.hbjson", data)
    patches = read_patches(path)
    assert "1 orphaned shades are left out" in caplog.text
    assert "2 indoor shades are left out" in caplog.text
    assert patches.areas.sum() == pytest.approx(6 * 3.048**2)
    patches.shape_names = tuple(name.replace("Window", "Win") for name in patches.shape_names)
    check_room(patches)
    assert list(read_patches(path, ids="room").names) == ["R1"]
    assert zone_names(patches) == ("R1",)


def test_air_boundaries_of_honeybee(tmp_path, caplog):
    data = honeybee()
    del data["rooms"][0]["faces"][3]["apertures"]
    second = copy.deepcopy(data["rooms"][0])
    second["identifier"] = "R2"
    for face in second["faces"]:
        face["identifier"] = f"2:{face['identifier']}"
        face["geometry"]["boundary"] = [[x + 10, y, z] for x, y, z in face["geometry"]["boundary"]]
    data["rooms"].append(second)
    assert zone_names(read_patches(written(tmp_path, "a.hbjson", data))) == ("R1", "R2")
    (_, _, _, east, *_), (_, _, west, *_) = (room["faces"] for room in data["rooms"])
    for face, beyond in ((east, ["2:West", "R2"]), (west, ["East", "R1"])):
        face["face_type"], face["boundary_condition"] = "AirBoundary", {"boundary_condition_objects": beyond}
    patches = read_patches(written(tmp_path, "a.hbjson", data))
    assert zone_names(patches) == ("Enclosure of R1",) and len(patches) == 10
    assert "air boundaries join the rooms R1, R2 to one enclosure" in caplog.text


RAD = """# plates
void plastic grey 0 0 5 .5 .4 .3 .1 0
void glow lamp 0 0 4 2 1 0 0
void light sun 0 0 3 1 1 1
sun source s 0 0 4 0 0 1 .5
void alias paint grey
void brightfunc dirt 2 f dirt.cal 0 0
paint polygon floor
0
0
12 0 0 0  1 0 0  1 1 0  0 1 0
dirt plastic dirty 0 0 5 .5 .5 .5 0 0
lamp polygon ceiling 0 0 12 0 1 1  1 1 1  1 0 1  0 0 1
"""


def test_radiance(tmp_path, caplog):
    path = written(tmp_path, "a.rad", RAD)
    patches = read_patches(path)
    assert "line 12: 'dirty' is taken without its pattern 'dirt'" in caplog.text
    assert list(patches.names) == ["floor", "ceiling"]
    np.testing.assert_allclose(patches.reflectance, [[0.55, 0.46, 0.37], [0, 0, 0]])
    np.testing.assert_allclose(patches.emission, [[0, 0, 0], [2 * np.pi, np.pi, 0]])
    assert exact_form_factors(patches).matrix[0, 1] == pytest.approx(PLATES, abs=1e-8)
    assert list(read_patches(path, ids="groups").names) == ["paint", "lamp"]
    assert PatchSource(source=path, for_light=True).open().patches.channels == 3


def test_materials_that_are_not_diffuse_or_in_another_file_are_black(tmp_path, caplog):
    more = "void glass pane 0 0 3 1 1 1\n" + "".join(
        f"{material} polygon p{k} 0 0 9 {k} 0 0 {k + 1} 0 0 {k} 1 0\n"
        for k, material in enumerate(("pane", "wood", "wood"), 5)
    )
    patches = read_patches(written(tmp_path, "a.rad", RAD + more))
    np.testing.assert_allclose(patches.reflectance[2:], 0)
    assert "the material 'pane' is glass; its 1 polygon is taken as black" in caplog.text
    assert "the material 'wood' is not in the file; its 2 polygons are taken as black" in caplog.text


def changed(data, *path, to):
    data = copy.deepcopy(data)
    place = data
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    return data


SOLID = ("CityObjects", "b1", "geometry", 1)
VERTICES = energyplus()["BuildingSurface:Detailed"]["Z2:East"]["vertices"]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.epjson", "{", "is no JSON"),
        ("a.idf", "Version, 9.4;", "has no surfaces of EnergyPlus"),
        ("a.idf", "##include x.imf\nZone, Z1;", "has commands of EPMacro, such as ##include"),
        ("a.idf", "Zone, Z1;\nZone, Z1;", "two Zone have the name 'Z1'"),
        ("a.idf", as_idf(energyplus()) + "Floor:Detailed, F, c, Z1, Adiabatic, , , , , 1, 2, 3;", "'F' has 11 fields"),
        (
            "a.epjson",
            changed(energyplus(), "Construction:AirBoundary", to={"": {}}),
            "an air boundary of 'Z1' leads to no other zone",
        ),
        ("a.json", {"type": "FeatureCollection"}, "has no surfaces of EnergyPlus, CityJSON or Honeybee"),
        ("a.epjson", changed(energyplus(), "GlobalGeometryRules", to={}), "has no GlobalGeometryRules"),
        ("a.epjson", changed(energyplus(), "Window", to={"w": {}}), "'w' is a Window, given by angles"),
        (
            "a.epjson",
            changed(energyplus(), "FenestrationSurface:Detailed", "Z2:Win", "building_surface_name", to="Z9"),
            "the base 'Z9' of 'Z2:Win'",
        ),
        (
            "a.epjson",
            changed(energyplus(), "FenestrationSurface:Detailed", "Z2:Win", "vertex_1_x_coordinate", to=3.0),
            "'Z2:Win' in 'Z2:East' lies in another plane",
        ),
        ("a.epjson", changed(energyplus(), "BuildingSurface:Detailed", "Z1:Roof", to={}), "has no 'vertices'"),
        (
            "a.epjson",
            changed(energyplus(), "BuildingSurface:Detailed", "Z2:East", "vertices", 1, "vertex_x_coordinate", to=None),
            "'Z2:East' is no list of points of three numbers",
        ),
        (
            "a.epjson",
            changed(energyplus(), "BuildingSurface:Detailed", "Z2:East", "vertices", to=VERTICES[:2]),
            "'Z2:East' has 2 corners; it needs three",
        ),
        ("a.epjson", energyplus(vertex_entry_direction="Sideways"), "an unknown direction or coordinate system"),
        ("a.epjson", energyplus(coordinate_system="Polar"), "an unknown direction or coordinate system"),
        ("a.city.json", changed(city(), "transform", "scale", to=[1, 1]), "is damaged"),
        ("a.city.json", changed(city(), *SOLID, "lod", to="high"), "is damaged"),
        ("a.city.json", changed(city(), *SOLID, "boundaries", 0, 2, to=[]), "is damaged"),
        (
            "a.city.json",
            changed(city(), *SOLID, "boundaries", 0, 3, 1, to=[8, 9]),
            "a hole of 'b1:3' has 2 corners; it needs three",
        ),
        ("a.city.json", changed(city(), "vertices", to=[[0, 0, 0]]), "surface 0 of 'b1' names vertex"),
        ("a.city.json", changed(city(), "vertices", to="x"), "'vertices' is no list of points"),
        ("a.city.json", {"type": "CityJSON", "CityObjects": {}, "vertices": []}, "has no surfaces"),
        (
            "a.city.json",
            changed(city(), *SOLID, "type", to="MultiPoint"),
            "'b1' is a MultiPoint",
        ),
        ("a.hbjson", {"type": "Model", "orphaned_faces": [{}]}, "has no rooms, only 1 orphaned faces: make rooms"),
        ("a.hbjson", changed(honeybee(), "units", to="Miles"), "not 'Miles'"),
        ("a.hbjson", changed(honeybee(), "rooms", 0, "faces", 0, to={"identifier": "x"}), "has no 'geometry'"),
        ("a.rad", RAD + "void sphere s 0 0 4 0 0 0 1\n", "line 14: sphere 's' is no polygon"),
        ("a.rad", RAD + "grey polygon p 0 0 8 0 0 0 1 0 0 0 1\n", "line 14: polygon 'p' has 8 numbers"),
        ("a.rad", RAD + "grey polygon p 0 0 9 0 0 0 1 0 0 0 1\n", "line 14: the primitive is incomplete"),
        ("a.rad", RAD + "grey polgyon p 0 0 9 0 0 0 1 0 0 0 1 0\n", "line 14: polgyon 'p' is no polygon"),
        ("a.rad", " !xform a.rad\n", "line 1: commands are not run"),
    ],
)
def test_broken_files(tmp_path, name, content, message):
    with pytest.raises(PatchError) as error:
        read_patches(written(tmp_path, name, content))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_the_room_is_closed_but_for_the_edges_of_its_window(tmp_path):
    data = energyplus()
    del data["FenestrationSurface:Detailed"]
    del data["BuildingSurface:Detailed"]["Z1:Floor"]
    data["BuildingSurface:Detailed"] = {k: v for k, v in data["BuildingSurface:Detailed"].items() if k.startswith("Z2")}
    assert diagnose(read_patches(written(tmp_path, "a.epjson", data))).is_closed
