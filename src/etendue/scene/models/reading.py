"""A model file as a scene: its surfaces with the nearest materials of Mitsuba, its cameras and its lights."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from etendue.core import SceneError, library, logger

from ..builtin.table import BundledScene
from ..meshes import MeshDescription
from . import gltf, materials

#: Suffixes of model files.
SUFFIXES = (".obj", ".gltf", ".glb", ".ply", ".stl", ".off")

_GLTF = (".gltf", ".glb")
#: The direction from which a model without a camera is seen, and the angle of the shorter side of the picture.
_VIEW, _FOV = np.array([0.9, 1.1, 2.0]), 40.0
#: The direction towards the sun of a model without light, its irradiance, and the radiance of the sky: the sides that
#: the camera sees differ, lit ones are brighter than the sky behind them, and those in shadow darker.
_SUN, _SUNLIGHT, _SKYLIGHT = np.array([-0.8, 1.0, 0.5]), 3.0, 0.2


def is_model(source: Any) -> TypeGuard[Path]:
    """Whether a scene is a model file, by its suffix."""
    return isinstance(source, Path) and source.suffix.lower() in SUFFIXES


def emits(path: Path) -> bool:
    """Whether an OBJ or glTF file has a material that emits light."""
    kind = path.suffix.lower()
    if kind in _GLTF and path.is_file():
        return any(max(m.get("emissiveFactor", [0.0])) > 0.0 for m in gltf.description(path).get("materials", []))
    return kind == ".obj" and any(any(numbers) for numbers in _emitted(path))


def _emitted(path: Path) -> Iterator[list[float]]:
    """The numbers of the statements ``Ke`` of an OBJ file's materials."""
    libraries = [path.with_name(name) for _, name in _statements(path, "mtllib")]
    for _, words in (line for file in libraries for line in _statements(file, "ke")):
        with suppress(ValueError):
            yield [float(word) for word in words.split()]


def model(path: Path) -> BundledScene:
    """A model file as a scene that is described on request."""
    return BundledScene(str(path), f"the model {path.name}", lambda: _described(path))


def _described(path: Path) -> dict[str, Any]:
    """The scene dictionary of a model. Surfaces without material are grey; a model without camera is seen from above
    its front, and one without light has a white sky, and a line of the log says so.

    Raises :class:`SceneError` for a file that cannot be read or has no faces.
    """
    trimesh = library("trimesh", f"reading {path}", "models")
    found = gltf.description(path) if path.suffix.lower() in _GLTF else {}
    gltf.check_extensions(path, found)
    try:
        if found:
            around = trimesh.resolvers.FilePathResolver(str(path))
            loaded = trimesh.load_scene(gltf.numbered(path, found), path.suffix[1:].lower(), around, process=False)
        else:
            loaded = trimesh.load_scene(path, process=False)
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"{path} cannot be read as a model: {text}; export it again") from error
    surfaces: list[Any] = [getattr(mesh, "visual", None) for mesh in loaded.geometry.values()]
    used = {str(visual.material.name): visual.material for visual in surfaces if hasattr(visual, "material")}
    _check_files(path, used)
    raw = {str(number): material for number, material in enumerate(found.get("materials", []))}
    for name in used.keys() & raw.keys():
        gltf.check_pictures(path, found, raw[name], used[name])
    scene: dict[str, Any] = {"type": "scene"}
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for number, node in enumerate(loaded.graph.nodes_geometry):
        matrix, geometry = loaded.graph[node]
        mesh = loaded.geometry[geometry]
        faces = np.asarray(getattr(mesh, "faces", ()), np.int64)  # curves and clouds of points have none
        if not len(faces):
            logger.warning(f"{path}: '{node}' has no faces; it is left out")
            continue
        described = _mesh(f"{_word(node)}-{number}", mesh, faces, np.asarray(matrix, np.float64), raw)
        scene[described.name] = described
        low, high = np.minimum(low, described.points.min(0)), np.maximum(high, described.points.max(0))
    if len(scene) == 1:
        raise SceneError(f"{path} has no faces, so there is nothing to render; export its surfaces")
    for number, light in enumerate(gltf.lights(found)):
        scene[f"light-{number}"] = light
    if not any("light-" in name or getattr(item, "emitter", None) for name, item in scene.items()):
        _warn_once(path.resolve(), f"{path} has no light: a white sky and a sun above its left light it")
        scene["sky"] = {"type": "constant", "radiance": _SKYLIGHT}
        scene["sun"] = {"type": "directional", "irradiance": _SUNLIGHT, "direction": (-_turned(_SUN, path)).tolist()}
    sensors = list(gltf.cameras(found))
    if not sensors:
        _warn_once(path.resolve(), f"{path} has no camera: it is seen from above its front")
        sensors = [_seen_whole(low, high, path)]
    for number, sensor in enumerate(sensors):
        scene[f"sensor-{number}"] = sensor | {"film": {"type": "hdrfilm", "width": 768, "height": 576}}
    return scene


