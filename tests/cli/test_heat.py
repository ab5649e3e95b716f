"""`etendue heat`: tables of conditions and loads, and files of results."""

from __future__ import annotations

import csv
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import etendue
from etendue.cli.main import main
from etendue.radiosity import STEFAN_BOLTZMANN as SIGMA, band_shares, box, read_form_factors

CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
#: A room, whose fronts are inside.
ROOM = {"floor": "5 7 3 1", "roof": "4 8 6 2", "walls": "3 4 2 1\nf 6 8 7 5\nf 2 6 5 1\nf 7 8 4 3"}


def run(command: str) -> int:
    return main(["heat", *shlex.split(command)])


def rows(path):
    """The rows of a table, by the heads of its columns without their units."""
    with Path(path).open() as file:
        found = list(csv.DictReader(file))
    return [{re.sub("_(m2|K|W|W_m2)$", "", head): cell for head, cell in row.items()} for row in found]


def write_body():
    """A cube in the open, of one group."""
    vertices, faces = box((0, 0, 0), (1, 1, 1), 1)
    corners = [f"v {x} {y} {z}" for x, y, z in vertices]
    sides = ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    Path("body.obj").write_text("\n".join([*corners, "g body", *sides, ""]))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    for name, faces in ROOM.items():
        lines += [f"g {name}", f"f {faces}"]
    Path("room.obj").write_text("\n".join([*lines, ""]))
    Path("c.csv").write_text("group,temperature,flux,emissivity\nfloor,350,,0.9\nroof,290,,0.8\nwalls,,adiabatic,0.5\n")


def test_a_room_with_adiabatic_walls(capsys):
    """By the network: floor and roof exchange directly and over the walls, which have one radiosity for each height;
    at most that of walls of one radiosity, at least that without walls."""
    assert run("room.obj -c c.csv --bundles 1024 --max-area 0.02 --seed 1 -o heat.csv -o heat.npz -o heat.vtu") == 0
    assert capsys.readouterr().out.split() == ["heat.csv", "heat.npz", "heat.vtu"]
    found = {row["group"]: {k: float(v) for k, v in row.items() if k != "group"} for row in rows("heat.csv")}
    direct = 0.199824895698387
    black = SIGMA * (350**4 - 290**4)
    surfaces = 1 / 0.9 - 1 + 1 / 0.8 - 1
    least, most = (black / (1 / f + surfaces) for f in (direct, direct + (1 - direct) / 2))
    assert least < found["floor"]["heat"] < 1.002 * most
    assert found["roof"]["heat"] == pytest.approx(-found["floor"]["heat"], rel=1e-9)
    assert found["walls"]["heat"] == pytest.approx(0, abs=1e-6) and found["walls"]["area"] == pytest.approx(4)
    assert found["walls"]["temperature"] == pytest.approx(((350**4 + 290**4) / 2) ** 0.25, rel=0.01)
    assert 290 < found["walls"]["lowest"] < found["walls"]["highest"] < 350
    assert found["floor"]["lowest"] == found["floor"]["highest"] == 350
    arrays = np.load("heat.npz")
    assert arrays["temperature"].shape == (len(arrays["group"]), 1) and arrays["names"].tolist() == list(ROOM)


def test_loads_and_given_factors():
    assert main(["form-factors", "room.obj", "--bundles", "256", "--repair", "-o", "f.npz"]) == 0
    Path("c.csv").write_text("group;temperature;flux;conductance;ambient;emissivity\nfloor;300;;;;1\n*;;;5;280;0.9\n")
    Path("hours.csv").write_text("hour,floor:temperature,roof:ambient\n9:00,300,280\n10:00,320,300\n")
    assert run("room.obj -c c.csv --factors f.npz --loads hours.csv -o hours-out.csv") == 0
    both = rows("hours-out.csv")
    assert [row["case"] for row in both] == ["9:00", "10:00"]
    assert both[1]["floor:temperature"] == "320" and float(both[1]["roof:temperature"]) > float(
        both[0]["roof:temperature"]
    )
    # Each hour alone, and by Python.
    for temperature, ambient, row in ((300, 280, both[0]), (320, 300, both[1])):
        Path("one.csv").write_text(
            "group,temperature,conductance,ambient,emissivity\n"
            f"floor,{temperature},,,1\nroof,,5,{ambient},0.9\nwalls,,5,280,0.9\n"
        )
        alone = etendue.solve_heat("room.obj", "one.csv", factors="f.npz")
        table = alone.table()
        for g, name in enumerate(alone.names):
            assert float(row[f"{name}:temperature"]) == pytest.approx(table["temperature"][g, 0], rel=1e-8)
            assert float(row[f"{name}:heat"]) == pytest.approx(table["heat"][g, 0], rel=1e-6)
    # In a closed room, heat by radiation is only exchanged.
    assert sum(float(both[0][f"{name}:heat"]) for name in ROOM) == pytest.approx(0, abs=1e-6)


