"""The ground, the sky and its patches as columns of form factors, against closed forms."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from support.patches import square

import etendue
from etendue.core import OptionError
from etendue.lighting import LightingError, SkyPatches
from etendue.radiosity import (
    ABuffer,
    LocalRays,
    Patches,
    RadiosityError,
    RayScene,
    Segments,
    form_factors,
    joined,
    read_form_factors,
    save_form_factors,
    sky_parts,
    solve,
    with_local_rays,
)

SKY = SkyPatches(1)
ROW = np.repeat(np.arange(len(SKY.in_row)), SKY.in_row)
#: Depth of the canyon in widths, and half of its length.
DEPTH, END = 0.8, 40.0


def canyon(**properties):
    """A street along y between walls; patch 0 is a square of its floor in the middle."""
    floor = [(a, b) for a, b in ((-0.5, 0.5), (-END, -0.5), (0.5, END))]
    squares = [square((-0.5, a, 0), (1, 0, 0), (0, b - a, 0)) for a, b in floor]
    left = square((-0.5, -END, 0), (0, 2 * END, 0), (0, 0, DEPTH))
    right = square((0.5, END, 0), (0, -2 * END, 0), (0, 0, DEPTH))
    return Patches(*joined(*squares, left, right), **properties)


def canyon_shares(points=40):
    """(145,) shares of the sky's patches for the floor of an endless canyon: the integral of the cosine over pi and
    over the lit share of the width, 1 - DEPTH |x| / z."""
    x = (np.arange(points) + 0.5) / points - 0.5
    result = []
    for k, row in enumerate(ROW):
        low, high = np.sin(SKY.row_height * row), np.sin(min(SKY.row_height * (row + 1), np.pi / 2))
        z = (low + high) / 2 + (high - low) * x[:, None]
        width = 2 * np.pi / SKY.in_row[row]
        azimuth = (k + 1 - SKY.first[row] + x[None]) * width
        lit = np.maximum(1 - DEPTH * np.sqrt(1 - z**2) * np.abs(np.sin(azimuth)) / z, 0)
        result.append(np.mean(z * lit) * width * (high - low) / np.pi)
    return np.array(result)


def directed(engine, count, batches=8):
    made = list(engine.directed(count, 0, count // batches))
    pairs, ways = [one.pairs for one in made], [one.ways for one in made]
    are_even = engine.bundles is not None
    return Segments(engine.patches, pairs, np.arange(batches), engine.expected(count), ways, are_even)


def test_an_open_plane_has_the_shares_of_tregenzas_rows():
    # Of a horizontal plane, rows have the difference of the squared sines of their limits, in equal patches.
    found = etendue.compute_form_factors(Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0))), sky_patches=1).factors
    low, high = ROW * SKY.row_height, np.minimum((ROW + 1) * SKY.row_height, np.pi / 2)
    exact = (np.sin(high) ** 2 - np.sin(low) ** 2) / SKY.in_row[ROW]
    assert exact.sum() == pytest.approx(1) and found.sky == pytest.approx([1]) and found.ground == pytest.approx([0])
    assert found.sky_patches.sum(axis=1) == pytest.approx(found.sky, rel=1e-14)
    rows = [np.bincount(ROW, shares) for shares in (found.sky_patches[0], exact)]
    assert rows[0] == pytest.approx(rows[1], rel=0.02)
    # Some 28 bundles go to each patch; within it the cosine varies by up to a quarter in the lowest row.
    assert np.sqrt(np.mean((found.sky_patches[0] / exact - 1) ** 2)) < 0.04


@pytest.mark.parametrize("backend", ["compiled", "drjit"])
def test_a_street_canyon_by_bundles(backend):
    patches, exact = canyon(), canyon_shares()
    # The strings of Hottel, for the whole sky.
    assert exact.sum() == pytest.approx(np.sqrt(1 + DEPTH**2) - DEPTH, rel=2e-3)
    segments = directed(ABuffer(patches, lines=30_000, backend=backend), 2048)
    found = sky_parts(form_factors(segments), segments, m=1)
    shares = found.sky_patches[0]
    errors = np.sqrt(np.maximum(exact, 1e-4) / segments.counted[0])
    z = (shares - exact) / errors
    assert np.abs(z).max() < 5 and np.mean(z**2) < 1.5
    assert shares.sum() == pytest.approx(exact.sum(), rel=0.02)
    assert found.ground[0] == 0 and found.row_sums() == pytest.approx(np.ones(5), abs=1e-12)


def test_local_rays_and_mixed_ones_know_their_directions():
    patches, exact = canyon(), canyon_shares()
    alone = directed(LocalRays(RayScene(patches)), 1 << 19)
    lines = directed(ABuffer(patches, lines=6_000), 1024)
    mixed = with_local_rays(lines, least=4096)
    assert mixed.rays > 0 and mixed.extra[0] > 1
    for segments in (alone, mixed):
        found = sky_parts(form_factors(segments), segments, m=1)
        z = (found.sky_patches[0] - exact) / np.sqrt(np.maximum(exact, 1e-4) / segments.counted[0])
        assert np.abs(z).max() < 5 and np.mean(z**2) < 1.5
        assert found.sky_patches.sum(axis=1) + found.ground == pytest.approx(segments.sky, abs=1e-12)
    parts = [mixed.batch(k) for k in range(mixed.batch_count)]
    assert sum(part.sky_counts(SKY.number_of, SKY.solid_angles)[0, 0] for part in parts) == 0


@pytest.mark.parametrize("up", ["z", "y"])
def test_a_wall_sees_as_much_ground_as_sky(up):
    wall, tilted = ((0, 0, 1), (0, 0.6, 0.8)) if up == "z" else ((0, 1, 0), (0, 0.8, -0.6))
    # A plane that is tilted by b sees (1 + cos b) / 2 of the sky: cos b = 0.6.
    for edge, sky in ((wall, 0.5), (tilted, 0.8)):
        plane = Patches(*square((0, 0, 0), (1, 0, 0), edge))
        found = etendue.compute_form_factors(plane, bundles=512, up=up).factors
        assert found.sky == pytest.approx([sky], abs=0.01) and found.sky_patches is None
        assert found.sky + found.ground == pytest.approx([1], abs=1e-12)


def test_north_turns_the_patches():
    # A wall that faces north, when north is turned by 90 degrees to +x, faces west.
    wall = Patches(*square((1, 0, 0), (-1, 0, 0), (0, 0, 1)))
    assert wall.normals[0] == pytest.approx([0, 1, 0])
    for north, azimuth in ((0.0, 0.0), (90.0, 270.0)):
        found = etendue.compute_form_factors(wall, sky_patches=1, north=north, bundles=1024).factors
        mean = found.sky_patches[0] @ SKY.directions[1:]
        away = (np.rad2deg(np.arctan2(mean[0], mean[1])) - azimuth + 180) % 360 - 180
        assert abs(away) < 2


def test_corrections_and_groups_keep_the_parts_together():
    segments = directed(ABuffer(canyon(), lines=6_000), 512)
    found = sky_parts(form_factors(segments, "pooled"), segments, m=1)
    for made in (found.normalised(), found.repaired()):
        assert made.row_sums() == pytest.approx(np.ones(5), abs=1e-9)
        assert made.sky_patches.sum(axis=1) == pytest.approx(made.sky, abs=1e-12)
        assert np.all(made.ground[3:] > 0)
    street = etendue.radiosity.between_groups(found, np.array([0, 0, 0, 1, 1]))
    floor = found.areas[:3] / found.areas[:3].sum()
    assert street.sky_patches[0] == pytest.approx(floor @ found.sky_patches[:3])
    assert street.ground[1] == pytest.approx(found.ground[3:].mean())


def test_files(tmp_path):
    segments = directed(ABuffer(canyon(), lines=6_000), 256)
    found = sky_parts(form_factors(segments), segments, m=1)
    for name in ("f.npz", "f.nc"):
        save_form_factors(tmp_path / name, found)
        again = read_form_factors(tmp_path / name)
        assert np.array_equal(again.ground, found.ground) and np.array_equal(again.sky_patches, found.sky_patches)
        assert np.array_equal(again.outside, found.outside)
    save_form_factors(tmp_path / "f.csv", found)
    rows = list(csv.DictReader((tmp_path / "f.csv").open()))
    assert float(rows[3]["ground"]) == pytest.approx(found.ground[3], rel=1e-8)
    assert float(rows[0]["sky:145"]) == pytest.approx(found.sky_patches[0, 144], rel=1e-8)
    save_form_factors(tmp_path / "svf.inp.001", found)
    assert np.loadtxt(tmp_path / "svf.inp.001") == pytest.approx(found.sky, abs=1e-8)


def test_light_from_outside_comes_from_the_ground_too():
    corner = joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 1, 0), (1, 0, 0), (0, 0, 1)))
    patches = Patches(*corner, reflectance=0.5, sky=1.0)
    segments = directed(ABuffer(patches, lines=6_000), 256)
    whole = form_factors(segments)
    apart = sky_parts(whole, segments)
    assert apart.ground.max() > 0.1
    before, after = (solve(patches, factors).irradiance for factors in (whole, apart))
    assert after == pytest.approx(before, rel=1e-9)


def test_a_run_is_resumed_with_its_directions(tmp_path):
    checkpoint, asked = tmp_path / "c.checkpoint", {"sky_patches": 1, "seed": 3}
    etendue.compute_form_factors(canyon(), bundles=128, checkpoint=checkpoint, **asked)
    resumed = etendue.resume(checkpoint, scene=canyon(), bundles=256)
    whole = etendue.compute_form_factors(canyon(), bundles=256, **asked)
    assert np.array_equal(resumed.factors.sky_patches, whole.factors.sky_patches)


def test_bad_requests(caplog):
    plane = Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    with pytest.raises(OptionError, match="method lines"):
        etendue.compute_form_factors(plane, "exact", up="z")
    with pytest.raises(LightingError, match="y or z"):
        etendue.compute_form_factors(plane, up="x")
    with pytest.raises(LightingError, match="1, 2"):
        etendue.compute_form_factors(plane, sky_patches=0)
    with pytest.raises(OptionError, match="north"):
        etendue.compute_form_factors(plane, up="z", north=20)
    segments = ABuffer(plane).cast(16)
    with pytest.raises(RadiosityError, match="directed=True"):
        sky_parts(form_factors(segments), segments)
    etendue.compute_form_factors(plane, sky_patches=4, bundles=64)
    assert "patches of the sky" in caplog.text
