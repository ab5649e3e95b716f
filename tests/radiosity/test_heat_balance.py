"""Temperatures and heat against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from support.patches import factors_of, squares

from etendue.radiosity import (
    STEFAN_BOLTZMANN as SIGMA,
    Conditions,
    RadiosityError,
    heat_balance,
)

PLATES = [[0, 1], [1, 0]]


def test_two_plates_and_a_flux():
    """q = sigma (T_1^4 - T_2^4) / (1 / e_1 + 1 / e_2 - 1), whichever of q, T_1 and T_2 is to be found."""
    patches = squares(1, 1)
    e = np.array([0.8, 0.3])
    q = SIGMA * (500**4 - 300**4) / (1 / e[0] + 1 / e[1] - 1)
    both = heat_balance(patches, factors_of(patches, PLATES), Conditions(emissivity=e, temperature=[500, 300]))
    np.testing.assert_allclose(both.heat[:, 0], [q, -q], rtol=1e-9)
    for t, flux in (([np.nan, 300], [q, 0]), ([500, np.nan], [0, -q])):
        made = heat_balance(patches, factors_of(patches, PLATES), Conditions(emissivity=e, temperature=t, flux=flux))
        np.testing.assert_allclose(made.temperature[:, 0], [500, 300], rtol=1e-9)
        np.testing.assert_allclose(made.heat[:, 0], [q, -q], rtol=1e-8)
        assert made.steps == 1 and made.imbalance[0] < 1e-9


def test_an_adiabatic_wall():
    """The third wall of a long triangular duct, whose others are black: 2 T^4 = T_1^4 + T_2^4, whatever its
    emissivity."""
    patches = squares(1, 1, 1)
    third = np.full((3, 3), 0.5) - 0.5 * np.eye(3)
    t = [800, 400, np.nan]
    made = heat_balance(patches, factors_of(patches, third), Conditions(emissivity=[1, 1, 0.4], temperature=t))
    assert made.temperature[2, 0] == pytest.approx(((800**4 + 400**4) / 2) ** 0.25, rel=1e-10)
    # The network of resistances: directly 1 / F_12, and by way of the adiabatic wall 2 / F_13 in parallel.
    assert made.heat[0, 0] == pytest.approx(SIGMA * (800**4 - 400**4) * (0.5 + 0.25), rel=1e-9)
    assert made.heat[2, 0] == pytest.approx(0, abs=1e-6)


def test_a_wall_that_is_cooled_by_air():
    """A plate opposite a hot one, with air at 290 K: e_eff sigma (T_h^4 - T^4) = h (T - 290)."""
    patches = squares(1, 1)
    h, e = np.array([0.01, 0.5, 8.0, 500.0, 1e6]), np.array([[0.9], [0.6]])
    cases = np.stack([np.full(5, 900.0), np.full(5, np.nan)])
    conditions = Conditions(
        emissivity=e, temperature=cases, conductance=np.stack([0 * h, h]), ambient=np.stack([0 * h, 290 + 0 * h])
    )
    made = heat_balance(patches, factors_of(patches, PLATES), conditions)
    effective = 1 / (1 / 0.9 + 1 / 0.6 - 1)
    for c, value in enumerate(h):
        exact = brentq(
            lambda t, value=value: effective * SIGMA * (900**4 - t**4) - value * (t - 290), 200, 900, xtol=1e-12
        )
        assert made.temperature[1, c] == pytest.approx(exact, rel=1e-8), value
        assert made.heat[1, c] == pytest.approx(value * (290 - exact), rel=1e-6)
    assert made.steps < 15


def test_a_crater():
    """A bowl that is part of a sphere: every patch sees dA_j / A of patch j, A the area of the whole sphere. Its sunlit
    part absorbs (1 - a) S of the sun, the rest is in shadow; infrared emissivity e [Ingersoll 1992]. The irradiance is
    the same everywhere."""
    areas = np.array([0.1, 0.3, 0.2, 0.4, 0.5])
    lit = np.array([True, True, False, False, False])
    sphere, e, absorbed = 4 * np.pi, 0.95, 900.0
    patches = squares(*areas)
    made = heat_balance(
        patches,
        factors_of(patches, np.broadcast_to(areas / sphere, (5, 5))),
        Conditions(emissivity=e, flux=np.where(lit, absorbed, 0.0)),
    )
    # B = q + G everywhere, so that G = sum F (q + G).
    share = areas.sum() / sphere
    irradiance = (areas[lit].sum() / sphere * absorbed) / (1 - share)
    np.testing.assert_allclose(made.irradiance[:, 0], irradiance, rtol=1e-9)
    shadow = (irradiance / SIGMA) ** 0.25
    sunlit = ((irradiance + absorbed / e) / SIGMA) ** 0.25
    np.testing.assert_allclose(made.temperature[:, 0], np.where(lit, sunlit, shadow), rtol=1e-9)
    assert made.to_sky[0] == pytest.approx(areas[lit].sum() * absorbed, rel=1e-9)


def test_surroundings_warm_an_open_plate():
    patches = squares(2)
    made = heat_balance(patches, factors_of(patches, [[0]]), Conditions(emissivity=0.5, surroundings=[250.0, 300.0]))
    np.testing.assert_allclose(made.temperature, [[250, 300]])
    made = heat_balance(patches, factors_of(patches, [[0]]), Conditions(emissivity=0.5, flux=100, surroundings=250))
    assert made.temperature[0, 0] == pytest.approx((250**4 + 100 / 0.5 / SIGMA) ** 0.25)
    assert made.heat[0, 0] == pytest.approx(200) and made.to_sky[0] == pytest.approx(200)


def test_what_has_no_heat_is_cold():
    """A plate in the dark at 0 K."""
    made = heat_balance(squares(1), factors_of(squares(1), [[0]]), Conditions(emissivity=0.5))
    assert made.temperature[0, 0] == made.heat[0, 0] == made.residual == 0


def test_a_mirror_that_air_warms():
    """It exchanges no radiation, so that T = T_a + q / h."""
    patches = squares(1, 1)
    conditions = {"emissivity": [0, 1], "temperature": [np.nan, 300], "flux": [-50, 0], "conductance": [10, 0]}
    for edges in (None, [0, 4e-6, np.inf]):
        known = conditions if edges is None else {**conditions, "emissivity": [[0, 0], [1, 1]], "edges": edges}
        made = heat_balance(patches, factors_of(patches, PLATES), Conditions(**known, ambient=290))
        assert made.temperature[0, 0] == pytest.approx(285, rel=1e-10) and made.heat[0, 0] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("conditions", "words"),
    [
        ({"emissivity": [0, 1], "temperature": [np.nan, 300], "flux": [10, 0]}, "patch 0 has emissivity 0"),
        ({"temperature": [np.nan, 300], "flux": [-1e4, 0]}, "colder than 0 K"),
        ({"temperature": np.nan, "flux": [10, 0]}, "the heat of patch 0 cannot leave"),
        ({"temperature": np.nan}, "the heat of patch 0 cannot leave"),
        ({"emissivity": 1.2, "temperature": 300}, "emissivity must be in"),
        ({"temperature": [-5, 300]}, "temperature must be at least 0"),
        ({"temperature": [300, 300, 300]}, "2 patches"),
        ({"temperature": np.full((2, 3), 300), "flux": np.zeros((2, 4))}, "different numbers of cases"),
    ],
)
def test_what_cannot_be(conditions, words):
    patches = squares(1, 1)
    with pytest.raises(RadiosityError, match=words):
        heat_balance(patches, factors_of(patches, PLATES), Conditions(**conditions))
