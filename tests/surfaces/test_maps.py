"""Maps of irradiance: known densities, edges and corners, what must not leak, errors, passes, files, bad input."""

from __future__ import annotations

import dataclasses

import mitsuba as mi
import numpy as np
import pytest
from support.scenes import camera, diffuse, field, furnace

from etendue.core import SceneError, UnsupportedError
from etendue.density import Samples, silverman
from etendue.particles import Particles
from etendue.scene import load
from etendue.surfaces import (
    HistogramBuilder,
    KernelBuilder,
    MapSurfaces,
    NearestMap,
    PatchMap,
    SurfaceError,
    irradiance_at,
    read_map,
    rule_bandwidths,
    save_map,
    variable_bandwidths,
)
from etendue.surfaces.maps import kernels

#: Irradiance of the three channels, by power per area.
COLOUR = np.array([1.0, 2.0, 3.0])
EDGES = np.array([[-1, 0, -1], [1, 0, 1], [0, 0, -1], [1, 0, 0.3]]) * 0.999
UP = np.array([0.0, 1.0, 0.0])


def particles(position, power, direction=(0.3, -0.8, 0.2), path=None):
    """Particles of a path each, unless numbers are given."""
    n = len(position)
    d = np.broadcast_to(np.asarray(direction, float) / np.linalg.norm(direction), (n, 3))
    zero = np.zeros(n, np.uint32)
    path = np.arange(n) if path is None else path
    return Particles(position, d, np.broadcast_to(power, (n, 3)), zero, zero, np.zeros((n, 2)), path, zero)


def on_plane(n, seed=1, slope=0.0):
    """Particles on the plane of ``field``, with the density 1 + slope x; four units of area."""
    r = np.random.default_rng(seed)
    x = r.uniform(-1, 1, (n, 2))
    kept = r.uniform(0, 1 + slope, n) < 1 + slope * x[:, 0]
    x = x[kept]
    return particles(np.column_stack([x[:, 0], 0 * x[:, 0], x[:, 1]]), COLOUR * (4 / len(x)))


@pytest.fixture(scope="module")
def plane():
    return MapSurfaces(field(0.5, 1.0), 400)


@pytest.mark.parametrize("boundary", ["renormalise", "linear", "reflect"])
def test_kernels_of_an_even_density_are_exact_up_to_the_corners(plane, boundary):
    builder = KernelBuilder(plane, 0.25, boundary=boundary)
    builder.add(on_plane(60_000))
    made = builder.build()
    assert np.abs(made.values.mean(axis=0) / COLOUR - 1).max() < 0.01
    z = (made.values - COLOUR) / made.errors
    assert 0.7 < np.sqrt((z**2).mean()) < 1.6  # eight groups: the ratio has the spread of Student's t
    value, error = irradiance_at(made, EDGES, np.tile(UP, (4, 1)))
    assert (np.abs(value - COLOUR) < 5 * error).all()
    assert (error / COLOUR).max() < 0.1


def test_a_fine_mesh_costs_what_a_coarse_one_does(monkeypatch):
    """A kernel that covers a third of a plane visits as many points for its integral as on a coarse mesh, and the
    integral is that over all points but for some noise."""
    visited = []

    def sums(self, at, *others):
        visited.append(len(at))
        return plain(self, at, *others)

    plain = kernels._Frames.sums
    monkeypatch.setattr(kernels._Frames, "sums", sums)
    builder = KernelBuilder(MapSurfaces(field(0.5, 1.0), 5000), 0.6)
    builder.sums += 1.0  # light in all cells
    few = builder._weights()[:, 0]
    assert visited[0] < 4000
    monkeypatch.setattr(kernels, "_POINT", 1e-4)
    ratio = few / builder._weights()[:, 0]
    assert visited[1] > 10_000
    assert abs(ratio.mean() - 1) < 0.002 and ratio.std() < 0.01


