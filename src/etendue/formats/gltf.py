"""Meshes as glTF 2.0, with vertex colours in linear floats, two sets of texture coordinates and custom attributes.

A file has one mesh of triangles with positions, normals of the faces and a material without shading
(``KHR_materials_unlit``), so that a viewer shows the colours unchanged. Files are read by trimesh, but not
written: trimesh rounds colours to bytes, supports one set of texture coordinates, and no material extensions.
"""

from __future__ import annotations

import base64
import io
import json
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, library
from etendue.film import write_bytes

from .errors import FormatError

if TYPE_CHECKING:
    import trimesh

Index = NDArray[np.int64]

_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_MAGIC, _JSON, _BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
#: Lengths in a binary file are numbers of 32 bits.
_LARGEST = (1 << 32) - 1


@dataclass
class GltfMesh:
    """A mesh for glTF.

    ``vertices``, ``normals``: (v, 3). ``triangles``: (t, 3), counterclockwise seen from the front. ``attributes``: of
    vertices, (v, k) or (v,), by their names in glTF (``COLOR_0``, ``TEXCOORD_0``; custom names begin with ``_``).
    ``extras``: JSON values about the mesh.
    """

    vertices: Array
    normals: Array
    triangles: Index
    attributes: dict[str, NDArray[Any]] = field(default_factory=dict)
    extras: dict[str, Any] = field(default_factory=dict)


def far_centre(vertices: Array) -> Array | None:
    """The centre of ``vertices`` (v, 3) so far from the origin that single precision would move them by more than about
    1e-4 of the mesh's size; ``None`` nearer to it."""
    if not len(vertices):
        return None
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    is_far = np.abs(vertices).max() > 1e3 * np.linalg.norm(high - low)
    return np.asarray(low + high) / 2 if is_far else None


def write_gltf(path: str | os.PathLike[str], mesh: GltfMesh, metadata: Mapping[str, Any] | None = None) -> None:
    """Write ``.glb``, binary, or ``.gltf``, text with the data in it. ``metadata``: values for JSON. Vertices far from
    the origin are written relative to their centre, with the translation in the node.

    Raises :class:`FormatError` for a ``.glb`` of more than 4 GB, :class:`etendue.core.OutputError` if the file cannot
    be written.
    """
    centre = far_centre(mesh.vertices)
    arrays = {
        "POSITION": mesh.vertices if centre is None else mesh.vertices - centre,
        "NORMAL": mesh.normals,
        **mesh.attributes,
        "indices": mesh.triangles.astype(np.uint32).ravel(),
    }
    data, views, accessors = bytearray(), [], []
    for name, values in arrays.items():
        stored = np.ascontiguousarray(values if name == "indices" else np.asarray(values, np.float32))
        target = _INDICES if name == "indices" else _VERTICES
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": stored.nbytes, "target": target})
        accessors.append(_accessor(name, stored, len(views) - 1))
        data += stored.tobytes()  # a multiple of four bytes, as glTF requires
    primitive = {
        "attributes": {name: k for k, name in enumerate(arrays) if name != "indices"},
        "indices": len(arrays) - 1,
        "material": 0,
    }
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "etendue", "extras": dict(metadata or {})},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0} | ({} if centre is None else {"translation": centre.tolist()})],
        "meshes": [{"primitives": [primitive], "extras": mesh.extras}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0}, "extensions": {"KHR_materials_unlit": {}}}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    if Path(path).suffix.lower() == ".gltf":
        text = base64.b64encode(data).decode("ascii")
        content["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{text}"
        write_bytes(path, json.dumps(content).encode())
        return
    write_bytes(path, _binary(content, bytes(data), path))


def read_texture_coordinates(path: str | os.PathLike[str], number: int = 1) -> tuple[Array, Index, Array | None]:
    """Vertices (v, 3) in the coordinates of the scene, triangles (t, 3) and set ``number`` of texture coordinates
    (v, 2) of all meshes of a ``.glb`` or ``.gltf`` file; no texture coordinates (``None``) if a mesh lacks this set.

    Raises :class:`FormatError` for a file that cannot be read, :class:`etendue.core.BackendError` without trimesh.
    """
    trimesh = library("trimesh", f"reading {path}")
    name, kept = f"TEXCOORD_{number}", f"_TEXCOORD_{number}"
    try:
        content, rest = _parsed(Path(path).read_bytes())
        for primitive in (p for mesh in content.get("meshes", ()) for p in mesh["primitives"]):
            # trimesh reads only the first set, but keeps custom attributes.
            if name in primitive["attributes"]:
                primitive["attributes"][kept] = primitive["attributes"].pop(name)
        text = json.dumps(content).encode()
        file, kind = (io.BytesIO(text), "gltf") if rest is None else (io.BytesIO(_joined(text, rest)), "glb")
        resolver = trimesh.resolvers.FilePathResolver(str(path))
        scene = trimesh.load(file, file_type=kind, resolver=resolver, force="scene", process=False)
        parts = [(scene.geometry[geometry], scene.graph[node][0]) for node, geometry in _placed(scene)]
    except FileNotFoundError:
        raise FormatError(f"there is no mesh file '{path}'") from None
    except Exception as error:  # trimesh fails on broken files in many ways
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FormatError(f"'{path}' cannot be read as glTF: {reason}") from error
    if not parts:
        raise FormatError(f"'{path}' has no triangles")
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh, _ in parts)])
    vertices = np.concatenate([mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3] for mesh, matrix in parts])
    faces = np.concatenate([mesh.faces + offset for (mesh, _), offset in zip(parts, offsets[:-1], strict=True)])
    sets = [mesh.vertex_attributes.get(kept) for mesh, _ in parts]
    if any(coordinates is None for coordinates in sets):
        return vertices, faces, None
    uv = np.concatenate(sets).astype(np.float64)
    return vertices, faces.astype(np.int64), np.column_stack([uv[:, 0], 1.0 - uv[:, 1]])


