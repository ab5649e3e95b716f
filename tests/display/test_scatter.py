"""Projections are drawn where the points are, in a file that stands by itself."""

from __future__ import annotations

import re
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest

from etendue.display import Projection, projection_plot

SVG = "{http://www.w3.org/2000/svg}"


def test_points_are_where_they_belong():
    root = ElementTree.fromstring(projection_plot([Projection([0.0, 0.25], [0.0, 0.75], "a", "b")], "t"))
    square = root.find(f"{SVG}g/{SVG}rect")
    side = float(square.get("width"))
    path = root.find(f"{SVG}g/{SVG}path").get("d")
    places = [tuple(map(float, m)) for m in re.findall(r"M([\d.]+) ([\d.]+)h0", path)]
    assert places == [(0.0, side), (side / 4, side / 4)]  # y goes up


@pytest.mark.parametrize(("count", "columns", "rows"), [(1, 1, 1), (4, 4, 1), (6, 4, 2)])
def test_squares_do_not_overlap_and_lie_inside(count, columns, rows):
    panels = [Projection(np.zeros(1), np.zeros(1), f"x{i}", f"y{i}", "note") for i in range(count)]
    root = ElementTree.fromstring(projection_plot(panels, "title"))
    places = [
        tuple(float(v) for v in re.search(r"translate\(([\d.]+) ([\d.]+)\)", g.get("transform")).groups())
        for g in root.findall(f"{SVG}g")
    ]
    side = float(root.find(f"{SVG}g/{SVG}rect").get("width"))
    assert len({x for x, _ in places}) == columns and len({y for _, y in places}) == rows and len(places) == count
    for x, y in places:
        assert 0 < x < float(root.get("width")) - side and 0 < y < float(root.get("height")) - side
    for (a, b), (c, d) in pairwise(places):
        assert abs(a - c) > side or abs(b - d) > side


def test_names_are_escaped_and_read_aloud():
    root = ElementTree.fromstring(projection_plot([Projection([0.5], [0.5], "<x>", "y & z", "D* 0.1")], "a < b"))
    assert root.get("aria-label") == "a < b: y & z over <x>, D* 0.1"
    assert {"a < b", "<x>", "y & z", "D* 0.1"} <= {text.text for text in root.iter(f"{SVG}text")}
