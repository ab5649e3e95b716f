"""The memory of form factors: that of the pairs that see each other, estimated before lines are cast."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, cube, joined

import etendue
import etendue.radiosity.casting
from etendue.radiosity import (
    ABuffer,
    LineCasting,
    Patches,
    PatchProblem,
    RadiosityError,
    entry_bytes,
    form_factors,
)
from etendue.radiosity.factors import formfactors
from etendue.radiosity.factors.counting import PairCounts
from etendue.radiosity.factors.formfactors import ESTIMATORS


@pytest.fixture(autouse=True)
def any_variant(variant):
    pass


def field(n=24):
    """A flat field of n x n with a small house on it: nearly all lines end in the sky."""
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    corner = (i * (n + 1) + j).ravel()
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    ground = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    faces = np.stack([corner, corner + n + 1, corner + n + 2, corner + 1], axis=1)
    return Patches(*joined((ground, faces), box((0.4, 0.4, 0.001), (0.5, 0.5, 0.1), 2)))


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_stream_gives_the_form_factors_of_its_segments(estimator):
    patches = cube(4)
    engine = ABuffer(patches)
    stored = form_factors(engine.cast(40), estimator)
    streamed = form_factors(engine.stream(40), estimator, patches=patches, expected=engine.expected(40))
    for name in ("matrix", "errors"):
        assert abs(getattr(stored, name) - getattr(streamed, name)).max() == 0
    np.testing.assert_array_equal(streamed.sky, stored.sky)
    np.testing.assert_array_equal(streamed.lines, stored.lines)
    np.testing.assert_array_equal(streamed.face, stored.face)


def test_what_a_stream_needs():
    engine = ABuffer(cube(2))
    with pytest.raises(RadiosityError, match="give patches="):
        form_factors(engine.stream(2))
    with pytest.raises(RadiosityError, match="give expected="):
        form_factors(engine.stream(2), "reciprocal", patches=engine.patches)


def test_pairs_are_counted_in_blocks(monkeypatch):
    segments = ABuffer(cube(4)).cast(40)
    whole = PairCounts(96, segments.chunks)
    monkeypatch.setattr("etendue.radiosity.factors.counting._BLOCK", 1000)
    parts = PairCounts(96, segments.chunks)
    assert len(whole) == len(parts) and abs(whole.upper() - parts.upper()).max() == 0
    np.testing.assert_array_equal(parts.ends[:96, 0], segments.counted)


def test_a_field_needs_memory_for_its_pairs_only(monkeypatch):
    patches = field()
    segments = ABuffer(patches).cast(64)
    factors = form_factors(segments)
    need = entry_bytes("F1") * factors.matrix.nnz
    assert need < 0.2 * 64 * min(2 * len(segments), len(patches) ** 2)
    monkeypatch.setattr(formfactors, "free_memory", lambda: int(1.01 * need))
    assert form_factors(segments).matrix.nnz == factors.matrix.nnz
    monkeypatch.setattr(formfactors, "free_memory", lambda: int(0.99 * need))
    with pytest.raises(RadiosityError, match=f"{factors.matrix.nnz} form factors of {len(patches)} patches need"):
        form_factors(segments)


def prepared(patches):
    casting = LineCasting()
    casting.prepare(PatchProblem(patches), 0)
    return casting


@pytest.mark.parametrize("scene", ["field", "room"])
def test_the_estimate_is_a_close_bound(scene, monkeypatch):
    """The number of bundles that fit: never more than their true need allows, and in a field nearly as many."""
    monkeypatch.setattr("etendue.radiosity.factors.counting._BLOCK", 1 << 10)
    patches = field() if scene == "field" else Patches(*box((0, 0, 0), (1, 1, 1), 20, inward=True))
    casting, count = prepared(patches), 128
    segments = casting.engine.cast(count)
    pairs = form_factors(segments).matrix.nnz / 2
    need = 8 * len(segments) + 4 * pairs + entry_bytes("F1") * 2 * pairs
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: int(need))
    most = casting.memory(entry_bytes("F1"))
    assert 0.4 * count < most <= 1.02 * count


def test_refused_before_lines_are_cast_or_not_at_all(monkeypatch):
    patches = field()
    whole = etendue.compute_form_factors(patches, bundles=64).factors
    monkeypatch.setattr("etendue.radiosity.factors.counting._BLOCK", 1 << 10)
    for module in (etendue.radiosity.casting, formfactors):
        monkeypatch.setattr(module, "free_memory", lambda: 40_000_000)
    again = etendue.compute_form_factors(patches, bundles=64).factors
    assert abs(again.matrix - whole.matrix).max() == 0
    monkeypatch.setattr(LineCasting, "step", lambda *arguments: pytest.fail("lines were cast"))
    with pytest.raises(RadiosityError, match="do not fit into memory"):
        etendue.compute_form_factors(patches, bundles=4096)
