"""Scenes beside the one that is rendered: objects of them that are kept, and what they cost."""

from __future__ import annotations

import os
import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared
from support.tables import thinned

from etendue import methods
from etendue.scene import graph

#: Settings that leave little to do.
SMALL = {name: {"bootstrap": 1 << 12, "samples_per_pass": 16} for name in ("pssmlt", "mmlt", "film_metropolis")}
#: Parts of a scene that someone may keep.
KEPT = {
    "emitters": lambda scene: scene.emitters(),
    "shapes": lambda scene: scene.shapes(),
    "materials": lambda scene: [shape.bsdf() for shape in scene.shapes()],
    "textures": lambda scene: [one for one in graph.below(scene) if isinstance(one, mi.Texture)],
    "sensors": lambda scene: scene.sensors(),
    "parameters": lambda scene: list(dict(mi.traverse(scene)).values()),
}
KEPT["all"] = lambda scene: [keep(scene) for kind, keep in KEPT.items() if kind != "all"]


def other() -> mi.Scene:
    """A scene with lamps of many kinds, and materials that the room does not have."""
    names = ("disk", "textured", "mesh", "cylinder", "sphere", "focused", "point", "spot", "projector", "envmap")
    found = {"type": "scene", "sensor": scenes.camera(), "floor": scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)}
    found |= {f"lamp {name}": scenes.EMITTERS[name]()["light"] for name in names}
    found |= {f"thing {name}": scenes.thing(name, (0.0, 0.3, 0.0)) for name in ("principled", "plastic", "bumpmap")}
    found["beam"] = {"type": "rectangle", "emitter": {"type": "directionalarea", "radiance": scenes.rgb(1, 1, 1)}}
    return scenes.load(found).scene


def own() -> mi.Scene:
    """A room with a lamp of each kind that is treated by itself."""
    lamps = {name: scenes.EMITTERS[name]()["light"] for name in ("sphere", "point", "constant", "rectangle")}
    found = {"type": "scene", "sensor": scenes.camera(), "floor": scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)}
    return scenes.load(found | lamps | {"ball": scenes.thing("roughconductor", (0.0, 0.3, 0.0))})


def picture(problem, name: str) -> np.ndarray:
    return go(prepared(problem, name, **{"samples_per_pass": 4} | SMALL.get(name, {})), 1).mean


def keep_and_render(kind: str, names: list[str]) -> None:
    """In a process of its own: pictures while something is kept of a scene that is gone, as before."""
    problem = own()
    before = {name: picture(problem, name) for name in names}
    kept = KEPT[kind](other())  # the scene itself is not kept
    assert kept
    for name in names:
        np.testing.assert_allclose(picture(problem, name), before[name], rtol=1e-3, atol=1e-4)


def in_a_child(kind: str, names: list[str]) -> None:
    code = f"import etendue.core; etendue.core.use_variant({mi.variant()!r}); import test_other_scenes as t; "
    code += f"t.keep_and_render({kind!r}, {names!r})"
    here = os.path.dirname(__file__)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([here, os.path.dirname(here), *sys.path])}
    done = subprocess.run([sys.executable, "-X", "faulthandler", "-c", code], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]


@pytest.mark.parametrize(
    "kind", [kind if kind == "emitters" else pytest.param(kind, marks=pytest.mark.slow) for kind in KEPT]
)
def test_parts_of_a_scene_that_is_gone_do_no_harm(kind):
    """An area light that outlives its scene has lost its shape: whoever calls it crashes the process."""
    in_a_child(kind, ["path", "bpt"] if kind == "emitters" else ["path"])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(methods.table()))
def test_lights_of_a_scene_that_is_gone_are_met_by_no_method(name):
    in_a_child("emitters", [name])


@pytest.mark.parametrize("name", thinned(["path", "bpt"], ["path"]))
def test_other_scenes_are_no_part_of_kernels(name):
    """Their materials and lamps are not visited: no kernel is compiled anew for their sake."""
    problem = scenes.room("sphere", scenes.FEW)
    sizes = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for _ in range(2):
            dr.kernel_history_clear()
            picture(problem, name)
            kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
            sizes.append(sum(one["operation_count"] for one in kernels if "operation_count" in one))
            others = [scenes.room("sphere", tuple(group)) for group in (scenes.GROUPS["rough"], ("ward", "plastic"))]
            others.append(scenes.room("mixed", ("blendbsdf",)))
    assert len(others) == 3
    assert sizes[1] == sizes[0]
