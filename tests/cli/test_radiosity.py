"""`etendue form-factors` and `etendue radiosity`: files, what is said, bad input."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from support.patches import box, joined

from etendue.cli.main import main
from etendue.radiosity import read_form_factors

meshio = pytest.importorskip("meshio")
sparse = pytest.importorskip("scipy.sparse")

SCENE = """<scene version="3.0.0">
    <sensor type="perspective"/>
    {light}
    <shape type="cube"><boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><spectrum name="reflectance" value="{reflectance}"/></bsdf></shape>
</scene>
"""
#: A lamp that hangs in the cube and shines down.
LAMP = """<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><translate z="-0.5"/></transform>
    <bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="1, 2, 4"/></emitter></shape>"""


def run(command: str) -> int:
    return main(shlex.split(command))


def write_room(name, inward=True, walls=6):
    vertices, faces = box((0, 0, 0), (1, 2, 3), 2, inward=inward)
    meshio.write(name, meshio.Mesh(vertices, [("quad", faces[: 4 * walls].astype(np.int32))]))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_room("room.ply")


def test_form_factors_of_a_mesh(capsys):
    command = "form-factors room.ply -o f.npz --bundles 32 --seed 3 --estimator reciprocal --reflectance 0.25"
    assert run(command) == 0
    out, err = capsys.readouterr()
    assert out == "f.npz\n"
    assert "room.ply: 24 patches of 24 faces, closed" in err and "32 bundles" in err and "form factors" in err
    assert "sky" not in err and "warning" not in err
    with np.load("f.npz") as arrays:
        assert arrays["emissivity"].tolist() == [0.75] * 24
        known = json.loads(str(arrays["metadata"]))
        assert {"source": "room.ply", "bundles": 32, "seed": 3, "estimator": "reciprocal"}.items() <= known.items()
        areas = arrays["areas"]
    first = sparse.load_npz("f.npz").todense()
    np.testing.assert_allclose(areas[:, None] * first, (areas[:, None] * first).T, atol=1e-12)
    assert run(command) == 0  # the same seed, the same lines
    np.testing.assert_array_equal(sparse.load_npz("f.npz").todense(), first)


@pytest.mark.parametrize("options", ["--row-sums", "--reciprocal", "--repair --threshold 0.001"])
def test_corrected_form_factors(capsys, options):
    write_room("open.ply", walls=5)
    command = f"form-factors open.ply -o f.npz --bundles 64 {options}"
    assert run(f"{command} --checkpoint c") == 0
    err = capsys.readouterr().err
    assert re.search(
        r"row sums were off by at most \S+ \(\S+ standard errors\) and are by \S+; factors change by at most", err
    )
    assert ("small ones dropped" in err) == ("threshold" in options) and "warning" not in err
    made = read_form_factors("f.npz")
    if options != "--reciprocal":
        np.testing.assert_allclose(made.row_sums(), 1, rtol=1e-9)
    if options != "--row-sums":
        assert made.reciprocity_error() < 1e-9
    Path("f.npz").unlink()
    assert run("resume c --bundles 64") == 0  # the same corrections
    np.testing.assert_array_equal(read_form_factors("f.npz").matrix.todense(), made.matrix.todense())


def test_factors_between_groups_for_other_programs(capsys):
    """Shapes of a scene by their names, each with several patches; the checkpoint keeps what was asked for."""
    outputs = "-o 'Zone 1.idf' -o box.i -o f.csv -o f.npz -o constant/F -o constant/globalFaceFaces"
    Path("constant").mkdir()
    assert run(f"form-factors cornell-box --groups --bundles 32 --max-area 0.5 {outputs} --checkpoint c") == 0
    capsys.readouterr()
    made = read_form_factors("f.npz")
    assert made.name.tolist()[:3] == ["light", "floor", "ceiling"] and len(made) == 8
    assert Path("f.csv").read_text().startswith("name,light,floor,ceiling,back,green-wall,red-wall,small-box,")
    text = Path("Zone 1.idf").read_text()
    assert text.startswith("ZoneProperty:UserViewFactors:BySurfaceName,\n  Zone 1,\n") and text.count("\n") == 66
    assert "boundary = 'light floor" in Path("box.i").read_text()
    assert Path("constant/F").read_text().splitlines()[9] == "8"
    first = Path("f.csv").read_bytes()
    assert run("resume c --bundles 32 -o again.csv") == 0
    assert Path("again.csv").read_bytes() == first


def test_form_factors_for_udales(capsys):
    write_room("open.ply", walls=5)
    outputs = "-o vfsparse.inp.001 -o svf.inp.001 -o vf.nc.inp.001"
    assert run(f"form-factors open.ply --bundles 64 --row-sums --reciprocal --threshold 5e-7 {outputs}") == 0
    assert capsys.readouterr().out.split() == outputs.split()[1::2]
    i, _, factors = np.loadtxt("vfsparse.inp.001").T
    sky = np.loadtxt("svf.inp.001", skiprows=1)
    np.testing.assert_allclose(np.bincount(i.astype(int) - 1, factors) + sky, 1, atol=1e-6)


@pytest.mark.parametrize("name", ["f.npz", "f.nc", "f.vf"])
def test_form_factors_from_a_file_are_solved(capsys, name):
    """Grey bodies of one temperature receive sigma T^4 everywhere, whatever they reflect."""
    if name.endswith(".nc"):
        pytest.importorskip("h5netcdf")
    assert run(f"form-factors room.ply -m exact --repair -o {name}") == 0
    assert run(f"radiosity room.ply --factors {name} --temperature 300 --reflectance 0.4 -o s.npz") == 0
    assert re.search(r"(conjugate-gradient|gauss-seidel): \d+ iterations?", capsys.readouterr().err)
    with np.load("s.npz") as arrays:
        np.testing.assert_allclose(arrays["irradiance"], 5.670374419e-8 * 300**4, rtol=2e-6)
        assert json.loads(str(arrays["metadata"]))["factors"] == name


def test_ground_and_sky_apart(capsys):
    write_room("tower.ply", inward=False)
    assert run("form-factors tower.ply -o f.npz --sky-patches 2 --up y --north 30 --bundles 64") == 0
    found, known = read_form_factors("f.npz"), json.loads(str(np.load("f.npz")["metadata"]))
    assert (known["up"], known["north"], known["sky_patches"]) == ("y", 30.0, 2)
    assert found.sky_patches.shape == (24, 577) and found.row_sums() == pytest.approx(np.ones(24), abs=1e-12)
    assert found.sky.max() == pytest.approx(1) and found.ground.max() == pytest.approx(1)
    assert run("form-factors tower.ply -m spheres --up z") == 2
    assert "method lines" in capsys.readouterr().err


def test_form_factors_from_a_file_that_do_not_fit(capsys):
    write_room("open.ply", walls=5)
    vertices, faces = box((0, 0, 0), (1, 2, 4), 2, inward=True)
    meshio.write("high.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    assert run("form-factors room.ply -o f.npz --bundles 64 --estimator reciprocal") == 0
    assert run("radiosity room.ply --factors f.npz --emission 1 --reflectance 0.5 -o s.npz") == 0
    assert "row sums of 'f.npz' are off by up to 0.0" in capsys.readouterr().err
    for mesh, options, message in (
        ("open.ply", "", "'f.npz' has 24 rows, and there are 20 patches"),
        ("high.ply", "", "row 0 has the area 1.5, and patch 0 has 2"),
        ("room.ply", "--bundles 8", "no lines are cast, so leave out bundles"),
        ("room.ply", "-m multipath --ambient fuzzy", "leave out method, ambient"),
        ("room.ply", "--factors s.npz", "'s.npz' is not a file of form factors"),
        ("room.ply", "--factors no.vf", "there is no file of form factors 'no.vf'"),
    ):
        assert run(f"radiosity {mesh} --factors f.npz --emission 1 {options}") == 2
        assert message in capsys.readouterr().err


def test_form_factors_as_text_of_an_open_mesh_of_sheets(capsys):
    write_room("open.ply", walls=5)
    assert run("form-factors open.ply -o f.vf --bundles 16 --two-sided --max-area 0.3") == 0
    err = capsys.readouterr().err
    assert "% of what patches see is the sky" in err
    patches = int(Path("f.vf").read_text().split()[5])
    assert f"{patches} patches of {patches // 2} faces" in err and patches > 100


def test_exact_form_factors(capsys):
    assert run("form-factors room.ply -m exact -o f.npz --reflectance 0.25") == 0
    out, err = capsys.readouterr()
    assert out == "f.npz\n" and "form factors (exact), rows sum to" in err and "sky" not in err
    with np.load("f.npz") as arrays:
        assert json.loads(str(arrays["metadata"]))["estimator"] == "exact" and not arrays["errors"].any()
        assert arrays["emissivity"].tolist() == [0.75] * 24
    np.testing.assert_allclose(np.asarray(sparse.load_npz("f.npz").sum(axis=1)).ravel(), 1, atol=1e-6)
    write_room("open.ply", walls=5)
    assert run("form-factors open.ply -m exact -o f.vf") == 0
    assert "% of what patches see is the sky" in capsys.readouterr().err


def test_exact_form_factors_of_a_room_with_a_box(capsys):
    walls, inner = box((0, 0, 0), (1, 2, 3), 1, inward=True), box((0.2, 0.2, 0.2), (0.5, 0.5, 0.5))
    vertices, faces = np.concatenate([walls[0], inner[0]]), np.concatenate([walls[1], inner[1] + len(walls[0])])
    meshio.write("hidden.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    assert run("form-factors hidden.ply -m auto --error 1e-5") == 0
    assert "method exact: to an error of 1e-05 integrals take about" in capsys.readouterr().err
    np.testing.assert_allclose(read_form_factors("factors.npz").row_sums(), 1, atol=3e-5)
    assert run("form-factors hidden.ply -m auto") == 0
    assert "method exact: integrals take about" in capsys.readouterr().err
    assert run("form-factors hidden.ply -m auto --bundles 16") == 0
    assert "method lines: bundles is asked for" in capsys.readouterr().err


def test_exact_form_factors_of_boxes_on_a_floor(capsys):
    """One box of the scene stands on its floor, the other one is in part below."""
    for method in ("-m exact --error 0.01", "-m auto", "--exact --error 0.01"):
        assert run(f"form-factors cornell-box {method} -o boxes.npz") == 0
        err = capsys.readouterr().err
        assert "form factors (exact)" in err and "% of what patches see is the sky" in err


def test_a_room_that_is_turned_outward_is_noticed(capsys):
    write_room("flipped.ply", inward=False)
    assert run("form-factors flipped.ply --bundles 8") == 0
    assert "warning: patches see only the sky" in capsys.readouterr().err
    assert Path("factors.npz").is_file()


def test_power_that_gets_lost_is_a_warning_and_an_exit_status(capsys, variant):
    """Two walls of the room are turned: light of the others ends on their backs."""
    vertices, faces = box((0, 0, 0), (1, 2, 3), 1, inward=True)
    faces[:2] = faces[:2, ::-1]
    meshio.write("turned.ply", meshio.Mesh(vertices, [("quad", faces.astype(np.int32))]))
    command = f"radiosity turned.ply --emission 1 --reflectance 0.5 --bundles 32 -o s.npz --variant {variant}"
    assert run(command) == 8
    out, err = capsys.readouterr()
    assert out == "s.npz\n" and Path("s.npz").is_file()
    assert "warning: the power that enters the scene" in err and "standard error of" in err
    assert run(f"radiosity turned.ply --solution s.npz -o s.vtu --variant {variant}") == 8
    for more in ("-m multipath --points 4096", "-m boxes --passes 2"):
        assert run(command.replace("--bundles 32", more)) == 8


@pytest.mark.parametrize("solver", ["conjugate-gradient", "direct"])
def test_radiosity_of_a_scene(solver, capsys, variant):
    Path("scene.xml").write_text(SCENE.format(light=LAMP, reflectance=0.5))
    assert run(f"radiosity scene.xml -o s.vtu --bundles 128 --max-area 0.5 --solver {solver} --variant {variant}") == 0
    out, err = capsys.readouterr()
    assert out == "s.vtu\n"
    assert f"{solver}: " in err and "imbalance of power" in err and "standard error of irradiance" in err
    mesh = meshio.read("s.vtu")
    radiosity, emission, error = (
        np.concatenate(mesh.cell_data[name]) for name in ("radiosity", "emission", "radiosity_error")
    )
    assert radiosity.shape == (sum(len(block.data) for block in mesh.cells), 3) and (radiosity >= emission).all()
    np.testing.assert_allclose(radiosity[:, 2], 4 * radiosity[:, 0], rtol=1e-5)
    np.testing.assert_allclose(emission.max(axis=0), np.pi * np.array([1, 2, 4]), rtol=1e-5)
    assert error.max() > 0


def test_one_bundle_has_no_error(capsys, variant):
    Path("scene.xml").write_text(SCENE.format(light=LAMP, reflectance=0.5))
    assert run(f"radiosity scene.xml -o s.npz --bundles 1 --variant {variant}") == 0
    err = capsys.readouterr().err
    assert "1 bundle\n" in err and "standard error" not in err
    with np.load("s.npz") as arrays:
        assert "radiosity_error" not in arrays and json.loads(str(arrays["metadata"]))["bundles"] == 1


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("form-factors nothing.ply", "there is no mesh file nothing.ply"),
        ("form-factors room.ply -o f.txt", "take .npz, .vf"),
        ("form-factors room.ply -o nowhere/f.npz", "there is no folder"),
        ("form-factors room.ply -o ''", "take .npz, .vf"),
        ("form-factors room.ply --checkpoint c --no-checkpoint", "exclude each other"),
        ("form-factors room.ply --estimator F9", "there is no estimator 'F9'"),
        ("form-factors room.ply -o zone.idf", "knows surfaces by names"),
        ("form-factors room.ply --threshold 2", "at least 0 and below 1"),
        ("form-factors room.ply --reflectance 1.2", "must be in [0, 1]"),
        ("form-factors room.ply -m exact --bundles 8", "method exact: no lines are cast, so leave out bundles"),
        ("form-factors room.ply --bundles 0", "'--bundles': 0"),
        ("form-factors room.ply --max-area -1", "must be a positive number"),
        ("form-factors room.ply --max-area 1e-12", "allow larger ones"),
        ("form-factors broken.ply", "cannot be read as a mesh"),
        ("radiosity nothing.xml", "there is no scene file 'nothing.xml'"),
        ("radiosity cornell-box -o s.obj", "take .npz, .vtu, .ply"),
        ("radiosity cornell-box --solver gauss", "there is no solver 'gauss'"),
        ("radiosity cornell-box --solver multipath", "is a method, not a solver: give method multipath"),
        ("radiosity cornell-box -m boxes --bundles 8", "'boxes' counts passes: give passes in place of bundles"),
        ("radiosity cornell-box -m multipath --grid 3", "method 'multipath' has no option 'grid'"),
        ("radiosity cornell-box --threshold 3", "threshold is for boxes"),
        ("radiosity dark.xml", "no emitter"),
        ("radiosity spot.xml -m boxes", "has no surface; use method lines or multipath"),
        ("radiosity white.xml", "reflects 1.2 of the light"),
        ("radiosity room.ply", "'room.ply' has no light for radiosity; give it emission, a temperature or a sky"),
        ("radiosity room.ply --emission 1 -o p.png", "a picture needs a scene with a camera"),
        ("radiosity room.ply --emission 1 -o p.exr --lightmap 64 --uv scene", "uv of the scene needs a scene"),
        ("radiosity nothing.obj", "there is no mesh file nothing.obj"),
        ("radiosity room.ply --emission glow", "no array 'glow' for its faces"),
        ("radiosity room.ply --emission 1 --reflectance 1", "it would never be absorbed"),
        ("radiosity room.ply --emission -1", "must not be negative, nor infinite"),
        ("radiosity room.ply --emission inf", "must not be negative, nor infinite"),
        ("radiosity room.ply --emission 1 --temperature 300", "give one of the two"),
        ("radiosity room.ply --temperature -3", "at least 0 kelvin"),
        ("radiosity room.ply --emission 1 --sky blue", "--sky is a number"),
        ("radiosity room.ply --emission 1,2 --reflectance 0.1,0.2,0.3", "3 channels, emission 2"),
        ("radiosity room.ply --emission 1,2 -o s.ply", ".ply shows one channel or three"),
        ("radiosity room.ply --emission 1 -P a=1", "parameters are for scenes in XML"),
        ("radiosity cornell-box --reflectance 0.5", "reflectance is for mesh files"),
        ("radiosity room.ply --emission 1 --max-area 1e-4 --solver direct", "GB are free"),
        ("radiosity cornell-box --two-sided", "two_sided is for mesh files"),
        ("radiosity room.ply --emission 1 --error 0", "--error must be above 0"),
        ("radiosity room.ply --emission 1 -o s.npz --checkpoint s.npz", "named for two outputs"),
        ("radiosity room.ply --emission 1 --checkpoint nowhere/c", "there is no folder"),
        ("form-factors nan.vtu", "vertices are not finite"),
        ("form-factors lines.vtu", "has no triangles or quadrilaterals"),
        ("form-factors needles.ply", "none of 2 faces has an area"),
        ("form-factors room.ply --max-area 1e-4 -o f.vf", "write .npz, where zeros take no place"),
        ("resume room.ply", "is not an étendue checkpoint"),
    ],
)
def test_bad_input(command, message, capsys, variant):
    """One line, before any line is cast, and no file."""
    Path("broken.ply").write_text("ply\nformat ascii 1.0\nnonsense")
    Path("dark.xml").write_text(SCENE.format(light="", reflectance=0.5))
    Path("spot.xml").write_text(SCENE.format(light='<emitter type="point"/>', reflectance=0.5))
    Path("white.xml").write_text(SCENE.format(light=LAMP, reflectance=1.2))
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, np.nan]])
    meshio.write("nan.vtu", meshio.Mesh(points, [("triangle", np.array([[0, 1, 3]]))]))
    meshio.write("lines.vtu", meshio.Mesh(points[:3], [("line", np.array([[0, 1]]))]))
    meshio.write("needles.ply", meshio.Mesh(points[:3], [("triangle", np.array([[0, 1, 2], [0, 2, 1]], np.int32))]))
    capsys.readouterr()
    before = sorted(Path().iterdir())
    assert run(command + (f" --variant {variant}" if "radiosity" in command else "")) in (1, 2, 3, 4, 5)
    err = capsys.readouterr().err
    assert message in err and len(err.splitlines()) == 1
    assert sorted(Path().iterdir()) == before


def test_ctrl_c_before_the_first_line_keeps_the_old_file(monkeypatch, capsys):
    def interrupted(*arguments, **named):
        raise KeyboardInterrupt

    Path("f.npz").write_text("old")
    monkeypatch.setattr("etendue.radiosity.sources.read_patches", interrupted)
    assert run("form-factors room.ply -o f.npz") == 130
    assert "stopped; nothing was written" in capsys.readouterr().err
    assert Path("f.npz").read_text() == "old" and len(list(Path().iterdir())) == 2


def test_form_factors_by_lines_in_spheres(capsys):
    """Walls from -1 on in an array of the file; two boxes are one object."""
    mesh = joined(box((0, 0, 0), (1, 1, 1), inward=True), box((0.2,) * 3, (0.3,) * 3), box((0.6,) * 3, (0.8,) * 3))
    numbers = np.repeat([-1, 4], [6, 12])
    meshio.write("boxes.vtu", meshio.Mesh(mesh[0], [("quad", mesh[1])], cell_data={"thing": [numbers]}))
    command = "form-factors boxes.vtu -m spheres -o f.npz --objects thing --bundles 20 --point-set halton"
    assert run(command) == 0
    assert "(F4), rows sum to" in capsys.readouterr().err
    with np.load("f.npz") as arrays:
        assert json.loads(str(arrays["metadata"]))["estimator"] == "F4"
    assert run("form-factors boxes.vtu -o f.npz --walls 4") == 2
    assert "walls is for method spheres" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("form-factors two.vtu --hierarchy --bundles 8", "form-factors two.vtu -m spheres --bundles 8"),
        (
            "form-factors two.vtu --hierarchy=thing --bundles 8",
            "form-factors two.vtu -m spheres --objects thing --bundles 8",
        ),
        ("form-factors room.ply --exact", "form-factors room.ply -m exact"),
        (
            "radiosity --hierarchy two.vtu --emission 1 --bundles 2",
            "radiosity two.vtu -m boxes --emission 1 --passes 2",
        ),
    ],
)
def test_the_options_of_version_1_mean_the_same(old, new, capsys):
    mesh = joined(box((0, 0, 0), (1, 1, 1), inward=True), box((0.2,) * 3, (0.3,) * 3), box((0.6,) * 3, (0.8,) * 3))
    numbers = np.repeat([-1, 4, 5], [6, 6, 6])
    meshio.write("two.vtu", meshio.Mesh(mesh[0], [("quad", mesh[1])], cell_data={"thing": [numbers]}))
    for command, name in ((old, "old.npz"), (new, "new.npz")):
        capsys.readouterr()
        assert run(f"{command} -o {name}") == 0
        assert ("goes with the next version" in capsys.readouterr().err) == (command == old)
    with np.load("old.npz") as was, np.load("new.npz") as now:
        for name in set(was.files) - {"metadata"}:
            np.testing.assert_array_equal(was[name], now[name], err_msg=name)


def test_lines_of_a_bundle_are_chosen(capsys):
    """Their number is that of the segments, which are twice as many for twice the lines, up to one in ten."""
    found = []
    for lines in (4000, 8000):
        assert main(shlex.split(f"radiosity cornell-box --max-area 0.3 --bundles 16 --lines {lines} -o s.npz")) == 0
        found.append(float(re.search(r"([\d.e+]+) segments", capsys.readouterr().err)[1]))
    assert found[1] / found[0] == pytest.approx(2.0, rel=0.1)
