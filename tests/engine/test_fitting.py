"""Samples of a pass that add up to what was asked for."""

from __future__ import annotations

import pytest

from etendue.core import OptionError
from etendue.engine import fit_samples
from etendue.engine.fitting import fitting_samples


@pytest.mark.parametrize(("spp", "most", "passes", "total"), [
    (1, 16, 1, 1), (7, 16, 1, 7), (16, 16, 1, 16), (20, 16, 2, 20), (64, 16, 4, 64), (17, 16, 2, 18), (37, 4, 10, 40),
    (5, 1, 5, 5), (100, 16, 10, 100),
])  # fmt: skip
def test_samples_share_the_budget(spp, most, passes, total):
    samples = fitting_samples(spp, most)
    assert samples <= most
    assert (-(-spp // samples), -(-spp // samples) * samples) == (passes, total)


def test_no_samples():
    with pytest.raises(OptionError, match="at least one sample"):
        fitting_samples(0, 4)


@pytest.mark.parametrize(("asked", "samples", "expected"), [(0, 8, 4), (0, 6, 3), (0, 3, 3), (1, 6, 1), (5, 6, 5)])
def test_a_method_is_fitted_unless_it_was_told(noise, asked, samples, expected):
    """The fake chooses four samples a pass."""
    method = type(noise)(noise.settings.replace(samples_per_pass=asked))
    fitted = fit_samples(method, samples, None, 3)
    assert fitted.samples_per_iteration == expected
    assert (fitted is method) == (asked != 0 or expected == 4)
    assert fitted is method or fitted.pilot == 3.5


@pytest.mark.parametrize("samples", [6, 8])
def test_a_method_that_tells_its_samples_is_prepared_once(noise, monkeypatch, samples):
    """Preparing may take as long as a pass."""
    kind, prepared, prepare = type(noise), [], type(noise).prepare

    def counted(method, problem, seed):
        prepared.append(method)
        prepare(method, problem, seed)

    monkeypatch.setattr(kind, "prepare", counted)
    monkeypatch.setattr(kind, "samples_for", lambda method, problem: 4, raising=False)
    fitted = fit_samples(kind(noise.settings.replace(samples_per_pass=0)), samples, None, 3)
    assert prepared == [fitted] and fitted.pilot == 3.5


@pytest.mark.parametrize(("samples", "passes"), [(8, 8), (64, 16), (40, 20), (1, 1), (1000, 250)])
def test_a_method_that_learns_has_its_passes(noise, monkeypatch, samples, passes):
    """A fake that chooses four samples a pass and wants sixteen passes."""
    monkeypatch.setattr(type(noise), "least_passes", 16, raising=False)
    fitted = fit_samples(type(noise)(noise.settings.replace(samples_per_pass=0)), samples, None, 3)
    assert -(-samples // fitted.samples_per_iteration) == passes
