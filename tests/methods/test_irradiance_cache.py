"""The method ``irradiance_cache``: light as that of ``path``, at a share of its noise; records that are carried on."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.running import Stepped, go, prepared, run
from support.scenes import camera, diffuse, furnace, rgb

from etendue.core import CheckpointError, OptionError
from etendue.film import relative_mse
from etendue.scene import load
from etendue.transport import IrradianceCache

RADIANCE, ALBEDO = 0.8, 0.5


@pytest.mark.parametrize("after", [0, 1])
def test_inside_a_furnace(after):
    """L / (1 - a): all light but that of the walls themselves, a L, is from records, which hit or miss nothing."""
    found = run(furnace("box", RADIANCE, ALBEDO), "irradiance_cache", passes=6, samples=64, map_after=after)
    pictures = found.images.mean(axis=(1, 2, 3))
    exact = RADIANCE / (1 - ALBEDO)
    # Records are the same in all passes: 12 paths or more into each of 768 strata, with a deviation of 0.4.
    assert abs(pictures.mean() - exact) < 4 * pictures.std(ddof=1) / np.sqrt(6) + 0.005 * exact


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["cornell-box", "cornell-glass"])
def test_the_light_of_path(scene):
    """In the mean within 1.5 %, also of light through glass onto diffuse surfaces, which no light point finds."""
    problem = load(scene, size=(32, 32))
    exact = run(problem, "path", passes=4, samples=1024)
    error = exact.images.mean(axis=(1, 2, 3)).std(ddof=1) / 2
    pictures = [run(problem, "irradiance_cache", passes=1, samples=256, seed=seed).mean.mean() for seed in range(4)]
    error = np.hypot(error, np.std(pictures, ddof=1) / 2)
    assert abs(np.mean(pictures) - exact.mean.mean()) < 4 * error + 0.015 * exact.mean.mean()
    assert error < 0.01 * exact.mean.mean()


def test_a_lamp_in_a_mirror_counts_once():
    """On a floor, light of a lamp comes directly, from light points, and by a mirror, from paths of the records."""

    def plate(*turns, scale, **more):
        place = mi.ScalarTransform4f()
        for turn in turns:
            place = place @ turn
        return {"type": "rectangle", "to_world": place.scale(scale), **more}

    move, turn = mi.ScalarTransform4f().translate, mi.ScalarTransform4f().rotate
    problem = load(
        {
            "type": "scene",
            "floor": plate(turn([1, 0, 0], -90), scale=1.0, bsdf=diffuse(0.5, 0.5, 0.5)),
            "lamp": plate(move([0.3, 0.8, 0]), turn([1, 0, 0], 90), scale=0.3, bsdf=diffuse(0.0, 0.0, 0.0))
            | {"emitter": {"type": "area", "radiance": rgb(4.0, 2.0, 1.0)}},
            "mirror": plate(move([1, 1, 0]), turn([0, 1, 0], -90), scale=1.0)
            | {"bsdf": {"type": "conductor", "material": "none"}},
            "sensor": camera([0, 3, 0.1], [0, 0, 0], fov=30.0, size=(8, 8)),
        }
    )
    exact = run(problem, "path", passes=4, samples=4096).mean
    direct = run(problem, "path", passes=4, samples=1024, max_depth=2).mean
    found = np.mean([run(problem, "irradiance_cache", 1, 1024, seed=seed, rays=3072).mean for seed in range(4)], axis=0)
    assert exact.mean() > 1.08 * direct.mean()  # the mirror matters
    assert found.mean() == pytest.approx(exact.mean(), rel=0.01)


@pytest.mark.slow
def test_less_noise_than_path():
    """At as many camera paths. Measured: 0.00021 and 0.0040 in pixels of 192 x 192."""
    problem = load("cornell-box", size=(64, 64))
    exact = run(problem, "path", passes=2, samples=1024, seed=9).mean
    errors = [relative_mse(run(problem, m, 1, 16).mean, exact) for m in ("irradiance_cache", "path")]
    assert errors[0] < 0.3 * errors[1]


@pytest.mark.slow
def test_depth_ends_the_paths_of_records():
    problem = load("cornell-box", size=(16, 16))
    for depth in (1, 2, 3):
        exact = run(problem, "path", passes=2, samples=2048, max_depth=depth).mean.mean()
        found = run(problem, "irradiance_cache", passes=1, samples=1024, max_depth=depth).mean.mean()
        assert found == pytest.approx(exact, rel=0.015), depth


def test_records_are_carried_on():
    problem = load("cornell-box", size=(24, 24))
    whole = go(prepared(problem, "irradiance_cache", samples_per_pass=4), 3)
    first, last = (prepared(problem, "irradiance_cache", samples_per_pass=4) for _ in range(2))
    go(first, 2)
    last.restore(first.state())
    np.testing.assert_allclose(last.step(2, 1).mean(), whole.images[2], rtol=1e-6)
    many = len(first.state()["records"])
    go(first, 1)
    assert many <= len(first.state()["records"]) < 2 * many  # later passes need few
    with pytest.raises(CheckpointError, match="the irradiance cache in the checkpoint is damaged"):
        Stepped(first.method).restore({"records": np.zeros((3, 5))})
    with pytest.raises(OptionError, match="nearest=9, above farthest=3"):
        prepared(problem, "irradiance_cache", nearest=9.0, farthest=3.0)


def test_records_in_grids_are_all_that_are_near():
    """Sums over grids of records of similar reach, against sums over all records."""
    cache, source = IrradianceCache((0.01, 2.0), 0.4, strata=(4, 8)), np.random.default_rng(3)

    def unit(count):
        v = source.normal((0, 0, 4), size=(count, 3))
        return v / np.linalg.norm(v, axis=1, keepdims=True)

    for reach in (0.05, 0.3, 4.0):
        shape = (60, 4, 8)
        light = source.uniform(0.5, 1.5, (*shape, 3))
        cache.add(source.uniform(-1, 1, (60, 3)), unit(60), light, np.full(shape, reach))
    p, n = source.uniform(-1, 1, (500, 3)), unit(500)
    values, weight = cache(p, n)
    assert len(cache._levels[1]) >= 3
    at, normal, e, rotation, translation, reach = np.split(cache.records, [3, 6, 9, 18, 27], axis=1)
    offset = p[:, None] - at
    far = np.linalg.norm(offset, axis=2) / reach[:, 0] + np.sqrt(np.maximum(1 - n @ normal.T, 0)) / 0.4
    used = (far < 1) & (np.einsum("pra,pra->pr", offset, n[:, None] + normal) > -2 * 0.05 * reach[:, 0])
    w = np.where(used, 1 / np.maximum(far, 1e-4) - 1, 0)
    turned = np.einsum("pra,rca->prc", np.cross(normal, n[:, None]), rotation.reshape(-1, 3, 3))
    moved = np.einsum("pra,rca->prc", offset, translation.reshape(-1, 3, 3))
    expected = (w[..., None] * np.maximum(e + turned + moved, 0)).sum(axis=1)
    np.testing.assert_allclose(weight, w.sum(axis=1), rtol=1e-3, atol=1e-3)
    known = w.sum(axis=1) > 0.01
    assert np.count_nonzero(known) > 300
    expected = expected[known] / w.sum(axis=1)[known, None]
    np.testing.assert_allclose(values[known], expected, rtol=2e-3, atol=1e-4)
