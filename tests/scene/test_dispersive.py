"""The BSDFs ``dispersive`` and ``roughdispersive``: catalogues, Snell's law, energy, and Mitsuba's own glass."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.spectral import spectral_variant

from etendue.core import OptionError, SceneError, UnsupportedError
from etendue.scene import Material, load
from etendue.scene.members import Members
from etendue.scene.plugins.dispersive import make_dispersive, make_roughdispersive
from etendue.scene.plugins.glasses import GLASSES, abbe_number, constant, of_abbe

N = 200_000
WAVELENGTHS = (431.0, 502.0, 587.5618, 655.0)


@pytest.fixture(autouse=True)
def _spectral() -> Iterator[None]:
    with spectral_variant():
        yield


def glass(rough: bool = False, **parameters: Any) -> mi.BSDF:
    props = mi.Properties("roughdispersive" if rough else "dispersive")
    for key, value in parameters.items():
        props[key] = value
    return (make_roughdispersive if rough else make_dispersive)()(props)


def interaction(wi: Any, n: int = N, wavelengths: Any = WAVELENGTHS) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = dr.normalize(mi.Vector3f(*wi))
    si.sh_frame = mi.Frame3f(mi.Vector3f(0.0, 0.0, 1.0))
    si.wavelengths = mi.Spectrum(*wavelengths)
    return si


def numbers(seed: int = 1, n: int = N) -> tuple[mi.Float, mi.Point2f]:
    random = np.random.default_rng(seed)
    return mi.Float(random.random(n).astype(np.float32)), mi.Point2f(random.random((2, n)).astype(np.float32))


def in_packets(bsdf: mi.BSDF) -> Material:
    """As étendue calls materials, with the hero in front."""
    pointer = mi.BSDFPtr(bsdf)
    number = np.array(dr.reinterpret_array(mi.UInt32, pointer))
    return Material(pointer, Members(mi.BSDFPtr, number, number, [bsdf]))


# ---------------------------------------------------------------------------------------------------- indices


@pytest.mark.parametrize(
    ("name", "index", "abbe"),
    [
        ("bk7", 1.51680, 64.17),
        ("n-bak4", 1.56883, 55.98),
        ("f2", 1.62004, 36.37),
        ("sf10", 1.72825, 28.53),
        ("n-sf11", 1.78472, 25.68),
        ("n-lasf9", 1.85025, 32.17),
        ("fused silica", 1.45846, 67.82),
        ("water", 1.33336, 55.8),
        ("diamond", 2.4175, 55.3),
    ],
)
def test_glasses_have_their_catalogue_s_numbers(name, index, abbe):
    assert GLASSES[name].at(587.5618) == pytest.approx(index, abs=5e-5)
    assert abbe_number(GLASSES[name]) == pytest.approx(abbe, rel=2e-3)


def test_an_abbe_number_gives_the_index_at_three_lines():
    found = of_abbe(1.6, 30.0)
    assert found.at(587.5618) == pytest.approx(1.6, abs=1e-9)
    assert abbe_number(found) == pytest.approx(30.0, rel=1e-9)
    assert abbe_number(constant(1.5)) == np.inf


# ---------------------------------------------------------------------------------------------------- smooth


@pytest.mark.parametrize("wi", [(0.5, 0.2, 0.8), (0.3, -0.4, -0.9)])
@pytest.mark.parametrize("packets", [False, True])
def test_each_wavelength_is_refracted_by_snell_s_law(wi, packets):
    bsdf, si, u = glass(int_ior="sf10", ext_ior="vacuum"), interaction(wi), numbers()
    arguments = mi.BSDFContext(), si, *u
    bs, weight = in_packets(bsdf).call(mi.BSDF.sample, *arguments) if packets else bsdf.sample(*arguments, True)
    weight, wo, active = np.array(weight), np.array(bs.wo), np.array(bs.pdf) > 0.0
    through = active & (wo[2] * wi[2] < 0.0)
    sine = np.hypot(wi[0], wi[1]) / np.linalg.norm(wi)
    for k, wavelength in enumerate(WAVELENGTHS):
        alone = through & (weight[k] > 0.0)
        if packets and k:
            assert not alone.any()
            continue
        index = GLASSES["sf10"].at(wavelength)
        if alone.any():
            expected = sine / index if wi[2] > 0.0 else sine * index
            np.testing.assert_allclose(np.hypot(wo[0], wo[1])[alone], expected, rtol=2e-5)
            assert (np.delete(weight, k, axis=0)[:, alone] == 0.0).all()  # one wavelength goes on alone


@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("wi", [(0.5, 0.2, 0.8), (0.3, -0.2, -0.9), (0.8, 0.1, -0.6)])
def test_no_light_is_made_or_lost(rough, wi):
    """Of each wavelength as much goes on as has come: on average over the choice of the one that goes on, at random, or
    as the hero."""
    bsdf, u = glass(rough, int_ior="sf10", **({"alpha": 0.02} if rough else {})), numbers()
    found = {"at random": [], "hero": []}
    for hero in range(4):
        si = interaction(wi, wavelengths=np.roll(WAVELENGTHS, -hero).tolist())
        arguments = mi.BSDFContext(mi.TransportMode.Importance), si, *u
        for name, (_, weight) in zip(
            found, (bsdf.sample(*arguments, True), in_packets(bsdf).call(mi.BSDF.sample, *arguments)), strict=True
        ):
            found[name].append(np.roll(np.array(weight, np.float64), hero, axis=0))
    for name, weights in found.items():
        one = np.mean(weights, axis=0)  # (wavelengths, samples)
        error = one.std(axis=1) / np.sqrt(N)
        # Facets that shadow each other lose what they scatter.
        assert (np.abs(one.mean(axis=1) - 1.0) < 5.0 * error + (4e-3 if rough else 1e-6)).all(), (
            name,
            one.mean(axis=1),
        )


@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("mode", ["Radiance", "Importance"])
@pytest.mark.parametrize("wi", [(0.5, 0.2, 0.8), (0.3, -0.4, -0.9)])
def test_without_dispersion_it_is_mitsuba_s_glass(rough, mode, wi):
    own = glass(rough, int_ior=1.6, ext_ior=1.1, **({"alpha": 0.3, "distribution": "ggx"} if rough else {}))
    plugin = {"type": "roughdielectric", "alpha": 0.3, "distribution": "ggx"} if rough else {"type": "dielectric"}
    theirs = mi.load_dict(plugin | {"int_ior": 1.6, "ext_ior": 1.1})
    same = interaction(wi, wavelengths=(550.0,) * 4)  # a path that goes on with the hero alone
    context, (lobe, u) = mi.BSDFContext(getattr(mi.TransportMode, mode)), numbers()
    bs, weight = in_packets(own).call(mi.BSDF.sample, context, same, lobe, u)
    their_bs, their_weight = theirs.sample(context, same, lobe, u)
    there = np.array(their_weight)[0] > 0.0  # what facets shadow has no weight, but Mitsuba gives it a density
    assert there.mean() > 0.5
    np.testing.assert_allclose(np.array(weight), np.array(their_weight), rtol=2e-3, atol=2e-4)
    for a, b in ((bs.wo, their_bs.wo), (bs.pdf, their_bs.pdf), (bs.eta, their_bs.eta)):
        np.testing.assert_allclose(np.array(a)[..., there], np.array(b)[..., there], rtol=2e-3, atol=2e-4)
    if rough:
        values = in_packets(own).call(mi.BSDF.eval_pdf, context, same, bs.wo)
        for a, b in zip(values, theirs.eval_pdf(context, same, bs.wo), strict=True):
            np.testing.assert_allclose(np.array(a)[..., there], np.array(b)[..., there], rtol=2e-3, atol=2e-4)


def test_the_density_of_rough_glass_is_that_of_its_samples():
    """The share of samples in a cone is the integral of the density over it."""
    bsdf, si = glass(True, int_ior=1.7, abbe=8.0, alpha=0.4), interaction((0.5, 0.2, 0.8))
    bs, _ = bsdf.sample(mi.BSDFContext(), si, *numbers(), True)
    there = mi.warp.square_to_uniform_sphere(numbers(2)[1])
    density = np.array(bsdf.pdf(mi.BSDFContext(), si, there, True), np.float64)
    for axis in ((0.0, 0.0, 1.0), (-0.3, -0.1, -0.95), (-0.6, 0.3, 0.7)):
        axis = np.array(axis) / np.linalg.norm(axis)
        found = (axis @ np.array(bs.wo) > 0.9) & (np.array(bs.pdf) > 0.0)
        inside = np.where(axis @ np.array(there) > 0.9, 4.0 * np.pi * density, 0.0)
        error = np.hypot(found.std(), inside.std()) / np.sqrt(N)
        assert abs(found.mean() - inside.mean()) < 4.5 * error
        assert inside.mean() > 5.0 * error


def test_a_wavelength_alone_does_not_count_four_times_again():
    alone = in_packets(glass(int_ior="sf10"))
    arguments = mi.BSDFContext(mi.TransportMode.Importance), interaction((0.2, 0.0, 0.9), wavelengths=(480.0,) * 4)
    _, weight = alone.call(mi.BSDF.sample, *arguments, *numbers())
    np.testing.assert_allclose(np.array(weight), 1.0, rtol=1e-5)


# ---------------------------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"int_ior": "crown"}, "no index of refraction is known for 'crown'"),
        ({"int_ior": 1.5, "cauchy": "1.5, 0.004"}, "either 'int_ior' or 'cauchy'"),
        ({"int_ior": 1.5, "abbe": 40.0, "dispersion": 0.5}, "either 'abbe' or 'dispersion'"),
        ({"int_ior": "bk7", "abbe": 40.0}, "give 'int_ior' a number"),
        ({"int_ior": 1.5, "abbe": 0.0}, "must be a number above 0"),
        ({"int_ior": 25.0}, "between 0.1 and 10"),
        ({"cauchy": "one"}, "a text of numbers A, B, C"),
        ({"sellmeier": "1, 2, 3"}, "B_1, B_2, B_3, C_1, C_2, C_3"),
        ({"cauchy": "1.5, 4000"}, "wavelengths are in micrometres"),
    ],
)
def test_wrong_parameters_are_named(parameters, message):
    with pytest.raises(OptionError, match=message):
        glass(**parameters)


def test_the_ways_to_give_an_index_agree():
    by_name, cauchy = glass(int_ior="bk7"), glass(cauchy="1.5, 0.004")
    numbers_of = [GLASSES["bk7"].numbers[i] for i in (0, 2, 4, 1, 3, 5)]
    by_formula = glass(sellmeier=" ".join(map(str, numbers_of)))
    gltf, abbe = glass(int_ior=1.5, dispersion=0.5), glass(int_ior=1.5, abbe=40.0)
    si = interaction((0.0, 0.0, 1.0), 1)
    for a, b in ((by_name, by_formula), (gltf, abbe)):
        np.testing.assert_allclose(np.ravel(a._indices(si)), np.ravel(b._indices(si)), rtol=1e-6)
    squares = 1e-6 * np.square(WAVELENGTHS)
    np.testing.assert_allclose(np.ravel(cauchy._indices(si)), (1.5 + 0.004 / squares) / 1.000277, rtol=1e-6)


def test_parameters_can_be_changed():
    bsdf, si = glass(int_ior=1.5), interaction((0.0, 0.0, 1.0), 1)
    values = mi.traverse(bsdf)
    values["int_index_0"] = 1.7
    values.update()
    np.testing.assert_allclose(np.ravel(bsdf._indices(si)), 1.7 / 1.000277, rtol=1e-6)


def test_an_rgb_variant_is_refused_by_name():
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective"},
        "ball": {"type": "sphere", "bsdf": {"type": "dispersive"}},
        "sky": {"type": "constant"},
    }
    needs = pytest.raises((SceneError, UnsupportedError), match=r"'dispersive' needs .*--variant llvm_ad_spectral")
    with mi.variant_context("llvm_ad_rgb"), needs:
        load(scene)
    assert load(scene).scene is not None
