"""The digest is the same in every process, and moves with every parameter."""

import subprocess
import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.scene import load


def base():
    return {
        "type": "scene",
        "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 32, "height": 24}},
        "lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": 3.0}},
        "sky": {"type": "constant", "radiance": 0.1},
        "box": {"type": "cube", "bsdf": {"type": "roughconductor", "alpha": 0.2}},
        "ball": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture()}},
    }


def texture(**more):
    pixels = np.linspace(0, 1, 48).reshape(4, 4, 3).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True} | more


def changed(**parts):
    return base() | parts


CHANGES = {
    "reference": lambda: base(),
    "fov": lambda: changed(camera=base()["camera"] | {"fov": 50.0}),
    "camera": lambda: changed(camera=base()["camera"] | {"to_world": mi.ScalarTransform4f().translate([0, 0, 1])}),
    "film": lambda: changed(camera={"type": "perspective", "film": {"type": "hdrfilm", "width": 33, "height": 24}}),
    "filter": lambda: changed(
        camera={
            "type": "perspective",
            "film": {"type": "hdrfilm", "width": 32, "height": 24, "f": {"type": "gaussian", "stddev": 0.6}},
        }
    ),
    "radiance": lambda: changed(lamp={"type": "rectangle", "emitter": {"type": "area", "radiance": 3.1}}),
    "sky": lambda: changed(sky={"type": "constant", "radiance": 0.11}),
    "roughness": lambda: changed(box={"type": "cube", "bsdf": {"type": "roughconductor", "alpha": 0.21}}),
    "distribution": lambda: changed(
        box={"type": "cube", "bsdf": {"type": "roughconductor", "alpha": 0.2, "distribution": "ggx"}}
    ),
    "position": lambda: changed(box=base()["box"] | {"to_world": mi.ScalarTransform4f().translate([0.1, 0, 0])}),
    "normals": lambda: changed(box=base()["box"] | {"flip_normals": True}),
    "radius": lambda: changed(ball=base()["ball"] | {"radius": 1.01}),
    "texture filter": lambda: changed(
        ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": texture(filter_type="nearest")}}
    ),
    "material swap": lambda: changed(box=base()["box"] | {"bsdf": base()["ball"]["bsdf"]}, ball={"type": "sphere"}),
    "one shape more": lambda: changed(second=base()["ball"]),
}


def test_every_change_shows():
    digests = {name: load(make()).fingerprint for name, make in CHANGES.items()}
    assert len(set(digests.values())) == len(CHANGES), digests


def test_equal_scenes_are_equal():
    reference = load(base()).fingerprint
    assert load(base()).fingerprint == reference
    reordered = dict(reversed(list(base().items())))
    assert load(reordered).fingerprint == reference
    renamed = {f"{k}x" if k != "type" else k: v for k, v in base().items()}
    assert load(renamed).fingerprint == reference
    more_samples = base()
    more_samples["camera"]["sampler"] = {"type": "independent", "sample_count": 99}
    assert load(more_samples).fingerprint == reference
    other_integrator = changed(integrator={"type": "ptracer"})
    assert load(other_integrator).fingerprint == reference


def test_a_texture_edited_in_place_shows():
    scene = mi.load_dict(base())
    before = load(scene).fingerprint
    params = mi.traverse(scene)
    params["ball.bsdf.reflectance.data"] = params["ball.bsdf.reflectance.data"] * 0.5
    params.update()
    assert load(scene).fingerprint != before


CODE = """
import sys
import etendue
import mitsuba as mi
mi.set_variant(sys.argv[2])
from etendue.scene import load
print(load(sys.argv[1], size=(20, 10)).fingerprint)
"""


@pytest.mark.parametrize("name", ["water-caustic", "cornell-glass"])
def test_another_process_agrees(name, request):
    source = name
    if name == "water-caustic":
        source = str(request.getfixturevalue("scenes_dir") / name / "scene.xml")
    command = [sys.executable, "-c", CODE, source, mi.variant()]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert out.strip() == load(source, size=(20, 10)).fingerprint


def test_a_large_mesh_is_quick():
    import time

    n = 300
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    points = np.stack([u, v, u * v], -1).astype(np.float32)
    i = np.arange((n - 1) * n).reshape(n - 1, n)[:, :-1].ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n], -1), np.stack([i + 1, i + n + 1, i + n], -1)]).astype(np.uint32)
    mesh = mi.Mesh("sheet", n * n, len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = points.ravel()
    params["faces"] = faces.ravel()
    params.update()
    dr.sync_thread()
    problem = load(changed(sheet=mesh))
    start = time.process_time()  # other work on the machine does not count
    assert len(problem.fingerprint) == 32
    assert time.process_time() - start < 1.0
