"""Tests whether reflectances, opacities and weights are between zero and one."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import graph

from .report import Finding, Findings
from .surfaces import Array, host, points_on

_POINTS = 4096
#: Parameters of Mitsuba's and étendue's materials that must be in [0, 1].
_SHARES = frozenset(
    (
        "reflectance",
        "diffuse_reflectance",
        "specular_reflectance",
        "specular_transmittance",
        "base_color",
        "opacity",
        "weight",
        "metallic",
        "roughness",
        "spec_trans",
        "clearcoat",
    )
)


def check_textures(
    bsdf: mi.BSDF,
    component: str | None = None,
    *,
    scene: mi.Scene | None = None,
    shape: mi.Shape | None = None,
    seed: int = 0,
) -> list[Finding]:
    """Test each texture of a ``mi.BSDF`` that must be in [0, 1] (reflectances, opacity, weights): all texels of a
    bitmap, other textures at points of ``shape``. One finding, ``texture NAME``, for each."""
    rng = np.random.default_rng([seed, 0x7E87])
    name = component or graph.describe(bsdf, "material")
    rows: list[Finding] = []
    si = None
    for node in graph.below(bsdf):
        for key, texture in graph.contents(node).objects:
            if key not in _SHARES or not isinstance(texture, mi.Texture):
                continue
            findings = Findings(name)
            with findings.trying(f"texture {key}"):
                texels = dict(graph.contents(texture).values).get("data")
                if texels is not None and texels.ndim == 3:
                    values = _values(texture, np.asarray(texels.array))
                elif not texture.is_spatially_varying():
                    values = host(texture.eval(points_on(None, None, 1, rng)), 1)
                else:
                    si = si if si is not None else points_on(scene, shape, _POINTS, rng)
                    values = host(texture.eval(si), dr.width(si.uv))
                _judge(findings, key, values)
            rows += findings.rows
    return rows


def _values(texture: mi.Texture, texels: NDArray[Any]) -> Array:
    """The values that a bitmap's texels stand for: Mitsuba keeps eight bits as they are, in sRGB unless ``raw``, and
    converts other formats."""
    values = texels.astype(np.float64)
    if texels.dtype.kind == "f":
        return values
    values /= np.iinfo(texels.dtype).max
    if "raw = 1" in str(texture):
        return values
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _judge(findings: Findings, key: str, values: Array) -> None:
    low, high = float(values.min()), float(values.max())
    outside = not (low >= -1e-4 and high <= 1.0 + 1e-4)
    worst = low if not low >= -1e-4 else high
    findings.judge(
        f"texture {key}",
        worst,
        1.0,
        f"largest value; the least is {low:.3g}",
        f"it must be in [0, 1] but has values from {low:.3g} to {high:.3g}, so the material creates light or absorbs "
        "more than arrives; scale the texture to [0, 1]",
        failed=outside,
    )
