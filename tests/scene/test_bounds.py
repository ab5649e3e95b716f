"""Boxes around scenes."""

import mitsuba as mi
import numpy as np
import pytest
from support import scenes

import etendue
from etendue.scene import corners_of


def room():
    """A room of rectangles of one material, with an open side, under a sky."""

    def wall(*turn):
        place = scenes.transform()
        for axis, angle in turn:
            place = place.rotate(axis, angle)
        return {"type": "rectangle", "to_world": place.translate([0, 0, -1]), "bsdf": scenes.diffuse(0.5, 0.5, 0.5)}

    return {
        "type": "scene",
        "camera": scenes.camera((0, 0, 0.9), (0, -0.3, 0), 75.0, size=(8, 8)),
        "floor": wall(([1, 0, 0], -90)),
        "ceiling": wall(([1, 0, 0], 90)),
        "left": wall(([0, 1, 0], 90)),
        "back": wall(),
        "ball": {"type": "sphere", "radius": 0.2, "center": [0.3, -0.8, 0], "bsdf": scenes.diffuse(0.2, 0.2, 0.2)},
        "sky": {"type": "constant", "radiance": 1.0},
    }


def test_merged_rectangles_are_in_the_box():
    loaded = mi.load_dict(room())
    assert len(loaded.shapes()) == 2  # Mitsuba has merged them
    for corner, expected in zip(corners_of(loaded), (-1.0, 1.0), strict=True):
        np.testing.assert_allclose(corner, expected, atol=1e-6)


@pytest.mark.parametrize("method", ["path", "bpt", "light"])
def test_they_hide_the_sky(method):
    """The sphere of Mitsuba's sky ends before them: light came through the walls."""
    merged, alone = (
        etendue.render(source, method, spp=256, seed=1, max_depth=3).image[..., :3].mean()
        for source in (mi.load_dict(room()), room())
    )
    assert merged == pytest.approx(alone, rel=0.01)
