"""How many lines a bundle has in a run to an error: enough for it, with less variance, and as the user says."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import cube, room

import etendue
from etendue.engine import Checkpoint
from etendue.radiosity import ABuffer, SpiralPoints, exact_form_factors, split_for


@pytest.mark.parametrize("error", [0.05, 0.01, 0.003])
@pytest.mark.parametrize("patches", [cube(8), room(24)], ids=["few", "many"])
def test_a_split_has_the_lines_of_its_error(patches, error):
    split = split_for(patches, error)
    engine = ABuffer(patches, lines=split.lines)
    one_less, these = (engine.expected(count) for count in (split.bundles - 1, split.bundles))
    assert np.mean(1 / np.sqrt(these)) <= error
    assert split.bundles == 128 or error < np.mean(1 / np.sqrt(one_less))
    assert engine.expected(1).mean() == pytest.approx(split.each)


def test_all_bundles_of_a_coarse_run_are_of_one_spiral():
    """Spirals of the few directions that the error needs would have ten times the variance."""
    patches = room(8)
    found = etendue.compute_form_factors(patches, error=0.05)
    assert found.bundles == split_for(patches, 0.05).bundles
    values, expected = np.exp(patches.centres[:, 0]), exact_form_factors(patches).matrix
    off = (found.factors.matrix - expected) @ values
    assert np.sqrt(np.mean(off**2)) < 0.004 * values.mean()


def test_bundles_have_more_lines_for_a_smaller_error_of_many_patches():
    patches = room(24)
    splits = [split_for(patches, error) for error in (0.05, 0.01, 0.003)]
    assert splits[0].each == pytest.approx(ABuffer(patches).expected(1).mean())
    assert splits[1].each / splits[2].each == pytest.approx((0.003 / 0.01) ** 0.8)


@pytest.mark.slow
def test_so_many_lines_have_less_variance_than_as_many_in_other_bundles():
    patches = room(24)
    split, centres = split_for(patches, 0.01), patches.centres
    values = np.exp(2 * centres[:, 0]) * (1 + 0.5 * np.sin(7 * centres[:, 1] + 5 * centres[:, 2]))

    def variance(factor):
        count = round(split.bundles / factor)
        one, other = (
            ABuffer(patches, SpiralPoints(seed, count), split.lines * factor).cast(count).gather(values)
            for seed in range(2)
        )
        return np.mean((one - other) ** 2) / 2

    chosen = variance(1.0)
    assert chosen < 0.85 * variance(4 / split.each) and chosen < 0.85 * variance(6.0)


def test_a_run_to_an_error_takes_it_and_says_so(tmp_path, caplog):
    patches, path = room(24), tmp_path / "a.checkpoint"
    split = split_for(patches, 0.03)
    with caplog.at_level("INFO"):
        found = etendue.compute_form_factors(patches, error=0.03, checkpoint=path)
    assert split.bundles <= found.bundles < split.bundles + 8 and found.stopped_by == "error"
    assert f"in {split.bundles} bundles of" in caplog.text
    saved = Checkpoint.read(path).settings
    assert f'"directions": {split.bundles}' in saved and '"replicates": 1' in saved
    again = etendue.compute_form_factors(patches, error=0.03)
    assert (found.factors.matrix != again.factors.matrix).nnz == 0
    own = etendue.compute_form_factors(patches, error=0.03, lines=20000)
    assert own.segments.expected[0] == pytest.approx(ABuffer(patches, lines=20000).expected(own.bundles)[0])
