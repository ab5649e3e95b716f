"""BSDFs asked for what they answer badly."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.core import IndependentSource
from etendue.transport.scattering import evaluate_camera_end, evaluate_light_end, scatter_camera, scatter_light

MATERIALS = {
    "diffuse": {"type": "diffuse"},
    "roughplastic": {"type": "roughplastic", "distribution": "beckmann", "alpha": 0.1},
    "roughconductor": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.1},
    "roughdielectric": {"type": "roughdielectric", "alpha": 0.1},
    "principled": {"type": "principled", "roughness": 0.2, "spec_tint": 0.5, "clearcoat": 0.5},
}


@pytest.mark.parametrize("evaluate", [evaluate_camera_end, evaluate_light_end])
@pytest.mark.parametrize("name", MATERIALS)
def test_directions_in_the_surface_have_finite_densities(name, evaluate):
    scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle", "bsdf": MATERIALS[name]}})
    cosines = mi.Float([0.0, -0.0, 1e-30, 1e-9, -1e-9, 1e-7, 1e-5, 0.3, 1.0])
    sines = dr.safe_sqrt(1.0 - cosines * cosines)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.2, 1.0), dr.normalize(mi.Vector3f(0.5, 0.0, -1.0))))
    answer = evaluate(si.bsdf(), si, mi.Vector3f(0.0, sines, cosines), mi.Bool(True))
    for values in (answer.value, answer.pdf, answer.reverse_pdf):
        values = np.asarray(values)
        assert np.isfinite(values).all()
        assert (values[..., -1] > 0.0).all() or name == "roughdielectric"


def fresnel(cosine, index):
    """Reflectance of an interface for unpolarised light by complex arithmetic; ``index`` relative to the outside."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return (abs(across) ** 2 + abs(along) ** 2) / 2


@pytest.mark.parametrize("scatter", [scatter_camera, scatter_light])
@pytest.mark.parametrize(
    ("index", "material", "straight"),
    [
        (1.5, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, 0.04),
        (0.2 + 3.4j, {"type": "conductor", "eta": 0.2, "k": 3.4}, 0.93846),
    ],
)
def test_walks_are_reflected_by_fresnel(index, material, straight, scatter):
    """At normal incidence the values in closed form; glass is chosen to reflect as often, a metal weighs by as much."""
    assert fresnel(1.0, index) == pytest.approx(straight, abs=5e-6)
    scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle", "bsdf": material}})
    for cosine in (1.0, 0.8, 0.4, 0.1):
        exact = fresnel(cosine, index)
        lane = dr.arange(mi.UInt32, 1 << 14)
        way = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, -cosine)
        si = scene.ray_intersect(mi.Ray3f(mi.Point3f(-way) + dr.zeros(mi.Point3f, len(lane)), way))
        found, _ = scatter(si.bsdf(), si, IndependentSource(lane, 1, "test", 0), mi.UInt32(0), mi.Bool(True))
        reflected = np.array(found.direction.z) > 0
        share = np.array(found.weight)[0] * np.array(found.pdf)  # of the light; the density is a probability
        np.testing.assert_allclose(share[reflected], exact, rtol=2e-5)
        if isinstance(index, complex):
            assert reflected.all()
        else:
            assert reflected.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / len(lane)))
