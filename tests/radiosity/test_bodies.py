"""Exact form factors of surfaces of revolution: closed forms, balances, and lines through the faces of rings."""

from __future__ import annotations

import numpy as np
import pytest
from support.tables import thinned

from etendue.radiosity import PatchError, Patches, RadiosityError, between_groups, exact_form_factors, form_factors
from etendue.radiosity.lines.abuffer import ABuffer


def cylinder(radius, length, inward=True, z=0.0):
    return (radius, z, radius, z + length) if inward else (radius, z + length, radius, z)


def sphere(radius, count, inward=True):
    angle = np.linspace(-np.pi / 2, np.pi / 2, count + 1)
    ends = radius * np.stack([np.maximum(np.cos(angle), 0), np.sin(angle)], axis=1)
    ends[[0, -1], 0] = 0
    return np.hstack([ends[:-1], ends[1:]] if inward else [ends[1:], ends[:-1]])


def factors_of(profile, tolerance=1e-6, **properties):
    return exact_form_factors(Patches.revolved(profile, **properties), tolerance)


FURNACE = [(0, 0, 0.5, 0), (0.5, 0, 0.5, 0.4), (0.5, 0.4, 0.5, 1), (0.5, 1, 0.5, 1.2), (0.5, 1.2, 0.1, 1.2)]
OUTSIDE = [(0.2, 0.2, 0, 0.2), (0.25, 0.7, 0.2, 0.2), (0.22, 0.7, 0.25, 0.7)]
CRUCIBLE = [*FURNACE, *OUTSIDE, (0.17, 0.25, 0.22, 0.7), (0, 0.25, 0.17, 0.25)]


@pytest.mark.parametrize(("a", "b", "h"), thinned([(1, 2, 1.5), (1, 1, 0.1), (0.1, 3, 4)], [(1, 2, 1.5), (0.1, 3, 4)]))
def test_coaxial_discs(a, b, h):
    x = 1 + (h**2 + b**2) / a**2
    found = factors_of([(0, 0, a, 0), (b, h, 0, h)])
    assert found.matrix[0, 1] == pytest.approx((x - np.sqrt(x**2 - 4 * (b / a) ** 2)) / 2, abs=2e-6)
    np.testing.assert_allclose(found.areas, np.pi * np.array([a, b]) ** 2)
    np.testing.assert_allclose(found.row_sums(), 1, atol=5e-6)


def test_the_inside_of_a_cylinder_and_of_a_cone():
    h = 3.0
    found = factors_of([(0, 0, 1, 0), cylinder(1, h), (1, h, 0, h)])
    end = 1 + (h**2 - h * np.sqrt(4 + h**2)) / 2
    expected = [[0, 1 - end, end], [(1 - end) / 2 / h, 1 - (1 - end) / h, (1 - end) / 2 / h], [end, 1 - end, 0]]
    np.testing.assert_allclose(found.matrix.toarray(), expected, atol=3e-6)
    assert not found.sky.any() and not found.dark.any()
    cone = factors_of([(0, 0, 1, 0), (1, 0, 0, 2)]).matrix.toarray()
    np.testing.assert_allclose(cone, [[0, 1], [1 / np.sqrt(5), 1 - 1 / np.sqrt(5)]], atol=3e-6)


def test_concentric_cylinders_of_finite_length():
    # Howell's catalogue, C-91 and C-92: outer to inner, and outer to itself.
    x, y = 2.0, 3.0
    a, b, c = x**2 + y**2 - 1, y**2 - x**2 + 1, np.sqrt(4 * x**2 + y**2)
    inner = np.sqrt((a + 2) ** 2 - 4 * x**2) * np.arccos(b / (x * a)) + b * np.arcsin(1 / x) - np.pi * a / 2
    to_inner = (1 - (np.arccos(b / a) - inner / (2 * y)) / np.pi) / x
    sine = (4 * (x**2 - 1) + (y / x) ** 2 * (x**2 - 2)) / (y**2 + 4 * (x**2 - 1))
    bracket = c / y * np.arcsin(sine) - np.arcsin((x**2 - 2) / x**2) + np.pi / 2 * (c / y - 1)
    to_itself = 1 - 1 / x + 2 / (np.pi * x) * np.arctan(2 * np.sqrt(x**2 - 1) / y) - y / (2 * np.pi * x) * bracket
    found = factors_of([cylinder(x, y), cylinder(1, y, inward=False)], 1e-5)
    np.testing.assert_allclose(found.matrix.toarray(), [[to_itself, to_inner], [x * to_inner, 0]], atol=1e-6)
    np.testing.assert_allclose(found.row_sums() + found.dark, 1, atol=5e-6)


