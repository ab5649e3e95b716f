"""Tone mapping keeps order and constants; a PNG holds exactly the bytes it was given."""

import os

import numpy as np
import pytest
from PIL import Image

from etendue.core import OptionError, OutputError
from etendue.display import CURVES, auto_exposure, encode_png, tonemap, write_png
from etendue.film import read_image
from etendue.viewer.shown import toned


def grey(values):
    return np.repeat(np.asarray(values, dtype=np.float64).reshape(1, -1, 1), 3, axis=2)


@pytest.mark.parametrize("curve", ["srgb", "filmic"])
def test_constant_and_neutral_pictures_stay_so(curve):
    out = tonemap(np.full((4, 5, 3), 0.37), curve=curve)
    assert len(np.unique(out)) == 1


def test_known_values_of_the_srgb_curve():
    linear = np.array([0.0, 0.0031308, 0.18, 0.5, 1.0])
    assert tonemap(grey(linear))[0, :, 0].tolist() == [0, 10, 118, 188, 255]


def test_a_stop_doubles():
    x = grey(np.linspace(0, 0.4, 50))
    np.testing.assert_array_equal(tonemap(x, 1.0), tonemap(2.0 * x))


def test_filmic_keeps_highlights_apart_that_clipping_merges():
    bright = grey([2.0, 4.0])
    assert len(np.unique(tonemap(bright))) == 1
    assert len(np.unique(tonemap(bright, curve="filmic"))) == 2


def test_values_that_are_no_colours():
    out = tonemap(np.array([[[np.nan, -1.0, np.inf], [-np.inf, 1e300, 0.0]]]))
    assert out.tolist() == [[[0, 0, 255], [0, 255, 0]]]
    assert tonemap(np.array([[[np.inf, 1e300, np.nan]]]), 20.0, "filmic").tolist() == [[[255, 255, 0]]]


def test_log_average_brings_a_grey_card_to_middle_grey():
    for level in (1e-4, 0.18, 50.0):
        image = np.full((6, 6, 3), level)
        assert 2.0 ** auto_exposure(image) * level == pytest.approx(0.18)
        np.testing.assert_array_equal(tonemap(image, "auto"), 118)


def test_auto_exposure_ignores_black_and_broken_pixels_and_keeps_highlights():
    image = np.full((10, 10, 3), 0.5)
    image[0], image[1, 0], image[1, 1] = 0.0, np.nan, np.inf
    assert 2.0 ** auto_exposure(image) * 0.5 == pytest.approx(0.18)
    assert 2.0 ** auto_exposure(image, "percentile") * 0.5 == pytest.approx(1.0)
    dark_room = np.full((10, 10, 3), 1e-6)
    dark_room[:3] = 1.0  # a third of the picture is lit; the log-average alone would burn it out
    assert 2.0 ** auto_exposure(dark_room) <= 1.0
    assert auto_exposure(np.zeros((2, 2, 3))) == 0.0


@pytest.mark.parametrize("method", ["log-average", "percentile"])
def test_nearly_black_pixels_do_not_count(method):
    """A picture with black around it has the exposure of the picture, also if a filter left traces of light there."""
    r = np.random.default_rng(1)
    image = np.repeat(np.exp(r.normal(0, 1, (40, 40, 1))), 3, axis=2)
    image[:4, :4] = 1000.0  # a lamp
    expected = auto_exposure(image, method)
    for trace in (0.0, 1e-30, 1e-9, 1e-6):
        around = np.full((80, 80, 3), trace)
        around[20:60, 20:60] = image
        assert auto_exposure(around, method) == pytest.approx(expected, abs=0.05)


def test_unknown_choices_are_named():
    image = np.ones((1, 1, 3))
    with pytest.raises(OptionError, match="did you mean 'filmic'"):
        tonemap(image, curve="flmic")
    with pytest.raises(OptionError, match="'auto'"):
        tonemap(image, "bright")
    for stops in (float("nan"), float("inf"), 1e9, -1e9, None, [1]):
        with pytest.raises(OptionError, match="a number of stops"):
            tonemap(image, stops)
    with pytest.raises(OptionError, match="percentile"):
        auto_exposure(image, "mean")


@pytest.mark.parametrize("shape", [(1, 1, 3), (7, 13, 3), (64, 48, 3)])
@pytest.mark.parametrize("kind", ["noise", "gradient", "flat"])
def test_png_holds_the_same_bytes(tmp_path, shape, kind):
    mi = pytest.importorskip("mitsuba")
    y, x, c = np.indices(shape)
    image = {
        "noise": np.random.default_rng(5).integers(0, 256, shape),
        "gradient": (3 * x + 2 * y + 40 * c) % 256,
        "flat": np.full(shape, 17),
    }[kind].astype(np.uint8)
    write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(np.array(mi.Bitmap(str(tmp_path / "a.png"))), image)
    turned = image[::-1, :, ::-1]  # not contiguous
    write_png(tmp_path / "a.png", turned)
    np.testing.assert_array_equal(np.array(mi.Bitmap(str(tmp_path / "a.png"))), turned)


def test_png_says_that_it_is_srgb():
    assert b"sRGB\0" in encode_png(np.zeros((2, 2, 3), np.uint8)).partition(b"IDAT")[0]


def test_png_filters_earn_their_place():
    y, x, c = np.indices((64, 64, 3))
    smooth = (x + 2 * y + 30 * c).clip(0, 255).astype(np.uint8)
    assert len(encode_png(smooth)) < 1500


def test_png_reads_back_as_the_linear_picture(tmp_path):
    linear = np.random.default_rng(6).random((8, 9, 3))
    write_png(tmp_path / "a.png", tonemap(linear))
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), linear, atol=5e-3)


def test_colours_of_a_png_with_alpha_are_not_multiplied_by_it(tmp_path):
    colour, alpha = np.array([0.2, 0.5, 0.9]), np.array([[[0.0], [0.25]], [[0.5], [1.0]]])
    made = tonemap(colour * alpha, alpha=alpha)
    np.testing.assert_array_equal(made[alpha[..., 0] > 0.0][:, :3], np.tile(tonemap(colour[None, None])[0], (3, 1)))
    np.testing.assert_array_equal(made[..., 3:], np.round(255.0 * alpha))
    write_png(tmp_path / "a.png", made)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), made)


def test_png_refuses_what_it_cannot_hold(tmp_path):
    for wrong in (np.ones((2, 2, 3)), np.zeros((2, 2), np.uint8), np.zeros((0, 2, 3), np.uint8)):
        with pytest.raises(OutputError, match="bytes"):
            write_png(tmp_path / "a.png", wrong)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize("curve", sorted(CURVES))
def test_the_viewer_shows_what_files_contain(curve):
    """Its tables of half precision, at most one step of eight bits away."""
    x = np.random.default_rng(2).lognormal(-1.0, 2.0, (40, 50, 3)).astype(np.float32)
    x[0, :4] = [[np.nan] * 3, [0.0] * 3, [1e6] * 3, [-1.0] * 3]
    for stops in (0.0, -2.5):
        shown, written = (np.asarray(p, int) for p in (toned(x, stops, curve), tonemap(x, stops, curve)))
        assert np.abs(shown - written).max() <= 1