def test_a_mesh_that_faces_all_ways_is_searched_by_facing(monkeypatch):
    """The integral of a cell looks at points of similar normals only, and is the same: a kernel wider than the mesh
    would otherwise visit all of its points from each cell. Nor is it computed where there is no light."""

    def sums(self, at, *others):
        visits.append(len(at) * len(others[3]))
        return plain(self, at, *others)

    plain, visits, told = kernels._Frames.sums, [], []
    monkeypatch.setattr(kernels._Frames, "sums", sums)
    sphere = {"type": "sphere", "bsdf": diffuse(0.5, 0.5, 0.5)}
    ball = {"type": "scene", "ball": sphere, "sky": {"type": "constant"}, "sensor": camera()}
    builder = KernelBuilder(MapSurfaces(load(ball), 4000), 1.0)
    builder.sums += 1.0
    builder.sums[:, ::2] = 0.0
    by_facing = builder._weights(told.append)[:, 0]
    assert (by_facing[::2] == 0).all() and (by_facing[1::2] > 0).all()
    assert len(told) > 10 and told == sorted(told) and told[-1] == 1.0
    cost = sum(visits)
    visits.clear()
    monkeypatch.setattr(kernels, "_ALIKE", 1e9)
    np.testing.assert_allclose(by_facing, builder._weights()[:, 0], rtol=1e-4)
    assert len(visits) == 1 and cost < 0.4 * visits[0]


def test_values_of_corners_wait_until_they_are_asked_for(plane, monkeypatch, tmp_path):
    """A map that is only written needs no interpolation between cells."""
    builder = KernelBuilder(plane, 0.25)
    builder.add(on_plane(1000))
    with monkeypatch.context() as patched:
        patched.setattr("etendue.surfaces.places.vertex_radiosity", None)
        made = builder.build()
        save_map(tmp_path / "map.npz", made)
    assert np.isfinite(irradiance_at(made, EDGES, np.tile(UP, (4, 1)))[0]).all()


def test_without_a_correction_edges_are_dark(plane):
    builder = KernelBuilder(plane, 0.25, boundary="none")
    builder.add(on_plane(60_000))
    value, _ = irradiance_at(builder.build(smooth=False), EDGES, np.tile(UP, (4, 1)))
    # The centre of a cell of 0.1 is 0.2 bandwidths inside the edge: 0.65 of the kernel is on the plane there.
    np.testing.assert_allclose(value / COLOUR, np.repeat([[0.65**2], [0.65**2], [0.65], [0.65]], 3, axis=1), atol=0.06)


def test_the_linear_correction_follows_a_slope(plane):
    """At the dark border of the density 1 + 0.8 x the mean of 20 maps: a kernel divided by its share sees too much."""
    at, found = np.array([[-0.95, 0, z] for z in np.linspace(-0.5, 0.5, 11)]), {}
    for boundary in ("renormalise", "linear"):
        builder = KernelBuilder(plane, 0.4, boundary=boundary)
        builder.add(on_plane(400_000, slope=0.8))
        found[boundary] = irradiance_at(builder.build(smooth=False), at, np.tile(UP, (11, 1)))[0][:, 0].mean()
    exact = 1 - 0.8 * 0.95
    assert abs(found["linear"] - exact) < 0.012
    assert found["renormalise"] > exact + 0.06


def test_neighbours_of_an_even_density(plane):
    """Corrected up to the corners; without, dark there."""
    hits = on_plane(60_000)
    centres, normals = plane.patches.centres, plane.patches.normals
    inner = np.abs(centres).max(axis=1) < 0.85
    made = NearestMap(plane, hits, 150)
    value, error = irradiance_at(made, centres, normals)
    assert np.abs(value[inner].mean(axis=0) / COLOUR - 1).max() < 0.02
    assert abs(value[~inner].mean() / COLOUR.mean() - 1) < 0.03
    assert 0.8 < np.sqrt((((value - COLOUR) / error)[inner] ** 2).mean()) < 1.2
    plain, _ = irradiance_at(NearestMap(plane, hits, 150, correct=False), centres, normals)
    np.testing.assert_allclose(plain[inner], value[inner], rtol=0.02)  # the disc as a sum over points
    found, errors = irradiance_at(made, EDGES, np.tile(UP, (4, 1)))
    dark, _ = irradiance_at(NearestMap(plane, hits, 150, correct=False), EDGES, np.tile(UP, (4, 1)))
    assert (np.abs(found - COLOUR) < 5 * errors).all()
    np.testing.assert_allclose((dark / found).mean(axis=1), [0.25, 0.25, 0.5, 0.5], rtol=0.05)


