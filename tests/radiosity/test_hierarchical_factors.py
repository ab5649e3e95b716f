"""Hierarchical form factors by global lines [Castro 2002, ch. 4]: spheres, counters, estimates, passes, requests, bad
input. What the thesis found on its scenes is in tests/benchmarks."""

from __future__ import annotations

import functools
import operator

import numpy as np
import pytest
from support.patches import box, joined, room, square

import etendue
from etendue.core import OptionError
from etendue.engine import Budget, Runner
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    ChainedRays,
    HierarchicalCasting,
    HierarchicalCastingSettings,
    Lines,
    PartialSegments,
    Patches,
    PatchProblem,
    RadiosityError,
    RayScene,
    SpherePairs,
    SpiralPoints,
    TreeBundles,
    TreeRays,
    allocated,
    area_shares,
    find_objects,
    form_factors,
    least_error_shares,
    partial_form_factors,
    scene_patches,
    sphere_tree,
)
from etendue.radiosity.hierarchical_factors.segments import OUTSIDE, marked

SHEET = square((0.3, 0.45, 0.3), (0.3, 0, 0), (0, 0.2, 0.1))
INNER, OUTER = box((0.62, 0.12, 0.22), (0.8, 0.4, 0.4)), box((0.3, 0.3, 0.2), (0.5, 0.5, 0.4))


def overlapping():
    """A room with two boxes that overlap, and a sheet that passes through one of them."""
    boxes = [box((0.3, 0.3, 0.2), (0.6, 0.6, 0.5)), box((0.5, 0.5, 0.3), (0.8, 0.7, 0.7))]
    sides = [False] * 36 + [True]
    return Patches(*joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), *boxes, SHEET), two_sided=sides)


def open_shelf():
    """Nothing around: a box that is open at the top, with a box in it and one beside it; ids name four objects."""
    vertices, faces = box((0, 0, 0), (1, 1, 1), 2)
    inside = box((0.02, 0.02, 0.02), (0.98, 0.98, 1), 2, inward=True)
    shelf = joined((vertices, faces[:20]), (inside[0], inside[1][:20]))
    return Patches(*joined(shelf, box((0.3, 0.3, 0.1), (0.7, 0.6, 0.8)), box((1.4, 0.2, 0), (1.8, 0.5, 0.6), 2)))


def engine(tree, kind, lines, seed, shares=None):
    """By rays, or by eight bundles of a spiral."""
    shares = area_shares(tree) if shares is None else shares
    if kind == "rays":
        points = [Independent(4, 1000 * seed + node) for node in range(len(tree))]
        return TreeRays(tree, RayScene(tree.objects.patches), points, allocated(lines, shares)), 1
    return TreeBundles(tree, [SpiralPoints(1000 * seed + k, 64) for k in range(len(tree))], lines / 64 * shares), 64


def cast(tree, kind="rays", lines=1 << 14, seed=0, shares=None):
    made, count = engine(tree, kind, lines, seed, shares)
    return PartialSegments(tree, list(made.stream(count)), made.densities(count))


def tree_of(patches, **options):
    return sphere_tree(find_objects(patches, **options))


# ---------------------------------------------------------------------- the tree and its lines


@pytest.mark.parametrize("count", [1, 2, 3, 17])
def test_k_objects_have_2k_spheres_each_inside_its_parent(count):
    random = np.random.default_rng(count)
    lows = random.uniform(0.02, 0.9, (count, 3))
    boxes = [box(low, low + random.uniform(0.01, 0.08, 3)) for low in lows]
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), *boxes))
    tree = sphere_tree(find_objects(patches, np.repeat(np.arange(-1, count), [24] + [6] * count)))
    assert len(tree) == 2 * count and tree.parents[0] == -1 and (tree.parents[1:] < np.arange(1, 2 * count)).all()
    for node in range(1, len(tree)):
        parent = tree.parents[node]
        away = np.linalg.norm(tree.centres[node] - tree.centres[parent])
        assert away + tree.radii[node] <= tree.radii[parent] * (1 + 1e-9)
    everything = np.arange(len(patches))
    for node in range(len(tree)):
        member = tree.belong(np.full(len(patches), node), everything)
        assert member[:24].all() == member[:24].any() == (node == 0)  # walls in the main sphere alone
        corners = patches.vertices[patches.faces[member]]
        assert (np.linalg.norm(corners - tree.centres[node], axis=-1) <= tree.radii[node] * (1 + 1e-9)).all()
        assert tree.areas[node] == pytest.approx(patches.areas[24:][member[24:]].sum())
    assert sorted(tree.last[tree.leaves] - tree.first[tree.leaves]) == [1] * count
    # A patch and itself have the smallest sphere of its object in common.
    assert (tree.common(everything, everything) == tree.lowest).all()
    one, other = random.integers(0, len(patches), (2, 50))
    for i, j, node in zip(one, other, tree.common(one, other), strict=True):
        both = [k for k in range(len(tree)) if tree.belong(np.array([k, k]), np.array([i, j])).all()]
        assert node == both[np.argmin(tree.last[both] - tree.first[both])]