def _placed(scene: trimesh.Scene) -> list[tuple[str, str]]:
    """(node, name of the triangle mesh that it places)."""
    nodes = [(node, scene.graph[node][1]) for node in scene.graph.nodes_geometry]
    return [(node, geometry) for node, geometry in nodes if hasattr(scene.geometry[geometry], "faces")]


def _accessor(name: str, values: NDArray[Any], view: int) -> dict[str, Any]:
    width = 1 if values.ndim == 1 else values.shape[1]
    accessor = {
        "bufferView": view,
        "componentType": _UINT32 if name == "indices" else _FLOAT,
        "count": len(values),
        "type": "SCALAR" if width == 1 else f"VEC{width}",
    }
    if name == "POSITION":
        accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
    return accessor


def _binary(content: Mapping[str, Any], data: bytes, path: str | os.PathLike[str]) -> bytes:
    rest = struct.pack("<II", len(data), _BINARY) + data if len(data) <= _LARGEST else b""
    if not rest or len(rest) + (1 << 20) > _LARGEST:
        raise FormatError(f"'{path}' would have {len(data) / 1e9:.1f} GB; glTF holds 4: write .vtu or .npz")
    return _joined(json.dumps(content).encode(), rest)


def _joined(text: bytes, rest: bytes) -> bytes:
    """A binary file from its JSON ``text`` and the chunks after that."""
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", _MAGIC, 2, 20 + len(text) + len(rest))
    return head + struct.pack("<II", len(text), _JSON) + text + rest


def _parsed(file: bytes) -> tuple[dict[str, Any], bytes | None]:
    """JSON of a file, and the chunks after the JSON; ``None`` for a text file."""
    if not file.startswith(b"glTF"):
        return json.loads(file), None
    length = struct.unpack_from("<I", file, 12)[0]
    return json.loads(file[20 : 20 + length]), file[20 + length :]