@pytest.mark.slow
def test_concentric_spheres():
    patches = Patches.revolved(np.concatenate([sphere(2, 16), sphere(1, 12, inward=False)]))
    found = exact_form_factors(patches)
    outer, areas = np.arange(16), found.areas
    inner = np.asarray(found.matrix[:16, 16:].sum(axis=1)).ravel()
    assert areas[outer] @ inner == pytest.approx(areas[16:].sum(), rel=1e-4)
    np.testing.assert_allclose(inner, 0.25, atol=0.01)  # frustums in place of spheres
    np.testing.assert_allclose(found.row_sums(), 1, atol=1e-4)
    assert abs(found.matrix[16:, 16:]).max() == 0
    # On a sphere every point sees equal areas equally.
    alone = factors_of(sphere(1, 64), 1e-4)
    shares = np.tile(alone.areas[:24] / alone.areas.sum(), (40, 1))
    np.testing.assert_allclose(alone.matrix.toarray()[24:, :24], shares, rtol=3e-3)


def test_a_plate_with_a_hole_hides_all_but_the_hole():
    # What is seen through the hole of a plate that ends at the wall is what its disc would see.
    box = [(0, 0, 1, 0), cylinder(1, 1), cylinder(1, 1, z=1), (1, 2, 0, 2)]
    found = factors_of([*box, (0.3, 1, 1, 1)], 1e-5, two_sided=[False] * 4 + [True])
    disc = factors_of([*box[:2], (0.3, 1, 0, 1)], 1e-5)
    assert found.matrix[0, [2, 3]].sum() == pytest.approx(disc.matrix[0, 2], abs=2e-5)
    np.testing.assert_allclose(found.row_sums(), 1, atol=2e-5)
    assert not found.sky.any()
    closed = factors_of([*box, (0, 1, 1, 1)], 1e-5, two_sided=[False] * 4 + [True])
    assert closed.matrix[0, [2, 3]].sum() == 0


@pytest.mark.parametrize("seed", thinned(range(3), [0]))
def test_rows_of_rings_that_cross_each_other_sum_to_1(seed):
    generator = np.random.default_rng(seed)
    begin = generator.uniform(0, 1, (8, 2))
    profile = np.hstack([begin, np.abs(begin + generator.normal(scale=0.5, size=(8, 2)))])
    found = factors_of(profile, 1e-4, two_sided=generator.random(8) < 0.5)
    np.testing.assert_allclose(found.row_sums() + found.dark, 1, atol=2e-4)
    assert found.reciprocity_error() < 1e-12


@pytest.mark.slow
def test_lines_through_the_faces_of_a_furnace_agree():
    patches = Patches.revolved(CRUCIBLE)
    found, exact = form_factors(ABuffer(patches).cast(2048), "pooled"), exact_form_factors(patches)
    assert exact.areas @ exact.sky == pytest.approx(patches.areas @ found.sky, rel=0.03)
    off = (found.matrix - exact.matrix).toarray()
    # Faces are those of polygons, of which a ring hides some thousandths more or less.
    allowed = 5 * found.errors.toarray() + 4e-3
    assert (np.abs(off) < allowed).all()
    assert (found.matrix.toarray() > 0.05).sum() > 30


@pytest.mark.slow
def test_errors_and_parts_of_rings():
    fine = factors_of(CRUCIBLE, 1e-6).matrix.toarray()
    for tolerance in (1e-3, 1e-5):
        found = factors_of(CRUCIBLE, tolerance)
        off = found.matrix.toarray() - fine
        assert np.sqrt((off.sum(axis=1) ** 2).mean()) < tolerance
        assert np.abs(off).max() < tolerance
        assert 1e-9 < np.sqrt((off**2).sum()) < 5 * np.sqrt((found.errors.toarray() ** 2).sum())
    patches = Patches.revolved(CRUCIBLE)
    parts = patches.subdivided(0.2)
    assert parts.areas.max() <= 0.2 and len(parts) > 30
    joined = between_groups(exact_form_factors(parts), parts.face)
    np.testing.assert_allclose(joined.matrix.toarray(), fine, atol=2e-4)
    grouped = patches.subdivided(0.2, grouped=True)
    np.testing.assert_allclose(exact_form_factors(grouped).matrix.toarray(), fine, atol=2e-4)
    np.testing.assert_allclose(grouped.areas, patches.areas)
    np.testing.assert_allclose(exact_form_factors(Patches.of_arrays(patches.arrays())).areas, patches.areas)


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ([(-0.1, 0, 1, 0)], "radius below zero"),
        ([(0, 0, 1, 0), (0, 0, 0, 1)], "ring 1 .* on the axis and has no area"),
        ([(1, 1, 1, 1), (1, 0, 1, 1)], "has no length"),
        ([(0, 0, 1, 0), (2, 0, 0.5, 0)], "ring 0 .* and ring 1 lie on each other"),
        ([(1, np.nan, 1, 1)], "not finite"),
        ([(1, 0, 1)], "a profile is"),
    ],
)
def test_profiles_that_are_refused(profile, message):
    with pytest.raises(PatchError, match=message):
        Patches.revolved(profile)


def test_a_tolerance_that_is_none_is_refused():
    with pytest.raises(RadiosityError, match="tolerance"):
        factors_of([(0, 0, 1, 0)], 2.0)
