"""Meshes with texture coordinates for lightmaps: from a file, from a scene, or an atlas made by xatlas."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SceneError, library, use_variant
from etendue.film import replacing
from etendue.formats import GltfMesh, read_texture_coordinates, write_gltf
from etendue.scene import graph

from ..errors import SurfaceError
from ..faces import triangles
from ..patches import Patches
from ..readers.scenepatches import loaded_scene
from ..readers.tessellation import tessellate
from ..smoothing import face_sides

Index = NDArray[np.int64]

#: Suffixes of mesh files with texture coordinates of a lightmap.
LIGHTMAP_MESHES = {".glb": "glTF in one file", ".gltf": "glTF as text", ".obj": "Wavefront"}
#: Empty texels between the charts of an atlas, for bilinear filtering and one mipmap level.
_GAP = 4
#: First guess of the covered share of an atlas, and number of refinements.
_COVERED, _TRIALS = 0.6, 12


@dataclass
class TexturedMesh:
    """Triangles with texture coordinates.

    ``vertices``: (v, 3). ``faces``: (t, 3), counterclockwise seen from the front. ``uv``: (v, 2), each in [0, 1], v
    upward: (0, 0) is the lower left corner of the picture.
    """

    vertices: Array
    faces: Index
    uv: Array


def _kept(made: Any) -> Any:
    """An atlas that is never destroyed: its destructor may wait forever for one of its threads, whose wake-up it has
    lost, and holds Python's lock meanwhile (xatlas 0.0.11)."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(made))
    return made


def atlas(patches: Patches, size: int = 1024) -> tuple[TexturedMesh, tuple[int, int]]:
    """The faces of patches, including backs of sheets, laid out without overlap by xatlas; and the width and height of
    the layout, at most ``size`` each. Charts are four texels apart.

    Raises :class:`SurfaceError` if the size is too small for the number of charts,
    :class:`etendue.core.BackendError` without xatlas.
    """
    xatlas = library("xatlas", "an atlas", "lightmap")
    if size < 16:
        raise SurfaceError(f"a lightmap has at least 16 texels a side, not {size}")
    parts = list(_sheets(patches))
    options = xatlas.PackOptions()
    centre, radius = patches.sphere  # xatlas has single precision and absolute thresholds for lengths
    options.padding, options.texels_per_unit = _GAP, size * radius * np.sqrt(_COVERED / patches.face_areas.sum())
    for _ in range(_TRIALS):
        made = _kept(xatlas.Atlas())
        for vertices, faces in parts:
            made.add_mesh(((vertices - centre) / radius).astype(np.float32), faces.astype(np.uint32))
        made.generate(xatlas.ChartOptions(), options)
        longest = max(made.width, made.height)
        if made.atlas_count == 1 and 0 < longest <= size:
            break
        options.texels_per_unit *= min(0.98 * size / max(longest, 1), 0.9)
    else:
        count = sum(len(faces) for _, faces in parts)
        raise SurfaceError(f"an atlas of {size} texels a side has no room for {count} triangles; make it larger")
    all_vertices, all_faces, all_uv, offset = [], [], [], 0
    for number, (vertices, _) in enumerate(parts):
        source, faces, uv = made.get_mesh(number)
        all_vertices.append(vertices[source])
        all_faces.append(faces.astype(np.int64).reshape(-1, 3) + offset)
        all_uv.append(np.asarray(uv, dtype=np.float64).reshape(-1, 2))
        offset += len(source)
    mesh = TexturedMesh(np.concatenate(all_vertices), np.concatenate(all_faces), np.concatenate(all_uv))
    return mesh, (int(made.width), int(made.height))


def gltf_mesh(path: str | os.PathLike[str]) -> TexturedMesh:
    """A mesh of a ``.glb`` or ``.gltf`` file with its second texture coordinates, ``TEXCOORD_1``, which are meant for
    lightmaps. Raises :class:`SurfaceError` if it has none, :class:`etendue.formats.FormatError` if it cannot be read.
    """
    vertices, faces, uv = read_texture_coordinates(path)
    if uv is None:
        raise SurfaceError(
            f"'{path}' has no second texture coordinates (TEXCOORD_1) on all its meshes; unwrap it for lightmaps, or "
            "let an atlas be made"
        )
    return TexturedMesh(vertices, faces, uv)


