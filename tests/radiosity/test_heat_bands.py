"""Emissivities in bands of wavelengths, and patches of one temperature, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from support.patches import factors_of, squares

from etendue.radiosity import (
    STEFAN_BOLTZMANN as SIGMA,
    Conditions,
    Patches,
    RadiosityError,
    band_shares,
    heat,
    heat_balance,
)

PLATES = [[0, 1], [1, 0]]
#: Two bands, below and above 4 micrometres.
EDGES = np.array([0, 4e-6, np.inf])
#: From textbooks' table of blackbody functions, right to 5e-5: the share of the emission below a wavelength times the
#: temperature, micrometre kelvin.
TABLE = {1000: 0.000321, 2000: 0.066728, 2898: 0.250108, 4000: 0.480877, 6000: 0.737818, 10000: 0.914199}


def emitted(t, edge=4e-6):
    """Emission of a black body in the two bands, by the integral of Planck's law."""
    x = min(1.438776877e-2 / (edge * t), 500)
    below = quad(lambda x: 15 / np.pi**4 * x**3 / np.expm1(x), x, 500, epsabs=1e-13)[0]
    return SIGMA * t**4 * np.array([below, 1 - below])


def sphere(*areas):
    """Patches that are all of the inside of a sphere: each sees A_j / A of patch j, and all have one irradiance."""
    patches = squares(*areas)
    return patches, factors_of(patches, np.broadcast_to(patches.areas / patches.areas.sum(), (len(areas),) * 2))


def test_shares_of_bands_against_the_table_of_blackbody_functions():
    for product, share in TABLE.items():
        assert band_shares([1000], [0, product * 1e-9])[0, 0] == pytest.approx(share, abs=5e-5)


def test_two_plates_by_hand():
    """q = sum_b (p_b(T_1) - p_b(T_2)) / (1 / e_1b + 1 / e_2b - 1), whichever of q, T_1 and T_2 is to be found; with the
    shares of the table at 1000 K and 500 K."""
    patches = squares(1, 1)
    factors = factors_of(patches, PLATES)
    e = np.array([[0.9, 0.3], [0.5, 0.8]])
    short = TABLE[4000] * 1000**4 - TABLE[2000] * 500**4
    long = (1 - TABLE[4000]) * 1000**4 - (1 - TABLE[2000]) * 500**4
    q = SIGMA * (short / (1 / 0.9 + 1 / 0.5 - 1) + long / (1 / 0.3 + 1 / 0.8 - 1))
    both = heat_balance(patches, factors, Conditions(emissivity=e, temperature=[1000, 500], edges=EDGES))
    np.testing.assert_allclose(both.heat[:, 0], [q, -q], rtol=1e-4)
    exact = (emitted(1000) - emitted(500)) @ (1 / (1 / e[0] + 1 / e[1] - 1))
    np.testing.assert_allclose(both.heat[:, 0], [exact, -exact], rtol=1e-9)
    for t, flux in (([np.nan, 500], [exact, 0]), ([1000, np.nan], [0, -exact])):
        made = heat_balance(patches, factors, Conditions(emissivity=e, temperature=t, flux=flux, edges=EDGES))
        np.testing.assert_allclose(made.temperature[:, 0], [1000, 500], rtol=1e-8)
        assert made.imbalance[0] < 1e-9 and made.residual < 1e-9


@pytest.mark.parametrize("e", [[[0.8], [0.05], [0.2], [0.6]], [[0.9, 0.3], [0.1, 0.4], [0.5, 0.02], [0.7, 0.8]]])
def test_a_radiation_shield(e):
    """Both sides of a sheet between two plates, of one temperature: as much heat goes through both gaps. Of grey plates
    q = sigma (T_1^4 - T_2^4) / sum (1 / e + 1 / e' - 1)."""
    e = np.array(e)
    patches = squares(1, 1, 1, 1)
    factors = factors_of(patches, np.kron(np.eye(2), PLATES))
    gaps = 1 / (1 / e[0] + 1 / e[1] - 1), 1 / (1 / e[2] + 1 / e[3] - 1)
    if e.shape[1] == 1:
        edges = None
        q = SIGMA * (1000**4 - 400**4) / (1 / gaps[0] + 1 / gaps[1]).item()
        shield = (1000**4 - q / gaps[0].item() / SIGMA) ** 0.25
    else:
        edges = EDGES
        shield = brentq(
            lambda t: (emitted(1000) - emitted(t)) @ gaps[0] - (emitted(t) - emitted(400)) @ gaps[1], 400, 1000
        )
        q = (emitted(1000) - emitted(shield)) @ gaps[0]
    t = [1000, np.nan, np.nan, 400]
    conditions = Conditions(emissivity=e, temperature=t, edges=edges, nodes=[-1, 3, 3, -1])
    made = heat_balance(patches, factors, conditions)
    np.testing.assert_allclose(made.temperature[:, 0], [1000, shield, shield, 400], rtol=1e-8)
    np.testing.assert_allclose(made.heat[:, 0], [q, -q, q, -q], rtol=1e-7)
    assert made.imbalance[0] < 1e-10


