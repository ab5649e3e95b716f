"""Lines and the segments they make: measures, agreement of engines, closed and open meshes."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from support.patches import box, cube, joined, room, square

import etendue.radiosity
from etendue.core import BackendError
from etendue.points import Halton, Independent, OwenSobol
from etendue.radiosity import (
    GENERATORS,
    ABuffer,
    ChainedRays,
    LocalRays,
    Patches,
    RadiosityError,
    RayScene,
    Segments,
    SpherePairs,
    form_factors,
    local_form_factors,
)

BALL_AND_FLOOR = joined(box((-0.2, -0.3, -0.1), (0.2, 0.1, 0.4), 2), square((-1, -1, -0.5), (2, 0, 0), (0, 2, 0)))


def engines(patches, points, lines=256):
    scene = RayScene(patches)
    yield "a-buffer", ABuffer(patches, points, lines), max(lines // 4, 1)
    for name, kind in GENERATORS.items():
        generator = kind(patches, lines) if name == "bundles" else kind(patches)
        yield name, ChainedRays(generator, scene, points), int(generator.lines_per_point)
    yield "local", LocalRays(scene, points), 1


@pytest.mark.parametrize("name", GENERATORS)
def test_directions_are_unit_vectors_and_lines_begin_outside(name):
    patches = Patches(*BALL_AND_FLOOR)
    lines = GENERATORS[name](patches).lines(Halton(4).block(300, 1))
    np.testing.assert_allclose(np.linalg.norm(lines.directions, axis=1), 1)
    low, high = patches.bounds
    inside = ((lines.origins > low) & (lines.origins < high)).all(axis=1)
    assert not inside.any()
    # Each line enters the body: it comes near to the centre.
    centre, radius = patches.sphere
    way = centre - lines.origins
    away = np.linalg.norm(way - (way * lines.directions).sum(axis=1, keepdims=True) * lines.directions, axis=1)
    assert (away <= radius * (1 + 1e-9)).all()


@pytest.mark.parametrize("name", GENERATORS)
def test_lines_meet_surfaces_as_often_as_integral_geometry_says(name):
    """A convex body of surface A in one of surface S is met by A / S of the lines, a patch by 2 A / S."""
    patches = Patches(*BALL_AND_FLOOR, two_sided=True)
    points = 1 << 15 if name != "bundles" else 1 << 11
    generator = GENERATORS[name](patches, 64) if name == "bundles" else GENERATORS[name](patches)
    segments = ChainedRays(generator, RayScene(patches), Independent(4, seed=3)).cast(points)
    expected = segments.expected
    # A front and the back of it are met by the same lines; 24 faces of the box have a scatter of their own.
    assert np.array_equal(segments.counted[:25], segments.counted[25:])
    # The lines of a bundle share a direction: another 1.3 % from 2048 of them.
    spread = np.sqrt(expected[:25] + (0.013 * expected[:25]) ** 2 * (name == "bundles"))
    assert (np.abs(segments.counted[:25] - expected[:25]) < 3.5 * spread).all()
    outer = segments.counted[:24].sum() / 2
    surface = 2 * (0.4 * 0.4 + 0.4 * 0.5 + 0.4 * 0.5)
    lines = points * generator.lines_per_point
    assert outer == pytest.approx(
        lines * surface / generator.surface, abs=4 * np.sqrt(lines * surface / generator.surface)
    )


def test_every_line_of_box_walls_hits_the_walls_of_a_room():
    patches = cube(2)
    segments = ChainedRays(GENERATORS["box-walls"](patches), RayScene(patches), OwenSobol(4, seed=1)).cast(4096)
    assert len(segments) >= 4094 and segments.to_sky.sum() <= 2


def exchange(segments):
    """Shares of all segments between patches, as a matrix."""
    n = len(segments.patches)
    pairs = np.concatenate(segments.chunks).astype(int)
    pairs = pairs[(pairs < n).all(axis=1)]
    counts = np.zeros((n, n))
    np.add.at(counts, (pairs[:, 0], pairs[:, 1]), 1)
    return counts + counts.T


def test_all_engines_agree():
    """On the walls of a room with boxes, sheets and an opening, by the scatter of independent points."""
    walls = box((0, 0, 0), (1, 1, 1), 1, inward=True)
    sheet = square((0.1, 0.2, 0.6), (0.7, 0.1, 0), (0, 0.5, 0.2))
    vertices, faces = joined((walls[0], walls[1][:5]), box((0.3, 0.3, 0.1), (0.6, 0.8, 0.4), 1), sheet)
    patches = Patches(vertices, faces, two_sided=np.arange(12) == 11)
    shares, names = [], []
    for name, engine, lines in engines(patches, Independent(4, seed=5)):
        segments = engine.cast((1 << 16) // lines)
        counts = exchange(segments)
        rows = np.column_stack([counts, segments.to_sky]) / np.maximum(segments.counted, 1)[:, None]
        np.testing.assert_allclose(rows.sum(axis=1), 1, rtol=1e-12)
        assert segments.to_dark.sum() <= 1e-4 * len(segments), name
        shares.append(rows)
        names.append(name)
    mean = np.mean(shares, axis=0)
    lines = (1 << 16) * patches.areas / patches.areas.sum() / 4
    spread = np.sqrt(mean * (1 - mean) / lines[:, None]) + 2e-3
    for name, rows in zip(names, shares, strict=True):
        assert (np.abs(rows - mean) < 6 * spread).all(), name


def test_the_rasteriser_finds_the_hits_of_rays():
    """The same lines by both engines: the same segments."""
    patches = room(5)
    points = OwenSobol(4, seed=9)
    raster = ABuffer(patches, points, 200)
    rays = ChainedRays(raster.bundles, RayScene(patches), points)
    ours, theirs = (exchange(engine.cast(40)) for engine in (raster, rays))
    assert ours.sum() > 2000
    assert np.abs(ours - theirs).sum() <= 4  # a ray in single precision may pass the other side of an edge


def test_a_closed_mesh_lets_no_line_through():
    segments = ABuffer(room(7), OwenSobol(4, seed=2), 3000).cast(200)
    assert len(segments) > 100_000
    assert segments.to_dark.sum() == 0 and segments.to_sky.sum() == 0
    assert len(segments.unseen) == 0


@pytest.mark.parametrize(
    "moved",
    [
        lambda v: v * 1e-4 + 1000,
        lambda v: v * 1e6,
        lambda v: (v + 100).astype(np.float32),
        lambda v: (v @ np.array([[0.36, 0.48, 0.8], [-0.8, 0.6, 0], [-0.48, -0.64, 0.6]])).astype(np.float32),
    ],
    ids=["small and far", "large", "single precision, far", "single precision, turned"],
)
def test_size_place_and_precision_of_a_mesh_do_not_matter(moved):
    patches = room(5)
    patches = Patches(moved(patches.vertices), patches.faces)
    scene, points = RayScene(patches), OwenSobol(4, seed=1)
    for segments in (
        ABuffer(patches, points, 2000).cast(128),
        ChainedRays(SpherePairs(patches), scene, points).cast(1 << 13),
        LocalRays(scene, points).cast(1 << 13),
    ):
        assert segments.to_dark.sum() + segments.to_sky.sum() <= 2 and len(segments) > 7000


def test_meshes_that_are_cut_differently_where_they_meet():
    patches = room(3).subdivided(0.02)
    segments = ABuffer(patches, OwenSobol(4, seed=2), 3000).cast(100)
    assert segments.to_dark.sum() + segments.to_sky.sum() <= 1e-5 * len(segments)


def test_a_box_on_the_floor_sees_it():
    """Coplanar faces that face each other: the floor under the box sees its bottom and nothing else."""
    walls = box((0, 0, 0), (1, 1, 1), 3, inward=True)
    patches = Patches(*joined(walls, box((1 / 3, 1 / 3, 0), (2 / 3, 2 / 3, 0.5), 1)))
    segments = ABuffer(patches, OwenSobol(4, seed=4), 2000).cast(100)
    assert segments.to_dark.sum() == 0
    under = np.argmin(np.linalg.norm(patches.centres[:54] - [0.5, 0.5, 0], axis=1))
    seen = exchange(segments)[under]
    assert seen.sum() > 1000 and np.flatnonzero(seen).tolist() == [58]


def test_a_sheet_of_two_faces_back_to_back():
    """The same as one of two sides, whatever the rounding, in a room and under the sky."""
    walls, sheet = box((0, 0, 0), (1, 1, 1), 1, inward=True), square((0.2, 0.2, 0.4), (0.6, 0.1, 0.1), (0, 0.5, 0.2))
    for around, gap in (([walls], 1e-9), ([walls], -1e-9), ([], 0)):
        turned = sheet[0] + np.array([0, 0, gap]), sheet[1][:, ::-1]
        one = Patches(*joined(*around, sheet), two_sided=np.arange(6 * len(around) + 1) == 6 * len(around))
        two = Patches(*joined(*around, sheet, turned))
        seen = [exchange(ABuffer(p, OwenSobol(4, seed=4), 2000).cast(64)) for p in (one, two)]
        np.testing.assert_allclose(seen[0], seen[1], atol=2)
        assert ABuffer(two, OwenSobol(4, seed=4), 2000).cast(64).to_dark.sum() == 0


def test_a_box_inside_out_shows_as_darkness(caplog):
    inner = box((0.3, 0.3, 0.3), (0.7, 0.7, 0.7), 1, inward=True)
    segments = ABuffer(Patches(*joined(box((0, 0, 0), (1, 1, 1), 1, inward=True), inner)), lines=500).cast(64)
    assert (segments.dark[:6] > 0.1).all()
    assert "backs of faces" in caplog.text


def test_patches_that_no_line_has_met_are_reported(caplog):
    segments = ABuffer(room(20), lines=50).cast(2)
    assert len(segments.unseen) > 1000
    assert f"no line has met {len(segments.unseen)} of 3506 patches" in caplog.text
    np.testing.assert_array_equal(segments.gather(np.ones(3506)) == 0, segments.counted == 0)


def test_open_surfaces_see_the_sky():
    patches = Patches(*square((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    for _, engine, lines in engines(patches, OwenSobol(4, seed=1)):
        segments = engine.cast((1 << 12) // lines)
        assert segments.counted[0] == segments.to_sky[0] > 0
        np.testing.assert_allclose(segments.gather([5.0], sky=2.0), [2.0])


def test_batches_tell_the_error_of_a_gather():
    patches = room(3)
    values = np.exp(patches.centres)
    runs = [ABuffer(patches, Independent(4, seed=seed), 300).cast(128) for seed in range(12)]
    results = np.array([run.gather(values) for run in runs])
    errors = np.array([run.gather_error(values) for run in runs])
    scatter = results.std(axis=0, ddof=1)
    assert np.sqrt((errors**2).mean()) == pytest.approx(np.sqrt((scatter**2).mean()), rel=0.1)
    both = runs[0] + runs[1]
    assert both.batch_count == 32 and len(both) == len(runs[0]) + len(runs[1])
    np.testing.assert_allclose(both.counted, runs[0].counted + runs[1].counted)


def test_expected_counts_are_the_mean_of_counts():
    patches = room(2)
    counts = np.mean([ABuffer(patches, OwenSobol(4, seed=s), 400).cast(256).counted for s in range(4)], axis=0)
    expected = ABuffer(patches, lines=400).expected(256)
    np.testing.assert_allclose(counts, expected, rtol=0.03)
    np.testing.assert_allclose(counts.sum(), expected.sum(), rtol=2e-3)


def test_the_same_points_give_the_same_segments_however_they_are_divided():
    engine = ABuffer(room(2), Halton(4), 100)
    whole = engine.cast(40)
    parts = [engine.cast(13), engine.cast(27, first=13)]
    np.testing.assert_array_equal(np.concatenate(whole.chunks), np.concatenate(parts[0].chunks + parts[1].chunks))
    assert isinstance(parts[0] + parts[1], Segments)


def test_what_cannot_be_cast():
    patches = cube(1)
    with pytest.raises(RadiosityError, match="four dimensions"):
        ABuffer(patches, Halton(3))
    with pytest.raises(RadiosityError, match="one line at least"):
        ABuffer(patches, lines=0.5)
    segments = ABuffer(patches).cast(8)
    with pytest.raises(RadiosityError, match="one row for each of 6 patches"):
        segments.gather(np.ones(5))
    with pytest.raises(RadiosityError, match="two batches"):
        segments.batch(0).gather_error(np.ones(6))
    with pytest.raises(RadiosityError, match="'counted' or the 'expected'"):
        segments.gather(np.ones(6), normalisation="guessed")
    with pytest.raises(RadiosityError, match="different patches"):
        segments + ABuffer(cube(2)).cast(1)


@pytest.mark.usefixtures("compiled_lines")
def test_without_numba_there_are_rays(monkeypatch):
    """The loops for the CPU need it; what is said tells how to get it."""
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.delitem(sys.modules, "etendue.radiosity.kernels", raising=False)
    monkeypatch.delattr(etendue.radiosity, "compiled", raising=False)
    patches = cube(1)
    with pytest.raises(BackendError, match="numba"):
        ABuffer(patches).cast(1)
    factors = local_form_factors(RayScene(patches), 64)
    np.testing.assert_allclose(factors.row_sums(), 1)


def test_what_does_not_fit_into_memory_is_refused_before():
    with pytest.raises(RadiosityError, match=r"GB.*cast fewer points, or take stream"):
        ABuffer(room(2), lines=1e7).cast(1_000_000)


@pytest.mark.parametrize("backend", ["compiled", "drjit"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_box_in_a_corner_of_a_room_makes_no_loose_ends(backend, turned):
    """Lines through the corner meet pairs of faces in the same place, and nothing else that tells their order."""
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), box((0, 0, 0), (0.4, 0.3, 0.35)))
    if turned:
        axes = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        vertices = vertices @ (axes * np.linalg.det(axes))
    patches = Patches(vertices, faces)
    segments = ABuffer(patches, OwenSobol(4, seed=1), 2000, backend).cast(64)
    assert segments.to_dark.sum() == segments.to_sky.sum() == 0
    # The sides of the box that lie at walls see them alone, the others never what they hide.
    factors = form_factors(segments).matrix.toarray()
    hidden = [i for i in range(24, 30) if np.all((patches.normals[i] @ (vertices - patches.centres[i]).T) < 1e-9)]
    assert len(hidden) == 3
    for i in hidden:
        walls = np.abs(patches.normals[:24] + patches.normals[i]).max(axis=1) < 1e-9
        assert factors[i, :24][walls].sum() == pytest.approx(1)
