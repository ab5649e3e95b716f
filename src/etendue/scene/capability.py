"""The capability check: whether the methods can render a scene correctly, before the first ray.

An unsupported element raises an error that names it and says what to use instead; nothing is approximated silently.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import SceneError, UnsupportedError, as_array, check_variant

from .bands import require_colours
from .changes.transforms import fault, mirrors, misshapen
from .graph import below, contents, describe, plugin_name, shapes, without_literals
from .lamps.environments import is_unsampled
from .lamps.radiance import is_black
from .media import is_constant, media_of, values_of, volume_of
from .packet import DISPERSES, is_spectral
from .space import METERS, SENSORS

if TYPE_CHECKING:
    import mitsuba as mi

_EMITTERS = (
    "area",
    "focusarea",
    "luminaire",
    "point",
    "spot",
    "projector",
    "directional",
    "directionalarea",
    "constant",
    "envmap",
    "sunsky",
    "sky",
)
_CURVES = ("bsplinecurve", "linearcurve")
#: Shapes besides meshes.
_SHAPES = ("rectangle", "disk", "sphere", "cylinder", "sdfgrid", "instance", "shapegroup", *_CURVES)
#: Shapes that may emit: points on them can be sampled uniformly by area.
_LAMPS = ("rectangle", "disk", "sphere", "cylinder")

#: Parameters of materials that are numbers, not colours.
_NUMBERS = {
    *("alpha", "alpha_u", "alpha_v", "roughness", "anisotropic", "metallic", "clearcoat", "clearcoat_gloss", "sheen"),
    *("sheen_tint", "spec_tint", "flatness", "spec_trans", "diff_trans", "opacity", "weight"),
}

_SENSOR_REMEDY = "use a 'perspective', 'thinlens', 'orthographic' or 'spherical' sensor, or a meter"


def check(scene: mi.Scene, sensor: mi.Sensor, lit: bool = True) -> None:
    """Raise :class:`UnsupportedError` or :class:`SceneError` if ``scene`` cannot be rendered through ``sensor``.

    ``lit``: whether it needs an emitter. Supported are perspective, thin-lens, orthographic and spherical sensors;
    every shape but ellipsoids, emitting from meshes, rectangles, discs, spheres and cylinders; every RGB
    emitter; every RGB BSDF; textures. Broken input (a NaN vertex or radiance, no emitter, an index beyond the vertices)
    is a :class:`SceneError`. Raises :class:`BackendError` under a Mitsuba variant that is not supported.
    """
    check_variant(scene.variant_name())
    without_literals(scene)
    _check_sensor(sensor)
    every_shape = shapes(scene)
    if not every_shape:
        raise SceneError("the scene has no shape, so there is nothing to render; add geometry")
    for shape in every_shape:
        _check_shape(shape)
    for medium in media_of(scene, sensor):
        _check_medium(medium)
    if lit and not scene.emitters():
        raise SceneError("the scene has no emitter, so every picture would be black; add one, such as 'constant'")
    for emitter in scene.emitters():
        _check_emitter(emitter)


def one_way(scene: mi.Scene) -> mi.Shape | None:
    """A shape that light crosses on paths which cannot be reversed, such as hair: only rays from outside hit curves, so
    that light enters it at a vertex and leaves it at none."""
    import mitsuba as mi

    through = mi.BSDFFlags.DiffuseTransmission | mi.BSDFFlags.GlossyTransmission | mi.BSDFFlags.DeltaTransmission
    for shape in shapes(scene):
        if plugin_name(shape) in _CURVES and shape.bsdf().flags() & through:
            return shape
    return None


def refuse_one_way(scene: mi.Scene, who: str) -> None:
    """Raise :class:`UnsupportedError` if light paths, which ``who`` needs, cannot cross it: see :func:`one_way`."""
    if (shape := one_way(scene)) is not None:
        raise UnsupportedError(
            f"{describe(shape, 'shape')} lets light through one way only, so that light paths, which {who} needs, "
            "cannot cross it; use auto, path or guided"
        )


def is_dark(scene: mi.Scene) -> bool:
    """Whether every emitter of a scene is known to be black."""
    return all(is_black(emitter) for emitter in scene.emitters())


def check_light(scene: mi.Scene) -> None:
    """Raises :class:`SceneError` if every emitter of a scene is black. For descriptions of scenes: in a loaded scene,
    all lamps may have been switched off."""
    if is_dark(scene):
        raise SceneError("every emitter of the scene emits nothing; give one a radiance above zero")


def _check_sensor(sensor: mi.Sensor) -> None:
    name = describe(sensor, "sensor")
    if plugin_name(sensor) not in (*SENSORS, *METERS):
        raise UnsupportedError(f"{name} is not supported; {_SENSOR_REMEDY}")
    film = sensor.film()
    if plugin_name(film) not in ("hdrfilm", "specfilm"):
        raise UnsupportedError(f"{describe(film, 'film')} is not supported; use 'hdrfilm'")
    if plugin_name(sensor) in METERS:
        require_colours(film, name)
    if film.sample_border():
        raise UnsupportedError(
            f"{describe(film, 'film')} samples its border, which is not supported; set sample_border to false"
        )
    _check_values(sensor, name)


def _check_shape(shape: mi.Shape) -> None:
    import mitsuba as mi

    name = describe(shape, "shape")
    values = dict(contents(shape).values)
    if not shape.is_mesh() and plugin_name(shape) not in _SHAPES:
        raise UnsupportedError(f"{name} is not supported; convert it to a mesh")
    if "vertex_positions" in values:
        _check_mesh(shape, values, name)
    else:
        _check_values(shape, name)
        if "to_world" in values and (why := misshapen(plugin_name(shape), values["to_world"])) is not None:
            raise UnsupportedError(f"{name} {why}")
    bsdf = shape.bsdf()
    if bsdf is not None:
        for node in below(bsdf):
            _check_values(node, f"{describe(node, 'material' if isinstance(node, mi.BSDF) else 'texture')} of {name}")
        if is_spectral():
            _check_spectra(bsdf, name)
    if shape.is_emitter():
        if not shape.is_mesh() and plugin_name(shape) not in _LAMPS:
            raise UnsupportedError(
                f"{name} emits light, which is not supported; use a mesh or one of: {', '.join(_LAMPS)}"
            )
        if not float(np.asarray(shape.surface_area()).ravel()[0]) > 0:
            raise SceneError(f"{name} emits light but has no area; remove it or repair its geometry")
        if plugin_name(shape) == "cylinder" and mirrors(values["to_world"]):
            raise UnsupportedError(
                f"{name} emits light and has a 'to_world' that mirrors it, so that Mitsuba draws its inside as lit and "
                "samples its outside; remove the reflection"
            )


def _check_spectra(bsdf: mi.BSDF, name: str) -> None:
    """Raise :class:`UnsupportedError` if a colour of the material of the shape ``name`` has no spectrum, or if it
    cannot be told whether light that it transmits is dispersed."""
    import mitsuba as mi

    for node in below(bsdf):
        if plugin_name(node) == "blendbsdf" and node.flags() & DISPERSES:
            raise UnsupportedError(
                f"{describe(node, 'material')} of {name} blends a material that disperses light with another, which is "
                "not supported; use one of them"
            )
        for key, child in contents(node).objects:
            if not isinstance(child, mi.Texture) or key in _NUMBERS or plugin_name(node) in ("normalmap", "bumpmap"):
                continue
            try:
                child.eval(dr.zeros(mi.SurfaceInteraction3f))
            except RuntimeError:
                raise UnsupportedError(
                    f"'{key}' of {describe(node, 'material')} of {name} has no spectrum: set 'raw' of its bitmap to "
                    "false, or render under an RGB variant (llvm_ad_rgb)"
                ) from None


def _check_emitter(emitter: mi.Emitter) -> None:
    import mitsuba as mi

    kind, name = plugin_name(emitter), describe(emitter, "emitter")
    shape = emitter.get_shape()
    if shape is not None and mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface):
        name += f" on {describe(shape, 'shape')}"
    if kind not in _EMITTERS:
        raise UnsupportedError(f"{name} is not supported; use one of: {', '.join(_EMITTERS)}")
    for node in below(emitter):
        _check_values(node, name)
    if kind == "projector":
        texture = dict(contents(emitter).objects)["irradiance"]
        if texture.is_spatially_varying() and plugin_name(texture) != "bitmap":
            raise UnsupportedError(
                f"{name} projects a {describe(texture, 'texture')}, which is not supported; use a 'bitmap'"
            )
    if is_unsampled(emitter):
        raise UnsupportedError(
            f"{name} is lit in its first or last row, beside dark texels, where Mitsuba does not sample it; give the "
            "scene as a file or a dictionary of plugins, or the picture twice as many rows"
        )


def _check_medium(medium: mi.Medium) -> None:
    import mitsuba as mi

    name = describe(medium, "medium")
    if plugin_name(medium) not in ("homogeneous", "heterogeneous"):
        raise UnsupportedError(f"{name} is not supported; use a 'homogeneous' or a 'heterogeneous' one")
    if mi.has_flag(medium.phase_function().flags(), mi.PhaseFunctionFlags.Microflake):
        raise UnsupportedError(f"{name} has a phase function of microflakes, which is not supported; use 'hg'")
    if medium.is_homogeneous() and not is_constant(volume_of(medium, "sigma_t")):
        raise SceneError(f"{name} has a volume as its 'sigma_t', but is homogeneous; make it 'heterogeneous'")
    for node in below(medium):
        _check_values(node, name)
    for key in ("sigma_t", "albedo"):
        values = _values(medium, key)
        if not np.isfinite(values).all():
            raise SceneError(f"{name} has a '{key}' that is not a finite number; correct it in the scene")
        if (values < 0.0).any():
            raise SceneError(f"{name} has a negative '{key}' or scale; correct it in the scene")
        if key == "albedo" and (values > 1.0 + 1e-5).any():
            raise SceneError(f"{name} has an albedo above 1, which would create light; lower it")


def _values(medium: mi.Medium, key: str) -> NDArray[np.floating[Any]]:
    """All values of a volume of a medium, that of the extinction times the medium's scale."""
    volume = volume_of(medium, key)
    if volume is None:
        return np.zeros(0)
    return values_of(volume) * (float(dict(contents(medium).values)["scale"]) if key == "sigma_t" else 1.0)


