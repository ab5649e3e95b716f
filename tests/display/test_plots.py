"""The convergence plot puts points where a logarithmic scale has them."""

import re
from xml.etree import ElementTree

import pytest

from etendue.display import Series, convergence_plot


def circles(svg):
    return [(float(e.get("cx")), float(e.get("cy"))) for e in ElementTree.fromstring(svg).iter("circle")]


def test_equal_ratios_are_equal_distances():
    svg = convergence_plot([Series("a", [(1.0, 1.0), (10.0, 0.1), (100.0, 0.01)])])
    (x0, y0), (x1, y1), (x2, y2) = circles(svg)
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.15) and x1 > x0
    assert y1 - y0 == pytest.approx(y2 - y1, abs=0.15) and y1 > y0


def test_points_stay_inside_the_frame():
    series = [Series(f"series {k}", [(2.0**i, 10.0 ** (k - i)) for i in range(9)]) for k in range(7)]
    for width, height in ((720, 400), (360, 320)):
        points = circles(convergence_plot(series, width=width, height=height))
        assert len(points) == 63
        assert all(40 < x < width and 0 < y < height - 40 for x, y in points)


def test_names_are_escaped_and_read_aloud():
    svg = convergence_plot([Series('<b> & "q"', [(1.0, 0.5), (8.0, 0.25)])])
    root = ElementTree.fromstring(svg)
    assert '<b> & "q"' in root.get("aria-label") and "0.25 after 8 s" in root.get("aria-label")
    assert '<b> & "q"' in ["".join(e.itertext()) for e in root.iter("text")]


def test_what_a_logarithm_cannot_show_is_left_out():
    points = [(0.0, 1.0), (1.0, 0.0), (2.0, float("nan")), (3.0, 0.5), (float("inf"), 1.0)]
    assert len(circles(convergence_plot([Series("a", points)]))) == 1
    assert convergence_plot([Series("a", points[:3])]) == "" and convergence_plot([]) == ""


@pytest.mark.parametrize("low, high", [(1.0, 3.0), (1e-7, 1e-1), (0.5, 2e5)])
def test_ticks_are_labelled(low, high):
    svg = convergence_plot([Series("a", [(low, high), (high, low)])])
    texts = ["".join(e.itertext()) for e in ElementTree.fromstring(svg).iter("text")]
    numbers = [t for t in texts if re.fullmatch(r"[\d.]+|(\d·)?10⁻?[⁰¹²³⁴⁵⁶⁷⁸⁹]+", t)]
    assert 4 <= len(numbers) <= 30
    assert "seconds" in texts and "relMSE" in texts