@cache
def _warn_once(file: Path, text: str) -> None:
    """A warning on a file, which a command may read several times."""
    logger.warning(text)


def _check_files(path: Path, used: Collection[str]) -> None:
    """Raise :class:`SceneError` if an OBJ file or one of the ``used`` materials names a file that is not there: trimesh
    ignores it."""
    if path.suffix.lower() != ".obj":
        return
    libraries = [path.with_name(name) for _, name in _statements(path, "mtllib")]
    named, material = list(libraries), ""
    for key, name in (line for file in libraries for line in _statements(file, "newmtl", "map_kd")):
        if key == "newmtl":
            material = name
        elif key == "map_kd" and material in used:
            named.append(path.with_name(name))
    for file in named:
        if not file.is_file():
            raise SceneError(f"{path} names {file.name}, which is not in its folder; put it there, or remove its line")


def _statements(path: Path, *keys: str) -> Iterator[tuple[str, str]]:
    """Key and arguments of the lines of an OBJ or MTL file with one of ``keys``."""
    if not path.is_file():
        return
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            key, *rest = line.split(maxsplit=1)[:2] or [""]
            if key.lower() in keys and rest:
                yield key.lower(), rest[0].strip()


def _mesh(
    name: str, mesh: Any, faces: NDArray[np.int64], matrix: NDArray[np.float64], raw: dict[str, Any]
) -> MeshDescription:
    points = np.asarray(mesh.vertices, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    normals = None
    if "vertex_normals" in mesh._cache:  # of the file; otherwise trimesh would compute them
        normals = np.asarray(mesh.vertex_normals, np.float64) @ np.linalg.inv(matrix[:3, :3])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
    if np.linalg.det(matrix[:3, :3]) < 0.0:  # a mirrored node: its front remains outside
        faces = faces[:, ::-1]
    visual, bsdf, emitted, colours = mesh.visual, materials.PLAIN, None, None
    material: Any = getattr(visual, "material", None)
    coordinates = getattr(visual, "uv", None)
    if type(material).__name__ == "PBRMaterial":
        bsdf, emitted = materials.of_gltf(material, raw.get(str(material.name), {}))
    elif material is not None and material.kwargs:
        bsdf, emitted = materials.of_mtl(material)
    elif getattr(visual, "kind", None) == "vertex":
        colours = np.asarray(visual.vertex_colors, np.float64)[:, :3] / 255.0
        bsdf = materials.of_vertices()
    if coordinates is not None:
        coordinates = np.asarray(coordinates, np.float64) * (1.0, -1.0) + (0.0, 1.0)  # Mitsuba's v points down
    return MeshDescription(name, points, faces, bsdf, normals, emitted, coordinates, colours)


def _turned(direction: NDArray[np.float64], path: Path) -> NDArray[np.float64]:
    """A direction with y up as one of a file: in STL z is up."""
    x, y, z = direction
    return np.array([x, -z, y]) if path.suffix.lower() == ".stl" else direction


def _seen_whole(low: NDArray[np.float64], high: NDArray[np.float64], path: Path) -> dict[str, Any]:
    """A camera that sees a whole box, and not much around it, in a picture of any shape."""
    import mitsuba as mi

    centre, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-6)
    towards, up = _turned(_VIEW / np.linalg.norm(_VIEW), path), _turned(np.array([0.0, 1.0, 0.0]), path)
    right = np.cross(up, towards) / np.linalg.norm(np.cross(up, towards))
    corners = np.stack(np.meshgrid(*zip(low - centre, high - centre, strict=True)), axis=-1).reshape(-1, 3)
    aside = np.abs(corners @ np.stack([right, np.cross(towards, right)], axis=1)).max(axis=1)
    # A corner nearer to the camera by its depth is in the picture if it is within the angle from there.
    distance = 1.08 * float((corners @ towards + aside / np.tan(np.deg2rad(0.5 * _FOV))).max(initial=radius))
    place = mi.ScalarTransform4d().look_at((centre + distance * towards).tolist(), centre.tolist(), up.tolist())
    clip = {"near_clip": 1e-3 * distance, "far_clip": 1e3 * distance}
    return {"type": "perspective", "fov": _FOV, "fov_axis": "smaller", "to_world": place} | clip


def _word(name: str) -> str:
    """A name without the characters that have a meaning in Mitsuba's ids."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in str(name)) or "mesh"
