"""The radiance of area lights over their surface, in cells, for textured lights and for meshes with vertex normals.

A cell is a triangle of a mesh, or a part of the unit square from which a rectangle, disc, sphere or cylinder samples
its points. Its mean radiance is measured at evenly distributed points, at least as dense as the texels of the texture.

A mesh with vertex normals emits into directions in front of both its face and its interpolated normal, by which Mitsuba
evaluates the radiance. Area and cosines are those of the faces, so points are sampled by triangle: Mitsuba tells only
the interpolated normal of a sampled point.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import as_array

from ..graph import contents, plugin_name
from ..packet import is_spectral, spread_wavelengths

#: Shapes that sample points uniformly by an invertible map of the unit square. All other lights are meshes.
SURFACES = ("rectangle", "disk", "sphere", "cylinder")
#: Smallest and largest number of cells per axis of that square; a cell has several texels of a larger texture.
_LEAST_CELLS, _MOST_CELLS = 32, 512
#: Points along an axis of a cell, and in a triangle, if no texels determine these numbers.
_POINTS, _TRIANGLE_POINTS = 4, 64
#: Points per texel in a triangle, where they are not a grid.
_TEXEL_POINTS = 4
#: Points that are evaluated at once, and limit for all triangles of a mesh.
_CHUNK, _MOST_POINTS = 1 << 20, 1 << 24


@dataclass
class RadianceCells:
    """An area light's surface in cells, each an entry of (rows, columns) arrays. Triangles fill the rows in turn."""

    surface: str  #: "mesh" or one of ``SURFACES``
    share: NDArray[np.float64]  #: of the light's area
    radiance: NDArray[np.float64]  #: mean over the cell and the colour channels, along the normal

    @property
    def mean(self) -> float:
        """Mean radiance of the light."""
        return float((self.share * self.radiance).sum())


def varies(emitter: mi.Emitter) -> bool:
    """Whether an area light's radiance depends on the point."""
    texture = _texture(emitter)
    return texture is not None and (texture.is_spatially_varying() or plugin_name(texture) == "meshattribute")


def is_smooth(emitter: mi.Emitter) -> bool:
    """Whether an area light is a mesh with vertex normals."""
    shape = emitter.get_shape()
    normals = None if shape is None else dict(contents(shape).values).get("vertex_normals")
    return normals is not None and len(normals) > 0


def has_cells(emitter: mi.Emitter) -> bool:
    """Whether points of an area light are sampled by its cells."""
    return varies(emitter) or is_smooth(emitter)


def front(si: mi.SurfaceInteraction3f) -> mi.Normal3f:
    """The normal of a face on the side of its interpolated normal, which is the side that emits."""
    return dr.mulsign(si.n, dr.dot(si.n, si.sh_frame.n))


def measure(emitter: mi.Emitter) -> RadianceCells:
    """The cells of an area light that :func:`has_cells`."""
    shape, texture = emitter.get_shape(), _texture(emitter)
    measured = _of_texture if plugin_name(shape) in SURFACES else _of_mesh
    return measured(emitter, shape, texture)


def is_black(emitter: mi.Emitter) -> bool:
    """Whether an emitter is known to be black: a factor of its radiance is zero everywhere."""
    found = contents(emitter)
    numbers = [as_array(value) for name, value in found.values if name in ("data", "scale", "dimming")]
    textures = [value for name, value in found.objects if name in ("radiance", "intensity", "irradiance", "texture")]
    return any((array <= 0).all() for array in numbers) or any(_is_black_texture(texture) for texture in textures)


def _is_black_texture(texture: mi.Texture) -> bool:
    if plugin_name(texture) == "bitmap" and is_spectral():  # its data are coefficients
        return float(np.asarray(texture.mean()).ravel()[0]) <= 0.0
    if plugin_name(texture) == "bitmap":
        return bool((as_array(dict(contents(texture).values)["data"]) <= 0).all())
    try:
        return float(texture.max()) <= 0.0
    except RuntimeError:  # a texture without a known maximum
        return False


def _texture(emitter: mi.Emitter) -> mi.Texture | None:
    return dict(contents(emitter).objects).get("radiance")


# ---------------------------------------------------------------------------------------------------- points


