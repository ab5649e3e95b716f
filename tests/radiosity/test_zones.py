"""Form factors of buildings of several zones: each zone by itself, an object for each in files of EnergyPlus."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.buildings import energyplus, written

import etendue
from etendue.cli.main import main
from etendue.core import OptionError
from etendue.engine import Budget
from etendue.formats import FormatError
from etendue.radiosity import (
    RadiosityError,
    check_factors,
    known_rows,
    no_factors,
    read_form_factors,
    read_notes,
    read_patches,
)
from etendue.surfaces import zone_names

#: Form factors of opposite and of adjacent sides of a cube.
PLATES, BESIDE = 0.19982490, 0.20004378


@pytest.fixture
def building(tmp_path, monkeypatch, variant):
    """Two rooms that share a wall."""
    monkeypatch.chdir(tmp_path)
    return written(tmp_path, "two.epJSON", energyplus(shift=1.0))


def objects(text):
    """Zone and factors by names of surfaces of each object in an IDF file, read as EnergyPlus does."""
    found = {}
    for item in text.split(";")[:-1]:
        kind, zone, *rest = (field.strip() for field in item.split(","))
        assert kind == "ZoneProperty:UserViewFactors:BySurfaceName"
        found[zone] = {(a, b): float(f) for a, b, f in zip(rest[::3], rest[1::3], rest[2::3], strict=True)}
    return found


@pytest.mark.parametrize("method", ["exact", "lines"])
def test_an_object_for_each_zone(building, method, capsys):
    assert main(f"form-factors {building} -m {method} --repair -o f.idf -o f.epJSON -o f.npz".split()) == 0
    err = capsys.readouterr().err
    assert ", closed\n" in err
    assert "zone 'Z1', 6 patches: 30 form factors" in err and "zone 'Z2', 7 patches: " in err and "warning" not in err
    zones = objects(Path("f.idf").read_text())
    assert list(zones) == ["Z1", "Z2"] and [len(pairs) for pairs in zones.values()] == [36, 49]
    tolerance = 1e-7 if method == "exact" else 5e-3
    for zone, pairs in zones.items():
        names = list(dict.fromkeys(first for first, _ in pairs))
        assert all(name.startswith(zone) for name in names)
        for name in names:
            assert sum(pairs[name, other] for other in names) == pytest.approx(1, abs=1e-7)
        assert pairs[f"{zone}:Floor", f"{zone}:Roof"] == pytest.approx(PLATES, abs=tolerance)
        assert pairs[f"{zone}:Floor", f"{zone}:West"] == pytest.approx(BESIDE, abs=tolerance)
    (content,) = json.loads(Path("f.epJSON").read_text()).values()
    assert [made["zone_or_zonelist_or_space_or_spacelist_name"] for made in content.values()] == ["Z1", "Z2"]
    assert [len(made["view_factors"]) for made in content.values()] == [36, 49]
    read = read_form_factors("f.npz")
    assert list(read.zone) == 6 * ["Z1"] + 7 * ["Z2"]
    assert read.matrix[:6, 6:].nnz == read.matrix[6:, :6].nnz == 0


@pytest.mark.parametrize(
    ("asked", "first", "second"),
    [
        ({"method": "auto"}, {"estimator": "exact"}, {"seed": 5, "bundles": 64, "estimator": "F1"}),
        ({"method": "rays", "error": 0.2}, *(2 * [{"estimator": "rays", "rays": 32, "seed": 5}])),
    ],
)
def test_how_each_zone_was_made(building, monkeypatch, asked, first, second):
    """Also by integrals in one zone and lines in the next; then all rows are known."""
    monkeypatch.setattr("etendue.products.patches.tasks.choose", lambda patches, error: (len(patches) == 6, "a test"))
    monkeypatch.setattr("etendue.products.patches.base._BUDGETS", {"bundles": Budget(samples=64)})
    result = etendue.compute_form_factors(building, seed=5, save="f.npz", **asked)
    known = read_notes("f.npz")[1]
    assert known.keys() == {"software", "source", "zones"}
    assert known["zones"] == {"Z1": first, "Z2": second} and known == result.metadata
    assert known_rows(read_form_factors("f.npz")).all()


def test_a_gap_shows_nothing_of_the_next_zone(tmp_path, variant):
    """Without the walls between them, two rooms would see each other."""
    data = energyplus(shift=1.0)
    for name in ("Z1:East", "Z2:West"):
        del data["BuildingSurface:Detailed"][name]
    path = written(tmp_path, "open.epJSON", data)
    for method in ("exact", "lines"):
        factors = etendue.compute_form_factors(path, method).factors
        assert factors.matrix[:5, 5:].nnz == factors.matrix[5:, :5].nnz == 0
        floor = list(factors.name).index("Z1:Floor")
        assert factors.sky[floor] == pytest.approx(BESIDE, abs=5e-3)


def test_heat_stays_in_a_zone(building):
    """Two rooms of other temperatures with a common wall: none sends heat to the other."""
    rows = [f"Z{k}:{side},{300 + 100 * (k - 1)},,0.8" for k in (1, 2) for side in ("Floor", "Roof")]
    table = ["group,temperature,flux,emissivity", *rows, "*,,adiabatic,0.8", ""]
    (building.parent / "c.csv").write_text("\n".join(table))
    result = etendue.solve_heat(read_patches(building), building.parent / "c.csv", bundles=64)
    np.testing.assert_allclose(result.balance.temperature[:, 0], 6 * [300] + 7 * [400], rtol=1e-6)


def test_one_zone(building, capsys):
    assert main(f"form-factors {building} -m exact --zone z1 -o any.idf".split()) == 0
    assert list(objects(Path("any.idf").read_text())) == ["Z1"]
    assert main(f"form-factors {building} -m lines --checkpoint c -o f.idf".split()) == 2
    assert "a checkpoint is of one zone: give zone, one of Z1, Z2" in capsys.readouterr().err
    assert main(f"form-factors {building} -m exact --zone Z3 -o f.idf".split()) == 3
    assert "has no zone 'Z3'; there are: Z1, Z2" in capsys.readouterr().err


def test_rows_that_are_open_are_named(tmp_path, variant, caplog):
    data = energyplus(shift=1.0)
    del data["BuildingSurface:Detailed"]["Z2:Roof"]
    etendue.compute_form_factors(written(tmp_path, "a.epJSON", data), "exact", save=tmp_path / "f.idf")
    assert re.search(r"off by at most 0\.2\d? in 1 zone \(Z2\), as of 'Z2:\w+'", caplog.text)


def test_groups_of_several_zones(building, tmp_path):
    """They have no zone, and are no surfaces of EnergyPlus."""
    patches = read_patches(building, ids="zone")
    assert list(patches.zones) == ["Z1", "Z2"]
    joined = read_patches(building, ids=[0] * 13)
    assert list(joined.zones) == [""]
    with pytest.raises(RadiosityError, match="is of several zones: take other groups"):
        etendue.compute_form_factors(joined, bundles=16, groups=True, save=tmp_path / "f.idf")
    found = etendue.compute_form_factors(building, "exact", max_area=0.5, groups=True)
    assert list(found.groups.zone) == 6 * ["Z1"] + 7 * ["Z2"]
    assert all(zone.groups is None for zone in found.zones.values())


def test_names_of_zones_are_checked_before_anything_is_computed(building, tmp_path):
    patches = read_patches(building)
    patches.zones = np.where(patches.zones == "Z2", "Hall, east", patches.zones)
    check_factors("f.epJSON", no_factors(patches))
    with pytest.raises(FormatError, match="no names with ',', ';' or '!', as 'Hall, east': rename it"):
        check_factors("f.idf", no_factors(patches))
    patches.zones = None  # their zone is then that of the file
    with pytest.raises(FormatError, match="as 'a,b'"):
        check_factors("a,b.idf", no_factors(patches))


def test_further_files(building, caplog):
    """Obstacles stand in every zone; patches of a file without zones would belong to none."""
    written(building.parent, "desk.obj", "v 0.4 0.4 0.5\nv 0.6 0.4 0.5\nv 0.6 0.6 0.5\nv 0.4 0.6 0.5\nf 1 2 3 4\n")
    patches = read_patches(building, obstacles=["desk.obj"])
    assert list(patches.zones) == 6 * ["Z1"] + 7 * ["Z2"] and not caplog.text
    factors = etendue.compute_form_factors(patches, "exact").factors
    floor, roof = (list(factors.name).index(name) for name in ("Z1:Floor", "Z1:Roof"))
    assert factors.matrix[floor, roof] < PLATES - 0.01 and factors.dark[roof] > 0.01
    assert read_patches(building, more=["desk.obj"]).zones is None
    assert "its zones are not kept beside a further file that has none" in caplog.text


def test_zones_of_two_files_are_apart(tmp_path, variant):
    """Two open rooms of the same name, face to face, see nothing of each other."""
    walls = energyplus(shift=1.0)["BuildingSurface:Detailed"]
    (tmp_path / "far").mkdir()
    for file, zone, opening in (("a", "Z1", "Z1:East"), ("b", "Z2", "Z2:West"), ("far/b", "Z2", "Z2:West")):
        own = {k: v | {"zone_name": "Hall"} for k, v in walls.items() if k.startswith(zone) and k != opening}
        hall = {"BuildingSurface:Detailed": own, "Zone": {"Hall": {}}, "FenestrationSurface:Detailed": {}}
        written(tmp_path, f"{file}.epJSON", energyplus() | hall)
    paths = [tmp_path / name for name in ("a.epJSON", "b.epJSON", "far/b.epJSON")]
    assert zone_names(read_patches(paths[0])) == ("Hall",)
    patches = read_patches(paths[0], more=[paths[1]])
    assert zone_names(patches) == ("a: Hall", "b: Hall")
    factors = etendue.compute_form_factors(patches, "exact").factors
    assert factors.matrix[:5, 5:].nnz == factors.matrix[5:, :5].nnz == 0
    assert factors.sky[0] == pytest.approx(BESIDE, abs=1e-6)
    assert zone_names(read_patches(paths[0], more=paths[1:])) == ("a: Hall", "b 2: Hall", "b 3: Hall")


def test_what_is_in_the_file(building, capsys):
    assert main(["info", str(building), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["zones"] == "Z1, Z2" and told["extent"] == "2 x 1 x 1" and told["mesh"].endswith(", closed")
    assert told["names"].startswith("Z1:Floor, Z1:Roof")


def test_other_methods_and_workers(building, capsys):
    """Spheres know no names of other zones; workers are refused."""
    factors = etendue.compute_form_factors(building, "spheres", bundles=64).factors
    floor, roof = (list(factors.name).index(name) for name in ("Z1:Floor", "Z1:Roof"))
    assert factors.matrix[floor, roof] == pytest.approx(PLATES, abs=0.03)
    for asked in ({"objects": "surfaces"}, {"objects": 13 * [0]}, {"walls": ("Z1:Floor",)}):
        with pytest.raises(OptionError, match="are those of one zone: read one of Z1, Z2"):
            etendue.compute_form_factors(building, "spheres", bundles=16, **asked)
    alone = "-m spheres --objects surfaces --zone Z1 --bundles 16 -o f.npz"
    assert main(f"form-factors {building} {alone}".split()) == 0 and len(read_form_factors("f.npz")) == 6
    assert main(f"form-factors {building} --workers 2 -o f.npz".split()) == 2
    assert "zones are computed one after the other" in capsys.readouterr().err