def test_power_and_surroundings_of_a_body():
    """A cube in the open: sigma e (T^4 - T_s^4) per area."""
    write_body()
    Path("c.csv").write_text("group,power,emissivity\nbody,600,0.8\n")
    assert run("body.obj -c c.csv --surroundings 250 --bundles 64") == 0
    found = rows("heat.csv")[0]
    assert float(found["heat"]) == pytest.approx(600, rel=1e-8) and float(found["flux"]) == pytest.approx(100, rel=1e-8)
    assert float(found["temperature"]) == pytest.approx((250**4 + 100 / 0.8 / SIGMA) ** 0.25, rel=1e-8)


def test_a_conductor_in_bands():
    """The same cube, if it is a conductor with emissivities in two bands, in hours with a sky of their own:
    sum_b e_b (p_b(T) - p_b(T_s)) per area; and its power by its table."""
    write_body()
    Path("c.csv").write_text("group,power,isothermal,emissivity:4-inf,emissivity:0-4\nbody,0,yes,0.1,0.9\n")
    Path("hours.csv").write_text("hour,body:power,surroundings\n1,6000,0\n2,600,300\n3,0,300\n")
    assert run("body.obj -c c.csv --loads hours.csv --bundles 64 --max-area 0.3") == 0

    def per_area(t):
        return SIGMA * t**4 * band_shares([t], [0, 4e-6, np.inf])[0] @ [0.9, 0.1]

    for row, power, sky in zip(rows("heat.csv"), (6000, 600, 0), (0, 300, 300), strict=True):
        t = float(row["body:temperature"])
        assert 6 * (per_area(t) - per_area(sky)) == pytest.approx(power, rel=1e-6, abs=1e-5)
        assert float(row["body:heat"]) == pytest.approx(power, abs=1e-6)


def test_walls_of_one_temperature():
    """Of a black room whose walls are an isothermal conductor: F_fr + (1 - F_fr) / 2 of sigma (T_f^4 - T_r^4)."""
    Path("c.csv").write_text(
        "group,temperature,flux,isothermal,emissivity\nfloor,350,,,1\nroof,290,,,1\nwalls,,0,yes,1\n"
    )
    assert run("room.obj -c c.csv --bundles 1024 --max-area 0.1 --seed 1") == 0
    found = {row["group"]: row for row in rows("heat.csv")}
    exact = ((350**4 + 290**4) / 2) ** 0.25
    walls = [float(found["walls"][k]) for k in ("temperature", "lowest", "highest")]
    np.testing.assert_allclose(walls, exact, rtol=1e-3)
    assert walls[0] == walls[1] == walls[2]
    direct = 0.199824895698387
    heat = SIGMA * (350**4 - 290**4) * (1 + direct) / 2
    assert float(found["floor"]["heat"]) == pytest.approx(heat, rel=2e-3)


def test_the_emissivity_of_the_mesh():
    """View3D's, if the table has none: of two large plates close to each other, q = sigma (T_1^4 - T_2^4) / 9."""
    corners = [
        f"V {4 * z + k + 1} {x} {y} {0.001 * z}"
        for z in (0, 1)
        for k, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])
    ]
    plates = ["S 1 1 2 3 4 0 0 0.2 low", "S 2 8 7 6 5 0 0 0.2 high"]
    Path("plates.vs3").write_text("\n".join(["T", "F 3", *corners, *plates, "End of Data", ""]))
    Path("c.csv").write_text("group,temperature\nlow,400\nhigh,300\n")
    assert run("plates.vs3 -c c.csv --bundles 1024") == 0
    found = float(rows("heat.csv")[0]["heat"])
    assert found == pytest.approx(SIGMA * (400**4 - 300**4) / (2 / 0.2 - 1), rel=0.02)


