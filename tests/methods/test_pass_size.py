"""Camera paths of a pass whose number is not given: so many that its fixed cost is small, few where a pass learns."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import pytest
from support import scenes
from support.running import prepared

from etendue import methods
from etendue.engine.fitting import fit_samples

#: Samples of a pass of 256x256 pixels, on two cores and on eight.
SAMPLES = {
    "path": (16, 64),
    "bpt": (8, 32),
    "vcm": (4, 16),
    "bpm": (4, 16),
    "sppm": (4, 16),
    "auto": (4, 16),
    "guided": (16, 64),
}


@pytest.fixture(autouse=True)
def on_a_cpu():
    if dr.backend_v(mi.Float) != dr.JitBackend.LLVM:
        pytest.skip("numbers of a CPU")


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_of_a_pass(name, monkeypatch):
    problem = scenes.field(0.5, 1.0, size=(256, 256))
    for threads, samples in zip((2, 8), SAMPLES[name], strict=True):
        monkeypatch.setattr(dr, "thread_count", lambda n=threads: n)
        assert prepared(problem, name).samples_per_iteration == samples


def test_small_pictures_have_at_most_64_samples_a_pass_and_large_ones_one(monkeypatch):
    monkeypatch.setattr(dr, "thread_count", lambda: 2)
    assert prepared(scenes.field(0.5, 1.0, size=(8, 8)), "path").samples_per_iteration == 64
    assert prepared(scenes.field(0.5, 1.0, size=(1024, 1024)), "vcm").samples_per_iteration == 1


@pytest.mark.parametrize(("name", "samples", "passes"), [("path", 64, 8), ("auto", 64, 8), ("vcm", 4, 4)])
def test_few_samples_are_several_passes_on_a_gpu(name, samples, passes, monkeypatch):
    """It would render them all in one, and know no error."""
    monkeypatch.setattr("etendue.methods.base.uses_cuda", lambda: True)
    problem, kind = scenes.field(0.5, 1.0, size=(512, 512)), methods.get(name)
    fitted = fit_samples(kind(kind.Settings()), samples, problem, 0)
    assert -(-samples // fitted.samples_per_iteration) == passes
