"""Domains that repeat without end: canyons in closed form, cubes among their copies, suns, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import opposite, square

import etendue
from etendue.cli.main import main
from etendue.core import CheckpointError, OptionError
from etendue.lighting import Meters, Suns
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    box,
    exact_form_factors,
    form_factors,
    joined,
    local_form_factors,
    point_factors,
    sky_parts,
    sunlight,
)
from etendue.radiosity.lines.periodic import PeriodicBundles, _wrap
from etendue.surfaces import PatchError

STREET, HEIGHT, ROOF, SHORT = 10.0, 8.0, 6.0, 3.0
#: Street, walls that face +x and -x, roof.
NAMES = ("street", "west", "east", "roof")


def canyon(period=(STREET + ROOF, SHORT), at=0.0):
    """One short period of an endless street along y, its street beginning at x = ``at``."""
    length = (0, SHORT, 0)
    parts = [
        square((at, 0, 0), (STREET, 0, 0), length),
        square((at, 0, 0), length, (0, 0, HEIGHT)),
        square((at + STREET, 0, 0), (0, 0, HEIGHT), length),
        square((at + STREET, 0, HEIGHT), (ROOF, 0, 0), length),
    ]
    return Patches(*joined(*parts), periodic=period)


def crossed_strings():
    """Form factors and sky view of the canyon [Hottel 1967]."""
    diagonal = np.hypot(STREET, HEIGHT)
    sky = (diagonal - HEIGHT) / STREET
    walls = (diagonal - STREET) / HEIGHT
    to_wall, to_street = (1 - sky) / 2, (1 - walls) / 2
    matrix = [[0, to_wall, to_wall, 0], [to_street, 0, walls, 0], [to_street, walls, 0, 0], [0] * 4]
    return np.array(matrix), np.array([sky, to_street, to_street, 1])


def means(patches, seeds, bundles=128):
    """Form factors with the sky in the last column, and their standard errors, by independent casts."""
    casts = [form_factors(ABuffer(patches, OwenSobol(4, seed=seed)).cast(bundles)) for seed in range(seeds)]
    rows = np.array([np.column_stack([f.matrix.todense(), f.sky]) for f in casts])
    for f in casts:
        assert f.row_sums() == pytest.approx(1, abs=1e-12) and not f.dark.any()
    return rows.mean(axis=0), rows.std(axis=0, ddof=1) / np.sqrt(seeds)


# Street by street, a street alone, and its seam through the roof, the street, or along x.
@pytest.mark.parametrize("period", [(STREET + ROOF, SHORT), (0, SHORT)])
@pytest.mark.parametrize("engine", ["lines", "rays"])
def test_an_endless_street(period, engine):
    matrix, sky = crossed_strings()
    wanted = np.column_stack([matrix, sky])
    patches = canyon(period)
    if engine == "lines":
        found, error = means(patches, 8)
    else:
        made = local_form_factors(RayScene(patches), 1 << 14)
        assert not made.dark.any()
        found = np.column_stack([made.matrix.todense(), made.sky])
        error = np.sqrt(found * (1 - found) / (1 << 14))
    assert (np.abs(found - wanted) < 5 * error + 1e-12).all() and error.max() < 5e-3


def test_a_street_along_x():
    patches = canyon()
    turned = Patches(patches.vertices[:, [1, 0, 2]], patches.faces[:, ::-1], periodic=(SHORT, 0))
    found, error = means(turned, 8)
    assert (np.abs(found - np.column_stack(crossed_strings())) < 5 * error + 1e-12).all()


def test_the_seam_may_be_anywhere():
    # Half of the street at either end of the mesh: the faces of a row are one patch each.
    half = STREET / 2
    length = (0, SHORT, 0)
    parts = [
        square((0, 0, 0), (half, 0, 0), length),
        square((half, 0, 0), (0, 0, HEIGHT), length),
        square((half, 0, HEIGHT), (ROOF, 0, 0), length),
        square((half + ROOF, 0, 0), length, (0, 0, HEIGHT)),
        square((half + ROOF, 0, 0), (half, 0, 0), length),
    ]
    found, error = means(Patches(*joined(*parts), ids=[0, 2, 3, 1, 0], periodic=(STREET + ROOF, SHORT)), 8)
    assert (np.abs(found - np.column_stack(crossed_strings())) < 5 * error + 1e-12).all()


def test_a_low_roof_between_the_copies_of_a_tower():
    low, high, gap, roof, tower = 2.0, 7.0, 3.0, 4.0, 5.0
    length = (0, SHORT, 0)
    x = np.cumsum([0, gap, roof, gap, tower])
    parts = [
        square((x[1], 0, low), (roof, 0, 0), length),
        square((x[1], 0, 0), (0, 0, low), length),
        square((x[2], 0, 0), length, (0, 0, low)),
        square((x[3], 0, 0), (0, 0, high), length),
        square((x[4], 0, 0), length, (0, 0, high)),
        square((x[3], 0, high), (tower, 0, 0), length),
        square((0, 0, 0), (gap, 0, 0), length),
        square((x[2], 0, 0), (gap, 0, 0), length),
    ]
    found, error = means(Patches(*joined(*parts), periodic=(x[4], SHORT)), 8)
    sky = (np.hypot(gap + roof, high - low) - np.hypot(gap, high - low)) / roof
    wanted = [(1 - sky) / 2, (1 - sky) / 2, sky]
    assert (np.abs(found[0, [3, 4, -1]] - wanted) < 5 * error[0, [3, 4, -1]]).all()


def cubes(tiles):
    """Cubes of side 1 on tiles of side 2, and the tile of each face; six faces each: five of the cube, and the ground
    around it in four strips of one patch."""
    parts, patch = [], []
    for k, (i, j) in enumerate(tiles):
        vertices, faces = box((2 * i + 0.5, 2 * j + 0.5, 0), (2 * i + 1.5, 2 * j + 1.5, 1))
        below = (vertices[faces][:, :, 2] == 0).all(axis=1)
        parts.append((vertices, faces[~below]))
        strips = [((0, 0), (2, 0.5)), ((0, 1.5), (2, 0.5)), ((0, 0.5), (0.5, 1)), ((1.5, 0.5), (0.5, 1))]
        for (x, y), (a, b) in strips:
            parts.append(square((2 * i + x, 2 * j + y, 0), (a, 0, 0), (0, b, 0)))
        patch += [*range(6 * k, 6 * k + 5), *[6 * k + 5] * 4]
    return *joined(*parts), patch


def test_cubes_among_copies_of_them():
    *one, ids = cubes([(0, 0)])
    found, error = means(Patches(*one, ids=ids, periodic=(2, 2)), 8)
    # A tile among 7 x 7, the middle one first, with a fence around: what the fence gets would go on.
    tiles = sorted(((i, j) for i in range(-3, 4) for j in range(-3, 4)), key=lambda t: t != (0, 0))
    *many, ids = cubes(tiles)
    fence = [((-6, -6), (0, 14)), ((8, -6), (0, 14)), ((-6, -6), (14, 0)), ((-6, 8), (14, 0))]
    sheets = [square((x, y, 0), (a, b, 0), (0, 0, 1)) for (x, y), (a, b) in fence]
    count = 6 * len(tiles)
    whole = Patches(*joined(many, *sheets), ids=[*ids, *[count] * 4], two_sided=np.arange(count + 1) == count)
    rays = local_form_factors(RayScene(whole), 1 << 14, rows=range(6))
    rows = rays.matrix[:6].todense()
    brute = np.column_stack([rows[:, :count].reshape(6, len(tiles), 6).sum(axis=1), rays.sky[:6]])
    beyond = rows[:, count:].sum(axis=1)
    noise = np.sqrt(error**2 + brute * (1 - brute) / (1 << 14))
    assert (np.abs(found - brute) <= 5 * noise + beyond[:, None]).all()
    assert beyond.max() < 0.02 and noise.max() < 5e-3


def test_rows_are_reciprocal():
    *one, ids = cubes([(0, 0)])
    patches = Patches(*one, ids=ids, periodic=(2, 2))
    segments = ABuffer(patches).cast(64)
    assert np.abs(segments.counted / segments.expected - 1).max() < 0.01
    assert form_factors(segments, "pooled").reciprocity_error() < 1e-12
    repaired = form_factors(segments).repaired()
    assert repaired.reciprocity_error() < 1e-9 and repaired.row_sums() == pytest.approx(1, abs=1e-6)
    assert patches.subdivided(0.5).period == patches.only(np.arange(6) < 3)[0].period == (2.0, 2.0)
    assert Patches.of_arrays(patches.arrays()).period == (2.0, 2.0)


def test_the_sky_is_above():
    patches = canyon()
    task = etendue.compute_form_factors(patches, bundles=256, up="z", sky_patches=1)
    f = task.factors
    assert not f.ground.any() and f.sky_patches.sum(axis=1) == pytest.approx(f.sky, abs=1e-12)
    # Half of the sky over a street along y is on either side.
    error = 3 / np.sqrt(256)
    assert f.sky[1:3].sum() == pytest.approx(2 * crossed_strings()[1][1], abs=error)


@pytest.mark.parametrize("along", [0.0, 2.0])
def test_low_suns_in_a_street(along):
    """Shadows of the next street's houses; a component of the sun along the street changes nothing."""
    slopes = np.array([2.0, 1.0, 0.5, 0.1, 0.02])
    suns = Suns([[-1.0, along, slope] for slope in slopes], [800] * 5)
    found = sunlight(canyon(), suns)
    lit = np.clip(1 - HEIGHT / slopes / STREET, 0, 1)
    wall = np.clip(slopes * STREET / HEIGHT, 0, 1)
    for row, wanted in ((0, lit), (2, wall), (3, np.ones(5))):
        assert (np.abs(found.sunlit[row] - wanted) < 5 * found.error[row] + 5e-3).all()
    assert not found.sunlit[1].any()