def test_turned_faces_of_form_factors():
    """--orient reaches the mesh."""
    turned = Path("room.obj").read_text().replace("f 5 7 3 1", "f 1 3 7 5")
    Path("turned.obj").write_text(turned)
    assert main(["form-factors", "turned.obj", "--bundles", "64", "--orient", "inward", "-o", "f.npz"]) == 0
    assert read_form_factors("f.npz").dark.max() == 0


@pytest.mark.parametrize(
    ("conditions", "loads", "words"),
    [
        ("group,temperature\nfloor,300\n", "", "no row of group 'roof'"),
        ("group,temperature\n*,300\nceiling,200\n", "", "line 3: there is no group 'ceiling'"),
        ("group,temperature\n*,300\nfloor,200\nfloor,210\n", "", "line 4: group 'floor' has a row above"),
        ("group,temperature,flux\n*,300,5\n", "", "has a temperature and a flux"),
        ("group,temperature\nfloor,300\n*,\n", "", "group 'roof' has no temperature, flux"),
        ("group,temperature,flux\nfloor,300,\n*,,none\n", "", "line 3: flux 'none' is no number"),
        ("group,temperature\n*,nan\n", "", "is no number"),
        ("group,temperature\n*,-3\n", "", "temperature must be at least 0"),
        ("group,temperature,emissivity\n*,300,1.5\n", "", "emissivity must be in"),
        ("group,kelvin\n*,300\n", "", "has a column 'kelvin'"),
        ("name,temperature\n*,300\n", "", "the first column is 'group'"),
        ("group,temperature,conductance\nfloor,300,\n*,,5\n", "", "belong together"),
        ("group,temperature\n*,300,4\n", "", "line 2 has 3 cells, not 2"),
        ("group,flux\n*,10\n", "", "the heat of patch 0 of group 'floor' cannot leave"),
        (
            "group,temperature,emissivity:0-4,emissivity:5-inf\n*,9,1,1\n",
            "",
            "emissivity:0-4, emissivity:5-inf do not go",
        ),
        ("group,temperature,emissivity:4-0,emissivity:4-inf\n*,9,1,1\n", "", "do not go on from 0 to inf"),
        ("group,temperature,emissivity:0-4\n*,9,1\n", "", "do not go on from 0 to inf"),
        ("group,temperature,emissivity:short\n*,9,1\n", "", "'emissivity:short' is no band in micrometres"),
        ("group,temperature,emissivity:0-4,emissivity:4-inf\n*,9,1,\n", "", "group 'floor' has no emissivity:4-inf"),
        ("group,temperature,emissivity,emissivity:0-inf\n*,9,1,1\n", "", "give one or the other"),
        ("group,temperature,emissivity:0-inf,emissivity:0-inf\n*,9,1,1\n", "", "has two columns 'emissivity:0-inf'"),
        ("group,temperature,isothermal\n*,9,perhaps\n", "", "line 2: isothermal is 'yes' or 'no', not 'perhaps'"),
        ("group,temperature,isotherm\n*,9,yes\n", "", "did you mean 'isothermal'"),
        ("group,temperature\n*,300\n", "h,surroundings,Surroundings\n1,2,3\n", "two columns 'Surroundings'"),
        ("group,temperature\n*,300\n", "h,surroundings\n1,-2\n", "surroundings must be at least 0"),
        ("group,temperature\n*,300\n", "h,floor:emissivity:0-4\n1,1\n", "'floor:emissivity:0-4' is no GROUP:COLUMN"),
        ("group,temperature\n*,300\n", "h,floor\n1,2\n", "'floor' is no GROUP:COLUMN"),
        ("group,temperature\n*,300\n", "h,floor:emissivity\n1,2\n", "must end in temperature"),
        ("group,temperature\n*,300\n", "h,floor:temperature\n1,2\n2,\n", "line 3: column 'floor:temperature' has no"),
        ("group,temperature\n*,300\n", "h,floor:temperature\n", "has no rows"),
    ],
)
def test_bad_tables_are_one_line(capsys, conditions, loads, words):
    Path("c.csv").write_text(conditions)
    Path("h.csv").write_text(loads)
    assert run("room.obj -c c.csv --bundles 16" + (" --loads h.csv" if loads else "")) not in (0, 70)
    told = capsys.readouterr().err
    line = next(line for line in told.splitlines() if line.startswith("error: "))
    assert words in line, line
    assert not Path("heat.csv").exists()