def test_a_conductor_of_two_patches_that_is_heated_and_cooled_by_air():
    """In a sphere whose first patch has a temperature: A_0 e_0 (G - sigma T_0^4) = Q = sum A e (sigma T^4 - G) of the
    heat Q of the conductor, in three cases."""
    areas, e = np.array([2.0, 0.7, 1.3]), np.array([0.8, 0.9, 0.2])
    patches, factors = sphere(*areas)
    q, h, air = np.array([500.0, 0.0, -80.0]), np.array([0.0, 6.0, 6.0]), np.array([0.0, 260.0, 320.0])
    of = np.array([[0.0], [1.0], [0.0]])  # heated at its first patch, cooled at its second
    conditions = Conditions(
        emissivity=e,
        temperature=np.array([350, np.nan, np.nan]),
        flux=of * q,
        conductance=of[::-1] * 0 + np.array([[0.0], [0.0], [1.0]]) * h,
        ambient=np.broadcast_to(air, (3, 3)),
        nodes=[-1, 0, 0],
    )
    made = heat_balance(patches, factors, conditions)
    for c in range(3):

        def sent(t, c=c):
            return areas[1] * q[c] + areas[2] * h[c] * (air[c] - t)

        def excess(t, c=c):
            g = SIGMA * 350**4 + sent(t, c) / (areas[0] * e[0])
            return (areas[1:] @ e[1:]) * (SIGMA * t**4 - g) - sent(t, c)

        t = brentq(excess, 100, 1000, xtol=1e-10)
        g = SIGMA * 350**4 + sent(t) / (areas[0] * e[0])
        np.testing.assert_allclose(made.temperature[:, c], [350, t, t], rtol=1e-8)
        np.testing.assert_allclose(made.heat[1:, c], areas[1:] * e[1:] * (SIGMA * t**4 - g), atol=1e-5)
    assert made.imbalance.max() < 1e-10


def test_equal_bands_are_grey():
    """Given temperatures, fluxes and air in four cases, closed and open."""
    random = np.random.default_rng(4)
    patches, closed = sphere(*random.uniform(0.2, 2, 12))
    is_open = factors_of(patches, 0.7 * closed.matrix.toarray())
    e = random.uniform(0.05, 1, (12, 1))
    t = np.where(np.arange(12)[:, None] < 4, random.uniform(200, 900, (12, 4)), np.nan)
    known = {
        "temperature": t,
        "flux": np.where(np.isnan(t), random.uniform(0, 300, (12, 4)), 0),
        "conductance": np.where(np.arange(12) > 7, 5.0, 0.0),
        "ambient": random.uniform(250, 320, (12, 4)),
        "surroundings": [100, 200, 300, 400],
    }
    for factors in (closed, is_open):
        grey = heat_balance(patches, factors, Conditions(emissivity=e, **known), tolerance=1e-13)
        bands = heat_balance(patches, factors, Conditions(emissivity=e, edges=[0, 3e-6, 9e-6, np.inf], **known))
        np.testing.assert_allclose(bands.temperature, grey.temperature, rtol=1e-10)
        scale = np.abs(grey.heat).max()
        np.testing.assert_allclose(bands.heat, grey.heat, atol=1e-10 * scale)
        np.testing.assert_allclose(bands.to_sky, grey.to_sky, atol=1e-10 * scale)
        assert bands.imbalance.max() < 1e-12 and bands.residual < 1e-10


