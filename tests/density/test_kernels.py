"""Kernels: closed forms, unit integrals, the same numbers from NumPy and on the device."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest

from etendue.density import KERNELS, DensityError, FixedKernel

PI = math.pi
_COSINE = 1 / (4 - 8 / PI)  # of the plane
#: Name to (1 / integral, integral of the square, second moment) on a line, then in the plane.
CLOSED = {
    "uniform": (1 / 2, 1 / 2, 1 / 3, 1 / PI, 1 / PI, 1 / 4),
    "cone": (1, 2 / 3, 1 / 6, 3 / PI, 3 / (2 * PI), 3 / 20),
    "epanechnikov": (3 / 4, 3 / 5, 1 / 5, 2 / PI, 4 / (3 * PI), 1 / 6),
    "biweight": (15 / 16, 5 / 7, 1 / 7, 3 / PI, 9 / (5 * PI), 1 / 8),
    "triweight": (35 / 32, 350 / 429, 1 / 9, 4 / PI, 16 / (7 * PI), 1 / 10),
    "cosine": (
        *(PI / 4, PI**2 / 16, 1 - 8 / PI**2, _COSINE, _COSINE**2 * (PI / 2 - 2 / PI)),
        _COSINE * PI * (2 / PI - 48 / PI**3 + 96 / PI**4),
    ),
    "gaussian": (1 / math.sqrt(2 * PI), 1 / (2 * math.sqrt(PI)), 1, 1 / (2 * PI), 1 / (4 * PI), 1),
}
#: What is cut off from a Gaussian.
LOST = {1: 6e-7, 2: 4e-6}


def test_there_are_the_six_kernels_and_the_gaussian():
    assert set(KERNELS) == set(CLOSED)


@pytest.mark.parametrize("name", CLOSED)
def test_closed_forms(name):
    kernel = KERNELS[name]
    found = [f(d) for d in (1, 2) for f in (kernel.normalisation, kernel.roughness, kernel.second_moment)]
    assert found == pytest.approx(CLOSED[name], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "formula"),
    [
        ("uniform", lambda u: 0.5 + 0 * u),
        ("cone", lambda u: 1 - abs(u)),
        ("epanechnikov", lambda u: 0.75 * (1 - u**2)),
        ("biweight", lambda u: 15 / 16 * (1 - u**2) ** 2),
        ("triweight", lambda u: 35 / 32 * (1 - u**2) ** 3),
        ("cosine", lambda u: PI / 4 * np.cos(PI * u / 2)),
        ("gaussian", lambda u: np.exp(-0.5 * u**2) / math.sqrt(2 * PI)),
    ],
)
def test_values_on_a_line(name, formula):
    u = np.linspace(-1, 1, 41)
    assert KERNELS[name].value(u) == pytest.approx(formula(u), abs=1e-12)
    assert (KERNELS[name].value(np.array([-5.01, 5.01, 1e9])) == 0).all()
    assert KERNELS[name].value(0.25) == pytest.approx(formula(0.25))


@pytest.mark.parametrize("dimension", [1, 2])
@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_integrates_to_one(name, dimension):
    kernel, n = KERNELS[name], 200_000
    u = (np.arange(n) + 0.5) * (kernel.reach / n)
    shell = 2.0 if dimension == 1 else 2 * PI * u
    lost = LOST[dimension] if name == "gaussian" else 0.0
    assert np.sum(kernel.value(u, dimension) * shell) * kernel.reach / n == pytest.approx(1 - lost, abs=1e-6)
    assert (np.diff(kernel.value(u, dimension)) <= 1e-15).all()


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_on_the_disc_has_the_mean_one(name):
    n = 100_000
    t = (np.arange(n) + 0.5) / n  # even in t is even on the disc
    assert np.mean(KERNELS[name].on_disc(t)) == pytest.approx(1, abs=1e-7)
    some = t[:: n // 16].copy()
    on_device = np.array(KERNELS[name].on_disc(mi.Float(some))) + np.zeros(16)
    assert on_device == pytest.approx(KERNELS[name].on_disc(some) + np.zeros(16), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", KERNELS)
def test_the_share_up_to_a_distance_is_the_integral(name):
    kernel, n = KERNELS[name], 40_000
    edge = np.linspace(0, 1.1 * kernel.reach, n + 1)
    middle, step = 0.5 * (edge[1:] + edge[:-1]), edge[1]
    line = np.append(0, np.cumsum(kernel.value(middle)) * step)
    disc = np.append(0, np.cumsum(kernel.value(middle, 2) * 2 * PI * middle) * step)
    np.testing.assert_allclose(kernel.mass(edge), line, rtol=0, atol=3e-5)
    np.testing.assert_allclose(kernel.mass(-edge), -line, rtol=0, atol=3e-5)
    np.testing.assert_allclose(kernel.mass(edge, 2), disc, rtol=0, atol=1e-4)
    some = edge[:: n // 50].copy()
    assert np.array(kernel.mass(mi.Float(some))) == pytest.approx(line[:: n // 50], abs=4e-5)
    assert np.array(kernel.mass(mi.Float(some), 2)) == pytest.approx(disc[:: n // 50], abs=1e-4)


def test_bandwidths_that_smooth_alike():
    """Of Epanechnikov and Gauss: 2.214 on a line [Marron 1988]."""
    one, other = KERNELS["epanechnikov"], KERNELS["gaussian"]
    assert one.canonical_bandwidth(1) / other.canonical_bandwidth(1) == pytest.approx(2.214, abs=5e-4)


def test_the_gaussian_is_the_default():
    assert FixedKernel([0.0, 1.0], 0.3).kernel is KERNELS["gaussian"]


def test_what_is_no_kernel():
    with pytest.raises(DensityError, match="did you mean 'epanechnikov'"):
        FixedKernel([0.0, 1.0], 0.3, "epanechnikof")
    with pytest.raises(DensityError, match="one or two dimensions"):
        KERNELS["cone"].normalisation(3)
