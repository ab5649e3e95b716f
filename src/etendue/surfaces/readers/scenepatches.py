"""Patches of a Mitsuba scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SceneError, UnsupportedError, logger, seed_key, use_variant
from etendue.scene import Problem, RenderSpace, graph, load, refuse_media, require_rgb, warn_of_steps

from ..errors import PatchError, SurfaceError
from ..patches import Patches
from .meshfiles import broken_faces
from .tessellation import face_means, tessellate

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]


def scene_patches(
    scene: Any,
    *,
    max_area: float | None = None,
    per: Literal["face", "shape"] = "face",
    segments: int = 32,
    lamps_apart: bool = False,
) -> Patches:
    """Patches of a scene: an ``mi.Scene``, or another argument or a result of :func:`etendue.scene.load`. Channels are
    red, green, blue.

    Each face of a shape is a patch, with the mean of its textures (faces without area and duplicates keep their rows,
    see ``left_out`` of :class:`Patches`), or each shape is a patch (``per="shape"``).
    Rectangles become quadrilaterals, spheres, cylinders and disks polygons of ``segments`` sides inside them.
    Reflectance is that of a diffuse material; other reflecting materials are replaced by diffuse ones with the same
    hemispherical albedo, with a warning. A ``twosided`` material makes sheets. Area lights emit from their fronts; a
    ``constant`` light is the sky.

    max_area: larger faces are subdivided after textures are read, see :meth:`Patches.subdivided`; not for
        ``per="shape"``.

    lamps_apart: leave out lamps without a surface, such as ``point`` or ``envmap``, whose light
        :func:`etendue.radiosity.lamp_light` finds; otherwise they are refused.

    The patches know their ``shapes``, for :func:`find_objects`.

    Raises :class:`UnsupportedError` for materials that transmit, lights that are not diffuse or have no area, curves,
    volumes and instances, :class:`SceneError` for a scene without shapes, :class:`PatchError` for broken meshes and
    for materials that absorb nothing. A scene without emitter is valid, since form factors need no light.
    """
    use_variant()
    require_rgb("patches of scenes")
    scene, space = loaded_scene(scene)
    if per not in ("face", "shape"):
        raise SurfaceError(f"a patch is made per 'face' or per 'shape', not {per!r}")
    if per == "shape" and max_area is not None:
        raise SurfaceError("each shape is one patch and is not divided: leave out max_area, or take per='face'")
    if not isinstance(segments, int) or segments < 3:
        raise SurfaceError(f"a circle needs three segments at least, not {segments!r}")
    refuse_media(scene, "patches")
    patches, shape, sheets = patches_of(scene.shapes(), segments, space)
    patches = patches.with_properties(sky=scene_sky(scene, lamps_apart))
    if space.is_own:
        remedy = "put it near the origin, or give it as a file or as a dictionary of plugins"
        warn_of_steps("the scene", np.abs(patches.vertices).max(), patches.sphere[1], remedy)
    if per == "shape":
        patches = _joined(patches, shape, sheets)
        patches.shapes = patches.labels
    else:
        patches.shapes = shape[patches.labels]
    patches.shape_names = tuple(graph.name(item) or f"shape {k}" for k, item in enumerate(scene.shapes()))
    return patches if max_area is None else patches.subdivided(max_area)


def patches_of(shapes: Sequence[Any], segments: int, space: RenderSpace) -> tuple[Patches, Index, NDArray[np.bool_]]:
    """Patches of Mitsuba shapes, one for each face; the shape of each face, and which shapes are sheets."""
    parts = [_part(shape, segments) for shape in shapes]
    if not parts:
        raise SceneError("the scene has no shapes; a radiosity problem needs surfaces")
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    counts = [len(part.faces) for part in parts]
    is_sheet = np.array([part.is_sheet for part in parts])
    sheets = np.repeat(is_sheet, counts)
    reflectance = np.concatenate([part.reflectance for part in parts])
    backs = np.concatenate([part.back_reflectance for part in parts])[sheets]
    emission = np.concatenate([part.emission for part in parts])
    patches = Patches(
        space.to_scene(np.concatenate([part.vertices for part in parts])),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets[:-1], strict=True)]),
        reflectance=np.concatenate([reflectance, backs]),
        emission=np.concatenate([emission, np.zeros_like(backs)]),
        two_sided=sheets,
        left_out=np.concatenate(
            [part.left_out + first for part, first in zip(parts, np.cumsum([0, *counts]), strict=False)]
        ),
    )
    return patches, np.repeat(np.arange(len(parts)), counts), is_sheet


def loaded_scene(scene: Any) -> tuple[mi.Scene, RenderSpace]:
    """The ``mi.Scene`` for an argument of :func:`scene_patches`, and its space, which is not that of a
    :class:`RayScene`."""
    import mitsuba as mi

    if isinstance(scene, mi.Scene):
        return scene, RenderSpace()
    problem = scene if isinstance(scene, Problem) else load(scene)
    return problem.scene, problem.space


@dataclass
class _Part:
    """One shape."""

    vertices: Array
    faces: Index
    reflectance: Array  # (m, 3), fronts
    back_reflectance: Array
    emission: Array
    is_sheet: bool
    left_out: Index


def _part(shape: mi.Shape, segments: int) -> _Part:
    import mitsuba as mi

    points, faces, at = tessellate(shape, segments)
    bsdf = shape.bsdf()
    is_sheet = bool(mi.has_flag(bsdf.flags(), mi.BSDFFlags.BackSide))
    front = face_means(_albedo(bsdf, at), len(faces))
    if is_sheet:
        at.wi = mi.Vector3f(0, 0, -1)
        back = face_means(_albedo(bsdf, at), len(faces))
    else:
        back = np.zeros_like(front)
    brightest = max(front.max(initial=0), back.max(initial=0))
    if brightest >= 1:
        raise PatchError(
            f"{graph.describe(bsdf, 'material')} reflects {brightest:.3g} of the light: radiosity needs less than 1"
        )
    emission = np.zeros_like(front)
    if shape.emitter() is not None:
        if graph.plugin_name(shape.emitter()) != "area":
            raise UnsupportedError(
                f"{graph.describe(shape.emitter(), 'emitter')} does not emit evenly into all directions; radiosity "
                "needs an area light of type 'area'"
            )
        at.wi = mi.Vector3f(0, 0, 1)
        emission = np.pi * face_means(shape.emitter().eval(at), len(faces))
    left_out = broken_faces(points, faces, graph.describe(shape, "shape"))
    return _Part(points, faces, front, back, emission, is_sheet, left_out)


def _albedo(bsdf: mi.BSDF, at: mi.SurfaceInteraction3f) -> mi.Color3f:
    """Share of the light that is reflected on the side of ``at.wi``."""
    import mitsuba as mi

    flags = bsdf.flags()
    if mi.has_flag(flags, mi.BSDFFlags.Transmission) or mi.has_flag(flags, mi.BSDFFlags.Null):
        raise UnsupportedError(
            f"{graph.describe(bsdf, 'material')} transmits light, which radiosity does not support; replace it by an "
            "opaque one, or render the picture by 'path' or 'vcm'"
        )
    if not (mi.has_flag(flags, mi.BSDFFlags.Glossy) or mi.has_flag(flags, mi.BSDFFlags.Delta)):
        return bsdf.eval_diffuse_reflectance(at)
    logger.warning("%s counts as diffuse, with the same albedo", graph.describe(bsdf, "material"))
    return _hemispherical_albedo(bsdf, at)


def _hemispherical_albedo(bsdf: mi.BSDF, at: mi.SurfaceInteraction3f, directions: int = 16) -> mi.Color3f:
    """Mean over uniform incident light, with the same random numbers for every face."""
    import mitsuba as mi

    side = dr.sign(at.wi.z)
    generator = mi.PCG32(size=dr.width(at.p), initstate=seed_key(0, "albedo", 0)[0])
    total = dr.zeros(mi.Spectrum, dr.width(at.p))
    context = mi.BSDFContext()
    for _ in range(directions):
        u = mi.Point2f(generator.next_float32(), generator.next_float32())
        at.wi = mi.warp.square_to_cosine_hemisphere(u)
        at.wi.z *= side
        u = mi.Point2f(generator.next_float32(), generator.next_float32())
        total += bsdf.sample(context, at, generator.next_float32(), u)[1]
    return total / directions


def scene_sky(scene: mi.Scene, are_apart: bool = False) -> Array:
    """(3,) radiosity of ``constant`` lights. Raises :class:`UnsupportedError` for :func:`lamps_apart`, unless they
    ``are_apart``."""
    import mitsuba as mi

    if not are_apart and (others := lamps_apart(scene)):
        raise UnsupportedError(
            f"{graph.describe(others[0], 'emitter')} has no surface; radiosity takes area lights, and 'constant' as "
            "the sky; read the patches with lamps_apart=True, and add lamp_light"
        )
    skies = [emitter for emitter in scene.emitters() if graph.plugin_name(emitter) == "constant"]
    at = dr.zeros(mi.SurfaceInteraction3f)
    light = [np.pi * np.array(sky.eval(at), dtype=np.float64).ravel() for sky in skies]
    return np.sum(light, axis=0) if light else np.zeros(3)


def lamps_apart(scene: mi.Scene) -> list[mi.Emitter]:
    """The lamps of a scene without a surface, apart from ``constant``."""
    return [lamp for lamp in scene.emitters() if lamp.get_shape() is None and graph.plugin_name(lamp) != "constant"]


def _joined(patches: Patches, shape: Index, sheets: NDArray[np.bool_]) -> Patches:
    """One patch for each shape, with means by area."""
    faces = len(shape)
    group = np.concatenate([shape, shape[patches.other_side[:faces] >= 0]])
    is_back = np.arange(len(patches)) >= faces
    order = np.cumsum(sheets) - 1 + len(sheets)
    group = np.where(is_back, order[group], group)
    weight = np.bincount(group, patches.areas)

    def means(values: Array) -> Array:
        return np.stack([np.bincount(group, column * patches.areas) / weight for column in values.T], axis=1)

    return Patches(
        patches.vertices,
        patches.faces,
        reflectance=means(patches.reflectance),
        emission=means(patches.emission),
        ids=shape[patches.labels[patches.front]],
        two_sided=sheets,
        sky=patches.sky,
        numbers=patches.numbers,
    )