def surface_point(
    shape: mi.Shape, triangle: mi.UInt32, place: mi.Point2f, active: mi.Bool | bool = True
) -> mi.SurfaceInteraction3f:
    """The point of an area light's shape for ``place`` in the unit square; for a mesh, ``place`` are barycentric
    coordinates in ``triangle``."""
    kind = plugin_name(shape)
    if kind not in SURFACES:
        met = dr.zeros(mi.PreliminaryIntersection3f)
        met.t = mi.Float(1.0)
        met.prim_index, met.prim_uv, met.shape = triangle, place, mi.ShapePtr(shape)
        ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0))  # unused: the triangle has its own corners
        return shape.compute_surface_interaction(ray, met, mi.RayFlags.All, active)
    return uniform_point(shape, place, active)


def uniform_point(shape: mi.Shape, u: mi.Point2f, active: mi.Bool | bool = True) -> mi.SurfaceInteraction3f:
    """The point of a shape that ``u`` samples uniformly by area."""
    si = mi.SurfaceInteraction3f(shape.sample_position(0.0, u, active), spread_wavelengths())
    if plugin_name(shape) == "sphere":  # Mitsuba 3.9 does not rotate the normal with the sphere
        si.n = dr.normalize(dict(contents(shape).values)["to_world"] @ mi.Vector3f(si.n))
    return si


def sphere_point(
    shape: mi.Shape, p: mi.Point3f, outward: mi.Vector3f, like: mi.SurfaceInteraction3f
) -> mi.SurfaceInteraction3f:
    """The point ``p`` of a spherical light; ``like``: another point of the light."""
    to_world = dict(contents(shape).values)["to_world"]
    inwards = dr.dot(like.n, like.p - to_world @ mi.Point3f(0.0)) < 0.0
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.p, si.n = mi.Point3f(p), mi.Normal3f(dr.select(inwards, -outward, outward))
    local = to_world.inverse() @ mi.Point3f(p)
    turn = dr.atan2(local.y, local.x) * dr.inv_two_pi
    si.uv = mi.Point2f(turn - dr.floor(turn), dr.acos(dr.clip(local.z, -1.0, 1.0)) * dr.inv_pi)
    return si


def sphere_point_facing(shape: mi.Shape, normal: mi.Vector3f, like: mi.SurfaceInteraction3f) -> mi.SurfaceInteraction3f:
    """The point of a spherical light whose normal, on the side that emits, is ``normal``; ``like``: another point
    of the light."""
    to_world = dict(contents(shape).values)["to_world"]
    offset = like.p - to_world @ mi.Point3f(0.0)
    outward = dr.select(dr.dot(like.n, offset) < 0.0, -normal, normal)
    return sphere_point(shape, to_world @ mi.Point3f(0.0) + outward * dr.norm(offset), outward, like)


def place_of(surface: str, uv: mi.Point2f) -> mi.Point2f:
    """Where in the unit square a hit of texture coordinates ``uv`` on one of ``SURFACES`` lies."""
    match surface:
        case "rectangle":
            return mi.Point2f(uv)
        case "cylinder":
            return mi.Point2f(uv.y, uv.x)
        case "sphere":
            return mi.Point2f(uv.x, 0.5 - 0.5 * dr.cos(dr.pi * uv.y))
    sin, cos = dr.sincos(dr.two_pi * uv.y)
    return mi.warp.uniform_disk_to_square_concentric(mi.Point2f(uv.x * cos, uv.x * sin))


# ---------------------------------------------------------------------------------------------------- measuring


