"""Kernels that another process, or another pass, finds in the cache."""

import os
import re
import subprocess
import sys
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared
from support.tables import thinned

from etendue import methods
from etendue.core import as_array

#: With more work per pass than the defaults leave to so small a picture.
_SETTINGS: dict[str, dict[str, Any]] = {
    "guided": {"cell_samples": 500},
    "pssmlt": {"samples_per_pass": 32, "bootstrap": 1 << 13},
    "mmlt": {"samples_per_pass": 32, "bootstrap": 1 << 13},
    "film_metropolis": {"samples_per_pass": 64, "bootstrap": 1 << 13},
}


@pytest.mark.parametrize("name", thinned(sorted(methods.table()), ("guided", "vegas", "sppm", "vcm", "ambient_path")))
def test_kernels_read_aligned_memory(name: str) -> None:
    """Memory that NumPy gave is aligned by chance, and the alignment is compiled into the kernels that read it."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        go(prepared(scenes.room("rectangle", scenes.FEW), name, 1, **_SETTINGS.get(name, {})), 2, 1)
        kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    texts = {id(one): one["ir"].getvalue() for one in kernels}
    if not mi.variant().startswith("cuda"):  # where loads are written in another form
        assert any(re.search(r"load <\d+ x [^\n]*align \d+", text) for text in texts.values())
    reading = [one for one in kernels if re.search(r"load <\d+ x [^\n]*align 1\b", texts[id(one)])]
    # Those that copy such memory are short, and the same for all scenes.
    assert kernels and not [one["size"] for one in reading if one["operation_count"] > 10]


def room_of_nine(seed: int) -> dict[str, Any]:
    """Nine lamps and nine balls at random."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera(size=(16, 12))}
    for k, (x, y, size) in enumerate(np.random.default_rng(seed).uniform(0.1, 0.9, (9, 3)).tolist()):
        place = scenes.transform().translate([2 * x - 1, 1.5, y]).rotate([1, 0, 0], 90).scale(0.3 * size)
        scene[f"lamp{k}"] = {"type": "rectangle", "to_world": place, "emitter": scenes._area(x, y, size)}
        ball = {"type": "sphere", "center": [x, size, -y], "radius": 0.1 * size}
        scene[f"ball{k}"] = ball | {"bsdf": scenes.diffuse(x, y, size)}
    return scene


def launched(least: int = 0) -> set[str]:
    """Identities of the kernels since the last call that have at least so many operations."""
    kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    return {one["hash"] for one in kernels if one["operation_count"] >= least}


