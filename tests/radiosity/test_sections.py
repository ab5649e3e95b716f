"""Exact form factors of surfaces without end along y: crossed strings, lines of the periodic domain, and balances."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support.patches import cube
from support.tables import thinned

from etendue.radiosity import Patches, RadiosityError, SpiralPoints, exact_form_factors, form_factors
from etendue.radiosity.lines.abuffer import ABuffer


def prism(*ways, length=1.0, **properties):
    """Faces along lines through points of the plane x, z, with their fronts to the left."""
    segments = [ends for way in ways for ends in pairwise(way)]
    corners = [[(a[0], 0, a[1]), (b[0], 0, b[1]), (b[0], length, b[1]), (a[0], length, a[1])] for a, b in segments]
    faces = np.arange(4 * len(segments)).reshape(-1, 4)
    return Patches(np.array(corners, float).reshape(-1, 3), faces, periodic=(0, length), **properties)


def scattered(count, seed, size, **properties):
    """Segments at random places, many of which cross."""
    generator = np.random.default_rng(seed)
    begin = generator.uniform(0, 1, (count, 2))
    return prism(*np.stack([begin, begin + generator.normal(size=(count, 2)) * size], axis=1), **properties)


def test_parallel_plates_and_a_plate_between_them():
    w, h, b = 3.0, 2.0, 1.2
    plates = [(0, 0), (w, 0)], [(w, h), (0, h)]
    assert exact_form_factors(prism(*plates)).matrix[0, 1] == pytest.approx((np.hypot(w, h) - h) / w, abs=1e-14)
    screen = [((w - b) / 2, h / 2), ((w + b) / 2, h / 2)]
    found = exact_form_factors(prism(*plates, screen, obstacles=[2]))
    # Strings that pass the screen on either side of it.
    assert found.matrix[0, 1] == pytest.approx((np.hypot(w - b, h) - h) / w, abs=1e-14)
    # What the screen takes is what strings to its ends enclose, for the plate below and as backs.
    half = (np.hypot((w + b) / 2, h / 2) - np.hypot((w - b) / 2, h / 2)) / w
    np.testing.assert_allclose(found.dark, half, atol=1e-14)
    np.testing.assert_allclose(found.row_sums() + found.dark, 1, atol=1e-14)


@pytest.mark.parametrize("degrees", [20, 90, 150])
def test_wedges(degrees):
    angle = np.radians(degrees)
    found = exact_form_factors(prism([(2 * np.cos(angle), 2 * np.sin(angle)), (0, 0), (2, 0)], length=5.0))
    np.testing.assert_allclose(found.matrix.toarray(), (1 - np.sin(angle / 2)) * (1 - np.eye(2)), atol=1e-14)
    np.testing.assert_allclose(found.areas, 10)


def test_a_triangle_and_a_canyon():
    triangle = exact_form_factors(prism([(0, 0), (3, 0), (0, 4), (0, 0)]))
    np.testing.assert_allclose(triangle.matrix.toarray()[0], [0, (3 + 5 - 4) / 6, (3 + 4 - 5) / 6], atol=1e-14)
    np.testing.assert_allclose(triangle.row_sums(), 1, atol=1e-14)
    canyon = exact_form_factors(prism([(-5, 10), (0, 10), (0, 0), (8, 0), (8, 10), (9, 10)]))
    np.testing.assert_allclose(canyon.sky[[0, 2, 4]], [1, (np.hypot(8, 10) - 10) / 8, 1], atol=1e-14)
    np.testing.assert_allclose(canyon.sky[1], (8 + 10 - np.hypot(8, 10)) / 20, atol=1e-14)


def test_a_wall_in_the_middle_of_a_floor_divides_it():
    found = exact_form_factors(prism([(0, 0), (3, 0)], [(1, 0), (1, 1)], [(1, 1), (1, 0)]))
    parts = exact_form_factors(prism([(0, 0), (1, 0), (3, 0)], [(1, 0), (1, 1)], [(1, 1), (1, 0)]))
    both = (parts.matrix[0] + 2 * parts.matrix[1]) / 3
    np.testing.assert_allclose(found.matrix.toarray()[0, 1:], both.toarray().ravel()[2:], atol=1e-14)
    np.testing.assert_allclose(found.matrix.toarray()[0, 1], (1 + 1 - np.sqrt(2)) / 6, atol=1e-14)


def test_balances_of_segments_that_cross():
    found = exact_form_factors(scattered(200, 1, 0.2))
    np.testing.assert_allclose(found.row_sums() + found.dark, 1, atol=1e-10)
    assert found.reciprocity_error() < 1e-14 and found.dark.max() > 0.1


def test_sheets_of_two_sides():
    """The sides of both surfaces are those of each sheet."""
    one = exact_form_factors(scattered(20, 2, 0.4, two_sided=True))
    assert one.dark.max() == 0
    np.testing.assert_allclose(one.row_sums(), 1, atol=1e-11)


@pytest.mark.parametrize("seed", thinned(range(3), [0]))
def test_lines_of_the_endless_domain_agree(seed):
    patches = scattered(15, seed, 0.3)
    exact = exact_form_factors(patches)
    runs = []
    for k in range(6):
        factors = form_factors(ABuffer(patches, SpiralPoints(k, 512), 20000).cast(512, warn=False))
        runs.append(np.column_stack([factors.matrix.toarray(), factors.sky, factors.dark]))
    error = np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    off = np.mean(runs, axis=0) - np.column_stack([exact.matrix.toarray(), exact.sky, exact.dark])
    assert np.sqrt((off**2).mean()) < 1.5 * np.sqrt((error**2).mean()) < 2e-3


def outline(x, z, width, height):
    """The outside of a box."""
    return [(x, z), (x, z + height), (x + width, z + height), (x + width, z), (x, z)]


def test_boxes_in_contact_and_rooms_back_to_back():
    """Two boxes beside each other on the ground, and one on top; the same with lines."""
    patches = prism([(0, 0), (9, 0)], outline(1, 0, 2, 1), outline(3, 0, 2, 2), outline(1.5, 1, 1, 1))
    found = exact_form_factors(patches)
    assert found.dark.max() == 0 and abs(found.row_sums() - 1).max() < 1e-13
    ground, low, bottom = found.matrix.toarray()[0], found.matrix.toarray()[4], found.matrix.toarray()[8]
    assert ground[4] == pytest.approx(2 / 9, abs=1e-14) and low[0] == pytest.approx(1, abs=1e-14)
    assert found.matrix[3, 5] == pytest.approx(1, abs=1e-14)  # sides of both boxes
    assert bottom[0] == pytest.approx(1, abs=1e-14)
    cast = form_factors(ABuffer(patches, SpiralPoints(0, 1024), 40000).cast(1024))
    np.testing.assert_allclose(cast.matrix.toarray(), found.matrix.toarray(), atol=0.01)
    room = outline(0, 0, 1, 1)[::-1]
    rooms = exact_form_factors(prism(room, [(x + 1, z) for x, z in room])).matrix.toarray()
    np.testing.assert_allclose(rooms.sum(axis=1), 1, atol=1e-14)
    assert rooms[:4, 4:].max() == 0


def test_parts_are_strips():
    whole = prism([(0, 1), (0, 0), (3, 0), (3, 1)], length=2.0)
    parts = whole.subdivided(1.0)
    np.testing.assert_allclose(parts.areas, 1)
    assert len(parts) == 10 and parts.period == (0, 2)
    found, expected = exact_form_factors(parts), exact_form_factors(whole)
    np.testing.assert_allclose(np.bincount(parts.face, found.sky * parts.areas) / whole.areas, expected.sky, atol=1e-13)
    grouped = exact_form_factors(whole.subdivided(1.0, grouped=True))
    np.testing.assert_allclose(grouped.matrix.toarray(), expected.matrix.toarray(), atol=1e-13)
    cast = form_factors(ABuffer(parts, SpiralPoints(0, 512), 20000).cast(512))
    np.testing.assert_allclose(cast.matrix.toarray(), found.matrix.toarray(), atol=0.01)


def near_the_same(noise, seed):
    """A room with a box and a roof on it, whose ends differ by a little."""
    generator = np.random.default_rng(seed)
    walls = [(0, 0), (9, 0), (9, 6), (0, 6), (0, 0)]
    ways = pairwise(walls), pairwise([(3, 0), (3, 2), (5, 2), (5, 0)]), pairwise([(3, 2), (4, 4), (5, 2)])
    return prism(*(np.array(ends) + noise * generator.normal(size=(2, 2)) for way in ways for ends in way))


@pytest.mark.parametrize("noise", [1e-9, 5e-9, 1e-8, 3e-8, 1e-7])
def test_ends_that_are_nearly_the_same(noise):
    found, expected = (exact_form_factors(near_the_same(scale, 1)) for scale in (noise, 0.0))
    np.testing.assert_allclose(found.matrix.toarray(), expected.matrix.toarray(), atol=3 * noise)


def test_edges_that_cross_within_rounding_are_refused():
    with pytest.raises(RadiosityError, match="corners closer than 9e-08 are not told apart"):
        exact_form_factors(near_the_same(1e-8, 54))


def test_what_is_no_such_domain_is_refused():
    strip = prism([(0, 0), (1, 0)], [(1, 1), (0, 1)])
    with pytest.raises(RadiosityError, match="integrals cannot repeat a periodic domain"):
        exact_form_factors(Patches(strip.vertices, strip.faces, periodic=(0, 2)))  # with a gap after each repetition
    vertices, faces = cube(1).vertices, cube(1).faces
    with pytest.raises(RadiosityError, match="integrals cannot repeat a periodic domain"):
        exact_form_factors(Patches(vertices, faces, periodic=(0, 1)))
    with pytest.raises(RadiosityError, match="faces 0 and 1 lie on each other and face the same way"):
        exact_form_factors(prism([(0, 0), (2, 0)], [(1, 0), (3, 0)]))
