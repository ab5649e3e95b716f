"""BSDFs asked for what they answer badly."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.transport.scattering import evaluate_camera_end, evaluate_light_end

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
