"""The trial of a larger merge radius: what it decides for known noise and bias, and runs that resume within it."""

import numpy as np
import pytest
from support.running import prepared

from etendue import scene
from etendue.methods.auto import widening
from etendue.methods.auto.widening import Trial

HEIGHT, WIDTH = 96, 128
MOST = 4.0
#: Costs of a pass without photons, and of merging them.
CHEAP = np.array([10.0, 0.001])


def trial(*, merged=1.0, other=0.05, bias=0.0, blurred=0.2, cost=CHEAP, seed=1):
    """The factor for pictures whose noise has variance ``other`` + ``merged`` / factor^2, and where the largest radius
    has a relative ``bias`` in a share ``blurred`` of the rows."""
    rng = np.random.default_rng(seed)
    level = 0.5 + rng.random((HEIGHT, WIDTH))
    made = Trial.none().begun(0.01)
    assert made.most == MOST
    count = 0
    while made.runs:
        factor = made.next
        assert factor == (MOST if count % 2 else 1.0)
        picture = level + level * np.sqrt(other + merged / factor**2) * rng.standard_normal(level.shape)
        if factor > 1.0:
            picture[: int(blurred * HEIGHT)] *= 1.0 + bias
        made = made.after(picture, cost)
        count += 1
    assert made.next == made.factor and not made.tiles.size
    return made.factor


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_against_bias(seed):
    # After 64 passes the relative variance is (0.05 + 1 / f^2) / 64, and the squared bias in the mean over the picture
    # 0.2 b^2 ((f^2 - 1) / 15)^2: without bias the largest factor is best, and with b = 0.6 it is 2.
    assert trial(seed=seed) >= 2.0 * np.sqrt(2.0)
    assert trial(seed=seed, bias=0.03) >= 2.0 * np.sqrt(2.0)
    assert trial(seed=seed, bias=0.6) == 2.0
    assert trial(seed=seed, bias=3.0) <= np.sqrt(2.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_where_merging_makes_no_noise_the_radius_stays(seed):
    assert trial(seed=seed, merged=0.0) == 1.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_photons_take_time(seed):
    assert trial(seed=seed, cost=np.array([1.0, 10.0])) == 1.0


def test_no_trial_where_discs_are_full():
    full = Trial.none().begun(0.3)
    assert not full.runs and not full.begins and full.factor == 1.0


@pytest.mark.slow
def test_a_run_resumes_within_the_trial(monkeypatch):
    """Equal to a run that was not interrupted, but for the order of atomic additions."""
    monkeypatch.setattr(widening, "_PHOTONS", 100.0)  # a trial in any scene
    problem = scene.load("caustics", size=(32, 24))
    whole = prepared(problem, "auto", seed=3)
    expected = [whole.step(iteration, 3).mean() for iteration in range(9)]
    assert 0 < len(whole.state()["widening"]["tiles"]) < 9
    first = prepared(problem, "auto", seed=3)
    for iteration in range(5):
        first.step(iteration, 3)
    second = prepared(problem, "auto", seed=3)
    second.restore(first.state())
    for iteration in range(5, 9):
        np.testing.assert_allclose(second.step(iteration, 3).mean(), expected[iteration], rtol=1e-5, atol=1e-6)