def scene_mesh(scene: Any) -> TexturedMesh:
    """The meshes of a Mitsuba scene with their texture coordinates, as one atlas; ``scene`` is an argument or a result
    of :func:`etendue.scene.load`. Raises :class:`SceneError` for shapes that have none."""
    use_variant()
    loaded, space = loaded_scene(scene)
    parts, offset = [], 0
    for shape in loaded.shapes():
        if not (shape.is_mesh() and shape.has_vertex_texcoords()):
            raise SceneError(
                f"{graph.describe(shape, 'shape')} has no texture coordinates of vertices; let an atlas be made"
            )
        vertices, faces, _ = tessellate(shape, 3)  # oriented as the shape
        uv = np.array(shape.vertex_texcoords_buffer(), dtype=np.float64).reshape(-1, 2)
        parts.append((space.to_scene(vertices), faces[:, :3] + offset, uv))
        offset += len(vertices)
    if not parts:
        raise SceneError("the scene has no shapes; a lightmap needs surfaces")
    vertices, faces, uv = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return TexturedMesh(vertices, faces, np.column_stack([uv[:, 0], 1 - uv[:, 1]]))


def save_textured_mesh(path: str | os.PathLike[str], mesh: TexturedMesh, lightmap: str | None = None) -> None:
    """Write the mesh for a lightmap: ``.glb`` or ``.gltf`` with ``TEXCOORD_1`` (and ``TEXCOORD_0``, which the format
    requires before it), or ``.obj``. ``lightmap`` is the name of the texture, for the ``extras`` of glTF.

    Raises :class:`SurfaceError` for another suffix, :class:`etendue.core.OutputError` if it cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in LIGHTMAP_MESHES:
        raise SurfaceError(
            f"the mesh of a lightmap is written as {', '.join(LIGHTMAP_MESHES)}, not as '{path}'; change the name"
        )
    if suffix == ".obj":
        with replacing(path) as part, part.open("w", encoding="ascii") as file:
            file.writelines(_wavefront(mesh))
        return
    normals = mesh_normals(mesh)
    # Vertices at an edge within a chart have one texture coordinate, but two normals.
    corner = np.column_stack([mesh.faces.ravel(), np.repeat(np.round(normals * 1e5).astype(np.int64), 3, axis=0)])
    _, first, number = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    source = mesh.faces.ravel()[first]
    uv = np.column_stack([mesh.uv[source, 0], 1 - mesh.uv[source, 1]])
    written = GltfMesh(mesh.vertices[source], normals[first // 3], number.reshape(-1, 3))
    written.attributes = {"TEXCOORD_0": uv, "TEXCOORD_1": uv}
    written.extras = {"lightmap": lightmap} if lightmap else {}
    write_gltf(path, written)


def _sheets(patches: Patches) -> Iterator[tuple[Array, Index]]:
    """Fronts, and backs if there are any, as vertices and triangles of meshes whose faces meet at common vertices."""
    corners, _ = face_sides(patches)
    fronts = np.count_nonzero(patches.front >= 0)
    for part in (corners[:fronts], corners[fronts:]):
        if len(part):
            cut, _ = triangles(part)
            vertices, number = np.unique(patches.vertices[cut.ravel()], axis=0, return_inverse=True)
            yield vertices, number.reshape(-1, 3)


def mesh_normals(mesh: TexturedMesh) -> Array:
    """Normals (t, 3) of the triangles of a mesh; zero for one without area."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    vectors = np.cross(b - a, c - a)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def _wavefront(mesh: TexturedMesh) -> Iterator[str]:
    yield from (f"v {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in mesh.vertices)
    yield from (f"vt {u:.9g} {v:.9g}\n" for u, v in mesh.uv)
    yield from (f"f {a}/{a} {b}/{b} {c}/{c}\n" for a, b, c in mesh.faces + 1)