def test_a_selective_absorber_in_the_open():
    """sum_b e_b (p_b(T) - p_b(T_s)) = q for heat of any size; a black sky at 0 K and no heat leave 0 K."""
    patches = squares(1)
    e = np.array([[0.9, 0.05]])
    flux, sky = np.array([[0.0, 1e-3, 50, 900, 1e6, 0.0]]), np.array([0.0, 0, 0, 250, 250, 250])
    made = heat_balance(
        patches, factors_of(patches, [[0]]), Conditions(emissivity=e, flux=flux, surroundings=sky, edges=EDGES)
    )
    assert made.temperature[0, 0] == 0 and made.temperature[0, 5] == pytest.approx(250, rel=1e-9)
    for q, cold, t in list(zip(flux[0], sky, made.temperature[0], strict=True))[1:5]:
        arrived = emitted(cold) if cold else 0
        exact = brentq(lambda t, q=q, a=arrived: (e @ (emitted(t) - a)).item() - q, 3, 1e4, xtol=1e-9)
        assert t == pytest.approx(exact, rel=1e-8)
    np.testing.assert_allclose(made.to_sky, flux[0], rtol=1e-8, atol=1e-9)


def test_cases_in_parts_are_those_of_all(monkeypatch):
    patches, factors = sphere(1, 2, 3)
    t = np.array([[300.0, 320, 340, 360, 380], [np.nan] * 5, [400, 390, 380, 370, 360]])
    for known in ({"emissivity": [0.9, 0.5, 0.3]}, {"emissivity": [[0.9, 0.1], [0.5, 0.4], [0.3, 1]], "edges": EDGES}):
        conditions = Conditions(temperature=t, surroundings=t[0], **known)
        whole = heat_balance(patches, factors, conditions)
        with monkeypatch.context() as patched:
            patched.setattr(heat, "_MOST", 12)
            parts = heat_balance(patches, factors, conditions)
        np.testing.assert_allclose(parts.temperature, whole.temperature, rtol=1e-9)
        np.testing.assert_allclose(parts.heat, whole.heat, atol=1e-7)


def test_a_patch_without_area_has_no_temperature():
    three = squares(1, 1, 1)
    patches = Patches(three.vertices, three.faces, left_out=[1])
    factors = factors_of(patches, [[0, 0, 1], [0, 0, 0], [1, 0, 0]])
    t = [600, np.nan, np.nan]
    made = heat_balance(patches, factors, Conditions(emissivity=[[0.9, 0.2]], temperature=t, edges=EDGES))
    np.testing.assert_allclose(made.temperature[:, 0], [600, np.nan, 600], rtol=1e-9)
    assert made.steps < 15


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        ({"edges": [0, 5e-6, 4e-6, np.inf]}, "edges of bands ascend"),
        ({"edges": [1e-6, 4e-6, np.inf]}, "the first begins at 0, the last ends at infinity"),
        ({"edges": [0, 4e-6]}, "the first begins at 0, the last ends at infinity"),
        ({"edges": EDGES, "emissivity": [[0.1, 0.2, 0.3]]}, "3 columns for 2 bands"),
        ({"edges": EDGES, "emissivity": [[0.1, 1.2]]}, "emissivity must be in"),
        ({"nodes": [0, 0]}, "patch 0 has one temperature with others: give it to all"),
        ({"nodes": [0, 0], "temperature": [300, 310]}, "patch 0 has one temperature with others: give it to all"),
        ({"nodes": [0, 0, 1]}, "nodes are whole numbers, one for each of 2 patches"),
        ({"nodes": [0.5, 0.5]}, "nodes are whole numbers"),
        ({"edges": EDGES, "emissivity": [[0.5, 0], [0, 0.5]], "flux": [0, 9]}, "the heat of patch 1 cannot leave"),
        ({"edges": EDGES, "emissivity": [[0.5, 0], [0, 0.5]]}, "the heat of patch 1 cannot leave"),
        ({"edges": EDGES, "emissivity": [[0.5, 1], [0, 0]], "flux": [0, 9]}, "patch 1 has emissivity 0"),
        ({"edges": EDGES, "flux": [0, -1e4]}, "patch 1 would have to be colder than 0 K"),
    ],
)
def test_what_cannot_be(conditions, words):
    patches = squares(1, 1)
    with pytest.raises(RadiosityError, match=words):
        heat_balance(patches, factors_of(patches, PLATES), Conditions(**{"temperature": [300, np.nan], **conditions}))
