"""Heat exchange: closed forms of two grey surfaces, bands, Gebhart factors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from support.patches import room

from etendue.points import OwenSobol
from etendue.radiosity import (
    STEFAN_BOLTZMANN,
    ABuffer,
    Patches,
    SurfaceError,
    band_shares,
    box,
    form_factors,
    gebhart_factors,
    joined,
    solve,
    thermal,
)
from etendue.surfaces import band_emission

INNER, OUTER = box((0.3, 0.3, 0.3), (0.6, 0.7, 0.8)), box((0, 0, 0), (1, 1, 1), inward=True)


def enclosure():
    """A box in a box, each one patch: all of the inner one's light goes to the outer one."""
    patches = Patches(*joined(INNER, OUTER), ids=np.repeat([0, 1], 6))
    return patches, form_factors(ABuffer(patches, OwenSobol(4, seed=1), 2000).cast(1024), "reciprocal").repaired()


def test_two_grey_surfaces():
    """q = A_1 sigma (T_1^4 - T_2^4) / (1 / e_1 + A_1 / A_2 (1 / e_2 - 1))."""
    patches, factors = enclosure()
    solution = solve(thermal(patches, [400, 300], [0.8, 0.3]), factors, "direct", tolerance=1e-12)
    resistance = 1 / 0.8 + patches.areas[0] / patches.areas[1] * (1 / 0.3 - 1)
    exact = patches.areas[0] * STEFAN_BOLTZMANN * (400**4 - 300**4) / resistance
    np.testing.assert_allclose(solution.net_power[:, 0], [exact, -exact], rtol=1e-6)


def test_bands_of_equal_emissivity_are_grey_and_nothing_flows_at_one_temperature():
    patches, factors = enclosure()
    edges = [0, 5e-6, 10e-6, np.inf]
    grey = solve(thermal(patches, [400, 300], [0.8, 0.3]), factors, "direct").net_power[:, 0]
    banded = solve(thermal(patches, [400, 300], [0.8, 0.3], edges=edges), factors, "direct").net_power
    assert banded.shape == (2, 3)
    np.testing.assert_allclose(banded.sum(axis=1), grey, rtol=1e-6)
    still = thermal(patches, 350, lambda t: [[0.1, 0.9, 0.5]] * len(t), edges=edges)
    np.testing.assert_allclose(solve(still, factors, "direct").net_power, 0, atol=1e-4)


def test_shares_of_bands():
    """Against the integral of Planck's law, and Wien's law of displacement: a quarter lies below the maximum."""

    def planck(x):
        return 15 / np.pi**4 * x**3 / np.expm1(x)

    for micrometres in (1.0, 9.66, 20.0, 48.0, 300.0, 1e4):
        x = 1.438776877e-2 / (micrometres * 1e-6 * 300)
        exact = quad(planck, x, 500)[0] if x < 500 else 0
        assert band_shares([300], [0, micrometres * 1e-6])[0, 0] == pytest.approx(exact, abs=1e-9)
    np.testing.assert_allclose(band_shares([0, 300, 6000], [0, 1e-6, 1e-5, np.inf]).sum(axis=1), [0, 1, 1])
    assert band_shares([300], [0, 2.897771955e-3 / 300])[0, 0] == pytest.approx(0.2500, abs=1e-3)


def test_emission_of_bands_and_its_derivative():
    """4 sigma T^3 of all bands together; of each, the difference quotient."""
    t, edges = np.array([30.0, 300, 1000, 6000]), [0, 1e-6, 3e-6, 1e-5, 5e-5, np.inf]
    emission, slope = band_emission(t, edges)
    np.testing.assert_allclose(emission, band_shares(t, edges) * STEFAN_BOLTZMANN * t[:, None] ** 4, rtol=1e-12)
    np.testing.assert_allclose(slope.sum(axis=1), 4 * STEFAN_BOLTZMANN * t**3, rtol=1e-12)
    above, below = band_emission(t * (1 + 1e-4), edges)[0], band_emission(t * (1 - 1e-4), edges)[0]
    quotient = (above - below) / (2e-4 * t[:, None])
    np.testing.assert_allclose(slope, quotient, rtol=1e-4, atol=1e-10 * slope.max())
    np.testing.assert_array_equal(band_emission(np.zeros(1), edges), 0)


def test_gebhart_factors_give_the_net_heat():
    random = np.random.default_rng(2)
    patches = room(1)
    hot = thermal(patches, random.uniform(280, 400, len(patches)), random.uniform(0.2, 1, len(patches)))
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(256), "reciprocal").repaired()
    g = gebhart_factors(hot, factors)
    np.testing.assert_allclose(g.sum(axis=1), 1, rtol=1e-9)
    weighted = (1 - hot.reflectance[:, 0])[:, None] * patches.areas[:, None] * g
    np.testing.assert_allclose(weighted, weighted.T, atol=1e-9 * weighted.max())
    sent = patches.areas * hot.emission[:, 0]
    net = solve(hot, factors, "direct", tolerance=1e-12).net_power[:, 0]
    np.testing.assert_allclose(sent - g.T @ sent, net, atol=1e-9 * sent.max())


def test_a_warm_sky():
    patches = Patches(*INNER)
    warm = thermal(patches, 300, 0.7, surroundings=300)
    segments = ABuffer(patches, lines=200).cast(32)
    np.testing.assert_allclose(solve(warm, segments).net_power, 0, atol=1e-9 * warm.emission.max())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"temperatures": -3}, "at least 0 kelvin"),
        ({"temperatures": [300.0, 400.0]}, "one for each of 6 patches"),
        ({"emissivity": -0.1}, "in [0, 1]"),
        ({"emissivity": 1.2}, "in [0, 1]"),
        ({"emissivity": [0.5, 0.5]}, "2 rows for 6 patches"),
        ({"emissivity": [[0.5, 0.6]]}, "the edges of the bands"),
        ({"emissivity": [[0.5, 0.6]], "edges": [0, 1, 2, 3]}, "2 columns for 3 bands"),
        ({"edges": [1e-6, 1e-7]}, "ascend"),
    ],
)
def test_what_cannot_be(options, words):
    with pytest.raises(SurfaceError) as error:
        thermal(Patches(*OUTER), **{"temperatures": 300, "emissivity": 0.5, **options})
    assert words in str(error.value)
