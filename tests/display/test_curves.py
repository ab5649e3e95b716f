"""Tone curves: black, white, order, neutral greys, exact encodings, and the tables that a page has."""

import numpy as np
import pytest

from etendue.display import CURVES, tonemap
from etendue.display.curves import TABLE_RANGE, srgb_encode


def grey(values):
    return np.repeat(np.asarray(values, dtype=np.float64).reshape(1, -1, 1), 3, axis=2)


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("exposure", [-2.0, 0.0, 3.5])
def test_monotone_from_black_to_white_and_neutral(name, exposure):
    out = tonemap(grey(np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 3000)])), exposure, name)
    assert (np.diff(out.astype(int), axis=1) >= 0).all()
    assert out[0, 0].tolist() == [0, 0, 0] and out[0, -1].tolist() == [255, 255, 255]
    assert np.ptp(out, axis=2).max() == 0


@pytest.mark.parametrize("name", CURVES)
def test_a_channel_grows_with_its_light(name):
    x = np.geomspace(1e-4, 1e3, 2000)
    for channel in range(3):
        colour = np.full((1, 2000, 3), 0.3)
        colour[0, :, channel] = x
        assert (np.diff(tonemap(colour, curve=name)[0, :, channel].astype(int)) >= 0).all()


@pytest.mark.parametrize("name", CURVES)
def test_white_is_where_it_is_said_to_be(name):
    curve = CURVES[name]
    if np.isfinite(curve.white):
        assert curve(np.full((1, 3), curve.white)).min() > 1.0 - 1e-4
        assert curve(np.full((1, 3), 0.95 * curve.white)).max() < 1.0 - 1e-4
    else:
        assert curve(np.full((1, 3), 10.0)).max() < 1.0 < 1.0 + curve(np.full((1, 3), 1e5)).min()


def test_encodings_are_exact():
    x = np.linspace(0.0, 1.0, 1001)
    linear = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    np.testing.assert_allclose(CURVES["srgb"](grey(linear))[0, :, 0], x, atol=2e-5)
    np.testing.assert_allclose(CURVES["gamma"](grey(x**2.2))[0, :, 0], x, atol=1e-12)
    levels = np.arange(256) / 255.0
    back = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    np.testing.assert_array_equal(tonemap(grey(back))[0, :, 0], np.arange(256))


@pytest.mark.parametrize("name", ["logarithmic", "s-curve"])
def test_curves_that_keep_middle_grey(name):
    np.testing.assert_allclose(CURVES[name](np.full((1, 3), 0.18)), srgb_encode(np.full((1, 3), 0.18)), rtol=1e-12)


def test_aces_against_its_transform_in_opencolorio():
    """Greys of the view 'ACES 1.0 - SDR Video' of OpenColorIO's cg-config-v2.2.0_aces-v1.3, on an sRGB display."""
    x = [0.0126491106, 0.0377176819, 0.126491106, 0.424204224, 1.42262353, 4.77095131, 16.0]
    seen = [0.0194, 0.09322555, 0.27328160, 0.59862483, 0.86601216, 0.96444434, 0.99974114]
    np.testing.assert_allclose(CURVES["aces"](grey(x))[0, 1:, 0], seen[1:], atol=0.005)


def test_agx_against_the_fit_of_its_curve():
    """The polynomial by Wrensch, whose own mean squared error is 4e-6, at equal steps of the logarithm."""
    t = np.linspace(0.0, 1.0, 400)
    fit = np.polyval([15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232], t)
    curve = CURVES["agx"]
    assert np.abs(curve.f(0.18 * 2.0 ** (16.5 * t - 10.0)) - fit).max() < 0.007


def test_agx_fades_a_bright_colour():
    red = np.array([[[20.0, 0.2, 0.2]]])
    assert tonemap(red, curve="srgb")[0, 0].tolist() == [255, 124, 124]
    shown = tonemap(red, curve="agx")[0, 0].astype(int)
    assert shown[0] == 255 and 80 < shown[1] < 250


@pytest.mark.parametrize("name", CURVES)
def test_the_tables_of_a_page_give_the_same_bytes(name):
    """As the page's script reads them: linear between entries, the channels mixed by the matrices."""
    curve, tables = CURVES[name], CURVES[name].tables()
    low, high = TABLE_RANGE
    x = np.random.default_rng(3).uniform(-9.0, 4.0, (400, 1, 3))
    x = 2.0**x

    def f(v):
        steps = np.linspace(low, high, len(tables["f"]))
        return np.interp(np.log2(np.maximum(v, 2.0**low)), steps, tables["f"])

    before, after = (np.eye(3) if tables[key] is None else np.array(tables[key]) for key in ("before", "after"))
    y = np.clip(f(x @ before.T) @ after.T, 0.0, 1.0)
    place = np.sqrt(y) * (len(tables["encode"]) - 1)
    shown = 255.0 * np.interp(place, np.arange(len(tables["encode"])), tables["encode"])
    assert np.abs(shown - 255.0 * curve(x)).max() < 0.3
