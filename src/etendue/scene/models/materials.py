"""Materials of model files as Mitsuba's: those of OBJ (MTL) and of glTF 2.0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import logger

from ..packet import is_spectral

Dict = dict[str, Any]

#: Material of a surface without one.
PLAIN: Dict = {"type": "twosided", "nested": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}}
#: Illumination models of MTL that refract, and that reflect like a mirror.
_REFRACTING, _MIRRORS = (4, 6, 7, 9), (3, 5, 8)
#: Least roughness of a glossy material, below which it is smooth.
_LEAST_ROUGHNESS = 0.02


def of_mtl(material: Any) -> tuple[Dict, Dict | None]:
    """BSDF and radiance (None: no light) of a material of an MTL file, as trimesh reads it.

    ``d`` below 1 with a refracting ``illum`` is glass of index ``Ni``, otherwise opacity. ``Pr`` and ``Pm`` make it
    ``principled``; ``Ks`` above 0 and ``illum`` 2 make it plastic, whose roughness is that of a Phong lobe of exponent
    ``Ns`` [Walter 2007, sec. 5.2]; else it is diffuse. ``Ke`` is the radiance.
    """
    values = material.kwargs
    given = _numbers(values.get("kd"), [0.8])
    diffuse = _textured(material.image, given) if material.image is not None else rgb(given)
    glossy, emitted = _numbers(values.get("ks"), [0.0]), _numbers(values.get("ke"), [0.0])
    illum, index = int(_numbers(values.get("illum"), [2])[0]), _numbers(values.get("ni"), [1.5])[0]
    opacity = _numbers(values.get("d"), [1.0 - _numbers(values.get("tr"), [0.0])[0]])[0]
    if illum in _REFRACTING and opacity < 1.0 and index > 1.0:
        bsdf: Dict = {"type": "dielectric", "int_ior": index}
        opacity = 1.0
    elif "pr" in values or "pm" in values:
        bsdf = _twosided(
            {
                "type": "principled",
                "base_color": diffuse,
                "roughness": max(_numbers(values.get("pr"), [0.5])[0], _LEAST_ROUGHNESS),
                "metallic": _numbers(values.get("pm"), [0.0])[0],
            }
        )
    elif illum in _MIRRORS and max(glossy) > 0.0 and max(given) == 0.0:
        bsdf = _twosided({"type": "conductor", "material": "none", "specular_reflectance": rgb(glossy)})
    elif max(glossy) > 0.0 and illum >= 2:
        exponent = max(_numbers(values.get("ns"), [10.0])[0], 0.0)
        alpha = float(np.sqrt(2.0 / (exponent + 2.0)))
        bsdf = _twosided({"type": "roughplastic", "alpha": alpha, "diffuse_reflectance": diffuse, "nonlinear": True})
    else:
        bsdf = _twosided({"type": "diffuse", "reflectance": diffuse})
    if opacity < 1.0:
        bsdf = {"type": "mask", "opacity": opacity, "nested": bsdf}
    return bsdf, rgb(emitted) if max(emitted) > 0.0 else None


def of_gltf(material: Any, raw: Mapping[str, Any]) -> tuple[Dict, Dict | None]:
    """BSDF and radiance (None: no light) of a material of a glTF file, as trimesh reads it; ``raw``: the same as in the
    file, for its factors in full precision and for the extensions ``KHR_materials_emissive_strength``,
    ``KHR_materials_ior``, ``KHR_materials_transmission`` and, where all light is transmitted, under spectral variants,
    ``KHR_materials_dispersion``."""
    surface, extensions = raw.get("pbrMetallicRoughness", {}), raw.get("extensions", {})
    colour = [float(v) for v in surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))]
    texture = material.baseColorTexture
    bsdf: Dict = {"type": "principled"}
    bsdf["base_color"] = rgb(colour[:3]) if texture is None else _textured(texture, colour[:3])
    bsdf["metallic"] = metallic = float(surface.get("metallicFactor", 1.0))
    bsdf["roughness"] = roughness = max(float(surface.get("roughnessFactor", 1.0)), _LEAST_ROUGHNESS)
    if material.metallicRoughnessTexture is not None:
        channels = _array(material.metallicRoughnessTexture.convert("RGB")).astype(np.float32) / 255.0
        bsdf["roughness"] = _raw(np.maximum(channels[..., 1] * roughness, _LEAST_ROUGHNESS))
        bsdf["metallic"] = _raw(channels[..., 2] * metallic)
    transmission = float(extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0))
    bsdf["eta"] = float(extensions.get("KHR_materials_ior", {}).get("ior", 1.5))
    dispersion = float(extensions.get("KHR_materials_dispersion", {}).get("dispersion", 0.0))
    if dispersion > 0.0 and transmission == 1.0:
        bsdf = _dispersive(bsdf, roughness, dispersion)
    elif transmission > 0.0:
        bsdf["spec_trans"] = transmission
    else:
        bsdf = _twosided(bsdf)
    if material.normalTexture is not None:
        bsdf = {
            "type": "normalmap",
            "normalmap": _bitmap(material.normalTexture.convert("RGB"), raw=True),
            "bsdf": bsdf,
        }
    mode = raw.get("alphaMode", "OPAQUE")
    if mode in ("MASK", "BLEND"):
        cut = float(raw.get("alphaCutoff", 0.5)) if mode == "MASK" else None
        opacity = _opacity(texture, colour[3], cut)
        if opacity is not None:
            bsdf = {"type": "mask", "opacity": opacity, "nested": bsdf}
    strength = float(extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0))
    emitted = [strength * float(v) for v in raw.get("emissiveFactor", (0.0, 0.0, 0.0))]
    if max(emitted) <= 0.0:
        return bsdf, None
    shining = material.emissiveTexture
    return bsdf, rgb(emitted) if shining is None else _textured(shining, emitted)


def _dispersive(principled: Dict, roughness: float, dispersion: float) -> Dict:
    """Glass that disperses light, in place of a material that transmits all light; without dispersion in RGB."""
    if not is_spectral():
        logger.warning("glass with dispersion is rendered without it in RGB; use a spectral variant (llvm_ad_spectral)")
        return principled | {"spec_trans": 1.0}
    index = {"int_ior": principled["eta"], "ext_ior": 1.0, "dispersion": dispersion}
    glass: Dict = {"type": "dispersive"}
    if roughness > _LEAST_ROUGHNESS:
        glass = {"type": "roughdispersive", "distribution": "ggx", "alpha": roughness**2}
    return {**glass, **index, "specular_transmittance": principled["base_color"]}


def of_vertices() -> Dict:
    """A diffuse material with the colours of a mesh's vertices."""
    return _twosided({"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}})


def rgb(values: Any) -> Dict:
    """A colour of a scene dictionary, from one number or three."""
    values = [float(v) for v in values]
    return {"type": "rgb", "value": values * 3 if len(values) == 1 else values[:3]}


def _numbers(words: Any, default: list[float]) -> list[float]:
    """Numbers of a statement, which trimesh leaves as words; the default for what is no number."""
    try:
        found = [float(word) for word in (words if isinstance(words, list) else [words])]
    except (TypeError, ValueError):
        return default
    return found if found and np.isfinite(found).all() else default


def _twosided(bsdf: Dict) -> Dict:
    return {"type": "twosided", "nested": bsdf}


def _array(image: Any) -> NDArray[Any]:
    return np.array(image)  # a copy, since Mitsuba takes no array that is read-only


def _textured(image: Any, factor: list[float]) -> Dict:
    """A picture times a factor, whose values are linear."""
    picture = image.convert("RGB")
    if np.allclose(factor, 1.0):
        return _bitmap(picture)
    import mitsuba as mi

    linear = np.array(mi.Bitmap(_array(picture)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))
    return _raw(linear * np.asarray(factor, np.float32))


def _bitmap(image: Any, raw: bool = False) -> Dict:
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(_array(image)), "raw": raw}


def _raw(values: NDArray[Any]) -> Dict:
    """A texture of linear values: colours, or numbers."""
    import mitsuba as mi

    values = np.ascontiguousarray(values if values.ndim == 3 else values[..., None], np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": values.shape[2] == 1}


def _opacity(image: Any, factor: float, cut: float | None) -> Dict | float | None:
    """Opacity by the alpha of a picture, 0 or 1 where there is a threshold; None if all is opaque."""
    alpha = np.full((1, 1), factor, np.float32)
    if image is not None and "A" in image.getbands():
        alpha = factor * _array(image.getchannel("A")).astype(np.float32) / 255.0
    if cut is not None:
        alpha = (alpha >= cut).astype(np.float32)
    if alpha.min() >= 1.0:
        return None
    return float(alpha[0, 0]) if alpha.size == 1 else _raw(alpha)
