"""Form factors between groups of patches, and names of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.patches import box, cube

from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    between_groups,
    exact_form_factors,
    form_factors,
    group_index,
    local_form_factors,
    row_names,
)

pytest.importorskip("scipy.sparse")
WALLS = ("west", "east", "south", "north", "floor", "roof")


def named_cube(n, walls=WALLS):
    patches = cube(n)
    patches.shapes, patches.shape_names = np.repeat(np.arange(6), n * n), tuple(walls)
    return patches


def test_walls_of_a_cube():
    """Opposite squares of a cube see 0.199825 of each other [Howell 2010, configuration C-11], four others the rest."""
    groups = between_groups(exact_form_factors(named_cube(3)))
    expected = np.full((6, 6), (1 - 0.1998249) / 4) * (1 - np.eye(6))
    for wall in range(0, 6, 2):
        expected[wall, wall + 1] = expected[wall + 1, wall] = 0.1998249
    np.testing.assert_allclose(groups.matrix.toarray(), expected, atol=2e-6)
    assert groups.name.tolist() == list(WALLS)
    np.testing.assert_allclose(groups.areas, 1)
    np.testing.assert_allclose(groups.row_sums(), 1, atol=1e-7)
    assert groups.face.tolist() == list(range(0, 54, 9))


def test_groups_of_unequal_areas_keep_rows_reciprocity_and_sky():
    vertices, faces = box((0, 0, 0), (1, 2, 3), 2, inward=True)
    patches = Patches(vertices, faces[:-4])
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=2), 2000).cast(128), "pooled").repaired()
    names = np.array(["low", "high"])[(patches.centres[:, 2] > 1).astype(int)]
    groups = between_groups(factors, names)
    assert sorted(groups.name.tolist()) == ["high", "low"] and groups.areas.sum() == pytest.approx(factors.areas.sum())
    np.testing.assert_allclose(groups.row_sums(), 1, rtol=1e-9)
    assert groups.reciprocity_error() < 1e-9
    assert (groups.sky * groups.areas).sum() == pytest.approx((factors.sky * factors.areas).sum())
    high = names == "high"
    by_hand = (factors.areas[:, None] * factors.matrix.toarray())[np.ix_(high, ~high)].sum() / factors.areas[high].sum()
    at = groups.name.tolist()
    assert groups.matrix[at.index("high"), at.index("low")] == pytest.approx(by_hand)


def test_errors_of_groups_are_upper_ones_of_the_right_size():
    """Rays of each patch with independent seeds: deviations from the exact factors, in the errors that are told. Walls
    of four patches with 256 rays each have counts of 1024 rays."""
    patches, ratios = named_cube(2), []
    exact = between_groups(exact_form_factors(patches)).matrix.toarray()
    scene = RayScene(patches)
    for seed in range(8):
        found = between_groups(local_form_factors(scene, 256, points=Independent(4, seed=seed)))
        off = ~np.eye(6, dtype=bool)
        ratios.append(((found.matrix.toarray() - exact) / found.errors.toarray().clip(1e-9))[off])
        np.testing.assert_allclose(found.errors.toarray()[off], np.sqrt(exact * (1 - exact) / 1024)[off], rtol=0.25)
    # 240 ratios: their mean square has a standard error of sqrt(2 / 240) = 0.09 times itself.
    assert 0.6 < np.mean(np.square(ratios)) < 1.2


def test_both_directions_inside_a_group_share_their_lines():
    """All of a closed room as one group sees itself, whatever the lines: an error that is not understated."""
    factors = form_factors(ABuffer(cube(1), OwenSobol(4, seed=2), 2000).cast(64))
    one = between_groups(factors, np.zeros(6, int))
    of_entries = (factors.areas[:, None] * factors.errors.toarray()) / factors.areas.sum()
    assert one.matrix[0, 0] == pytest.approx(1)
    assert one.errors[0, 0] == pytest.approx(np.sqrt((of_entries**2).sum() + (of_entries * of_entries.T).sum()))


def test_names_of_rows():
    names = ("wall", "wall", "lamp", "", "", "wall")
    assert row_names(exact_form_factors(named_cube(1, names))).tolist() == [
        *("wall:0", "wall:1", "lamp", "patch:3", "patch:4", "wall:5")
    ]
    assert row_names(exact_form_factors(cube(1))).tolist() == [f"patch:{k}" for k in range(6)]


def test_groups_by_default():
    by_label = exact_form_factors(Patches(*box((0, 0, 0), (1, 1, 1), 1, inward=True), ids=[7, 7, 3, 3, 5, 5]))
    assert group_index(by_label)[0].tolist() == ["3", "5", "7"]
    named = group_index(exact_form_factors(named_cube(1, ("wall", "", "wall", "lamp", "", "wall"))))
    assert named[0].tolist() == ["wall", "unnamed", "lamp"] and named[1].tolist() == [0, 1, 0, 2, 1, 0]
    with pytest.raises(RadiosityError, match="one name or number for each of 3 patches"):
        group_index(by_label, [1, 2])
    with pytest.raises(RadiosityError, match="neither names nor labels"):
        group_index(replace(by_label, name=None, label=None))
