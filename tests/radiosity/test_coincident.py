"""Faces that lie on each other: thin plates of two faces, solids that touch, and a door on a wall."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from support.patches import box, joined

import etendue
from etendue.engine import Budget, Runner
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    ChainedRays,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    LocalRays,
    Part,
    PartProblem,
    Patches,
    RayScene,
    depth_first,
    diagnose,
    first_shot,
    local_form_factors,
    scene_patches,
    shot_at_patches,
)

UPWARD = [[0, 1, 2, 3]]
ENGINES = {
    "compiled": lambda patches: ABuffer(patches).cast(64),
    "drjit": lambda patches: ABuffer(patches, backend="drjit").cast(64),
    "chained": lambda patches: ChainedRays.through(RayScene(patches)).cast(1 << 15),
    "local": lambda patches: LocalRays(RayScene(patches)).cast(1 << 16),
}


def turned(seed):
    """A random rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def sheet(size, cells, upward, triangles=False, shift=(0.0, 0.0), height=0.0):
    """A square around the origin in unequal cells, all seen from above or from below."""
    cuts = np.linspace(-size, size, cells + 1)
    cuts[1:-1] += 0.1 * np.sin(7 * np.arange(1, cells)) / cells
    x, y = np.meshgrid(cuts + shift[0], cuts + shift[1], indexing="ij")
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    faces = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 4)
    if triangles:
        faces = np.concatenate([faces[:, [0, 1, 2, 2]], faces[:, [0, 2, 3, 3]]])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1), faces if upward else faces[:, ::-1]


def plate(seed=0, single=False, upper_first=True, around=True, apart=0.0, shift=(0.0, 0.0)):
    """A plate of two sheets of different tessellation, in any orientation, in a closed room that shines; and the
    patches of the upper and of the lower sheet. ``apart``: half of the distance of the sheets."""
    sheets = [sheet(1, 2, True, height=apart), sheet(1, 3, False, True, shift, -apart)]
    sheets = [(points @ turned(seed).T, faces) for points, faces in sheets]
    if single:
        sheets = [(points.astype(np.float32).astype(np.float64), faces) for points, faces in sheets]
    count = np.array([len(faces) for _, faces in sheets])
    sheets, first = (sheets, [0, count[0]]) if upper_first else (sheets[::-1], [count[1], 0])
    room = [box((-2, -2, -2), (2, 2, 2), 2, inward=True)] if around else []
    vertices, faces = joined(*sheets, *room)
    emission = np.zeros((len(faces), 1))
    emission[count.sum() : count.sum() + 3] = 7
    emission[-1] = 20
    patches = Patches(vertices, faces, reflectance=0.5, emission=emission)
    return patches, *(start + np.arange(n) for start, n in zip(first, count, strict=True))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("seed", "single", "upper_first"), [(0, False, True), (1, False, False), (2, True, True)])
def test_plates_of_two_faces_have_two_sides_that_see_no_backs(engine, seed, single, upper_first):
    """The sheets overlap in part."""
    patches, upper, lower = plate(seed, single, upper_first, shift=(0.3, 0.1))
    assert len(patches.coincident.pairs) > 4 and not len(patches.coincident.clashing)
    segments = ENGINES[engine](patches)
    assert segments.dark[np.concatenate([upper, lower])].max() == 0
    pairs = np.concatenate(segments.chunks)
    assert not (np.isin(pairs, upper).any(axis=1) & np.isin(pairs, lower).any(axis=1)).any()


@pytest.mark.parametrize("upper_first", [True, False])
def test_rays_give_light_to_the_side_that_they_meet(upper_first):
    """Against the same plate with a gap between its sheets."""
    patches, upper, lower = plate(3, upper_first=upper_first)
    wanted, *_ = plate(3, upper_first=upper_first, apart=1e-3)
    areas = patches.areas[:, None]

    def both(irradiance):
        return [(areas * irradiance)[side].sum() for side in (upper, lower)]

    exact = ABuffer(wanted).cast(1024)
    light = both(exact.gather(wanted.emission))
    scene = RayScene(patches)
    for shot in (first_shot(scene, OwenSobol(4).block(1 << 18)), shot_at_patches(scene, 1 << 17)):
        assert both(shot.irradiance) == pytest.approx(light, rel=0.03)
        assert shot.lost.sum() < 1e-4 * (areas * patches.emission).sum()
    factors = local_form_factors(scene, 1024)
    np.testing.assert_allclose(factors.row_sums(), 1, atol=1e-3)
    assert both(factors.matrix @ patches.emission) == pytest.approx(light, rel=0.02)
    traced = depth_first(scene, 1 << 16)
    left = [(areas * traced.radiosity)[side].sum() for side in (upper, lower)]
    reflected = etendue.solve_radiosity(wanted, bundles=256).solution.radiosity
    assert left == pytest.approx([(areas * reflected)[side].sum() for side in (upper, lower)], rel=0.03)


