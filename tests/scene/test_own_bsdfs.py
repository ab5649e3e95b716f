"""The BSDFs ``phong`` and ``ward``: formulas, energy, reciprocity, densities, and life inside Mitsuba."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.statistics import assert_mean

import etendue
from etendue.core import SceneError
from etendue.integration import Box, Integrand, constant
from etendue.scene import composed_bsdf, load

N = 100_000
BSDFS: dict[str, dict[str, Any]] = {
    "phong": {"type": "phong", "diffuse_reflectance": 0.3, "specular_reflectance": 0.5, "exponent": 12.0},
    "phong broad": {"type": "phong", "diffuse_reflectance": 0.0, "specular_reflectance": 1.0, "exponent": 1.0},
    "phong narrow": {"type": "phong", "diffuse_reflectance": 0.0, "specular_reflectance": 1.0, "exponent": 400.0},
    "ward": {"type": "ward", "diffuse_reflectance": 0.2, "specular_reflectance": 0.7, "alpha": 0.2},
    "ward anisotropic": {"type": "ward", "specular_reflectance": 0.4, "alpha_u": 0.12, "alpha_v": 0.4},
    "ward streak": {"type": "ward", "diffuse_reflectance": 0.0, "specular_reflectance": 1.0}
    | {"alpha_u": 0.02, "alpha_v": 1.0},
}
INCIDENT = {
    "straight": (0.0, 0.0, 1.0),
    "slant": (0.5, 0.3, 0.9),
    "flat": (-0.6, 0.8, 0.25),
    "grazing": (0.2, 1.0, 0.02),
}


#: Materials made of functions of (u, v, light, eye): one that turns with the surface, and one that does not.
_DIRECTIONS = Box.of([(0, 1)] * 2 + [(-1, 1)] * 6)
COMPOSED = {
    "composed": lambda: constant(0.3, _DIRECTIONS),
    "composed brushed": lambda: Integrand(
        lambda x: 0.3 / (0.2 + (x[2] + x[5]) * (x[2] + x[5])), _DIRECTIONS, on="device"
    ),
}


def unit(v: Any) -> np.ndarray:
    v = np.asarray(v, np.float64)
    return v / np.linalg.norm(v, axis=0)


def hemisphere(n: int = N, seed: int = 2) -> np.ndarray:
    """Directions uniform over the upper hemisphere, (3, n)."""
    v = unit(np.random.default_rng(seed).normal(size=(3, n)))
    v[2] = np.abs(v[2])
    return v


def interaction(wi: Any, n: int = 1) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(np.asarray(wi, np.float32).tolist() if np.ndim(wi) == 1 else np.asarray(wi, np.float32))
    return si


def evaluate(bsdf: Any, wi: Any, wo: np.ndarray, ctx: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """First channel of f cos, and the density."""
    local = mi.Vector3f(wo.astype(np.float32))
    value, pdf = bsdf.eval_pdf(ctx or mi.BSDFContext(), interaction(wi, wo.shape[1]), local)
    return np.array(value[0], np.float64), np.array(pdf, np.float64)


def random_numbers(n: int, seed: int = 7) -> tuple[Any, Any]:
    u = np.random.default_rng(seed).random((3, n)).astype(np.float32)
    return mi.Float(u[0]), mi.Point2f(u[1:])


def phong(row: dict[str, Any], wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    n, mirror = row["exponent"], wi * [[-1], [-1], [1]]
    lobe = (n + 2) / (2 * np.pi) * np.where((cos := (mirror * wo).sum(0)) > 0, np.maximum(cos, 0) ** n, 0)
    return row["diffuse_reflectance"] / np.pi + row["specular_reflectance"] * lobe


def ward(row: dict[str, Any], wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    h = unit(wi + wo)
    au, av = row.get("alpha_u", row.get("alpha")), row.get("alpha_v", row.get("alpha"))
    tan2, phi = (h[0] ** 2 + h[1] ** 2) / h[2] ** 2, np.arctan2(h[1], h[0])
    gauss = np.exp(-tan2 * (np.cos(phi) ** 2 / au**2 + np.sin(phi) ** 2 / av**2)) / (4 * np.pi * au * av)
    diffuse = row.get("diffuse_reflectance", 0.5)
    return diffuse / np.pi + row["specular_reflectance"] * gauss / np.sqrt(wi[2] * wo[2])


@pytest.mark.parametrize("name", BSDFS)
def test_the_published_formula(name):
    wi, wo = hemisphere(2000, 1), hemisphere(2000, 2)
    clear = (wi[2] > 0.06) & (wo[2] > 0.06)  # nearer to the surface Ward's root is bounded
    wi, wo = wi[:, clear], wo[:, clear]
    value, _ = evaluate(mi.load_dict(BSDFS[name]), wi, wo)
    formula = phong if name.startswith("phong") else ward
    np.testing.assert_allclose(value, formula(BSDFS[name], wi, wo) * wo[2], rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("name", BSDFS)
def test_reciprocity(name):
    bsdf = mi.load_dict(BSDFS[name])
    wi, wo = hemisphere(2000, 3), hemisphere(2000, 4)
    wi[2, :500] *= 1e-3  # flat incidence, where Ward's root is bounded
    wi = unit(wi)
    there, back = evaluate(bsdf, wi, wo)[0] / wo[2], evaluate(bsdf, wo, wi)[0] / wi[2]
    np.testing.assert_allclose(there, back, rtol=3e-3, atol=1e-4)


@pytest.mark.parametrize("name", BSDFS)
def test_energy(name):
    """Reflects no more than k_d + k_s at any incidence; Phong exactly that straight on."""
    row = BSDFS[name] | {"diffuse_reflectance": 0.0, "specular_reflectance": 1.0}
    bsdf = mi.load_dict(row)
    for cos in (1.0, 0.7, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-5):
        for phi in (0.0, 0.7, np.pi / 2):
            sin = np.sqrt(1 - cos * cos)
            wi = (sin * np.cos(phi), sin * np.sin(phi), cos)
            _, weight = bsdf.sample(mi.BSDFContext(), interaction(wi, N), *random_numbers(N))
            weight = np.array(weight[0], np.float64)
            assert weight.mean() <= 1.0 + 4.5 * weight.std() / np.sqrt(N), (cos, phi)
            if cos == 1.0 and name.startswith("phong"):
                assert_mean(weight, 1.0, name)


def test_reflectances_that_exceed_one_are_scaled_in_their_channel():
    """0.9 + 0.6 in red becomes 0.6 + 0.4; the others stay."""
    colours = {"diffuse_reflectance": [0.9, 0.2, 0.0], "specular_reflectance": [0.6, 0.3, 1.0]}
    rows = {k: {"type": "rgb", "value": v} for k, v in colours.items()}
    si = interaction((0.0, 0.0, 1.0), N)
    for kind in ("phong", "ward"):
        bsdf = mi.load_dict({"type": kind} | rows)
        np.testing.assert_allclose(np.array(bsdf.eval_diffuse_reflectance(si))[:, 0], [0.6, 0.2, 0.0], rtol=1e-4)
        _, weight = bsdf.sample(mi.BSDFContext(), si, *random_numbers(N))
        albedo = np.array(weight, np.float64).mean(1)
        lobe = 1.0 if kind == "phong" else 0.971  # a Ward lobe of slope 0.1 reflects that much straight on
        np.testing.assert_allclose(albedo, np.array([0.6, 0.2, 0.0]) + np.array([0.4, 0.3, 1.0]) * lobe, atol=0.01)


@pytest.mark.parametrize("incident", INCIDENT)
@pytest.mark.parametrize("name", BSDFS)
def test_the_density_integrates_to_one(name, incident):
    """Over the hemisphere, together with the share of samples that fall below it."""
    wi = tuple(unit(INCIDENT[incident]))
    bsdf = mi.load_dict(BSDFS[name])
    bs, weight = bsdf.sample(mi.BSDFContext(), interaction(wi, N), *random_numbers(N))
    direction = np.array(bs.wo, np.float64)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=0), 1.0, rtol=1e-3)
    above = (direction[2] > 0) & (np.array(weight[0]) > 0)
    wo = hemisphere(20 * N)
    _, pdf = evaluate(bsdf, wi, wo)
    error = pdf.std() / np.sqrt(pdf.size) * 2 * np.pi
    assert error < 0.05
    assert abs(2 * np.pi * pdf.mean() - above.mean()) < 4.5 * np.hypot(error, 0.5 / np.sqrt(N))


@pytest.mark.parametrize("incident", ["straight", "slant", "flat"])
@pytest.mark.parametrize("name", [name for name in BSDFS if name not in ("phong narrow", "ward streak")])
def test_chi_square(name, incident, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a test that fails leaves a file
    sample, pdf = mi.chi2.BSDFAdapter(BSDFS[name]["type"], BSDFS[name], wi=unit(INCIDENT[incident]).tolist())
    # An even number of rows: the horizon, where the density ends, is an edge between two. The rows left out are too
    # narrow for its tables.
    settings = {"sample_dim": 3, "sample_count": 200_000, "res": 60, "ires": 16}
    test = mi.chi2.ChiSquareTest(mi.chi2.SphericalDomain(), sample, pdf, **settings)
    assert test.run(significance_level=1e-4, quiet=True), test.messages


@pytest.mark.parametrize("name", ["phong", "ward"])
def test_samples_say_what_they_are(name):
    bsdf = mi.load_dict(BSDFS[name])
    wi = tuple(unit(INCIDENT["slant"]))
    si = interaction(wi, 5000)
    bs, weight = bsdf.sample(mi.BSDFContext(), si, *random_numbers(5000))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, bs.wo)
    np.testing.assert_allclose(np.array(bs.pdf), np.array(pdf), rtol=1e-4)
    np.testing.assert_allclose(np.array(weight * bs.pdf), np.array(value), rtol=1e-3, atol=1e-5)
    component, kind = np.array(bs.sampled_component), np.array(bs.sampled_type)
    flags = np.array([int(+mi.BSDFFlags.DiffuseReflection), int(+mi.BSDFFlags.GlossyReflection)])
    assert (kind == flags[component]).all()
    row = BSDFS[name]
    share = row["specular_reflectance"] / (row["specular_reflectance"] + row["diffuse_reflectance"])
    assert_mean(component, share, name)


@pytest.mark.parametrize("name", ["phong", "ward anisotropic"])
def test_components(name):
    """Each by itself, by index and by kind; together they are the whole."""
    bsdf = mi.load_dict(BSDFS[name])
    assert bsdf.component_count() == 2
    assert mi.has_flag(bsdf.flags(0), mi.BSDFFlags.DiffuseReflection)
    assert mi.has_flag(bsdf.flags(1), mi.BSDFFlags.GlossyReflection)
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic) == (name == "ward anisotropic")
    assert not mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide)
    wi, wo = hemisphere(500, 5), hemisphere(500, 6)
    parts = []
    for index, kind in enumerate((mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)):
        by_index, by_kind = mi.BSDFContext(), mi.BSDFContext()
        by_index.component, by_kind.type_mask = index, +kind
        parts.append(evaluate(bsdf, wi, wo, by_index)[0])
        np.testing.assert_array_equal(parts[-1], evaluate(bsdf, wi, wo, by_kind)[0])
        bs, _ = bsdf.sample(by_index, interaction(wi, 500), *random_numbers(500))
        assert (np.array(bs.sampled_component) == index).all()
    np.testing.assert_allclose(sum(parts), evaluate(bsdf, wi, wo)[0], rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("name", [*BSDFS, *COMPOSED])
def test_a_material_that_turns_with_its_frame_says_so(name):
    """Connections keep no tangent of a material without the flag, so they see it turned by any angle."""
    bsdf = composed_bsdf(COMPOSED[name]()) if name in COMPOSED else mi.load_dict(BSDFS[name])
    wi, wo = hemisphere(2000, 10), hemisphere(2000, 11)
    value, pdf = evaluate(bsdf, wi, wo)
    turns = 0.0
    for angle in (0.3, 1.2, 2.9):
        sin, cos = np.sin(angle), np.cos(angle)
        turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        turned, turned_pdf = evaluate(bsdf, turn @ wi, turn @ wo)
        turns = max(turns, np.abs(turned - value).max(), np.abs(turned_pdf - pdf).max())
    changes = turns > 1e-3 * value.max()
    assert changes == ("anisotropic" in name or "streak" in name or "brushed" in name)
    flags = [bsdf.flags(), *(bsdf.flags(i) for i in range(bsdf.component_count()))]
    said = any(mi.has_flag(f, mi.BSDFFlags.Anisotropic) for f in flags)
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic) == said
    assert said >= changes
    if name in BSDFS:  # a function may be flagged for nothing
        assert said == changes


@pytest.mark.parametrize("name", BSDFS)
def test_one_side_only_and_two_with_twosided(name):
    bsdf, both = mi.load_dict(BSDFS[name]), mi.load_dict({"type": "twosided", "inner": BSDFS[name]})
    wi, wo = hemisphere(200, 8), hemisphere(200, 9)
    below = wi * [[1], [1], [-1]]
    for a, b in ((below, wo), (wi, wo * [[1], [1], [-1]])):
        value, pdf = evaluate(bsdf, a, b)
        assert not value.any()
        assert not pdf.any()
    front, back = evaluate(both, wi, wo)[0], evaluate(both, below, wo * [[1], [1], [-1]])[0]
    np.testing.assert_allclose(front, evaluate(bsdf, wi, wo)[0], rtol=1e-4)
    np.testing.assert_allclose(front, back, rtol=1e-4)


def test_reflectances_may_be_textures():
    pixels = np.zeros((1, 2, 3), np.float32)
    pixels[0, 1] = [0.2, 0.4, 0.6]
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True, "filter_type": "nearest"}
    bsdf = mi.load_dict({"type": "phong", "diffuse_reflectance": texture, "specular_reflectance": 0.0})
    assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.SpatiallyVarying)
    si = interaction((0.0, 0.0, 1.0), 2)
    si.uv = mi.Point2f([0.25, 0.75], [0.5, 0.5])
    value = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)))
    np.testing.assert_allclose(value.T, pixels[0] / np.pi, rtol=1e-3, atol=1e-6)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.3, 0.4))
    assert np.isfinite(np.array(weight)).all()


def test_parameters_can_be_changed():
    for kind, key, value in (("phong", "exponent", 80.0), ("ward", "alpha_v", 0.4)):
        bsdf = mi.load_dict({"type": kind})
        parameters = mi.traverse(bsdf)
        assert {"diffuse_reflectance.value", "specular_reflectance.value", key} <= set(parameters.keys())
        parameters[key] = value
        parameters["specular_reflectance.value"] = 0.4
        parameters.update()
        wi, wo = hemisphere(300, 5), hemisphere(300, 6)
        row = {"type": kind, "specular_reflectance": 0.4, "diffuse_reflectance": 0.5}
        row |= {key: value} | ({"alpha_u": 0.1} if kind == "ward" else {})
        np.testing.assert_allclose(evaluate(bsdf, wi, wo)[0], evaluate(mi.load_dict(row), wi, wo)[0], rtol=1e-5)
        assert mi.has_flag(bsdf.flags(), mi.BSDFFlags.Anisotropic) == (kind == "ward")
        parameters[key] = -1.0
        with pytest.raises(etendue.core.OptionError, match=f"'{kind}': '{key}' is .*-1"):
            parameters.update()


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ({"type": "phong", "exponent": -2.0}, "'exponent' is .*-2.* at least 0"),
        ({"type": "phong", "exponent": float("nan")}, "'exponent' is .*nan"),
        ({"type": "phong", "exponent": "much"}, "'exponent' is a number, not a str"),
        ({"type": "ward", "alpha": 0.0}, "'alpha_u' is .* above 0"),
        ({"type": "ward", "alpha": 0.1, "alpha_u": 0.2}, "either 'alpha', or"),
        ({"type": "ward", "alpha_u": 0.2}, "both 'alpha_u' and 'alpha_v'"),
        ({"type": "ward", "exponent": 2.0}, "exponent"),
    ],
)
def test_bad_parameters(row, text):
    with pytest.raises(Exception, match=text):
        mi.load_dict(row)


def test_a_scene_with_a_bad_parameter_is_one_line():
    scene = {"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "phong", "exponent": -2.0}}}
    with pytest.raises(SceneError, match=r"'exponent' is .*-2") as caught:
        load(scene)
    assert "Traceback" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_they_print_and_load_from_xml():
    bsdf = mi.load_string('<bsdf version="3.0.0" type="phong"><float name="exponent" value="7"/></bsdf>')
    assert "phong[" in str(bsdf)
    assert "exponent = [7]" in str(bsdf)
    text = '<bsdf version="3.0.0" type="twosided"><bsdf type="ward"><float name="alpha" value="0.3"/></bsdf></bsdf>'
    assert "alpha_v = [0.3]" in str(mi.load_string(text))


def test_other_variants_say_so():
    with mi.variant_context("scalar_rgb"), pytest.raises(Exception, match="'scalar_rgb' is not supported"):
        mi.load_dict({"type": "phong"})
