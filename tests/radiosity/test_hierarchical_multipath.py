"""Hierarchical transmittance-based multipath [Castro 2002, ch. 5]: boxes, transmittances, energy, agreement."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.radiosity.plain_caster import PlainCaster
from support.patches import room, square
from support.tasks import job_of

from etendue.core import CheckpointError
from etendue.engine import Budget, Checkpoint, Runner
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    RadiosityError,
    box,
    form_factors,
    grouped,
    joined,
    solve,
)
from etendue.radiosity.hierarchical_multipath import method
from etendue.radiosity.hierarchical_multipath.casting import region
from etendue.radiosity.hierarchical_multipath.exchange import Exchange
from etendue.radiosity.hierarchical_multipath.firstshot import FirstShots
from etendue.radiosity.hierarchical_multipath.grouping import _Item, _merged, _Pairs
from etendue.radiosity.hierarchical_multipath.lists import PartRays, preprocess
from etendue.radiosity.hierarchical_multipath.parts import Tree, box_area
from etendue.radiosity.hierarchical_multipath.regions import Regions
from etendue.radiosity.lines.generators import box_lines


def block(low, high, cells=1):
    return box(low, high, cells)


def walls(cells=3, light=True, size=3.0, **properties):
    """A cubic room, its ceiling lit."""
    vertices, faces = box((0, 0, 0), (size, size, size), cells, inward=True)
    emission = (vertices[faces][:, :, 2] == size).all(axis=1) * (10.0 if light else 0.0)
    return Patches(vertices, faces, **({"reflectance": 0.5, "emission": emission} | properties))


def moved(x, y, z=0.0, turn=0.0, scale=1.0):
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, scale, z], [0, 0, 0, 1.0]])


def things(cells=1):
    """Two small blocks, in a box that they fill by a third, around the origin."""
    return Patches(
        *joined(block((-0.4, -0.4, 0), (-0.1, 0.4, 0.5), cells), block((0.1, -0.3, 0), (0.4, 0.2, 0.4), cells)),
        reflectance=0.6,
    )


def hall(copies=2, **properties):
    """A room with copies of the two blocks."""
    places = [moved(0.8, 0.8), moved(2.1, 1.9, turn=0.5), moved(0.8, 2.2, 0.4, 1.0, 0.7)][:copies]
    return Part(walls(**properties), [(Part(things(), objects=2), np.array(places))])


def listed(root, lines=4000, regions=None, seed=0):
    rays = {part: PartRays(part) for part in root.distinct}
    counts = dict.fromkeys(root.distinct, lines)
    found = preprocess(rays, root, counts, regions or Regions(2, 4, 1), lambda k: OwenSobol(4, seed=10 * seed + k), 0)
    return rays, found


# ---------------------------------------------------------------------- boxes and regions


def test_every_direction_and_place_has_one_of_768_regions():
    """Check 21: a uniform density of lines meets all of them equally often."""
    regions, u = Regions(), np.random.default_rng(1).random((1 << 15, 4))
    corners = np.array([[0, 0, 0], [1, 1, 1.0]])
    o, d = box_lines(u, *corners)
    found = np.array([region(corners, p, w, 0.0, False, 4, 4, 2) for p, w in zip(o, d, strict=True)])
    count = np.bincount(found, minlength=len(regions))
    assert len(regions) == 768 and len(count) == 768
    mean = len(o) / 768
    assert ((count - mean) ** 2 / mean).sum() < 768 + 5 * np.sqrt(2 * 768)
    # The line backwards leaves where it entered: the same region.
    back = [region(corners, p, -w, 0.0, True, 4, 4, 2) for p, w in zip(o[:200], d[:200], strict=True)]
    np.testing.assert_array_equal(back, found[:200])


def test_a_region_without_lines_takes_the_mean_of_its_neighbours():
    """Check 22."""
    regions = Regions(2, 4, 1)
    values = np.random.default_rng(2).random(len(regions))
    known = np.ones(len(regions), dtype=bool)
    known[5] = False
    around = set(regions.neighbours()[5]) - {5}
    np.testing.assert_allclose(regions.interpolated(values, known)[5], np.mean([values[k] for k in around]))
    np.testing.assert_array_equal(regions.interpolated(values, np.zeros(len(regions), bool)), 1.0)
    weights = known.astype(float)
    donors = regions.donors(weights)
    assert donors[5] in around and (np.delete(donors, 5) == np.delete(np.arange(len(regions)), 5)).all()


def test_groups_follow_the_threshold():
    """Check 21: the quotient of areas decides; boxes that overlap are together in any case."""
    pair = [block((0.5, 0.5, 0.1), (1, 1, 1)), block((1.05, 0.5, 0.1), (1.5, 1, 1))]
    mesh = joined(box((0, 0, 0), (4, 4, 4), inward=True), *pair, block((3, 3, 0.1), (3.5, 3.5, 1)))
    patches, of = Patches(*mesh, emission=1.0), np.repeat([-1, 0, 1, 2], 6)
    quotient = (2 * (0.25 + 0.45 + 0.45) + 2 * (0.225 + 0.405 + 0.45)) / (2 * (0.5 + 0.9 + 0.45))
    for threshold, sizes in ((quotient - 1e-6, [6, 12]), (quotient + 1e-6, [6, 6, 6]), (0.1, [18])):
        root = grouped(patches, of, threshold, least=1)
        assert sorted(part.total for part, _ in root.children) == sizes
        assert len(root) == 6
    assert grouped(patches, of, 10.0).children == []  # boxes of six patches are worth nothing
    inside = joined(mesh, block((0.9, 0.7, 0.3), (1.2, 0.8, 0.5)))
    root = grouped(Patches(*inside, emission=1.0), np.append(of, [3] * 6), 100.0, least=1)
    assert sorted(part.objects for part, _ in root.children) == [1, 3]
    levels = grouped(patches, of, 0.2, least=1, levels=2)
    assert levels.total == sum(map(len, levels.distinct)) == len(patches)


def boxes_at_random(count, seed):
    """Boxes of different shapes, some of which overlap."""
    rng = np.random.default_rng(seed)
    low = rng.random((count, 3)) * 6
    return [
        _Item(a, b, box_area(a, b), (k,))
        for k, (a, b) in enumerate(zip(low, low + rng.random((count, 3)), strict=True))
    ]


def greedy(items, threshold):
    """The rule of :func:`grouped` word by word: all pairs anew for every merge."""
    groups = [(item.low, item.high, item.areas, item.objects) for item in items]

    def quotient(one, other):
        slack = 1e-6 * np.linalg.norm(np.maximum(one[1], other[1]) - np.minimum(one[0], other[0]))
        if (np.minimum(one[1], other[1]) - np.maximum(one[0], other[0]) > slack).all():
            return np.inf
        return (one[2] + other[2]) / box_area(np.minimum(one[0], other[0]), np.maximum(one[1], other[1]))

    while True:
        found = [(quotient(a, b), i, j) for i, a in enumerate(groups) for j, b in enumerate(groups) if i < j]
        best = max(found, default=(0,))
        if best[0] <= threshold:
            return {frozenset(group[3]) for group in groups}
        one, other = (groups.pop(k) for k in sorted(best[1:], reverse=True))
        low, high = np.minimum(one[0], other[0]), np.maximum(one[1], other[1])
        groups.append((low, high, one[2] + other[2], one[3] + other[3]))


@pytest.mark.parametrize("threshold", [0.3, 0.7, 1e9])
def test_groups_are_those_of_the_rule(threshold):
    items = boxes_at_random(40, 3)
    assert {frozenset(item.objects) for item in _merged(items, threshold)} == greedy(items, threshold)


def test_a_thousand_objects_take_a_million_pairs():
    """And not a thousand times as many."""
    pairs = _Pairs(boxes_at_random(1000, 5))
    merges = 0
    while (best := pairs.best()) is not None and best[0] > 0.05:
        pairs.merge(*best[1:])
        merges += 1
    assert merges > 900 and len(pairs.left()) == 1000 - merges
    assert pairs.evaluated < 1000**2


def test_walls_that_reach_into_a_box_leave_its_objects_without_one():
    mesh = joined(
        box((0, 0, 0), (4, 4, 4), inward=True), square((1, 0, 0), (0, 4, 0), (0, 0, 4)), block((0.5, 1, 1), (2, 2, 2))
    )
    root = grouped(Patches(*mesh, emission=1.0), np.repeat([-1, -1, 0], [6, 1, 6]), least=1)
    assert root.children == [] and len(root) == 13


# ---------------------------------------------------------------------- lines and transmittances


def test_transmittance_of_full_boxes_is_none_and_between_for_others():
    """Check 22."""
    _, found = listed(Part(walls(), [(Part(Patches(*block((0, 0, 0), (1, 1, 1), 2))), moved(1, 1, 0.5))]))
    full, _ = found.values()
    assert (full.transmittance == 0).all() and (full.hitting == full.through).all()
    cross = Patches(*joined(block((0, 0.4, 0.4), (1, 0.6, 0.6)), block((0.4, 0, 0.4), (0.6, 1, 1))))
    _, found = listed(Part(walls(), [(Part(cross), moved(1, 1, 0.5))]))
    some = next(iter(found.values())).transmittance
    assert 0.3 < some.mean() < 0.9 and (some > 0).all() and (some < 1).any()
    # Lines that meet nothing are counted only: a flat thing in the middle leaves whole regions of the sides free.
    flat = Patches(*joined(block((0, 0, 0), (0.01, 0.01, 1)), block((0.99, 0.99, 0), (1, 1, 1))))
    _, found = listed(Part(walls(), [(Part(flat), moved(1, 1, 0.5))]))
    assert next(iter(found.values())).transmittance.mean() > 0.9


def test_lines_meet_patches_as_often_as_their_areas_say():
    root = hall(3)
    _, found = listed(root, 20000)
    for part, lines in found.items():
        expected = lines.lines * 2 * part.patches.areas / part.box_area
        # Half of the lines through a face of a closed solid or room are on its front: all of them end there.
        assert abs(lines.counted.sum() / expected.sum() - 1) < 0.02
        np.testing.assert_allclose(lines.counted, expected, atol=6 * np.sqrt(expected.max()))
    lines = found[root]
    crossed = lines.child_lines.reshape(3, -1).sum(axis=1)
    areas = [part.box_area * abs(np.linalg.det(m[:3, :3])) ** (2 / 3) for part, m in root.children]
    np.testing.assert_allclose(crossed, 2 * lines.lines * np.array(areas) / root.box_area, rtol=0.05)
    assert lines.nbytes / lines.lines < 60


def test_first_hits_by_associated_polygons_are_those_of_all_polygons():
    """Check 23: with the conservative lists bit for bit, by fewer tests; by a listed polygon alone a few are wrong."""
    root = Part(walls(), [(Part(things(4), objects=2), np.array([moved(0.8, 0.8), moved(2.1, 1.9, turn=0.5)]))])
    rays, lists = listed(root, 1 << 14)
    caster = PlainCaster(Tree(root), rays, lists)
    u = Independent(4, seed=3).block(1 << 12)
    origins = np.column_stack([3 * u[:, :2], np.full(len(u), 2.999)])
    r, phi = np.sqrt(u[:, 2]), 2 * np.pi * u[:, 3]
    ways = np.column_stack([r * np.cos(phi), r * np.sin(phi), -np.sqrt(1 - u[:, 2])])
    plain, exact, quick = (caster.first_hits(origins, ways, how) for how in ("all", "conservative", "listed"))
    np.testing.assert_array_equal(exact.hits, plain.hits)
    np.testing.assert_array_equal(exact.distance, plain.distance)
    assert exact.tests < 0.8 * plain.tests and quick.tests < exact.tests
    wrong = (quick.hits != plain.hits).any(axis=1).mean()
    assert wrong < 0.05


# ---------------------------------------------------------------------- exchange


@pytest.mark.parametrize("shot", [True, False], ids=["shot", "lines"])
@pytest.mark.parametrize("sky", [0.0, 2.0])
def test_power_is_conserved_in_every_iteration(shot, sky):
    """Check 25: also where regions have no line, of few lines and boxes in boxes."""
    inner = Part(things(), objects=2)
    middle = Part(
        Patches(*block((-0.5, -0.5, 0.6), (0.5, 0.5, 0.65)), reflectance=0.3, emission=1.0), [(inner, moved(0, 0))]
    )
    scene = walls() if not sky else Patches(*square((0, 0, 0), (3, 0, 0), (0, 3, 0)), reflectance=0.7, sky=sky)
    root = Part(
        scene, [(middle, [moved(0.8, 0.8, 0.1), moved(2.2, 2.0, 0.1, 0.3, 0.8)]), (inner, moved(0.6, 2.4, 0.2))]
    )
    rays, lists = listed(root, 600, Regions())
    assert any((found.through == 0).any() for found in list(lists.values())[:-1])
    tree = Tree(root)
    sent = FirstShots(tree, rays).cast(500, OwenSobol(4, seed=5), 0, 1) if shot else None
    exchange, left = Exchange(tree, lists, sent), []
    for _ in range(6):
        exchange.iterate()
        left.append(exchange.residual[0] / exchange.sent[0])
        assert exchange.imbalance < 1e-9
        assert all((part >= 0).all() for part in exchange.received.of_parts)
    assert (np.diff(left) < 0).all() or shot is False
    assert left[-1] < 0.05
    emitted = sum((tree.areas(n)[:, None] * tree.parts[tree.part[n]].patches.emission).sum() for n in range(len(tree)))
    assert exchange.sent[0] >= emitted * (1 - 1e-9)


def solved(root, seed=1, lines=1 << 15, **settings):
    method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=lines, **settings))
    method.prepare(PartProblem(root), seed)
    made = method.step(0, seed, method.start())
    return method.solution(made.measurement)


def agreement(halves, expected, areas):
    """Root mean square of the difference, without its noise: halves err independently."""
    one, other = (half - expected for half in halves)
    return np.sqrt(max((areas * one * other).sum() / (areas * expected**2).sum(), 0))


@pytest.mark.parametrize("shot", [1.0, pytest.param(0.0, marks=pytest.mark.slow)], ids=["shot", "lines"])
def test_without_copies_it_is_flat_multipath(shot):
    """A hierarchy of no box has no bias: form factors of the same room, within the scatter."""
    patches = room(4, reflectance=0.5, emission=np.eye(1, len(room(4)), 3)[0] * 10)
    exact = solve(patches, form_factors(ABuffer(patches).cast(1024), "F4")).irradiance
    found = [solved(Part(patches), seed, shot=shot).irradiance_on(patches)[0] for seed in range(8)]
    mean, scatter = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(8)
    areas = patches.areas[:, None]
    noise = (areas * scatter**2).sum() + 1e-5 * (areas * exact**2).sum()
    assert (areas * (mean - exact) ** 2).sum() < 1.5 * noise
    assert noise < 0.05**2 * (areas * exact**2).sum()


def test_copies_agree_with_all_of_them_in_one_mesh():
    """Check 26, on few patches; the noise is taken off by two halves. Finer regions leave less of the bias."""
    places = [moved(0.8, 0.8), moved(2.1, 1.9, turn=0.5), moved(0.8, 2.2, 0.4, 1.0, 0.7)]
    root = Part(walls(6), [(Part(things(2), objects=2), np.array(places))])
    flat = root.joined()
    assert len(flat) == root.total == len(root) + 3 * len(things(2))
    exact = solve(flat, form_factors(ABuffer(flat).cast(1024), "F4")).irradiance
    areas, off = flat.areas[:, None], []
    for regions in ({"grid": 2, "rings": 1}, {"grid": 4, "sectors": 8, "rings": 4}):
        halves = [solved(root, seed, 1 << 18, **regions).irradiance_on(flat)[0] for seed in (1, 2)]
        off.append(agreement(halves, exact, areas))
        assert abs((areas * (np.mean(halves, axis=0) - exact)).sum() / (areas * exact).sum()) < 0.01
    assert off[1] < 0.03 and off[1] < off[0] < 0.08


def test_a_mirrored_turned_and_larger_scene_has_the_same_light():
    """Light in a copy of a whole scene: a room in a box, that nothing leaves."""
    sealed = Part(hall(2).patches, [(Part(things(), objects=2), np.array([moved(0.8, 0.8), moved(2.1, 1.9)]))])
    alone = solved(sealed, lines=1 << 16)
    mirror = np.diag([-2.0, 2, 2, 1])
    both = Part(Patches(*box((-20, -20, -20), (20, 20, 20), inward=True), reflectance=0.5), [(sealed, mirror)])
    inside = solved(both, lines=1 << 17, inside=1.0)
    rows = slice(6, None)
    flat, areas = both.joined(), inside.tree.joined().areas
    assert np.isclose(areas[rows].sum(), 4 * sealed.joined().areas.sum())
    irradiance = inside.irradiance_on(flat)[0]
    assert irradiance[:6].max() == 0
    node = 1
    expected, found = alone.irradiance(0), inside.irradiance(node)
    assert abs((found / expected).mean() - 1) < 0.02
    own = inside.tree.numbers_in_joined[inside.tree.offsets[node] : inside.tree.offsets[node + 1]]
    np.testing.assert_allclose(flat.normals[own], sealed.patches.normals @ (mirror[:3, :3] / 2).T, atol=1e-12)


def test_a_plate_under_the_sky_has_its_irradiance():
    plate = Patches(*square((0, 0, 0), (3, 0, 0), (0, 3, 0)), reflectance=0.7, sky=2.0)
    assert solved(Part(plate)).irradiance(0)[0, 0] == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("generator", ["sphere-pairs", "great-circle"])
@pytest.mark.parametrize("sky", [0.0, 2.0])
def test_lines_of_all_generators_come_to_the_same(generator, sky):
    """Power, also that of the sky, which a line carries by the density of its generator."""
    ground = Patches(*square((0, 0, 0), (3, 0, 0), (0, 3, 0)), reflectance=0.7, sky=sky)
    root = (
        Part(ground, [(Part(things(), objects=2), [moved(0.8, 0.8, 0.01), moved(2.1, 1.9, 0.01)])]) if sky else hall()
    )

    def light(generator, points, seed):
        settings = HierarchicalMultipathSettings(lines=1 << 14, generator=generator, point_set=points)
        method = HierarchicalMultipath(settings)
        method.prepare(PartProblem(root), seed)
        solution = method.solution(Runner(method, seed=seed, budget=Budget(iterations=1)).run().measurement)
        return [solution.irradiance(node).mean() for node in range(3)]

    expected = np.array([light("box-walls", "sobol", seed) for seed in range(8)])
    found = np.array([light(generator, "halton", seed) for seed in range(8)])
    error = np.hypot(*(x.std(axis=0, ddof=1) / np.sqrt(8) for x in (expected, found)))
    assert (np.abs(found.mean(axis=0) - expected.mean(axis=0)) < 4.5 * error).all()
    assert (error < 0.02 * expected.mean(axis=0)).all()


def test_values_on_patches_and_on_the_joined_mesh():
    """Each patch of both meshes has the irradiance of its place."""
    patches = Patches(*joined(*(block((4 * x, 0, 0), (4 * x + 1, 1, 1), 4) for x in (2, 0, 1))), emission=1.0)
    root = grouped(patches, np.repeat([0, 1, 2], 96), least=1)
    solution = solved(root)
    solution.received[:] = (solution.tree.joined().centres[:, :1] * solution.tree.joined().areas[:, None])[
        solution.tree.numbers_in_joined
    ]
    np.testing.assert_allclose(solution.irradiance_on(patches)[0][:, 0], patches.centres[:, 0])
    whole = solution.tree.joined()
    np.testing.assert_allclose(solution.irradiance_on(whole, joined=True)[0][:, 0], whole.centres[:, 0])


def test_the_sky_is_seen_by_a_scene_without_walls():
    blocks = joined(*(block((4 * x, 0, 0), (4 * x + 1, 1, 1), 2) for x in range(3)))
    patches = Patches(*blocks, reflectance=0.5, sky=1.0)
    of = np.repeat([0, 1, 2], 24)
    root = grouped(patches, of, least=1 << 20)  # no boxes
    assert root.patches.sky.tolist() == [1.0]
    with pytest.raises(RadiosityError, match="all patches are in boxes"):
        grouped(patches, of, least=1)


def test_passes_add_and_tell_their_error():
    root = hall(2)
    method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=1 << 12))
    method.prepare(PartProblem(root), 3)
    result = Runner(method, seed=3, budget=Budget(iterations=12)).run()
    found, error = method.solution(result.measurement), np.sqrt(method.noise(result.measurement))
    exact = solved(root, 9, 1 << 18)
    areas = np.concatenate([found.tree.areas(node) for node in range(len(found.tree))])[:, None]
    off = np.abs(found.received - exact.received).sum() / exact.received.sum()
    assert 0.3 * error < off < 1.5 * error < 0.2
    assert (found.error >= 0).all() and found.irradiance_error(0).shape == (len(root), 1)
    assert np.isclose((areas > 0).mean(), 1)
    out = found.absorbed + found.to_sky + found.lost + found.residual
    np.testing.assert_allclose(found.sent, out, rtol=1e-9)


def test_a_run_is_resumed_bit_by_bit(tmp_path):
    root = hall(2)

    def runner(**options):
        method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=1 << 11))
        method.prepare(PartProblem(root), 3)
        return Runner(method, seed=3, **options)

    whole = runner(budget=Budget(iterations=3)).run()
    part = runner(budget=Budget(iterations=2)).run()
    job_of(PartProblem(root), part.method, 3).checkpoint(part).write(tmp_path / "a")
    saved = Checkpoint.read(tmp_path / "a")
    saved.require_scene(PartProblem(hall(2)).fingerprint)
    with pytest.raises(CheckpointError):
        saved.require_scene(PartProblem(hall(3)).fingerprint)
    rest = runner(budget=Budget(iterations=3), start=saved.measurement, state=saved.state).run()
    np.testing.assert_array_equal(rest.measurement.sums["received"], whole.measurement.sums["received"])


def test_light_that_backs_of_faces_take_is_reported(caplog):
    """One wall of the room is turned outward: what it takes is missing in the balance, and a warning says so."""
    closed = walls()
    faces = closed.faces.copy()
    faces[:9] = faces[:9, ::-1]
    turned = Part(Patches(closed.vertices, faces, reflectance=0.5, emission=closed.emission))
    found = solved(turned)
    lost = (found.lost + found.residual).sum() / found.sent.sum()
    assert lost > 0.1 and found.imbalance == pytest.approx(lost, rel=1e-9)
    assert "of the light meets backs of faces" in caplog.text
    assert found.on(turned.patches).imbalance == pytest.approx(lost, rel=1e-9)
    caplog.clear()
    assert solved(Part(closed)).imbalance < 1e-3 and not caplog.text


def test_what_waits_at_boxes_counts_as_memory(monkeypatch):
    monkeypatch.setattr(method, "free_memory", lambda: 50e6)
    solved(hall(3), lines=1 << 12, shot=0)
    with pytest.raises(RadiosityError, match="4800000 regions of boxes need"):
        solved(hall(3), lines=1 << 12, grid=100, sectors=10, rings=2, shot=0)


# ---------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Part(None), "needs patches"),
        (lambda: Part(walls(), [(Part(things()), np.diag([1, 2, 1, 1.0]))]), "shears"),
        (lambda: Part(walls(), [(Part(things()), np.full((4, 4), np.nan))]), "finite matrices"),
        (lambda: Part(walls(), [(Part(things()), [moved(1, 1), moved(1.3, 1)])]), "boxes of copies 0 and 1 overlap"),
        (lambda: Part(walls(), [(Part(things()), moved(0.1, 1))]), "reaches into the box of copy 0"),
        (lambda: Part(walls(), [(Part(things()), moved(1.5, 1.5, scale=9))]), "reaches into the box of copy 0"),
        (
            lambda: Part(walls(), [(Part(things().with_properties(reflectance=[[0.1, 0.2]])), moved(1, 1))]),
            "1 and 2 channels",
        ),
        (lambda: Part(walls(), [(Part(things().with_properties(sky=1.0)), moved(1, 1))]), "the sky is around"),
        (lambda: solved(Part(walls(light=False))), "no patch emits light"),
        (lambda: solved(hall(2), lines=3), "no line crosses the box"),
        (lambda: grouped(walls(), [1, 2]), "objects are whole numbers"),
        (lambda: grouped(walls(), np.zeros(54, int), threshold=-1), "threshold"),
        (lambda: solved(hall(1), grid=1, lines=(1 << 31) - 1), "GB are free"),
    ],
)
def test_bad_input_is_one_line(build, message):
    with pytest.raises(RadiosityError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


def test_boxes_may_touch_each_other_and_walls():
    one = Part(Patches(*block((0, 0, 0), (1, 1, 1)), reflectance=0.5))
    root = Part(walls(), [(one, [moved(0, 0), moved(1, 0), moved(0, 1), moved(2, 2, 2)])])
    found = solved(root, lines=1 << 14)
    hidden = np.isin(np.round(root.patches.centres, 3), [0.5]).sum(axis=1) == 2  # walls behind the first block
    assert (
        found.irradiance(0)[hidden & (root.patches.centres.min(axis=1) == 0)].max() < 0.02 * found.irradiance(0).max()
    )


@pytest.mark.slow
def test_one_object_larger_than_the_room_and_all_in_one():
    """Objects that enclose or overlap each other are in one box or in none; the light is that without boxes."""
    patches = room(3, emission=np.eye(1, len(room(3)), 0)[0] * 10, reflectance=0.5)
    exact = solve(patches, form_factors(ABuffer(patches).cast(1024), "F4")).irradiance
    for of in (np.zeros(len(patches), int), np.repeat([-1, 0], [54, len(patches) - 54])):
        root = grouped(patches, of, least=1)
        assert root.total == len(patches)
        halves = [solved(root, seed, 1 << 17).irradiance_on(patches)[0] for seed in (1, 2)]
        assert agreement(halves, exact, patches.areas[:, None]) < 0.05