def _of_texture(emitter: mi.Emitter, shape: mi.Shape, texture: mi.Texture) -> RadianceCells:
    surface, texels = plugin_name(shape), _texels(texture)
    if texels and surface == "cylinder":
        texels = texels[1], texels[0]
    columns, rows = (int(np.clip(np.ceil(n), _LEAST_CELLS, _MOST_CELLS)) for n in texels or (0, 0))
    across, along = _POINTS, _POINTS
    if texels and surface in ("rectangle", "cylinder"):  # else the texels are not aligned with the cells
        across, along = (max(2, int(np.ceil(n / cells))) for n, cells in zip(texels, (columns, rows), strict=True))
    elif texels:
        across = along = max(_POINTS, int(np.ceil(2.0 * max(texels) / min(columns, rows))))
    radiance = np.zeros(rows * columns)
    per_cell = across * along
    step = max(1, _CHUNK // per_cell)
    for first in range(0, rows * columns, step):
        end = min(first + step, rows * columns)
        index = dr.arange(mi.UInt32, (end - first) * per_cell)
        cell, point = index // per_cell + first, index % per_cell
        u = (mi.Float(cell % columns) + (mi.Float(point % across) + 0.5) / across) / columns
        v = (mi.Float(cell // columns) + (mi.Float(point // across) + 0.5) / along) / rows
        values = _along_normal(emitter, surface_point(shape, mi.UInt32(0), mi.Point2f(u, v)))
        radiance[first:end] = np.array(dr.block_sum(values, per_cell), np.float64) / per_cell
    share = np.full((rows, columns), 1.0 / (rows * columns))
    return RadianceCells(surface, share, radiance.reshape(rows, columns))


def _of_mesh(emitter: mi.Emitter, shape: mi.Shape, texture: mi.Texture) -> RadianceCells:
    values = dict(contents(shape).values)
    faces = as_array(values["faces"]).reshape(-1, 3)
    corners = as_array(values["vertex_positions"]).astype(np.float64).reshape(-1, 3)[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    points = np.full(len(faces), _TRIANGLE_POINTS if varies(emitter) else 1)
    texels, coordinates = _texels(texture), as_array(values.get("vertex_texcoords", np.zeros(0)))
    if texels:
        covered = np.full(len(faces), 0.5)  # without texture coordinates, each triangle covers half of the texture
        if coordinates.size:
            uv = coordinates.astype(np.float64).reshape(-1, 2)[faces]
            e, f = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
            covered = 0.5 * np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0])
        wanted = _TEXEL_POINTS * covered * texels[0] * texels[1]
        wanted *= min(1.0, _MOST_POINTS / max(wanted.sum(), 1.0))
        points = np.maximum(points, np.ceil(wanted).astype(np.int64))
    triangle = np.repeat(np.arange(len(faces)), points)
    number = np.arange(len(triangle)) - np.repeat(np.cumsum(points) - points, points)
    radiance = np.zeros(len(faces))
    for first in range(0, len(triangle), _CHUNK):
        part = slice(first, first + _CHUNK)
        # An even sequence of points in each triangle.
        u = (np.mod((number[part] + 0.5) * step, 1.0).astype(np.float32) for step in (0.7548776662, 0.5698402910))
        place = mi.warp.square_to_uniform_triangle(mi.Point2f(*(mi.Float(value) for value in u)))
        at = surface_point(shape, mi.UInt32(triangle[part].astype(np.uint32)), place)
        radiance += np.bincount(triangle[part], np.array(_along_normal(emitter, at), np.float64), len(faces))
    columns = int(np.ceil(np.sqrt(len(faces))))
    rows = -(-len(faces) // columns)
    share, mean = np.zeros(rows * columns), np.zeros(rows * columns)
    share[: len(faces)], mean[: len(faces)] = area / area.sum(), radiance / points
    return RadianceCells("mesh", share.reshape(rows, columns), mean.reshape(rows, columns))


def _along_normal(emitter: mi.Emitter, si: mi.SurfaceInteraction3f) -> mi.Float:
    """Radiance along the normals of points, mean over the channels."""
    si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), spread_wavelengths()
    return dr.sum(emitter.eval(si)) / float(dr.size_v(mi.Spectrum)) + dr.zeros(mi.Float, dr.width(si.p))


def _texels(texture: mi.Texture | None) -> tuple[float, float] | None:
    """Texels that the unit square of texture coordinates holds along either axis; None if the texture has none."""
    if texture is None or plugin_name(texture) != "bitmap":
        return None
    width, height = (int(n) for n in np.asarray(texture.resolution()).ravel())
    turn = np.abs(as_array(dict(contents(texture).values)["to_uv"]).reshape(-1)[:9].reshape(3, 3))
    across, along = (width * turn[0, i] + height * turn[1, i] for i in (0, 1))
    return float(across), float(along)
