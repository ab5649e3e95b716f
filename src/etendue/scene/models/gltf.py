"""What trimesh does not read of glTF files: cameras, punctual lights, factors of materials; and what it ignores."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import SceneError, logger

from .materials import rgb

Dict = dict[str, Any]
Matrix = NDArray[np.float64]

_LIGHTS = "KHR_lights_punctual"
#: Extensions that a file may require.
_READ = {
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    _LIGHTS,
}
#: A camera of glTF looks along -z, with y up; one of Mitsuba along z, with x to the left. So do lights.
_TURN = np.diag([-1.0, 1.0, -1.0, 1.0])


def description(path: Path) -> Dict:
    """The JSON of a ``.gltf`` or ``.glb`` file."""
    try:
        data = path.read_bytes()
        if data[:4] == b"glTF":
            (length,) = struct.unpack("<I", data[12:16])
            data = data[20 : 20 + length]
        found = json.loads(data)
    except (OSError, ValueError, struct.error) as error:
        raise SceneError(f"{path} cannot be read as glTF: {error}; export it again") from error
    if not isinstance(found, dict):
        raise SceneError(f"{path} cannot be read as glTF: it has no description; export it again")
    return found


def numbered(path: Path, found: Mapping[str, Any]) -> BytesIO:
    """A file whose materials have their numbers as names: the file's own may be missing or equal."""
    materials = [{**material, "name": str(number)} for number, material in enumerate(found.get("materials", []))]
    text = json.dumps({**found, "materials": materials}).encode()
    data = path.read_bytes()
    if data[:4] != b"glTF":
        return BytesIO(text)
    (length,) = struct.unpack("<I", data[12:16])
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return BytesIO(data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + data[16:20] + text + rest)


def check_extensions(path: Path, found: Mapping[str, Any]) -> None:
    """Raise :class:`SceneError` if a file requires an extension that is not read."""
    unread = sorted(set(found.get("extensionsRequired", [])) - _READ)
    if unread:
        raise SceneError(f"{path} requires {', '.join(unread)}, which is not read; export it without")


def check_pictures(path: Path, found: Mapping[str, Any], raw: Mapping[str, Any], material: Any) -> None:
    """Raise :class:`SceneError` if a picture of a material is missing or broken, which trimesh ignores; warn if it has
    other texture coordinates than those that are read. ``raw``: the material in the file; ``material``: trimesh's."""
    for key, texture in {**raw.get("pbrMetallicRoughness", {}), **raw}.items():
        if not key.endswith("Texture") or key == "occlusionTexture":
            continue
        picture: Any = getattr(material, key, None)
        try:
            picture.load()
        except (AttributeError, OSError):
            name = _picture(found, texture)
            raise SceneError(
                f"{path} names {name}, which is missing or broken; put it there, or export again"
            ) from None
        if texture.get("texCoord", 0) or "KHR_texture_transform" in texture.get("extensions", {}):
            name = raw.get("name", "without a name")
            logger.warning(
                f"{path}: material '{name}' places its {key} by a second set of coordinates or a transform, "
                "which is not read; export it with one set"
            )


def _picture(found: Mapping[str, Any], texture: Mapping[str, Any]) -> str:
    """What a file calls the picture of a texture."""
    try:
        source = found["textures"][texture["index"]]
        number = source.get("source", source.get("extensions", {}).get("EXT_texture_webp", {}).get("source"))
        uri = str(found["images"][number].get("uri", "data:"))
        return f"picture {number}" if uri.startswith("data:") else uri
    except (LookupError, TypeError):
        return f"texture {texture.get('index')}"


def cameras(found: Mapping[str, Any]) -> Iterator[Dict]:
    """Sensors, without film, for the cameras of the nodes of a file's scene."""
    import mitsuba as mi

    for node, place in _nodes(found):
        if "camera" not in node:
            continue
        camera = found["cameras"][node["camera"]]
        lens = camera.get(camera["type"], {})
        clip = {"near_clip": float(lens.get("znear", 1e-2)), "far_clip": float(lens.get("zfar", 1e4))}
        if camera["type"] == "orthographic":
            size = np.diag([float(lens["xmag"]), float(lens["xmag"]), 1.0, 1.0])
            to_world = mi.ScalarTransform4d(_unscaled(place) @ _TURN @ size)
            yield {"type": "orthographic", "to_world": to_world} | clip
        else:
            fov = float(np.rad2deg(lens["yfov"]))
            to_world = mi.ScalarTransform4d(_unscaled(place) @ _TURN)
            yield {"type": "perspective", "fov": fov, "fov_axis": "y", "to_world": to_world} | clip


def lights(found: Mapping[str, Any]) -> Iterator[Dict]:
    """Emitters for the lights of the nodes of a file's scene: candela are taken for watts per steradian, lux for watts
    per square metre."""
    import mitsuba as mi

    described = found.get("extensions", {}).get(_LIGHTS, {}).get("lights", [])
    for node, place in _nodes(found):
        number = node.get("extensions", {}).get(_LIGHTS, {}).get("light")
        if number is None:
            continue
        light = described[number]
        power = float(light.get("intensity", 1.0))
        strength = rgb([power * float(v) for v in light.get("color", (1.0, 1.0, 1.0))])
        to_world = mi.ScalarTransform4d(_unscaled(place) @ _TURN)
        if light["type"] == "directional":
            yield {"type": "directional", "irradiance": strength, "to_world": to_world}
        elif light["type"] == "spot":
            cone = light.get("spot", {})
            outer = float(np.rad2deg(cone.get("outerConeAngle", np.pi / 4)))
            inner = min(float(np.rad2deg(cone.get("innerConeAngle", 0.0))), outer * (1.0 - 1e-4))
            angles = {"cutoff_angle": outer, "beam_width": inner}
            yield {"type": "spot", "intensity": strength, "to_world": to_world} | angles
        else:
            yield {"type": "point", "intensity": strength, "position": [float(v) for v in place[:3, 3]]}


def _nodes(found: Mapping[str, Any]) -> Iterator[tuple[Dict, Matrix]]:
    """Nodes of a file's scene, and their transforms to the world."""
    nodes, scenes = found.get("nodes", []), found.get("scenes", [])
    roots = scenes[found.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    stack = [(number, np.eye(4)) for number in roots]
    while stack:
        number, above = stack.pop(0)
        node = nodes[number]
        place = above @ _local(node)
        yield node, place
        stack = [(child, place) for child in node.get("children", [])] + stack


def _local(node: Mapping[str, Any]) -> Matrix:
    if "matrix" in node:
        return np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    place = np.eye(4)
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    place[:3, :3] = turn * np.asarray(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    place[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return place


def _unscaled(place: Matrix) -> Matrix:
    """A transform without its scale, for cameras and lights."""
    result = place.copy()
    result[:3, :3] /= np.linalg.norm(place[:3, :3], axis=0)
    return result