def test_a_sun_at_the_horizon_lights_roof_and_no_walls():
    found = sunlight(canyon(), Suns([[-1, 0.3, 0]], [800]))
    assert found.sunlit[2, 0] < 2e-3 and np.isfinite(found.error).all()


def test_sensors_in_any_period():
    places = np.array([[STREET / 2, 1, 0.0]]) + np.array([[0, 0, 0], [3 * (STREET + ROOF), -7 * SHORT, 0]])
    found = point_factors(canyon(), Meters(places, np.tile([0, 0, 1.0], (2, 1))), rays=1 << 14)
    wanted = STREET / 2 / np.hypot(STREET / 2, HEIGHT)
    assert found.sky == pytest.approx(wanted, abs=5 * np.sqrt(wanted * (1 - wanted) / (1 << 14)))
    assert not found.dark.any()


def test_periods_are_brought_back():
    for a, b, c, d in np.random.default_rng(0).integers(-12, 13, (2000, 4)).tolist():
        if a * d == b * c:
            continue
        columns, rows, skew = _wrap(a, b, c, d)
        assert columns * rows == abs(a * d - b * c)
        for column, row in ((a, b), (c, d), (a + 3 * c, b + 3 * d)):
            assert row % rows == 0 and (column - row // rows * skew) % columns == 0


@pytest.mark.parametrize("period", [(STREET + ROOF, SHORT), (0, SHORT)])
def test_the_mean_number_of_lines_is_right(period):
    bundles = PeriodicBundles(canyon(period), 300)
    choices = (np.arange(2048) + 0.5) / 2048
    for slope in (0.9, 0.31, 0.004, 0.0007):
        way = np.tile([np.sqrt(1 - slope**2), 0, slope], (len(choices), 1))
        mean = bundles.density(bundles.frames_along(way, choices)).mean()
        assert mean * bundles.spacing**2 == pytest.approx(1, rel=3e-3)


@pytest.mark.parametrize("lines", [1, 7])
def test_bundles_of_few_lines(lines):
    """Most lattices are far from the wanted number of lines, and many bundles have none; the mean is right."""
    wanted = np.column_stack(crossed_strings())
    casts = [ABuffer(canyon(), OwenSobol(4, seed=seed), lines=lines).cast(1024) for seed in range(8)]
    rows = [np.column_stack([f.matrix.todense(), f.sky]) for f in map(form_factors, casts)]
    error = np.std(rows, axis=0, ddof=1) / np.sqrt(len(rows))
    assert (np.abs(np.mean(rows, axis=0) - wanted) < 5 * error + 1e-12).all() and error.max() < 0.03
    shares = [segments.counted / segments.expected for segments in casts]
    error = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    assert (np.abs(np.mean(shares, axis=0) - 1) < 5 * error).all() and error.max() < 0.06


def test_what_is_refused(tmp_path, caplog):
    with pytest.raises(PatchError, match="the mesh is 16 long in x, more than its period of 15"):
        canyon((15, SHORT))
    for wrong in ((1, 2, 3), (np.nan, 1), (-1, 2), "ab"):
        with pytest.raises(PatchError, match="a period is two lengths"):
            canyon(wrong)
    assert canyon((0, 0)).period is None and not caplog.records
    canyon((STREET + ROOF, 4))
    assert "the mesh is 3 long in y, its period 4: lines pass through the gap" in caplog.text
    patches = canyon()
    for refused in (
        lambda: exact_form_factors(patches),
        lambda: etendue.compute_form_factors(patches, "spheres", bundles=2),
        lambda: etendue.solve_radiosity(patches.with_properties(emission=1.0), method="multipath", points=64),
        lambda: etendue.solve_radiosity(patches.with_properties(emission=1.0), method="boxes", passes=1),
    ):
        with pytest.raises(OptionError, match="cannot repeat a periodic domain"):
            refused()
    with pytest.raises(RadiosityError, match="compiled loops"):
        ABuffer(patches, backend="drjit")
    with pytest.raises(RadiosityError, match="z is up, not y"):
        sunlight(patches, Suns([[0, 0, 1]], [800]), up="y")
    with pytest.raises(RadiosityError, match="z is up, not y"):
        sky_parts(form_factors(ABuffer(patches).cast(1)), ABuffer(patches).cast(1), "y")
    assert etendue.compute_form_factors(patches, "auto", bundles=2).stopped_by != "exact"


def test_light_of_the_next_street():
    """A lit wall lights the street of its copy: radiosity by lines, without a shot that would see one period."""
    matrix, _ = crossed_strings()
    emission = np.where(np.arange(4) == 2, 1.0, 0.0)
    found = etendue.solve_radiosity(canyon().with_properties(emission=emission), bundles=256)
    assert found.solution.irradiance[:, 0] == pytest.approx(matrix[:, 2], abs=0.01)


def test_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    patches = canyon()
    lines = [f"v {x} {y} {z}" for x, y, z in patches.vertices]
    for name, face in zip(NAMES, patches.faces + 1, strict=True):
        lines += [f"g {name}", "f " + " ".join(map(str, face))]
    (tmp_path / "street.obj").write_text("\n".join(lines))
    period = ["--periodic", f"{STREET + ROOF},{SHORT}"]
    files = ["-o", "vfsparse.inp.001", "-o", "svf.inp.001"]
    assert main(["form-factors", "street.obj", *period, "--bundles", "256", "--repair", *files]) == 0
    matrix, sky = crossed_strings()
    assert np.loadtxt("svf.inp.001") == pytest.approx(sky, abs=0.01)
    (tmp_path / "suns.csv").write_text("azimuth,altitude\n270,20\n")
    assert main(["sunlight", "street.obj", *period, "--suns", "suns.csv", "-o", "sun.npz"]) == 0
    lit = np.tan(np.deg2rad(20)) * STREET / HEIGHT
    assert np.load("sun.npz")["sunlit"].ravel() == pytest.approx([0, 0, lit, 1], abs=0.01)
    (tmp_path / "points.csv").write_text("x,y,z,nx,ny,nz\n5,1,0,0,0,1\n")
    assert main(["point-factors", "street.obj", *period, "--points", "points.csv", "-o", "points.npz"]) == 0
    # A warm street and black walls at 0 K: what walls receive.
    (tmp_path / "heat.csv").write_text("group,temperature,emissivity\nstreet,300,1\n*,0,1\n")
    run = ["heat", "street.obj", "-c", "heat.csv", *period, "--bundles", "256", "--ids", "groups", "-o", "heat.npz"]
    assert main(run) == 0
    power = np.load("heat.npz")["heat"].ravel()
    sent = 5.670374419e-8 * 300**4 * STREET * SHORT
    assert np.sort(power / sent) == pytest.approx(np.sort([1, -matrix[0, 1], -matrix[0, 2], 0]), abs=0.01)
    for wrong in ("16", "16,a", "16,3,2"):
        assert main(["form-factors", "street.obj", "--periodic", wrong]) != 0
    assert main(["form-factors", "street.obj", "-m", "exact", *period]) != 0


def test_few_surfaces_in_a_large_period_send_rays():
    plates = joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0)))
    patches = Patches(*plates, periodic=(1e5, 1e5))
    assert not ABuffer.suits(patches)
    factors = etendue.compute_form_factors(patches, bundles=64).factors
    assert factors.matrix.todense() == pytest.approx(opposite(1, 1) * (1 - np.eye(2)), abs=5e-3)


def test_a_run_goes_on(tmp_path):
    once = etendue.compute_form_factors(canyon(), bundles=64, seed=3).factors
    etendue.compute_form_factors(canyon(), bundles=32, seed=3, checkpoint=tmp_path / "half.checkpoint")
    resumed = etendue.resume(tmp_path / "half.checkpoint", scene=canyon(), bundles=64)
    assert (resumed.factors.matrix != once.matrix).nnz == 0
    with pytest.raises(CheckpointError, match="not the one"):
        etendue.resume(tmp_path / "half.checkpoint", scene=canyon(None), bundles=64)
