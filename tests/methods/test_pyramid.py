"""The technique pyramid: its parts are the picture, and each technique alone estimates what it can make."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run
from support.statistics import assert_agree
from support.tables import thinned

from etendue.core import OptionError
from etendue.film import LONGER, Technique
from etendue.methods import store

METHODS = {
    "bpt cache": ("bpt", {}),
    "bpt path": ("bpt", {"light_source": "path", "heuristic": "power"}),
    "bpm": ("bpm", {"radius": 0.02}),
    "vcm": ("vcm", {"radius": 0.02, "next_events": 2, "connections": 2}),
}


def still(sheets: bool = False) -> Any:
    """A diffuse floor, ball and lamp that do not touch, so that no connection is infinitely short; ``sheets`` hangs
    surfaces that nobody sees between them."""
    scene: scenes.Dict = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 1.2, 5.0), (0.0, 1.2, 0.0), 40.0),
        "floor": {
            "type": "rectangle",
            "to_world": scenes.transform().rotate([1, 0, 0], -90).scale(1.5),
            "bsdf": scenes.diffuse(0.6, 0.5, 0.4),
        },
        "ball": {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.5, "bsdf": scenes.diffuse(0.7, 0.7, 0.7)},
        "light": {"type": "sphere", "center": [0.6, 2.3, 0.4], "radius": 0.4, "emitter": scenes._area(4, 4, 4)},
    }
    if sheets:
        for name, place in (
            ("low", scenes.transform().translate([0, 0.1, 0]).rotate([1, 0, 0], -90).scale(2.0)),
            ("high", scenes.transform().translate([0, 2.0, 0]).rotate([1, 0, 0], -90).scale(2.0)),
        ):
            scene[name] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "null"}}
    return scenes.load(scene)


def layers(problem: Any, method: str, passes: int = 6, samples: int = 256, **settings: Any) -> dict[str, np.ndarray]:
    """Pass by pass, all layers: (passes, height, width, 3)."""
    runner = prepared(problem, method, samples_per_pass=samples, pyramid=True, **settings)
    steps = [runner.step(i, 1) for i in range(passes)]
    return {name: np.stack([m.mean(name) for m in steps]) for name in steps[0].sums}


def weighted_sum(measurement: Any) -> np.ndarray:
    parts = [n for n in measurement.sums if n == LONGER or ((found := Technique.of_layer(n)) and found[1])]
    assert len(parts) >= 3
    return sum(measurement.mean(name) for name in parts)


@pytest.mark.parametrize("name", METHODS)
def test_the_weighted_layers_sum_to_the_image(name):
    method, settings = METHODS[name]
    problem = scenes.room("mixed", scenes.FEW, rfilter="gaussian")
    depth = {} if name == "bpm" else {"pyramid_depth": 3}  # layers are what takes long to compile
    measurement = run(problem, method, passes=2, samples=4, pyramid=True, **depth, **settings).measurement
    np.testing.assert_allclose(weighted_sum(measurement), measurement.mean(), rtol=1e-5, atol=2e-6)
    assert measurement.mean(LONGER).max() > 0.0


def test_the_sum_with_crossed_surfaces_groups_and_families():
    """Light paths in groups, technique families beside the techniques, materials that light passes unbent."""
    problem = scenes.room("sphere", ("mask", "cutout", "conductor"))
    settings = {"radius": 0.02, "split_layers": True, "pyramid": True, "pyramid_depth": 3}
    runner = prepared(problem, "vcm", samples_per_pass=4, **settings)
    runner.restore(runner.state() | {"groups": 3})
    measurement = go(runner, 2).measurement
    np.testing.assert_allclose(weighted_sum(measurement), measurement.mean(), rtol=1e-5, atol=2e-6)
    families = sum(measurement.mean(f) for f in ("emission", "next_event", "connection", "splat", "merge"))
    np.testing.assert_allclose(families, measurement.mean(), rtol=1e-5, atol=2e-6)


@pytest.mark.parametrize("name", ["bpt cache", "bpm", "vcm"])
def test_the_picture_is_the_same_with_and_without(name):
    """A pyramid casts more shadow rays, but decides about none that the picture is made of."""
    method, settings = METHODS[name]
    problem = scenes.room("mixed", scenes.FEW)
    pictures = []
    for pyramid in (False, True):
        runner = prepared(problem, method, samples_per_pass=4, pyramid=pyramid, pyramid_depth=3, **settings)
        runner._dark = 0.01  # measured by the pilot otherwise, where it differs a little
        pictures.append(go(runner, 2).mean)
    np.testing.assert_allclose(*pictures, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("source", thinned(["cache", "path"], ["cache"]))
def test_techniques_alone_agree_on_the_paths_of_a_length(source):
    """Each can make every path here; what differs is the noise."""
    found = layers(
        still(), "bpt", samples=2048, pyramid_depth=3, light_source=source, light_paths=2.0, direct_light="all"
    )
    for edges, precision in ((2, 0.03), (3, 0.1)):
        alone = [Technique(False, s, edges + 1 - s).layer(weighted=False) for s in range(edges + 1)]
        direct = Technique(False, 1, edges).layer(weighted=False)
        for name in alone:
            if name != direct:
                assert_agree(found[name], found[direct], (name, direct), block=8, precision=precision)


def test_merges_alone_agree_with_next_event_and_vanish_with_the_radius():
    """Consistent: each alone finds all light of its length; its weight falls with the disc's area."""
    shares = []
    for radius in (0.04, 0.01):
        settings = {"radius": radius, "radius_unit": "absolute", "alpha": 1.0, "eta_discount": 0.01, "pyramid_depth": 3}
        settings["diffuse_photons"] = 1.0
        found = layers(still(), "vcm", light_paths=2.0, direct_light="all", **settings)
        for edges, precision in ((2, 0.03), (3, 0.06)):
            direct = found[Technique(False, 1, edges).layer(weighted=False)].mean()
            for t in range(2, edges + 1):
                merged = Technique(True, edges + 2 - t, t).layer(weighted=False)
                np.testing.assert_allclose(found[merged].mean(), direct, rtol=precision)
        weighted = [name for name in found if name.startswith("m") and "unweighted" not in name]
        assert len(weighted) == 3
        shares.append(sum(found[name].mean() for name in weighted) / found["image"].mean())
    assert shares[0] > 1e-3
    assert 12.0 < shares[0] / shares[1] < 17.0  # the areas differ by 16