def test_the_two_spheres_with_the_closest_centres_are_joined_first():
    lows = np.array([[0.1, 0.1, 0.1], [0.2, 0.1, 0.1], [0.8, 0.8, 0.1], [0.8, 0.7, 0.15], [0.8, 0.8, 0.3]])
    boxes = [box(low, low + 0.04) for low in lows]
    tree = tree_of(Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), *boxes)))
    ends = zip(tree.first, tree.last, strict=True)
    groups = {tuple(np.flatnonzero((tree.rank >= a) & (tree.rank < b))) for a, b in ends}
    assert groups == {(0, 1, 2, 3, 4), (0, 1), (2, 3, 4), (2, 3), (0,), (1,), (2,), (3,), (4,)}


def test_a_fifth_of_the_lines_is_cast_in_the_main_sphere_and_the_rest_by_areas():
    tree = tree_of(room(2))
    shares = area_shares(tree)
    weights = tree.areas[1:] / (4 * np.pi * tree.radii[1:] ** 2)
    np.testing.assert_allclose(shares[1:] / shares[1:].sum(), weights / weights.sum())
    assert shares[0] == 0.2 and shares.sum() == pytest.approx(1)
    for total in (10, 4096, 99_999):
        lines = allocated(total, shares)
        assert lines.sum() == total and (np.abs(lines - total * shares) < 1).all()
    for main in (0, 1.1):
        with pytest.raises(RadiosityError, match="above 0 and up to 1"):
            area_shares(tree, main)


def fine_boxes():
    """A room of one patch a wall with three small boxes of 24 patches each."""
    boxes = [box(low, np.array(low) + 0.1, 2) for low in ((0.2, 0.2, 0.1), (0.35, 0.2, 0.1), (0.7, 0.7, 0.4))]
    return Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), *boxes))


@pytest.mark.parametrize(("patches", "gain"), [(room(3), 1), (fine_boxes(), 0.2)])
def test_shares_of_least_error_are_no_worse_than_any_others(patches, gain):
    """Where walls have patches as small as the boxes, all lines are best cast in the main sphere."""
    tree = tree_of(patches)
    areas, random = tree.objects.patches.areas, np.random.default_rng(1)

    def error(shares):
        return (1 / (areas * tree.of_patches(tree.densities(shares)))).sum()

    best, flat = least_error_shares(tree), np.eye(len(tree))[0]
    assert best.sum() == pytest.approx(1)
    assert error(best) < 0.9 * error(area_shares(tree)) and error(best) < gain * error(flat) * (1 + 1e-4)
    for _ in range(50):
        step = random.normal(size=len(tree)) * 0.02
        near = np.maximum(best + step - step.mean(), 1e-9)
        assert error(near / near.sum()) > error(best) * (1 - 1e-4)


# ---------------------------------------------------------------------- counters


@pytest.mark.parametrize("kind", ["rays", "bundles"])
def test_lines_of_a_sphere_count_only_for_patches_that_belong_to_it(kind):
    """And they find those as often as integral geometry says: N 2 A / S."""
    patches = room(2)
    tree = tree_of(patches)
    for node in range(len(tree)):
        shares = np.eye(len(tree))[node] * (1 - 1e-3) + np.eye(len(tree))[0] * 1e-3
        segments = cast(tree, kind, 1 << 14, node, shares / shares.sum())
        member = tree.belong(np.full(len(patches), node), np.arange(len(patches)))
        outside, few = segments.counted[~member].sum(), segments.expected[~member].sum()
        assert abs(outside - few) < 10 * np.sqrt(few) + 5
        spread = 4 * np.sqrt(segments.expected[member]) + 3
        assert (np.abs(segments.counted - segments.expected)[member] < spread).all()