@pytest.mark.parametrize(("heads", "cells"), [("flux,isothermal", "0,yes"), ("power,isothermal", "5,")])
def test_a_group_without_area(capsys, heads, cells):
    """It can have a flux, and then has no temperature."""
    Path("line.obj").write_text(Path("room.obj").read_text() + "g line\nf 1 2 2\n")
    Path("c.csv").write_text(f"group,temperature,{heads}\nline,,{cells}\n*,300,,\n")
    assert run("line.obj -c c.csv --bundles 16") not in (0, 70)
    what = "isothermal" if "yes" in cells else "power"
    assert f"group 'line' has no area, but {what} needs one" in capsys.readouterr().err
    Path("c.csv").write_text("group,temperature,flux,emissivity:0-4,emissivity:4-inf\nline,,0,1,1\n*,300,,0.5,1\n")
    assert run("line.obj -c c.csv --bundles 16") == 0
    found = {row["group"]: row["temperature"] for row in rows("heat.csv")}
    assert found == {"floor": "300", "roof": "300", "walls": "300", "line": ""}


def test_a_picture_and_no_heat_of_rounding(capsys):
    """The walls lose exactly 0, and the picture shows many temperatures, and white around the room."""
    assert run("room.obj -c c.csv --bundles 64 --max-area 0.1 -o heat.png -o heat.csv") == 0
    assert {row["group"]: row["heat"] for row in rows("heat.csv")}["walls"] == "0"
    pixels = np.asarray(Image.open("heat.png"))[:, :600].reshape(-1, 3)
    assert (255, 255, 255) in set(map(tuple, pixels.tolist()))
    assert len(np.unique(pixels, axis=0)) > 10
    Path("hours.csv").write_text("hour,floor:temperature\n9,300\n10,310\n")
    assert run("room.obj -c c.csv --loads hours.csv -o heat.png") == 2
    assert "room for one case" in capsys.readouterr().err


def test_files_that_cannot_be(capsys):
    assert run("room.obj -c c.csv -o heat.txt") == 2
    assert "written as .csv, .npz, .vtu" in capsys.readouterr().err
    assert run("room.obj -c none.csv") not in (0, 70)
    assert "there is no table none.csv" in capsys.readouterr().err


def test_a_room_of_one_temperature_exchanges_no_heat(capsys):
    """What is left in the balance is rounding."""
    Path("c.csv").write_text("group,temperature,flux,emissivity\nfloor,300,,0.9\n*,,adiabatic,0.5\n")
    assert run("room.obj -c c.csv --bundles 64 --max-area 0.1") == 0
    assert {(row["heat"], row["flux"]) for row in rows("heat.csv")} == {("0", "0")}


def test_heads_have_units(capsys):
    """Of groups, and of cases; and a sky without a temperature is told."""
    Path("hours.csv").write_text("hour,floor:temperature\n9,300\n10,310\n")
    assert run("room.obj -c c.csv --bundles 16 -o one.csv") == 0
    assert run("room.obj -c c.csv --bundles 16 --loads hours.csv -o two.csv") == 0
    assert "sky" not in capsys.readouterr().err
    heads = [Path(name).read_text().split("\n")[0] for name in ("one.csv", "two.csv")]
    assert heads[0] == "group,area_m2,temperature_K,lowest_K,highest_K,heat_W,flux_W_m2"
    assert heads[1].startswith("case,floor:temperature_K,floor:heat_W,")
    write_body()
    Path("b.csv").write_text("group,temperature\nbody,300\n")
    assert run("body.obj -c b.csv --bundles 16") == 0
    assert "100 % of what the surfaces see is the sky, which is taken to be at 0 K" in capsys.readouterr().err
    assert run("body.obj -c b.csv --bundles 16 --surroundings 0") == 0
    err = capsys.readouterr().err
    assert "at 0 K" not in err and "6 patches, 1 group: " in err


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("floor,300,,0.9\nroof,,5,0\n*,,0,0.5", "patch 1 of group 'roof' has emissivity 0, and can neither"),
        ("floor,300,,0.9\nroof,,-900,0.5\n*,,0,0.5", "of group 'roof' would have to be colder than 0 K"),
    ],
)
def test_errors_name_the_group(capsys, table, words):
    Path("c.csv").write_text(f"group,temperature,flux,emissivity\n{table}\n")
    assert run("room.obj -c c.csv --bundles 64") not in (0, 70)
    assert words in capsys.readouterr().err
