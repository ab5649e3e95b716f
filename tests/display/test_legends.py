"""False-colour pictures: colours, scales, isolines at their places, legends."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.core import OptionError
from etendue.display import check_range, false_colour, false_colour_picture, luminance_picture
from etendue.display.isolines import isolines
from etendue.display.scales import linear_ticks, logarithmic_ticks, round_down, round_up, tick_text

BLACK, YELLOW = (0, 0, 4), (252, 255, 164)


def luma(colours):
    return colours.astype(float) @ [0.299, 0.587, 0.114]


@pytest.mark.parametrize("logarithmic", [False, True])
def test_colours_rise_from_black_to_yellow(logarithmic):
    values = np.linspace(1.0, 1000.0, 500)[None]
    (shown,) = false_colour(values, 1.0, 1000.0, logarithmic=logarithmic)
    assert tuple(shown[0]) == BLACK and tuple(shown[-1]) == YELLOW
    assert (np.diff(luma(shown)) > -1.0).all()  # but for rounding
    middle = 1000.0**0.5 if logarithmic else 500.5  # the fifth of nine colours
    assert false_colour([[middle]], 1.0, 1000.0, logarithmic=logarithmic).ravel().tolist() == [186, 54, 85]


def test_a_picture_has_its_values_at_the_upper_left():
    values = np.random.default_rng(1).uniform(0.0, 700.0, (420, 300))
    shown = false_colour_picture(values, "lx", 0.0, 500.0)
    assert (shown[:420, :300] == false_colour(values, 0.0, 500.0, logarithmic=False)).all()
    legend = shown[:, 300:]
    assert shown.shape[0] == 420 and 40 < legend.shape[1] < 120 and (legend[:, :8] == 255).all()
    # The bar rises from black to yellow, and is as high as nearly the whole picture.
    column = legend[:, 20]
    bar = column[(column != 255).any(axis=1) & (np.arange(420) > 25)]
    assert len(bar) > 350 and tuple(bar[0]) == YELLOW and tuple(bar[-1]) == BLACK
    assert (np.diff(luma(bar)) < 1.0).all()


def test_small_arrays_are_enlarged_with_the_shape_of_their_pixels():
    shown = false_colour_picture([[0.0, 1.0], [2.0, 3.0]], "lx", 0.0, 3.0, pixel=(2.0, 1.0))
    assert tuple(shown[390, 10]) == tuple(false_colour([[2.0]], 0.0, 3.0, logarithmic=False)[0, 0])
    assert tuple(shown[10, 790]) == tuple(false_colour([[1.0]], 0.0, 3.0, logarithmic=False)[0, 0])
    assert shown.shape[0] == 400 and tuple(shown[390, 790]) == YELLOW and tuple(shown[10, 10]) == BLACK


@pytest.mark.parametrize("transposed", [False, True])
def test_isolines_of_a_ramp_are_where_it_has_the_level(transposed):
    ramp = np.tile(3.0 + 7.0 * np.arange(12), (9, 1))
    for level in (5.5, 31.0, 60.0):  # the second is the value of a column
        (line,) = isolines(ramp.T if transposed else ramp, level)
        across, along = (line[:, 1], line[:, 0]) if transposed else (line[:, 0], line[:, 1])
        assert np.allclose(across, (level - 3.0) / 7.0)
        assert sorted(along.tolist()) == list(range(9))
    assert isolines(ramp, 1.0) == isolines(ramp, 100.0) == []


def test_isolines_of_a_cone_are_closed_circles():
    y, x = np.mgrid[0:41, 0:51]
    (line,) = isolines(20.0 - np.hypot(x - 24.3, y - 20.6), 8.0)
    assert (line[0] == line[-1]).all()
    # Linear interpolation of a circle's cone errs by less than 1 / (8 r) per unit of distance.
    assert np.abs(np.hypot(*(line - [24.3, 20.6]).T) - 12.0).max() < 1 / (8 * 12) + 1e-3


def test_isolines_at_saddles_do_not_cross_and_leave_out_what_is_not_known():
    high, low = (isolines([[1.0, 0.0], [0.0, 1.0]], level) for level in (0.6, 0.4))
    # Above the middle, 0.5, the lines cut off the high corners; below, the low ones.
    ends = {tuple(sorted(map(tuple, np.round(line, 6).tolist()))) for line in high}
    assert ends == {((0.0, 0.4), (0.4, 0.0)), ((0.6, 1.0), (1.0, 0.6))}
    ends = {tuple(sorted(map(tuple, np.round(line, 6).tolist()))) for line in low}
    assert ends == {((0.6, 0.0), (1.0, 0.4)), ((0.0, 0.6), (0.4, 1.0))}
    ramp = np.tile(np.arange(4.0), (6, 1))
    ramp[2, 1] = np.nan
    assert sorted(len(line) for line in isolines(ramp, 1.5)) == [2, 3]


def test_lines_are_drawn_where_a_ramp_crosses_round_values():
    ramp = np.tile(np.linspace(0.0, 600.0, 601), (420, 1))  # x is the value
    plain = false_colour_picture(ramp, "lx", 0.0, 600.0)
    lined = false_colour_picture(ramp, "lx", 0.0, 600.0, lines=[150.0, 450.0])
    changed = np.flatnonzero((plain[5, :601] != lined[5, :601]).any(axis=1))
    assert set(changed) <= {148, 149, 150, 151, 152, 448, 449, 450, 451, 452} and {150, 450} <= set(changed)
    assert luma(lined[5, 150]) > 200 and luma(lined[5, 450]) < 60  # white on dark, black on bright
    automatic = false_colour_picture(ramp, "lx", 0.0, 600.0, lines=True)
    assert all((automatic[5, x] != plain[5, x]).any() for x in (100, 200, 300, 400, 500))
    labelled = (automatic[:, 160:200] != plain[:, 160:200]).any(axis=(1, 2))
    assert 8 < labelled.sum() < 60  # the label of 200, at one place


def width_of_scale(values, **options):
    from etendue.display.legends import _scale

    chosen = _scale(np.asarray(values, float), options.get("low"), options.get("high"), options.get("logarithmic"))
    return chosen.low, chosen.high, chosen.logarithmic


@pytest.mark.parametrize(
    ("values", "options", "expected"),
    [
        ([[30.0, 537.0]], {}, (0.0, 600.0, False)),
        ([[412.0, 537.0]], {}, (400.0, 540.0, False)),
        ([[0.3, 537.0]], {}, (0.2, 1000.0, True)),
        ([[0.3, 537.0]], {"logarithmic": False}, (0.0, 600.0, False)),
        ([[30.0, 537.0]], {"logarithmic": True}, (20.0, 1000.0, True)),
        ([[30.0, 537.0]], {"low": 1.0, "high": 500.0}, (1.0, 500.0, True)),
        ([[30.0, 537.0]], {"low": 0.0, "high": 500.0}, (0.0, 500.0, False)),
        ([[30.0, 537.0]], {"high": 100.0}, (0.0, 100.0, False)),
        ([[7.0, 7.0]], {}, (0.0, 7.0, False)),
        ([[0.0, 0.0]], {}, (0.0, 1.0, False)),
        ([[np.nan, np.inf]], {}, (0.0, 1.0, False)),
        ([[1e-9, 1e3]], {}, (0.1, 1e3, True)),
    ],
)
def test_automatic_scales_are_round(values, options, expected):
    assert width_of_scale(values, **options) == pytest.approx(expected)
    assert false_colour_picture(values, "lx", lines=True, **options).shape[0] > 100


def test_ticks_are_round():
    assert linear_ticks(0.0, 600.0) == [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0]
    assert linear_ticks(0.07, 0.33) == [0.1, 0.15, 0.2, 0.25, 0.3]
    assert [v for v, labelled in logarithmic_ticks(1.0, 1e4) if labelled] == [1.0, 10.0, 100.0, 1e3, 1e4]
    assert [round_up(v) for v in (0.9, 1.0, 1.1, 3.0, 7.0)] == [1.0, 1.0, 2.0, 5.0, 10.0]
    assert [round_down(v) for v in (0.9, 1.0, 1.1, 3.0, 7.0)] == [0.5, 1.0, 1.0, 2.0, 5.0]
    assert [tick_text(v) for v in (0.0, 0.05, 250.0, 1e5, 2e6, 1e-4)] == ["0", "0.05", "250", "10^5", "2·10^6", "10^-4"]


def test_luminance_is_683_lumens_a_watt():
    image = np.zeros((400, 300, 3))
    image[:, :150, 1] = 2.0
    values = np.where(np.arange(300) < 150, 683.0 * 0.7152 * 2.0, 0.0)[None].repeat(400, axis=0)
    assert (luminance_picture(image, low=0.0, high=2e3) == false_colour_picture(values, "cd/m^2", 0.0, 2e3)).all()


def test_bad_scales():
    for ends, message in (
        ((5.0, 1.0), "rises from its low"),
        ((0.0, 1.0, True), "begins above 0"),
        ((None, -1.0), "ends above 0"),
        ((float("nan"), None), "are numbers"),
    ):
        with pytest.raises(OptionError, match=message):
            check_range(*ends)
    with pytest.raises(OptionError, match=r"not an array of shape \(3,\)"):
        false_colour_picture([1.0, 2.0, 3.0], "lx")
