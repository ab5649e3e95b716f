"""Form factors with exact row sums, exact reciprocity and without small entries, and what is said of the changes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.patches import box, cube, joined

from etendue.core import OptionError
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    corrected,
    exact_form_factors,
    form_factors,
    local_form_factors,
)

sparse = pytest.importorskip("scipy.sparse")


def open_street():
    """A floor with two blocks on it, under the sky."""
    floor = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], [[0, 1, 2, 3]]
    blocks = [box((x, -1, 0.01), (x + 0.8, 1, 1), 2) for x in (-1.4, 0.6)]
    vertices, faces = joined((np.array(floor[0], float), np.array(floor[1])), *blocks)
    return Patches(vertices, faces)


@pytest.fixture(scope="module", params=["open", "closed"])
def noisy(request):
    """Independent rays of each patch: row sums are exact, reciprocity is not; and of lines, the other way round."""
    patches = open_street() if request.param == "open" else cube(2)
    rays = local_form_factors(RayScene(patches), 1024, points=Independent(4, seed=3))
    lines = form_factors(ABuffer(patches, OwenSobol(4, seed=2), 2000).cast(64), "reciprocal")
    return SimpleNamespace(rays=rays, lines=lines, is_open=request.param == "open")


def deviation(factors):
    return abs(factors.row_sums() + factors.dark - 1).max()


def test_row_sums_reciprocity_and_both(noisy):
    assert deviation(noisy.lines) > 1e-4 and noisy.rays.reciprocity_error() > 1e-3
    assert deviation(corrected(noisy.lines, row_sums=True).factors) < 1e-12
    assert corrected(noisy.rays, reciprocal=True).factors.reciprocity_error() < 1e-12
    for found in (noisy.lines, noisy.rays):
        made = corrected(found, row_sums=True, reciprocal=True)
        assert made.is_sound and deviation(made.factors) < 1e-9 and made.factors.reciprocity_error() < 1e-9
        assert (made.factors.sky.max() > 0.1) == noisy.is_open
        assert made.factors.matrix.data.min() >= 0 and 0 < made.rms < made.largest < 0.1
        # The mean of two independent estimates is half their distance from each: below a standard error in the rms.
        assert made.rms_in_errors is not None and 0.01 < made.rms_in_errors < 1


@pytest.mark.parametrize("both", [False, True])
def test_small_factors_go_back_to_the_rows(noisy, both):
    # By pairs, only those that are small in both directions.
    threshold = float(np.quantile(noisy.rays.matrix.data, 0.5 if both else 0.3))
    options = {"threshold": threshold, "reciprocal": both}
    without, returned = corrected(noisy.rays, **options), corrected(noisy.rays, **options, row_sums=True)
    assert without.dropped == returned.dropped > 0 and without.dropped_share > 0
    assert noisy.rays.matrix.nnz > without.factors.matrix.nnz == returned.factors.matrix.nnz
    if not both:
        assert without.factors.matrix.data.min() >= threshold
        np.testing.assert_allclose(deviation(without.factors), without.dropped_share, rtol=1e-9)
    assert deviation(returned.factors) < 1e-9
    assert not both or returned.factors.reciprocity_error() < 1e-9
    assert str(without).endswith(f"{without.dropped} small ones dropped, at most {without.dropped_share:.2g} of a row")
    assert returned.is_sound  # asked for, and told


def test_a_pair_stays_if_one_direction_is_large():
    """From a wall of area 54 to a face of area 1: F is 1/54 there, and 1 back."""
    outer, inner = box((0, 0, 0), (3, 3, 3), 1, inward=True), box((1, 1, 1), (2, 2, 2), 1)
    patches = Patches(*joined(outer, inner), ids=np.r_[np.zeros(6, int), 1 + np.arange(6)])
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 2000).cast(64), "reciprocal")
    assert corrected(factors, reciprocal=True, threshold=0.1).dropped == 0
    assert corrected(factors, threshold=0.1).dropped == 6


def test_a_repair_beyond_the_errors_is_told(caplog):
    """Rows that sum to 1.09, as of another program, and a factor that is too small by more than its error."""
    rays = local_form_factors(RayScene(cube(2)), 4096, points=Independent(4, seed=3))
    made = corrected(replace(rays, matrix=rays.matrix * 1.09), row_sums=True)
    assert not made.is_sound and made.off == pytest.approx(0.09) and deviation(made.factors) < 1e-12
    assert "is off by 0.09, more than standard errors explain" in caplog.text
    caplog.clear()
    matrix = rays.matrix.toarray()
    largest = matrix == matrix.max()
    matrix[largest] /= 2  # half of about 0.12, which is 0.06 or twelve errors; in the mean with the other one six
    bad = replace(rays, matrix=sparse.csr_array(matrix))
    assert not corrected(bad, reciprocal=True).is_sound and "a form factor changes by" in caplog.text
    caplog.clear()
    # A threshold explains what it takes from its own rows, and nothing elsewhere.
    assert not corrected(bad, reciprocal=True, row_sums=True, threshold=0.02).is_sound
    caplog.clear()
    assert corrected(rays, reciprocal=True).is_sound and not caplog.text


def test_small_faults_are_told_where_errors_are_small(caplog):
    """Rows that are off by a thousandth: noise of a thousand lines, a fault of a hundred million."""
    factors = exact_form_factors(cube(1))
    few, many = (
        replace(factors, matrix=factors.matrix * 1.001, lines=np.full(6, float(lines))) for lines in (1e3, 1e8)
    )
    made = corrected(few, row_sums=True)
    assert made.is_sound and made.off_in_errors == pytest.approx(1e-3 * np.sqrt(1e3), rel=1e-4) and made.left < 1e-12
    assert not caplog.text and not corrected(many, row_sums=True).is_sound and "is off by 0.001" in caplog.text


def test_exact_factors_need_no_correction():
    factors = exact_form_factors(cube(2))
    made = corrected(factors, row_sums=True, reciprocal=True)
    assert made.is_sound and made.largest < 1e-7 and made.largest_in_errors is None
    assert "their standard errors are not known" in str(made)


def test_what_cannot_be_corrected(caplog):
    factors = exact_form_factors(cube(1))
    for threshold in (-0.1, 1.0, float("nan")):
        with pytest.raises(OptionError, match="at least 0 and below 1"):
            corrected(factors, threshold=threshold)
    corrected(factors, row_sums=True, threshold=0.5)
    assert "6 rows are empty and cannot sum to 1, the first is that of patch 0" in caplog.text
    assert corrected(factors, threshold=0.5).left == 1
    # Two walls of areas 1 and 2 that see nothing but each other.
    matrix = sparse.csr_array(np.array([[0.0, 1.0], [0.5, 0.0]]))
    pair = replace(factors, matrix=matrix, errors=0 * matrix, sky=np.zeros(2), dark=np.zeros(2), areas=np.r_[1.0, 2.0])
    with pytest.raises(RadiosityError, match="row sums and reciprocity cannot both be exact"):
        corrected(replace(pair, lines=np.zeros(2)), row_sums=True, reciprocal=True)