def test_no_number_of_a_scene_needs_a_kernel_to_be_read() -> None:
    """With thousands of shapes, loading would take minutes."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        scenes.load(room_of_nine(1))
        first = launched()
        scenes.load(room_of_nine(2))
        assert first and launched() <= first


def pilot_and_pass(name: str, samples: int) -> None:
    problem = scenes.load(room_of_nine(1))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        runner = prepared(problem, name, 1, samples_per_pass=samples)
        pilot = launched(1000)
        go(runner, 1, 1)
        walks = launched(1000)
    assert len(walks) == 2 and walks <= pilot, (walks, pilot)


@pytest.mark.parametrize(
    ("name", "samples"), thinned([("vcm", 4), ("vcm", 1), ("bpt", 4), ("bpt", 1)], [("vcm", 4), ("bpt", 1)])
)
def test_a_pilot_shares_the_kernels_of_passes(name: str, samples: int) -> None:
    """Of passes that learn emission, of several camera paths per pixel and of one; in a process of its own, whose first
    kernels are those of the pilot."""
    code = f"import etendue.core; etendue.core.use_variant({mi.variant()!r}); import test_kernels as t; "
    code += f"t.pilot_and_pass({name!r}, {samples})"
    here = os.path.dirname(__file__)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([here, os.path.dirname(here), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]


#: Parameters that a user may change in a loaded scene, of lamps, camera, surfaces and materials.
CHANGED = (
    "lamp.emitter.radiance.value",
    "lamp.to_world",
    "ball.emitter.radiance.value",
    "ball.to_world",
    "point.intensity.value",
    "point.position",
    "sky.radiance.value",
    "sensor.to_world",
    "sensor.x_fov",
    "floor.to_world",
    "floor.bsdf.reflectance.value",
    "metal.bsdf.alpha.value",
    "metal.to_world",
)
#: Settings, two values each.
SETTINGS = {"radius": (0.004, 0.007), "clamp": (2.0, 3.0)}


def stage(lamps: tuple[str, ...] = ("lamp", "ball", "point", "sky")) -> Any:
    kinds = {"lamp": "rectangle", "ball": "sphere", "point": "point", "sky": "constant"}
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera()}
    scene |= {name: scenes.EMITTERS[kinds[name]]()["light"] for name in lamps}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)
    scene["metal"] = scenes.thing("roughconductor", (0.0, 0.3, 0.0))
    return scenes.load(scene)


def kernels_of(problem: Any, name: str, seed: int = 1, first: int = 0, **settings: Any) -> set[str]:
    """Identities of the kernels of a picture; those on disk count, too."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        go(
            prepared(problem, name, seed, **{"samples_per_pass": 4} | _SETTINGS.get(name, {}) | settings),
            1,
            seed,
            first,
        )
        return {one["hash"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT}


def change(parameters: Any, key: str) -> None:
    value = parameters[key]
    if "to_world" in key:
        parameters[key] = mi.Transform4f().translate([0.01, 0.002, 0.003]) @ mi.Transform4f(value.matrix)
    else:
        parameters[key] = type(value)(0.97 * value + 0.001)
    parameters.update()


def unsteady(problem: Any, name: str, keys: tuple[str, ...], times: int) -> dict[str, int]:
    """Parameters and settings whose values are compiled into kernels, with the number of further kernels."""
    parameters, found = mi.traverse(problem.scene), {}
    kernels_of(problem, name)  # Mitsuba holds some values in another form until they are changed or read first
    for key in keys:
        change(parameters, key)
        first = kernels_of(problem, name)
        for _ in range(times - 1):
            change(parameters, key)
            found[key] = found.get(key, 0) + len(kernels_of(problem, name) - first)
    first = kernels_of(problem, name)
    found["seed"] = len(kernels_of(problem, name, seed=2) - first)
    found["pass"] = len(kernels_of(problem, name, first=3) - first)
    for setting in SETTINGS.keys() & set(methods.get(name).Settings.names()):
        one, two = (kernels_of(problem, name, **{setting: value}) for value in SETTINGS[setting])
        found[setting] = len(two - one)
    return {key: count for key, count in found.items() if count}


@pytest.mark.parametrize(
    "lamps",
    [("lamp", "ball", "point", "sky"), pytest.param(("ball",), marks=pytest.mark.slow)],
    ids=["many", "one"],
)
def test_a_changed_value_needs_no_kernel_of_its_own(lamps: tuple[str, ...]) -> None:
    assert unsteady(stage(lamps), "vcm", (f"{lamps[0]}.emitter.radiance.value", "floor.to_world"), 2) == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(methods.table()))
def test_no_changed_value_needs_a_kernel_of_its_own(name: str) -> None:
    """Twenty values of each."""
    assert unsteady(stage(), name, CHANGED, 20) == {}


def test_numbers_of_the_device_are_read_without_a_kernel() -> None:
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        turned = mi.Transform4f().rotate([0.0, 1.0, 0.0], 20.0)
        read = [as_array(value) for value in (turned, mi.Color3f(0.25, 0.5, 1.0), mi.UInt32(4), mi.Bool(True))]
        assert not launched()
    assert [(one.shape, one.dtype.name) for one in read] == [
        ((4, 4, 1), "float32"),
        ((3, 1), "float32"),
        ((1,), "uint32"),
        ((1,), "bool"),
    ]
    np.testing.assert_array_equal(read[0], np.asarray(turned.matrix))
    np.testing.assert_array_equal(read[1][:, 0], [0.25, 0.5, 1.0])
