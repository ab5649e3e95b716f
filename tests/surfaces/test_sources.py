"""Rays that are made on the device against the same in NumPy."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.patches import BOXES, box, joined

from etendue.core import set_threads
from etendue.points import Halton, OwenSobol
from etendue.radiosity import LocalRays, Patches, RayScene
from etendue.surfaces import RaySource, Sides, around, columns, cosine_lanes, cosine_law, even_lanes, pairs_of


def furnished():
    """A room with a box; some faces are one patch, some are sheets, one of each is missing."""
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 3, inward=True), box(*BOXES[0]))
    faces = faces[1:-1]
    ids = np.arange(len(faces)) // 2
    return Patches(vertices, faces, ids=ids, two_sided=np.arange(ids[-1] + 1) % 5 == 0, reflectance=0.5)


@pytest.fixture
def scene(variant):
    return RayScene(furnished())


def test_places_are_those_of_numpy(scene):
    sides = Sides.of(scene.patches)
    source = RaySource(scene, sides)
    u = OwenSobol(4, seed=1).block(5000)
    patch = np.random.default_rng(1).integers(0, len(scene.patches), 5000)

    side, within = sides.pick_of(patch, u[:, 0])
    lanes = columns(u)
    places = source.of(mi.UInt32(patch.astype(np.uint32)), lanes[0], lanes[1])
    np.testing.assert_array_equal(places.side, side)
    np.testing.assert_allclose(np.array(places.point).T, sides.points(side, np.c_[within, u[:, 1]]), atol=3e-7)
    np.testing.assert_allclose(np.array(places.normal).T, sides.normals[side], atol=1e-7)
    np.testing.assert_array_equal(source.patch_of(places.side), patch)
    np.testing.assert_array_equal(source.face_of(places.side), sides.face[side])
    ways = np.array(places.directions(cosine_lanes(lanes[2], lanes[3]))).T
    cosines = (ways * sides.normals[side]).sum(axis=1)
    np.testing.assert_allclose(cosines, cosine_law(u[:, 2:])[:, 2], atol=1e-6)
    assert (((np.array(places.origin).T - np.array(places.point).T) * sides.normals[side]).sum(axis=1) > 5e-7).all()

    side = np.searchsorted(sides.edges, u[:, 0] * sides.edges[-1], side="right") - 1
    np.testing.assert_array_equal(source.any(lanes[0], lanes[1]).side, side)


def test_only_what_has_power_emits(scene):
    power = np.where(np.arange(len(scene.patches)) % 3 == 0, np.arange(len(scene.patches)), 0.0)
    sides = Sides.of(scene.patches).emitting(power)
    assert sides.edges[-1] == pytest.approx(power.sum())
    u = columns(OwenSobol(4, seed=1).block(1 << 14))
    source = RaySource(scene, sides)
    met = np.bincount(source.patch_of(source.any(u[0], u[1]).side), minlength=len(power)) / (1 << 14)
    np.testing.assert_allclose(met, power / power.sum(), atol=2 / (1 << 14))


def test_one_side_alone(scene):
    sides = Sides.of(scene.patches)
    one = Sides(sides.corners[:1], sides.normals[:1], sides.patch[:1], sides.face[:1], sides.edges[:2])
    u = columns(OwenSobol(4).block(64))
    places = RaySource(scene, one).any(u[0], u[1])
    assert not np.array(places.side).any()
    assert len(np.unique(np.array(places.point).T, axis=0)) == 64


def test_angles_are_even(variant):
    u = OwenSobol(2, seed=1).block(1 << 12)
    x, y, z = np.array(even_lanes(*columns(u)))
    np.testing.assert_allclose(np.arccos(z), np.pi / 2 * u[:, 0], atol=1e-3)
    aside = z < 0.99
    angle = np.mod(np.arctan2(y, x), 2 * np.pi)
    np.testing.assert_allclose(angle[aside], 2 * np.pi * u[aside, 1], atol=1e-4)


def test_what_rays_meet_is_what_numpy_finds(scene):
    """Patches, the sky and backs of faces."""
    sides = Sides.of(scene.patches)
    u = OwenSobol(4, seed=2).block(4000)
    side = np.arange(4000) % len(sides.patch)
    origins = sides.points(side, u[:, :2]) + 1e-6 * sides.normals[side]
    directions = around(sides.normals[side], cosine_law(u[:, 2:]))
    hits = scene.first_hits(origins, directions)
    expected = np.full(4000, len(scene.patches))
    expected[hits.ray] = scene.sides(hits.face, directions[hits.ray])[0]
    assert set(expected) >= {len(scene.patches), len(scene.patches) + 1}
    np.testing.assert_array_equal(scene.first_patches(origins, directions), expected)


@pytest.mark.parametrize("points", [OwenSobol(4, seed=4), Halton(4)])
def test_rays_do_not_depend_on_the_number_of_threads_or_on_pieces(points, scene):
    """Of points that the device makes, and of others."""
    engine, before, found = LocalRays(scene, points), dr.thread_count(), []
    try:
        for threads, size in ((1, 3000), (2, 500)):
            set_threads(threads)
            found.append(np.concatenate(list(engine.stream(3000, 7, size))))
    finally:
        set_threads(before)
    assert len(found[0]) > 3000
    np.testing.assert_array_equal(*(np.sort(np.ascontiguousarray(pairs).view(np.uint64).ravel()) for pairs in found))


def test_pairs(variant):
    one, other = mi.UInt32([1, 2, 3]), mi.UInt32([4, 5, 0xFFFFFFFF])
    assert pairs_of(one, other).tolist() == [[1, 4], [2, 5], [3, 0xFFFFFFFF]]
