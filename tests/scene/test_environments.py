"""Environment maps lit in few texels: next event estimation finds all of their light."""

import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.core import Result, UnsupportedError
from etendue.film import write_exr
from etendue.scene import load

LIT = {
    "first row": np.s_[0],
    "last row": np.s_[-1],
    "first column": np.s_[:, 0],
    "last column": np.s_[:, -1],
    "first texel": np.s_[0, 0],
    "last texel": np.s_[-1, -1],
    "texel of the first row": np.s_[0, 5],
    "texel": np.s_[2, 3],
    "1x1": (1, 1),
    "2x2": (2, 2),
    "2x1": (2, 1),
    "1x2": (1, 2),
}


def texels(name, dim=0.0):
    if "x1" in name or "x2" in name:
        return np.random.default_rng(3).random((*LIT[name], 3)).astype(np.float32)
    values = np.full((6, 12, 3), dim, np.float32)
    values[LIT[name]] = 1.0
    return values


def scene(values):
    sky = {"type": "envmap", "bitmap": mi.Bitmap(values)}
    return {"type": "scene", "ball": {"type": "sphere"}, "camera": {"type": "perspective"}, "sky": sky}


@pytest.mark.parametrize("dim", [0.0, 1e-6])
@pytest.mark.parametrize("name", LIT)
def test_all_light_of_an_environment_is_sampled(name, dim):
    emitter = load(scene(texels(name, dim))).scene.environment()
    rng, n = np.random.default_rng(7), 1 << 15
    it = dr.zeros(mi.Interaction3f, n)
    ds, weight = emitter.sample_direction(it, mi.Point2f(rng.random((2, n), np.float32)))
    weight = np.asarray(weight, np.float64)[0]

    si = dr.zeros(mi.SurfaceInteraction3f, 1 << 17)
    # Points of a spiral: the uniform integral over the sphere, exact to 1e-3.
    k = np.arange(1 << 17) + 0.5
    z, turn = 1.0 - 2.0 * k / (1 << 17), np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - z * z)
    si.wi = mi.Vector3f(*(v.astype(np.float32) for v in (flat * np.cos(turn), z, flat * np.sin(turn))))
    radiance = np.asarray(emitter.eval(si), np.float64)[0]
    ds.d, expected = -si.wi, 4.0 * np.pi * radiance.mean()
    density = np.asarray(emitter.pdf_direction(dr.zeros(mi.Interaction3f, 1 << 17), ds), np.float64)

    assert abs(weight.mean() - expected) < 5.0 * weight.std() / n**0.5 + 2e-3 * expected
    assert (density[radiance > 1e-3] > 0.0).all()
    assert (radiance[density > 0.0] / density[density > 0.0]).max() < 20.0 * expected


def test_rows_are_added_only_where_they_are_needed():
    for name, rows in {"texel": 6, "first row": 11, "last texel": 11}.items():
        loaded = load(scene(texels(name))).scene
        assert mi.traverse(loaded.environment())["data"].shape[0] == rows


def test_objects_of_the_caller_are_not_changed():
    for given in (mi.load_dict(scene(texels("first row"))), scene(texels("first row"))):
        if isinstance(given, dict):
            given["sky"] = mi.load_dict(given["sky"])
        with pytest.raises(UnsupportedError, match=r"emitter 'sky' .*first or last row"):
            load(given)


def test_a_file_is_read_with_one_thread(tmp_path):
    """Mitsuba waits for ever for threads that read OpenEXR, whatever the name of the file, if there is but one; as many
    are left as before. Other scenes start none."""
    write_exr(tmp_path / "sky.exr", Result({"image": np.ones((64, 128, 3), np.float32)}))
    (tmp_path / "sky.exr").rename(tmp_path / "sky.hdr")
    code = """
import sys; from etendue.core import set_threads, use_variant; from etendue.scene import load
use_variant(); set_threads(1); import drjit as dr
set_count = dr.set_thread_count; dr.set_thread_count = lambda count: (print(count), set_count(count))
for sky in ({"type": "constant"}, {"type": "envmap", "filename": sys.argv[1]}):
    load({"type": "scene", "sensor": {"type": "perspective"}, "ball": {"type": "sphere"}, "sky": sky})
    print("loaded", dr.thread_count())
"""
    command = [sys.executable, "-c", code, str(tmp_path / "sky.hdr")]
    output = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    assert output.split("\n")[:-1] == ["loaded 1", "2", "1", "loaded 1"]
