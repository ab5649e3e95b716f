"""The wavelengths of a pass: colours, white, and how they are spread over passes."""

from __future__ import annotations

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.spectral import spectral_variant

from etendue.scene import Packet


@pytest.fixture(autouse=True)
def _spectral() -> Iterator[None]:
    with spectral_variant():
        yield


def wavelengths(packet: Packet) -> np.ndarray:
    return np.array(packet.wavelengths, np.float64).ravel()


def quantiles(found: np.ndarray) -> np.ndarray:
    """Shares of the density of visible wavelengths below wavelengths in nanometres."""
    grid = np.linspace(360.0, 830.0, 100_001)
    density = np.array(mi.pdf_rgb_spectrum(mi.Spectrum(mi.Float(grid.astype(np.float32).tolist()))))[0]
    below = np.cumsum(density) * (grid[1] - grid[0])
    return np.interp(found, grid, below / below[-1])


def test_colours_are_those_of_mitsuba():
    packet, random = Packet(), np.random.default_rng(3)
    for iteration in range(8):
        packet.choose(iteration, 5)
        light = mi.Spectrum(*random.random(4).tolist())
        theirs = mi.spectrum_to_srgb(light / mi.pdf_rgb_spectrum(packet.wavelengths), packet.wavelengths)
        np.testing.assert_allclose(np.array(packet.rgb(light)), np.array(theirs), rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("seed", range(4))
def test_white_light_is_nearly_white_after_16_passes(seed):
    """Before the picture is divided by it."""
    packet, white = Packet(), []
    for iteration in range(16):
        packet.choose(iteration, seed)
        light = mi.Spectrum(*(mi.cie_d65(wavelength) for wavelength in packet.wavelengths))
        white.append(np.array(packet.rgb(light)).ravel())
        np.testing.assert_allclose(packet.white, white[-1], rtol=1e-5)
        np.testing.assert_allclose(np.array(packet.albedo(mi.Spectrum(1.0))).ravel(), white[-1], rtol=1e-5)
    np.testing.assert_allclose(np.mean(white, axis=0), 1.0, atol=1.5e-3)


@pytest.mark.parametrize("disperses", [False, True])
def test_wavelengths_and_heroes_are_evenly_spread(disperses):
    packet, found = Packet(), []
    for iteration in range(64):
        packet.choose(iteration, 2, disperses)
        found.append(quantiles(wavelengths(packet)))
        assert (np.bincount((4.0 * found[-1]).astype(int) % 4, minlength=4) == 1).all()  # one in each quarter
    rows, heroes = np.array(found), np.sort(np.array(found)[:, 0])
    if disperses:
        np.testing.assert_allclose(np.diff(heroes), 1 / 64, atol=2e-4)
    else:
        np.testing.assert_allclose(np.diff(np.sort(rows.ravel())), 1 / 256, atol=2e-4)
    assert (np.bincount((4.0 * heroes).astype(int), minlength=4) == 16).all()


def test_the_order_of_the_wavelengths_does_not_matter():
    one, other = Packet(), Packet()
    for iteration in range(4):  # the same four with another hero each
        other.choose(iteration, 1, disperses=True)
        if iteration == 0:
            one.choose(0, 1, disperses=True)
        order = [int(np.abs(wavelengths(one) - w).argmin()) for w in wavelengths(other)]
        assert sorted(order) == [0, 1, 2, 3]
        light = np.array([0.2, 0.5, 0.3, 0.9])
        found = one.rgb(mi.Spectrum(*light.tolist())), other.rgb(mi.Spectrum(*light[order].tolist()))
        np.testing.assert_allclose(*map(np.array, found), rtol=1e-5, atol=1e-6)


def test_rgb_has_no_wavelengths():
    with mi.variant_context("llvm_ad_rgb"):
        packet = Packet()
        assert dr.size_v(packet.wavelengths) == 0
        colour = mi.Color3f(0.1, 0.2, 0.3)
        assert packet.rgb(colour) is colour
        assert (packet.white == 1.0).all()