def test_neighbours_and_histogram_agree_away_from_edges(plane):
    """A density with a peak: the two maps are as far apart as their errors and the width of a cell allow."""
    r = np.random.default_rng(3)
    x = r.normal(0, 0.5, (80_000, 2))
    x = x[(np.abs(x) < 1).all(axis=1)]
    hits = particles(np.column_stack([x[:, 0], 0 * x[:, 0], x[:, 1]]), COLOUR / len(x))
    builder = HistogramBuilder(plane)
    builder.add(hits)
    histogram = builder.build()
    centres = plane.patches.centres
    inner = np.abs(centres).max(axis=1) < 0.8
    near, error = irradiance_at(NearestMap(plane, hits, 200), centres, plane.patches.normals)
    z = (near - histogram.values)[inner] / np.hypot(error, histogram.errors)[inner]
    assert np.sqrt((z**2).mean()) < 1.5
    assert abs(near[inner].mean() / histogram.values[inner].mean() - 1) < 0.01


def test_a_curved_surface():
    """Even light inside a sphere."""
    surfaces = MapSurfaces(furnace("sphere", 1.0, 0.5), 600)
    d = np.random.default_rng(4).normal(size=(60_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    hits = dataclasses.replace(particles(d, COLOUR * (4 * np.pi / len(d))), direction=d)
    builder = KernelBuilder(surfaces, 0.3)
    builder.add(hits)
    made = builder.build()
    assert np.abs(made.values.mean(axis=0) / COLOUR - 1).max() < 0.01
    assert np.sqrt((((made.values - COLOUR) / made.errors) ** 2).mean()) < 1.8
    near, _ = irradiance_at(NearestMap(surfaces, hits, 200), d[:500], -d[:500])
    assert abs(near.mean() / COLOUR.mean() - 1) < 0.02


@pytest.fixture(scope="module")
def shelves():
    """Two boards close above each other, both two-sided, and a wall at their edge: light on the upper side of the
    lower board, on the lower half of nothing else."""
    board = {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": diffuse(0.5, 0.5, 0.5)}}
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    scene = {
        "type": "scene",
        "sensor": camera(),
        "light": {"type": "constant"},
        "low": board | {"to_world": turn},
        "high": board | {"to_world": mi.ScalarTransform4f().translate([0, 0.02, 0]) @ turn},
        "wall": board
        | {"to_world": mi.ScalarTransform4f().translate([-1, 0, 0]) @ mi.ScalarTransform4f().rotate([0, 1, 0], 90)},
    }
    return load(scene)


def test_nothing_leaks(shelves):
    surfaces = MapSurfaces(shelves, 600)
    hits = on_plane(20_000)
    hits = dataclasses.replace(hits, direction=np.broadcast_to(-UP, (len(hits), 3)))
    builders = HistogramBuilder(surfaces), KernelBuilder(surfaces, 0.3)
    for builder in builders:
        builder.add(hits)
    points = np.array([[0, 0, 0], [0, 0, 0], [0, 0.02, 0], [0, 0.02, 0], [-1, 0.2, 0], [-1, 0.1, 0]])
    sides = np.array([[0, 1, 0], [0, -1, 0], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]])
    for made in (*(builder.build() for builder in builders), NearestMap(surfaces, hits, 100)):
        value, _ = irradiance_at(made, points, sides)
        assert abs(value[0, 0] - 1) < 0.35, made.kind
        np.testing.assert_array_equal(value[1:], 0.0, err_msg=made.kind)


def test_neighbours_of_a_dark_side(shelves):
    """The lower side of a board, lit a hundred times less than the upper side, has k neighbours of its own; what is lit
    by nothing has no error."""
    surfaces = MapSurfaces(shelves, 600)
    above, below = on_plane(100_000), on_plane(1000, seed=2)
    above = dataclasses.replace(above, power=above.power * 100, direction=np.broadcast_to(-UP, (len(above), 3)))
    below = dataclasses.replace(below, direction=np.broadcast_to(UP, (len(below), 3)))
    made = NearestMap(surfaces, Particles.joined([above, below]), 100)
    points = np.random.default_rng(5).uniform(-1, 1, (500, 3)) * [1, 0, 1]
    value, error = irradiance_at(made, points, -np.tile(UP, (500, 1)))
    assert abs(value.mean(axis=0) / COLOUR - 1).max() < 0.05
    assert 0.8 < np.sqrt((((value - COLOUR) / error) ** 2).mean()) < 1.3
    unlit, unknown = irradiance_at(made, [[0.0, 0.02, 0.0]], [UP])
    assert (unlit == 0).all() and np.isnan(unknown).all()
    # Fewer particles than neighbours: all of them.
    few = NearestMap(surfaces, Particles.joined([above, below[:50]]), 100)
    assert abs(irradiance_at(few, points, -np.tile(UP, (500, 1)))[0].mean() / COLOUR.mean() / 0.05 - 1) < 0.2


def test_passes_add_up(plane):
    hits = on_plane(20_000)
    parts = [hits[:7000], hits[7000:]]
    for kind in (HistogramBuilder, lambda surfaces: KernelBuilder(surfaces, 0.2, boundary="linear")):
        whole, by_parts = kind(plane), kind(plane)
        whole.add(hits)
        for part in parts:
            by_parts.add(part)
        np.testing.assert_allclose(by_parts.build().values, whole.build().values, rtol=1e-4)
        np.testing.assert_allclose(by_parts.build().errors, whole.build().errors, rtol=1e-3, atol=1e-6)


def test_errors_know_that_particles_of_a_path_belong_together(plane):
    """Ten particles of each path at one place are worth one."""
    hits = on_plane(4000)
    tenfold = hits[np.repeat(np.arange(len(hits)), 10)]
    tenfold = dataclasses.replace(tenfold, power=tenfold.power / 10)
    errors = []
    for each in (hits, tenfold):
        builder = HistogramBuilder(plane)
        builder.add(each)
        errors.append(builder.build().errors)
    np.testing.assert_allclose(*errors, rtol=1e-4)


def test_without_numbers_of_paths_errors_are_not_known(plane):
    hits = on_plane(4000)
    builder = HistogramBuilder(plane)
    builder.add(dataclasses.replace(hits, path=np.zeros(len(hits), np.uint32)))
    assert np.isnan(builder.build().errors).all()


def test_a_linear_map_is_the_sum_of_the_maps_of_its_particles(plane):
    """Also where one is below zero, at a dark edge beside light: a bound there would make the dark too bright."""
    hits = on_plane(20_000)
    x = hits.position[:, 0]
    strip, rest = hits[(x > -0.75) & (x < -0.65)], hits[x < -0.75]
    values = []
    for each in (strip, rest, Particles.joined([strip, rest])):
        builder = KernelBuilder(plane, 0.4, boundary="linear")
        builder.add(each)
        values.append(builder.build().values)
    assert values[0].min() < -0.01
    np.testing.assert_allclose(values[0] + values[1], values[2], atol=1e-4)


def test_bandwidths(plane):
    """The rule is that of the plane; a variable kernel is wide in the dark and narrow in the light."""
    hits = on_plane(5000)
    rule = silverman(Samples(hits.position[:, [0, 2]]), "epanechnikov")
    np.testing.assert_allclose(rule_bandwidths(plane, hits), rule, rtol=0.01)
    np.testing.assert_allclose(rule_bandwidths(plane, hits, total=64 * 5000), rule / 2, rtol=0.01)
    light = np.where(plane.patches.centres[:, :1] > 0, 4.0, 1.0)
    widths = variable_bandwidths(PatchMap(plane.places, light), 0.1)
    bright = plane.patches.centres[:, 0] > 0
    np.testing.assert_allclose(widths[~bright] / widths[bright][0], 2.0)
    np.testing.assert_allclose(
        0.8 * np.log(widths[bright][0] / 0.1) + 0.2 * np.log(widths[~bright][0] / 0.1), 0, atol=1e-9
    )


def test_files(plane, tmp_path):
    problem, hits = field(0.5, 1.0), on_plane(5000)
    builder = HistogramBuilder(plane)
    builder.add(hits)
    for made in (builder.build(), NearestMap(plane, hits, 50)):
        save_map(tmp_path / "map.npz", made)
        again = read_map(tmp_path / "map.npz", problem)
        assert again.kind == made.kind
        points, normals = plane.patches.centres[::7], plane.patches.normals[::7]
        for one, other in zip(irradiance_at(made, points, normals), irradiance_at(again, points, normals), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-5)


def test_bad_input(plane, tmp_path, caplog):
    hits = on_plane(2000)
    elsewhere = dataclasses.replace(hits, position=hits.position + np.float32(0.2))
    with pytest.raises(SurfaceError, match="lie on the surfaces of this scene"):
        HistogramBuilder(plane).add(elsewhere)
    with pytest.raises(SurfaceError, match="there are no particles"):
        HistogramBuilder(plane).add(Particles.empty())
    with pytest.raises(SurfaceError, match="add some first"):
        KernelBuilder(plane, 0.1).build()
    with pytest.raises(SurfaceError, match="k is a whole number from 2 to the number of particles, 2000"):
        NearestMap(plane, hits, 3000)
    with pytest.raises(SurfaceError, match=r"need 0\.0007 GB, there are 0\.0001"):
        NearestMap(plane, hits, 10, memory=100_000)
    for wrong in ({"bandwidth": 0.0}, {"bandwidth": np.ones(3)}, {"bandwidth": 0.1, "boundary": "mirror"}):
        with pytest.raises(SurfaceError):
            KernelBuilder(plane, **wrong)
    with pytest.raises(SurfaceError, match="a bandwidth is chosen by"):
        rule_bandwidths(plane, hits, "guess")
    damaged = hits.power.copy()
    damaged[3] = np.nan
    builder = HistogramBuilder(plane)
    builder.add(dataclasses.replace(hits, power=damaged))
    assert "1 of 2000 particles are damaged" in caplog.text
    assert np.isfinite(builder.build().values).all()

    problem = field(0.5, 1.0)
    save_map(tmp_path / "map.npz", builder.build())
    with pytest.raises(SurfaceError, match="is a map of another scene"):
        read_map(tmp_path / "map.npz", furnace("sphere", 1.0, 0.5))
    with pytest.raises(SurfaceError, match="there is no file of a map"):
        read_map(tmp_path / "none.npz", problem)
    (tmp_path / "map.npz").write_bytes(b"PK nothing")
    with pytest.raises(SurfaceError, match="is no map"):
        read_map(tmp_path / "map.npz", problem)
    save_map(tmp_path / "sound.npz", builder.build())
    save_map(tmp_path / "near.npz", NearestMap(plane, hits, 10))
    for name, changed in (
        ("sound", {"front": np.zeros(0, int)}),
        ("sound", {"smooth": np.ones(3)}),
        ("sound", {"back": np.zeros((2, 2))}),
        ("near", {"k": np.ones(2)}),
        ("near", {"position": hits.position[:, :2]}),
        ("near", {"path": np.zeros(3)}),
    ):
        with np.load(tmp_path / f"{name}.npz") as file:
            np.savez(tmp_path / "changed.npz", **(dict(file) | changed))
        with pytest.raises(SurfaceError, match="is no map"):
            read_map(tmp_path / "changed.npz", problem)
    with pytest.raises(SurfaceError, match=r"written as \.npz"):
        save_map(tmp_path / "map.txt", builder.build())


def test_surfaces_without_a_map():
    """Mirrors have none; shapes without faces are refused."""
    ball = {"type": "sphere", "bsdf": {"type": "conductor"}}
    scene = {"type": "scene", "sensor": camera(), "light": {"type": "constant"}, "ball": ball}
    with pytest.raises(SceneError, match="no surface that can have a map"):
        MapSurfaces(load(scene))
    group = {"type": "shapegroup", "ball": ball | {"bsdf": diffuse(0.5, 0.5, 0.5)}}
    scene |= {"group": group, "copy": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}}
    with pytest.raises(UnsupportedError, match="is not tessellated"):
        MapSurfaces(load(scene))


def test_a_small_scene_far_from_the_origin():
    """In render space: lengths, areas and irradiance are the scene's own."""
    side, centre = 0.05, np.array([64.0, 0.0, 0.0])
    place = mi.ScalarTransform4f().translate(list(centre)).rotate([1, 0, 0], -90).scale(side)
    scene = {
        "type": "scene",
        "light": {"type": "constant"},
        "plane": {"type": "rectangle", "to_world": place, "bsdf": diffuse(0.5, 0.5, 0.5)},
        "sensor": camera((64.0, 0.2, 0.0), (64.0, 0.0, 0.0)),
    }
    problem = load(scene)
    assert not problem.space.is_own
    surfaces = MapSurfaces(problem, 100)
    x = np.random.default_rng(2).uniform(-side, side, (30_000, 2))
    hits = particles(np.column_stack([x[:, 0], 0 * x[:, 0], x[:, 1]]) + centre, COLOUR * (4 * side**2 / len(x)))
    builders = HistogramBuilder(surfaces), KernelBuilder(surfaces, 0.02, boundary="reflect")
    for builder in builders:
        builder.add(hits)
    points = centre + np.array([[0, 0, 0], [0.03, 0, 0.03], [-side, 0, side]]) * 0.999
    for made in (*(builder.build() for builder in builders), NearestMap(surfaces, hits, 500)):
        value, error = irradiance_at(made, points, np.tile(UP, (3, 1)))
        assert (np.abs(value - COLOUR) < 5 * error).all(), made.kind
        assert (error < 0.15 * COLOUR).all()
