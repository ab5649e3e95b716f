"""BSDFs asked for what they answer badly."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.core import IndependentSource
from etendue.transport.scattering import (
    evaluate_camera_end,
    evaluate_light_end,
    scatter_camera,
    scatter_light,
    scatter_light_uniform,
    scatter_uniform,
)

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
    answer = evaluate(scenes.material(scene, si), si, mi.Vector3f(0.0, sines, cosines), mi.Bool(True))
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
        found, _ = scatter(
            scenes.material(scene, si), si, IndependentSource(lane, 1, "test", 0), mi.UInt32(0), mi.Bool(True)
        )
        reflected = np.array(found.direction.z) > 0
        share = np.array(found.weight)[0] * np.array(found.pdf)  # of the light; the density is a probability
        np.testing.assert_allclose(share[reflected], exact, rtol=2e-5)
        if isinstance(index, complex):
            assert reflected.all()
        else:
            assert reflected.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / len(lane)))


def fresnel_real(cosine, index):
    """The same in real arithmetic for ``index`` eta + j kappa [Leeson 2001, sec. 2.4, with the brackets repaired]."""
    eta, kappa, sine2 = np.real(index), np.imag(index), 1 - cosine**2
    rest = eta**2 - kappa**2 - sine2
    root = np.sqrt(rest**2 + 4 * eta**2 * kappa**2)
    a2b2, a = root, np.sqrt((root + rest) / 2)
    across = (a2b2 - 2 * a * cosine + cosine**2) / (a2b2 + 2 * a * cosine + cosine**2)
    along_sine = np.sqrt(sine2) * np.sqrt(sine2) / cosine
    along = (a2b2 - 2 * a * along_sine + along_sine**2) / (a2b2 + 2 * a * along_sine + along_sine**2)
    return across * (1 + along) / 2


@pytest.mark.parametrize("index", [1.5, 1 / 1.5, 2.4, 0.2 + 3.4j, 1.1 + 7.0j, 1.3 + 0.01j])
def test_fresnel_in_real_and_complex_arithmetic_and_on_the_device(index):
    """The two formulas to 1e-9 (beyond total reflection, too), and Mitsuba's functions in single precision."""
    cosine = np.linspace(0.01, 1.0, 200)
    exact = fresnel(cosine, index)
    np.testing.assert_allclose(fresnel_real(cosine, index), exact, rtol=1e-9, atol=1e-9)
    cosine = mi.Float(cosine)
    if isinstance(index, complex):
        found = mi.fresnel_conductor(cosine, mi.Complex2f(float(np.real(index)), float(np.imag(index))))
        np.testing.assert_allclose(np.array(found), exact, rtol=2e-4, atol=2e-5)
    else:
        found, inside, forth, back = (np.array(v) for v in mi.fresnel(cosine, mi.Float(index)))
        np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-5)
        total = np.array(cosine) < np.sqrt(max(0.0, 1 - index**2)) - 1e-3
        np.testing.assert_allclose(found[total], 1.0, rtol=1e-6)
        np.testing.assert_allclose([forth, back], [np.full(200, index), np.full(200, 1 / index)], rtol=1e-6)
        partly = exact < 1.0 - 1e-6
        sine = np.sqrt(1 - np.array(cosine, dtype=float) ** 2)[partly]
        np.testing.assert_allclose(np.abs(inside[partly]), np.sqrt(1 - (sine / index) ** 2), atol=1e-4)


@pytest.mark.parametrize(
    ("scatter", "power"),
    [(scatter_camera, 2), (scatter_light, 0), (scatter_uniform, 2), (scatter_light_uniform, 0)],
)
@pytest.mark.parametrize("index", [1.5, 1 / 1.5])
def test_transmitted_radiance_is_scaled_by_the_index(index, power, scatter):
    """F_t = 1 - F_r. Towards a camera, radiance is divided by the square of the index of the camera's side relative to
    the other; power, along light paths, is not."""
    material = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle", "bsdf": material}})
    cosine = 0.9
    lane = dr.arange(mi.UInt32, 1 << 12)
    way = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, -cosine if index > 1 else cosine)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(-way) + dr.zeros(mi.Point3f, len(lane)), way))
    found, _ = scatter(
        scenes.material(scene, si), si, IndependentSource(lane, 1, "test", 0), mi.UInt32(0), mi.Bool(True)
    )
    through = (np.array(found.direction.z) > 0) == (index < 1)
    share = np.array(found.weight)[0] * np.array(found.pdf)
    np.testing.assert_allclose(share[through], (1 - fresnel(cosine, index)) / index**power, rtol=1e-4)
    assert through.mean() > 0.8