@pytest.mark.parametrize("kind", ["rays", "bundles"])
def test_the_lines_of_a_patch_are_the_sum_of_those_to_all_others(kind):
    patches = overlapping()
    segments = cast(tree_of(patches), kind)
    found, both = segments.counts()
    sums = np.asarray(found.sum(axis=1)).ravel() + segments.to_sky + segments.to_dark
    np.testing.assert_array_equal(sums, segments.counted)
    assert abs(found - found.T).max() > 0 and (both > found).nnz == 0 and abs(both - both.T).nnz == 0
    dark = np.divide(segments.to_dark, segments.counted)
    np.testing.assert_allclose(partial_form_factors(segments, "F1").row_sums() + dark, 1, atol=1e-12)


@pytest.mark.slow
def test_lines_need_not_be_followed_beyond_their_sphere():
    """The same lines from far outside the scene to its other end have the same segments with ends in the sphere."""
    for patches in (room(2), overlapping(), open_shelf()):
        tree, scene = tree_of(patches), RayScene(patches)
        rays = ChainedRays.through(scene)
        for node in range(1, len(tree)):
            sphere = tree.centres[node], tree.radii[node]
            lines = SpherePairs(patches, sphere).lines(OwenSobol(4, node).block(1 << 10))
            reach = 2 * ((tree.centres[node] - lines.origins) * lines.directions).sum(axis=1)
            near, of = rays.segments_within(lines, reach)
            far = Lines(lines.origins - 3 * scene.radius * lines.directions, lines.directions)
            whole, of_whole = rays.segments_within(far, np.full(len(lines), np.inf))
            spheres = np.full(len(of), node), np.full(len(of_whole), node)
            kept, expected = marked(near, spheres[0], tree), marked(whole, spheres[1], tree)
            assert len(near) <= len(whole) and ((kept & OUTSIDE) > 0).any()
            rows, other = (sorted(map(tuple, pairs.tolist())) for pairs in (kept, expected))
            differing = len(set(rows) ^ set(other)) + abs(len(rows) - len(other))
            assert differing <= 0.01 * len(rows), (node, differing, len(rows))


# ---------------------------------------------------------------------- estimates


@pytest.mark.parametrize(
    ("kind", "patches"),
    [
        pytest.param("rays", room(1), marks=pytest.mark.slow),
        ("bundles", room(1)),
        pytest.param("rays", overlapping(), marks=pytest.mark.slow),
        ("rays", open_shelf()),
    ],
)
def test_form_factors_are_those_of_lines_of_the_whole_scene(kind, patches):
    """In the mean of 16 runs, whatever the objects: entries scatter about the exact ones as their errors say."""
    exact = np.asarray(form_factors(ABuffer(patches, lines=1 << 14).cast(1024), "reciprocal").matrix.todense())
    tree = tree_of(patches)
    runs = {name: [] for name in ("F1", "reciprocal", "pooled", "F4")}
    for seed in range(16):
        segments = cast(tree, kind, 1 << 13, seed)
        for name, found in runs.items():
            found.append(np.asarray(partial_form_factors(segments, name).matrix.todense()))
    areas = patches.areas
    large = exact * areas[:, None] > 1e-3 * areas.sum() / len(areas)
    for name, found in runs.items():
        mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(16)
        z = (mean - exact)[large & (error > 0)] / error[large & (error > 0)]
        if name == "F4":  # its weights are the counts themselves: more where more was counted
            assert z.mean() > 0.1
        else:
            # Squares of Student's t of 15 degrees have the mean 15/13 and the deviation 1.84; pairs are as one entry.
            assert abs(z.mean()) < 0.2 and (z**2).mean() < 15 / 13 + 4 * 1.84 / np.sqrt(len(z) / 2), name
        if name in ("reciprocal", "pooled"):
            assert np.abs(areas[:, None] * mean - (areas[:, None] * mean).T).max() < 1e-12