@pytest.mark.parametrize("seed", [0, 4])
def test_hierarchical_multipath_gives_light_to_both_sides_of_a_plate(seed):
    patches, upper, lower = plate(seed)
    method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=1 << 14))
    method.prepare(PartProblem(Part(patches)), seed=1)
    found = method.solution(Runner(method, seed=1, budget=Budget(iterations=4)).run().measurement)
    wanted = etendue.solve_radiosity(patches, bundles=256).solution
    assert found.imbalance < 1e-3
    for side in (upper, lower):
        light = [(patches.areas[:, None] * x)[side].sum() for x in (found.irradiance(0), wanted.irradiance)]
        assert light[0] == pytest.approx(light[1], rel=0.05)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("single", [False, True])
def test_plates_without_surroundings_see_the_sky(engine, single):
    patches, *_ = plate(5, single, around=False)
    np.testing.assert_array_equal(ENGINES[engine](patches).sky, 1)


@pytest.mark.parametrize("engine", ENGINES)
def test_plates_outside_of_an_open_room_see_the_sky(engine):
    """The room faces its inside, and one side of the plate faces the back of its ceiling: in solids that touch, too,
    the next face of a line shows its back."""
    vertices, faces = box((-1, -1, -1), (1, 1, 1), 2, inward=True)
    sheets = sheet(1, 2, True, height=1.5), sheet(1, 3, False, height=1.5)
    patches = Patches(*joined(*sheets, (vertices, faces[4:])))
    segments = ENGINES[engine](patches)
    np.testing.assert_array_equal(segments.sky[:4], 1)
    assert (segments.sky[4:13] < 0.9).all() and (segments.sky + segments.dark)[4:13] == pytest.approx(1)


def test_lines_traced_ray_by_ray_find_both_faces_of_solids_that_touch():
    """A box on the floor: its bottom and the floor see each other, and no line misses one of them."""
    patches = scene_patches("cornell-box", max_area=0.2)
    assert patches.coincident.back_to_back.any()
    traced, wanted = ChainedRays.through(RayScene(patches)).cast(1 << 16), ABuffer(patches).cast(128)
    assert traced.counted.sum() == pytest.approx(traced.expected.sum(), rel=2e-3)
    np.testing.assert_allclose(traced.dark, wanted.dark, atol=0.07)
    np.testing.assert_allclose(traced.sky, wanted.sky, atol=0.07)


def test_coincident_faces_are_found_in_part_and_in_single_precision():
    def pairs(*meshes):
        patches = Patches(*joined(*meshes))
        return patches.coincident.pairs.tolist(), patches.coincident.clashing.tolist()

    wall, room = sheet(1, 1, True), box((-2, -2, -2), (2, 2, 2), 3, inward=True)
    assert pairs(room) == ([], [])
    assert pairs(wall, sheet(1, 1, True, height=1e-4)) == ([], [])
    assert pairs(wall, sheet(1, 1, True, shift=(2.0, 0.0))) == ([], [])  # beside each other
    assert pairs(wall, sheet(0.2, 1, False, shift=(0.9, 0.9))) == ([[0, 1]], [])
    assert pairs(wall, sheet(0.2, 1, True, shift=(0.9, 0.9), height=2e-7)) == ([[0, 1]], [[0, 1]])
    patches = Patches(*joined(wall, sheet(0.5, 1, False)), two_sided=[True, False])
    assert patches.coincident.clashing.tolist() == [[0, 1]]  # the back of a sheet on the front of a face


def test_a_door_on_a_wall_is_named(caplog):
    walls, door = box((0, 0, 0), (1, 1, 1), inward=True), sheet(0.2, 1, True, shift=(0.5, 0.5))
    patches = Patches(*joined(walls, door), reflectance=0.5, emission=1.0)
    found = diagnose(patches)
    assert found.overlaps.tolist() == [[4, 6]] and "1 pair of faces on each other (4 and 6)" in str(found)
    for use in (RayScene, ABuffer, ABuffer):
        with caplog.at_level(logging.WARNING, logger="etendue"):
            use(patches)
    assert [record.getMessage() for record in caplog.records] == [
        "faces 4 and 6 lie on each other and face the same way; it is arbitrary which of them receives the light (of "
        "exact form factors, the smaller): cut the lower one, or remove one"
    ]
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="etendue"):
        etendue.solve_radiosity(patches.subdivided(0.3), bundles=8)
    assert "labelled 4 and 6) lie on each other" in caplog.text and "more pair" in caplog.text


def test_an_imbalance_far_above_its_error_is_a_warning(caplog):
    walls, faces = box((0, 0, 0), (1, 1, 1), 2, inward=True)
    emission = np.zeros((24, 1))
    emission[:4] = 1
    right = Patches(walls, faces, reflectance=0.5, emission=emission)
    faces = faces.copy()
    faces[-8:] = faces[-8:, ::-1]
    wrong = Patches(walls, faces, reflectance=0.5, emission=emission)
    for patches, is_right in ((right, True), (wrong, False)):
        for method, count in (("lines", {"bundles": 64}), ("multipath", {"points": 1 << 14}), ("boxes", {"passes": 2})):
            caplog.clear()
            with caplog.at_level(logging.WARNING, logger="etendue"):
                result = etendue.solve_radiosity(patches, method, **count)
            assert result.is_balanced == is_right, method
            assert ("the power that enters the scene" in caplog.text) != is_right
