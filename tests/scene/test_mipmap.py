"""Texture ``mipmap``: the bitmap where no footprint is known, means of texels where one is, and what methods know."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import run
from support.statistics import assert_agree
from support.tables import thinned

from etendue.scene import Problem
from etendue.transport.walk import set_footprint

PIXELS = np.random.default_rng(1).random((32, 64, 3)).astype(np.float32)


def texture(kind: str, pixels: np.ndarray = PIXELS, **how: Any) -> dict[str, Any]:
    return {"type": kind, "bitmap": mi.Bitmap(pixels), "raw": True, **how}


def at(uv: np.ndarray, width: float = 0.0) -> mi.SurfaceInteraction3f:
    """Places with a square footprint of a width in (u, v)."""
    si = dr.zeros(mi.SurfaceInteraction3f, uv.shape[1])
    si.uv = mi.Point2f(*uv.astype(np.float32))
    si.duv_dx, si.duv_dy = mi.Vector2f(width, 0.0), mi.Vector2f(0.0, width)
    return si


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror"])
@pytest.mark.parametrize("channels", [1, 3])
def test_without_a_footprint_it_is_the_bitmap(wrap, channels):
    how = {"wrap_mode": wrap, "to_uv": mi.ScalarTransform3f().rotate(20).scale([2, 3])}
    # A GPU's own interpolation has weights of eight bits.
    kinds = {"mipmap": {}, "bitmap": {"accel": False}}
    ours, theirs = (mi.load_dict(texture(kind, PIXELS[:27, :, :channels], **how, **o)) for kind, o in kinds.items())
    si = at(np.random.default_rng(2).uniform(-2.0, 2.0, (2, 4000)))
    for name in ("eval", "eval_1", "eval_3") if channels == 3 else ("eval", "eval_1"):
        found, expected = (np.array(getattr(one, name)(si)) for one in (ours, theirs))
        np.testing.assert_allclose(found, expected, atol=2e-4)
    assert np.array(ours.mean()) == pytest.approx(np.array(theirs.mean()))
    assert list(ours.resolution()) == list(theirs.resolution())


@pytest.mark.parametrize("level", [1, 2, 3, 5])
def test_levels_are_means_of_texels(level):
    """In the middle of their texels, for footprints of 2^level texels of the picture along v, the shorter side."""
    pixels = np.repeat(PIXELS[:, :1], 64, axis=1)
    side = 2**level
    means = pixels.reshape(32 // side, side, 64, 3).mean(axis=(1, 2))
    rows = (np.arange(32 // side) + 0.5) / (32 // side)
    values = {wide: np.array(mi.load_dict(texture("mipmap", pixels)).eval(
        _with_sides(rows, wide * side / 64, side / 32))).T for wide in (1.0, 7.0)}  # fmt: skip
    for value in values.values():
        np.testing.assert_allclose(value, means, atol=1e-5)
    between = mi.load_dict(texture("mipmap", pixels)).eval(_with_sides(rows, 1.0, side / 32 * 2**-0.5))
    finer = mi.load_dict(texture("mipmap", pixels)).eval(_with_sides(rows, 1.0, side / 64))
    np.testing.assert_allclose(np.array(between).T, 0.5 * (means + np.array(finer).T), atol=1e-5)


def _with_sides(rows: np.ndarray, u: float, v: float) -> mi.SurfaceInteraction3f:
    si = at(np.stack([np.full(len(rows), 0.3), rows]))
    si.duv_dx, si.duv_dy = mi.Vector2f(u, 0.0), mi.Vector2f(0.0, v)
    return si


def test_odd_pictures_keep_their_mean():
    pixels = np.random.default_rng(4).random((13, 5, 1)).astype(np.float32)
    made = mi.load_dict(texture("mipmap", pixels))
    found = np.array(made.eval_1(at(np.random.default_rng(5).random((2, 50)), 100.0)))
    np.testing.assert_allclose(found, pixels.mean(), rtol=1e-5)


def test_what_is_no_number_is_no_crash():
    uv = np.array([[np.nan, np.inf, 1e30, 0.5], [0.5, -np.inf, -1e30, np.nan]])
    for width in (0.0, np.nan, np.inf):
        dr.eval(mi.load_dict(texture("mipmap")).eval(at(uv, width)))


def test_footprints_on_surfaces():
    """A beam that meets a plate of 4 by 4 at 60 degrees is twice as long as wide."""
    plate = mi.load_dict({"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(2.0)})
    ray = mi.Ray3f(mi.Point3f(0.0, -(3.0**0.5), 1.0), dr.normalize(mi.Vector3f(0.0, 3.0**0.5, -1.0)))
    si = plate.ray_intersect(ray)
    set_footprint(si, ray.d, mi.Float(0.1))
    np.testing.assert_allclose(np.abs(np.array(si.duv_dx)).ravel(), (0.1 / 4, 0.0), atol=1e-6)
    np.testing.assert_allclose(np.abs(np.array(si.duv_dy)).ravel(), (0.0, 0.2 / 4), atol=1e-6)


def floor(kind: str) -> Problem:
    """A checkered floor up to the horizon, 128 squares in the depth of what is seen."""
    checkers = ((np.indices((256, 256)) // 4).sum(axis=0) % 2)[:, :, None].astype(np.float32) * [[[0.8, 0.6, 0.4]]]
    far = mi.ScalarTransform3f().scale([8, 8])
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 0.4, 0.0), 40.0)}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 30.0, up=True)
    scene["floor"]["bsdf"]["reflectance"] = texture(kind, checkers, to_uv=far)
    scene["ball"] = {"type": "sphere", "center": [0, 0.5, 0], "radius": 0.5, "bsdf": scenes.diffuse(0.4, 0.4, 0.4)}
    return scenes.load(scene | {"sky": {"type": "constant"}})


@pytest.mark.parametrize("method", thinned(["path", "vcm"], ["path"]))
def test_pictures_have_less_noise_and_the_same_means(method):
    """Blocks are those of the bitmap; the variance of pixels is less than half (0.32 to 0.37 for three seeds)."""
    sharp, soft = (run(floor(kind), method, passes=8, samples=4, max_depth=3) for kind in ("bitmap", "mipmap"))
    assert_agree(soft.images, run(floor("bitmap"), "path", passes=8, samples=256, max_depth=3).images, method)
    variance = [result.images.var(axis=0, ddof=1).mean() for result in (soft, sharp)]
    assert variance[0] < 0.5 * variance[1]


def test_pictures_of_8_bits_are_decoded():
    pixels = np.random.default_rng(6).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    kinds = {"mipmap": {}, "bitmap": {"accel": False}}
    ours, theirs = (mi.load_dict({"type": kind, "bitmap": mi.Bitmap(pixels), **o}) for kind, o in kinds.items())
    si = at((np.indices((16, 16)).reshape(2, -1) + 0.5) / 16)
    np.testing.assert_allclose(np.array(ours.eval(si)), np.array(theirs.eval(si)), atol=2e-3)


def test_misspelt_properties_are_named():
    with pytest.raises(RuntimeError, match="wrap_mod"):
        mi.load_dict(texture("mipmap", wrap_mod="mirror"))