@pytest.mark.slow
@pytest.mark.parametrize("direct", ["next_event", "all"])
def test_crossed_surfaces_are_no_vertices(direct):
    """Surfaces that nobody sees, between camera, lamp, floor and ball: every technique keeps its s, t and its share."""
    settings = {"radius": 0.03, "radius_unit": "absolute", "alpha": 1.0, "pyramid_depth": 3, "light_paths": 2.0}
    plain = layers(still(), "vcm", samples=1024, direct_light=direct, **settings)
    crossed = layers(still(sheets=True), "vcm", samples=1024, direct_light=direct, **settings)
    assert list(plain) == list(crossed)
    more = ("s2_t1", "m2_t2", "m2_t3") if direct == "all" else ()
    assert [name for name in plain if name in ("s2_t1", "m2_t2", "m2_t3")] == list(more)
    short = ("s0_t2", "s0_t3", "s1_t2", *more[:2])
    for name in (*short, "s1_t3", "s2_t2", "s3_t1", "m3_t2", *more[2:]):
        for layer in (name, name + "_unweighted"):
            precision = 0.05 if name in short else 0.2
            assert_agree(crossed[layer], plain[layer], layer, block=8, precision=precision)


def test_layers_are_those_of_the_techniques_in_use():
    problem = still()
    names = {
        method: set(run(problem, method, passes=1, samples=1, pyramid=True, **settings).measurement.sums)
        for method, settings in (
            ("bpm", {"pyramid_depth": 2}),
            ("bpt", {"pyramid_depth": 3, "connections": 0, "direct_light": "all"}),
            ("vcm", {"pyramid_depth": 3, "merge_first": False, "direct_light": "all"}),
        )
    }
    expected = {
        "bpm": "s0_t2 s0_t3 m2_t2",
        "bpt": "s0_t2 s0_t3 s1_t2 s2_t1 s0_t4 s1_t3 s3_t1",
        "vcm": "s0_t2 s0_t3 s1_t2 s2_t1 s0_t4 s1_t3 s2_t2 s3_t1 m2_t3",
    }
    for method, words in expected.items():
        alone = {f"{name}_unweighted" for name in words.split()}
        assert names[method] == {"image", LONGER} | set(words.split()) | alone
    assert set(run(problem, "vcm", passes=1, samples=1).measurement.sums) == {"image"}


def test_a_sensor_without_splats_has_no_layers_of_them():
    problem = scenes.room("sphere", ("diffuse",), sensor="orthographic")
    measurement = run(problem, "bpt", passes=1, samples=4, pyramid=True).measurement
    assert not any("_t1" in name for name in measurement.sums)
    np.testing.assert_allclose(weighted_sum(measurement), measurement.mean(), rtol=1e-5, atol=2e-6)


def test_memory_is_checked_first(monkeypatch):
    problem = still()
    problem.memory = 1_500_000
    with pytest.raises(OptionError, match=r"depth 5 at 16x12 needs 1 MB, too much for a memory limit of 2 MB.*to 2 MB"):
        prepared(problem, "vcm", pyramid=True, direct_light="all")
    problem.memory = None
    monkeypatch.setattr(store, "free_memory", lambda: 500_000)
    with pytest.raises(OptionError, match="needs 1 MB, but only 0 MB are free; lower pyramid_depth"):
        prepared(problem, "vcm", pyramid=True, direct_light="all")
    prepared(problem, "vcm", pyramid=True, pyramid_depth=1)
