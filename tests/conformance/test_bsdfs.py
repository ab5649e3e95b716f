"""Broken materials are found, each by the test that is for it; right ones pass."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.tables import thinned

from etendue.conformance import check_bsdf, check_textures


def verdicts(findings: list[Any]) -> dict[str, str]:
    return {f.test: f.verdict for f in findings}


def failing(findings: list[Any]) -> set[str]:
    return {f.test for f in findings if f.verdict == "fail"}


def broken(fault: str) -> Any:
    """A white-painted surface with one fault."""

    class Paint(mi.BSDF):
        def __init__(self) -> None:
            super().__init__(mi.Properties())
            self.plugin_name = "paint"
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def traverse(self, callback: Any) -> None:
            pass

        def _above(self, si: Any, wo: Any) -> Any:
            return (mi.Frame3f.cos_theta(si.wi) > 0.0) & (mi.Frame3f.cos_theta(wo) > 0.0)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            value = 0.7 * cos_o / dr.pi
            if fault == "creates energy":
                value *= 1.6
            if fault == "one-way":
                value *= 0.4 + 0.6 * cos_i
            if fault == "negative":
                value *= dr.select(wo.x > 0.9, -1.0, 1.0)
            if fault == "nan":
                value = dr.select(wo.x > 0.9, dr.nan, value)
            return mi.Color3f(value) & self._above(si, wo)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            cos = mi.Frame3f.cos_theta(wo)
            # Uniform over the hemisphere in place of the cosine that sample uses.
            value = dr.inv_two_pi if fault in ("pdf", "both pdfs") else cos * dr.inv_pi
            if fault == "unnormalised":
                value *= 1.2
            if fault == "half":
                value = dr.select(wo.x > 0.0, 2.0 * value, 0.0)
            return dr.select(self._above(si, wo), value, 0.0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            wo = mi.warp.square_to_cosine_hemisphere(sample2)
            if fault == "half":
                wo.x = dr.abs(wo.x)
            bs = mi.BSDFSample3f()
            bs.wo = wo
            bs.pdf = self.pdf(ctx, si, bs.wo)
            if fault == "pdf":
                bs.pdf = bs.wo.z * dr.inv_pi
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.DiffuseReflection))
            bs.sampled_component = 0
            weight = self.eval(ctx, si, bs.wo) / bs.pdf
            if fault == "weight":
                weight *= 0.5 + bs.wo.z
            if fault == "raises":
                raise ValueError("no such lobe")
            return bs, dr.select(self._above(si, bs.wo) & (bs.pdf > 0.0), weight, 0.0)

        def to_string(self) -> str:
            return "Paint[]"

    return Paint()


FAULTS = {
    "none": set(),
    "creates energy": {"energy"},
    "one-way": {"reciprocity"},
    "negative": {"range"},
    "nan": {"range"},
    "pdf": {"density", "sampler"},
    "both pdfs": {"sampler"},
    "unnormalised": {"integral", "sampler"},
    "half": {"coverage"},
    "weight": {"weight"},
    "raises": {"interface"},
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("quick", [False, True])
def test_a_fault_is_found_by_its_test(fault, quick):
    assert failing(check_bsdf(broken(fault), quick=quick)) == FAULTS[fault]


def test_figures_are_those_of_the_fault():
    rows = {f.test: f for f in check_bsdf(broken("creates energy"), "the wall")}
    assert rows["energy"].figure == pytest.approx(1.12, abs=1e-3)
    assert rows["energy"].component == "the wall"
    assert "1.12" in rows["energy"].meaning
    rows = {f.test: f for f in check_bsdf(broken("unnormalised"))}
    assert rows["integral"].figure == pytest.approx(1.2, abs=0.01)
    # Relative to the claimed density, which is 1.2 times the right one, RMS over the samples.
    assert rows["sampler"].figure == pytest.approx(0.2 / np.sqrt(1.2), abs=0.03)
    (row,) = (f for f in check_bsdf(broken("raises")) if f.verdict == "fail")
    assert "no such lobe" in row.meaning


def test_the_same_seed_gives_the_same_findings():
    first, again = (check_bsdf(mi.load_dict(scenes.MATERIALS["roughplastic"]()), seed=3) for _ in range(2))
    assert first == again
    assert first != check_bsdf(mi.load_dict(scenes.MATERIALS["roughplastic"]()), seed=4)


@pytest.mark.parametrize("material", thinned(scenes.MATERIALS, [*scenes.MATERIALS][::2]))
def test_materials_of_mitsuba_and_ours_pass(material):
    """On a ball in a room, at points that textures and bumps see."""
    problem = scenes.room("constant", (material,))
    (shape,) = (s for s in problem.scene.shapes() if s.id() in (material, "mesh") or "mesh" in s.id())
    rows = check_bsdf(shape.bsdf(), scene=problem.scene, shape=shape)
    assert failing(rows) == set(), [r for r in rows if r.verdict == "fail"]
    assert {r.test for r in rows if r.verdict == "warn"} <= WARNED.get(material, set())


#: What is known of materials of Mitsuba, and is warned of.
WARNED = {m: {"reciprocity"} for m in scenes.MATERIALS if m.startswith(("bumpmap", "normalmap"))}
WARNED |= {"roughdielectric": {"loss"}, "blendbsdf": {"range"}}


@pytest.mark.parametrize("alpha", [0.003, 0.03, 1.0])
@pytest.mark.parametrize("kind", ["roughconductor", "roughdielectric"])
def test_narrow_and_broad_lobes_pass(kind, alpha):
    rows = check_bsdf(mi.load_dict({"type": kind, "distribution": "ggx", "alpha": alpha}))
    assert failing(rows) == set(), [r for r in rows if r.verdict == "fail"]


@pytest.mark.parametrize(("alpha", "verdict"), [(0.05, "pass"), (0.7, "warn")])
def test_light_that_rough_glass_loses(alpha, verdict):
    glass = {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha}
    (row,) = (r for r in check_bsdf(mi.load_dict(glass)) if r.test == "loss")
    assert row.verdict == verdict
    coloured = check_bsdf(mi.load_dict(glass | {"specular_transmittance": 0.5}))
    assert "loss" not in {r.test for r in coloured}


def test_a_texture_above_one_is_found():
    pixels = np.full((4, 4, 3), 0.5, np.float32)
    pixels[1, 2, 0] = 1.5
    bsdf = mi.load_dict({"type": "diffuse", "reflectance": scenes.bitmap(pixels)})
    (row,) = check_textures(bsdf, "the wall")
    assert (row.verdict, row.figure) == ("fail", 1.5)
    assert (row.component, row.test) == ("the wall", "texture reflectance")


def test_textures_within_range_pass():
    bsdf = mi.load_dict(scenes.MATERIALS["twosided"]())
    rows = check_textures(bsdf)
    assert [(r.verdict, pytest.approx(r.figure)) for r in rows] == [("pass", 0.7), ("pass", 0.7)]


@pytest.mark.parametrize("number", ["uint8", "uint16", "float16", "float32"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_texels_of_every_format_are_read_as_the_texture_returns_them(number: str, channels: int) -> None:
    stored = np.linspace(0.1, 0.9, 4 * channels).reshape(2, 2, channels)
    if number.startswith("uint"):
        stored *= np.iinfo(number).max
    for raw in (None, True, False):
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(stored.astype(number)), "accel": False}
        texture |= {} if raw is None else {"raw": raw}
        (row,) = check_textures(mi.load_dict({"type": "diffuse", "reflectance": texture}))
        si = dr.zeros(mi.SurfaceInteraction3f, 4)
        si.uv = mi.Point2f([0.25, 0.75, 0.25, 0.75], [0.25, 0.25, 0.75, 0.75])  # the centres of the texels
        largest = np.asarray(mi.load_dict(texture).eval(si)).max()
        assert (row.verdict, row.figure) == ("pass", pytest.approx(largest, rel=2e-3))