def _check_values(item: mi.Object, name: str) -> None:
    """Raise :class:`SceneError` if a number of the object is not finite."""
    for key, value in contents(item).values:
        if "Transform" in type(value).__name__ and (why := fault(plugin_name(item), key, value)) is not None:
            raise SceneError(f"{name} {why}")
        array = _floats(value)
        if array is not None and not np.isfinite(array).all():
            raise SceneError(f"{name} has a NaN or infinite value in '{key}'; correct it in the scene")


def _check_mesh(mesh: mi.Mesh, values: dict[str, Any], name: str) -> None:
    for key in ("vertex_positions", "vertex_normals", "vertex_texcoords"):
        array = _floats(values.get(key))
        if array is not None and not np.isfinite(array).all():
            width = 2 if key == "vertex_texcoords" else 3
            vertex = int(np.flatnonzero(~np.isfinite(array))[0]) // width
            raise SceneError(f"{name} has a NaN or infinite number in {key} of vertex {vertex}; repair the mesh")
    faces = np.asarray(values["faces"])
    if faces.size == 0:
        raise SceneError(f"{name} has no faces; remove it or repair the mesh")
    if int(faces.max()) >= mesh.vertex_count():
        face = int(np.argmax(faces >= mesh.vertex_count())) // 3
        raise SceneError(
            f"{name} has a face ({face}) with vertex {int(faces.max())}, but only {mesh.vertex_count()} vertices; "
            "repair the mesh"
        )


def _floats(value: Any) -> NDArray[np.floating[Any]] | None:
    """``value`` as a float array, ``None`` if it has another type."""
    if value is None or isinstance(value, (str, bool)):
        return None
    array = as_array(value)
    return array if array.dtype.kind == "f" else None