@pytest.mark.slow
def test_stated_errors_are_those_of_independent_lines():
    """Root mean square over entries of the scatter of 30 runs, against the errors that runs state."""
    tree = tree_of(room(1))
    names = ("F1", "F2", "F3", "F4", "reciprocal", "pooled")
    runs = {name: [] for name in names}
    for seed in range(30):
        segments = cast(tree, "rays", 1 << 12, seed)
        for name in names:
            made = partial_form_factors(segments, name)
            runs[name].append(np.array([made.matrix.todense(), made.errors.todense()]))
    for name, found in runs.items():
        values = np.array(found)
        scatter = np.sqrt((values[:, 0].var(axis=0, ddof=1)).sum())
        stated = np.sqrt((values[:, 1] ** 2).mean(axis=0).sum())
        assert 0.87 < stated / scatter < 1.15, (name, stated / scatter)


# ---------------------------------------------------------------------- passes, requests


def hierarchical(patches, **settings):
    method = HierarchicalCasting(find_objects(patches), HierarchicalCastingSettings(**settings), goal="rows")
    method.prepare(PatchProblem(patches), 3)
    return method


@pytest.mark.parametrize("settings", [{"engine": "rays", "lines": 600}, {"engine": "bundles", "lines": 4000}])
def test_passes_add_up_and_depend_on_nothing_else(settings):
    method = hierarchical(room(2), bundles_per_pass=4, **settings)
    runner = Runner(method, seed=3, budget=Budget(samples=64))
    whole = runner.run().measurement
    parts = [method.step(k, 3, {}).measurement for k in (2, 0, 3, 1, *range(4, 16))]
    together = functools.reduce(operator.add, parts)
    one, other = method.segments(whole), method.segments(together)
    for a, b in zip(one.chunks, other.chunks, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(one.expected, method.engine.expected(64))
    assert method.noise(parts[0]) is None  # of too few passes
    assert method.noise(whole) == pytest.approx(np.mean(method.engine.expected(64) ** -0.5) ** 2)
    assert abs(one.counted.sum() / one.expected.sum() - 1) < 0.05


def test_points_settings_and_seeds_decide_the_lines():
    patches = room(1)
    counted = {}
    for name in ("independent", "halton", "sobol", "auto"):
        method = hierarchical(patches, point_set=name, lines=256, bundles_per_pass=2)
        counted[name] = method.segments(method.step(0, 3, {}).measurement).counted
    assert (counted["sobol"] == counted["auto"]).all() and (counted["halton"] != counted["independent"]).any()
    even = hierarchical(patches, main_share=0, lines=4096)
    assert (even.engine.lines != hierarchical(patches, lines=4096).engine.lines).any()


def test_a_run_with_budget_checkpoint_and_resuming(tmp_path):
    patches, saved = room(2), tmp_path / "lines.checkpoint"
    asked = {"method": "spheres", "objects": "components", "lines": 512.0}
    whole = etendue.compute_form_factors(patches, bundles=300, **asked)
    etendue.compute_form_factors(patches, bundles=130, checkpoint=saved, **asked)
    later = etendue.resume(saved, scene=patches, bundles=300)
    assert whole.bundles == later.bundles == 300
    np.testing.assert_array_equal(whole.segments.counted, later.segments.counted)
    np.testing.assert_allclose(whole.factors.matrix.todense(), later.factors.matrix.todense(), atol=1e-12)
    expected = partial_form_factors(whole.segments, "F4").matrix
    np.testing.assert_array_equal(whole.factors.matrix.todense(), expected.todense())
    to_error = etendue.compute_form_factors(patches, "spheres", error=0.2, main_share=0, engine="bundles")
    assert to_error.stopped_by == "error" and np.mean(1 / np.sqrt(to_error.segments.counted)) < 0.21


def test_objects_of_a_mesh_file_and_of_an_array(tmp_path):
    meshio = pytest.importorskip("meshio")
    patches = room(1)
    numbers = np.where(np.arange(len(patches)) < 6, -1, 7 + (np.arange(len(patches)) - 6) // 12)  # two boxes are one
    cells = {"thing": [numbers], "patch": [np.arange(len(patches)) // 2]}
    path = tmp_path / "room.vtu"
    meshio.Mesh(patches.vertices, [("quad", patches.faces)], cell_data=cells).write(path)
    made = etendue.compute_form_factors(path, "spheres", objects="thing", bundles=4, lines=256.0)
    assert made.segments.tree.objects.names == ("7", "8")
    etendue.compute_form_factors(path, "spheres", objects="thing", bundles=2, checkpoint=tmp_path / "c")
    cells["thing"][0][numbers == 7] = 8
    meshio.Mesh(patches.vertices, [("quad", patches.faces)], cell_data=cells).write(path)
    with pytest.raises(etendue.CheckpointError, match="made with other objects; find them as they were, or cast anew"):
        etendue.resume(tmp_path / "c", bundles=4)
    numbers = cells["thing"][0]
    made = etendue.compute_form_factors(path, "spheres", objects="thing", bundles=4, lines=256.0)
    given = etendue.compute_form_factors(patches, "spheres", objects=numbers, bundles=4, lines=256.0)
    np.testing.assert_array_equal(given.segments.tree.objects.of_patch, made.segments.tree.objects.of_patch)
    with pytest.raises(etendue.radiosity.PatchError, match="no array 'things' for its faces; did you mean 'thing'"):
        etendue.compute_form_factors(path, "spheres", objects="things")
    torn = etendue.radiosity.read_patches
    with pytest.raises(etendue.radiosity.PatchError, match="patch 3 has faces of the objects"):
        cells["thing"][0][6] = 9
        meshio.Mesh(patches.vertices, [("quad", patches.faces)], cell_data=cells).write(path)
        torn(path, ids="patch", objects="thing")


# ---------------------------------------------------------------------- bad input


def test_one_object_works_and_is_said(caplog):
    patches = Patches(*joined(box((0, 0, 0), (1, 1, 1), inward=True), box((0.4, 0.4, 0.2), (0.6, 0.6, 0.5))))
    tree = tree_of(patches)
    assert len(tree) == 2 and "there is one object" in caplog.text
    factors = partial_form_factors(cast(tree, lines=1 << 15), "pooled")
    assert np.abs(factors.row_sums() - 1).max() < 0.05


def test_an_object_larger_than_the_room_and_one_around_all():
    """Without walls the room itself is an object, and its sphere holds the others."""
    patches = room(1)
    tree = tree_of(patches, walls=())
    assert len(tree) == 10 and tree.radii[0] == pytest.approx(patches.sphere[1])
    factors = partial_form_factors(cast(tree, lines=1 << 15), "pooled")
    assert np.abs(factors.row_sums() - 1).max() < 0.1


def test_a_sphere_without_lines_leaves_its_patches_to_larger_ones():
    tree = tree_of(room(1))
    shares = area_shares(tree)
    shares[tree.leaves[0]] = 0
    segments = cast(tree, shares=shares / shares.sum())
    assert len(segments.unseen) == 0 and (segments.counted > 0).all()
    spread = 4.5 * np.sqrt(segments.expected)
    assert (np.abs(segments.counted - segments.expected) < spread).all()


def test_what_does_not_fit_is_refused():
    patches = room(1)
    objects = find_objects(patches)
    for settings, message in (
        ({"main_share": 1.5}, "at most all of the lines"),
        ({"point_set": "spiral"}, "a spiral is for bundles"),
        ({"shot": True}, "neither shot"),
    ):
        with pytest.raises(RadiosityError, match=message):
            HierarchicalCasting(objects, HierarchicalCastingSettings(**settings))
    with pytest.raises(RadiosityError, match="there is no estimator"):
        partial_form_factors(None, "F5")  # before it looks at any segment
    with pytest.raises(RadiosityError, match="of other patches"):
        HierarchicalCasting(objects).prepare(PatchProblem(room(2)), 0)
    with pytest.raises(RadiosityError, match="the main sphere needs lines"):
        cast(sphere_tree(objects), lines=2, shares=np.eye(8)[1])
    for asked, message in (
        ({"walls": [0]}, "walls is for method spheres"),
        ({"method": "spheres", "objects": "chairs"}, "objects are found by components"),
        ({"method": "spheres", "engine": "raster"}, "one of rays, bundles"),
    ):
        with pytest.raises(OptionError, match=message):
            etendue.compute_form_factors(patches, bundles=1, **asked)


def test_three_channels_of_a_scene():
    """Patches of a scene have three channels."""
    result = etendue.compute_form_factors(scene_patches("cornell-box"), "spheres", objects="shapes", bundles=2)
    assert (result.factors.row_sums() > 0.5).all()


def test_a_single_box_sees_only_the_sky(variant):
    result = etendue.compute_form_factors(Patches(*box((0, 0, 0), (1, 1, 1), 1)), "spheres", bundles=16)
    assert result.factors.matrix.nnz == 0
    np.testing.assert_allclose(result.factors.sky, 1)
