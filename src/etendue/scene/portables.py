"""Scenes for another machine: a description of plain values, arrays, and the files that the scene names."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from etendue.core import SceneError

from .builtin.table import BundledScene, bundled_scene
from .loading import Source, _is_loaded, _parse, _resolving, locate, use_variant_of
from .meshes import MeshDescription, built
from .models.reading import is_model, model
from .parsing import read_properties

if TYPE_CHECKING:
    import mitsuba as mi

#: Key of an encoded object in a scene dictionary.
_KIND = "__kind__"


@dataclass
class PortableScene:
    """A scene for another machine."""

    #: JSON values.
    description: dict[str, Any]
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    #: Files by their place in the folder of the scene; places are relative, with "/".
    files: dict[str, Path] = field(default_factory=dict)


def portable(source: Source, parameters: Mapping[str, Any] | None = None) -> PortableScene:
    """Describe a scene. :func:`restored` is the inverse.

    Raises :class:`SceneError` for a loaded ``mi.Scene``, and for Mitsuba objects in a dictionary.
    """
    use_variant_of(source)
    if _is_loaded(source):
        raise SceneError("a scene in memory cannot be sent to workers; give its file or its dictionary")
    found = locate(source, lambda _: None) if isinstance(source, (str, os.PathLike)) else source
    if isinstance(found, BundledScene):
        return PortableScene({"bundled": found.name})
    if is_model(found):
        return _of_dictionary(model(found).describe())
    return _of_file(found, parameters or {}) if isinstance(found, Path) else _of_dictionary(found)


def restored(portable: PortableScene, folder: Path) -> tuple[Any, dict[str, str]]:
    """The source of a scene whose files are at their places in ``folder``, and values of its ``$variables``."""
    described = portable.description
    if "bundled" in described:
        return bundled_scene(described["bundled"]), {}
    moved = {name: str(folder / place) for name, place in described["moved"].items()}
    if "dictionary" in described:
        return built(_decoded(described["dictionary"], portable.arrays, moved)), {}
    if "texts" in described:
        _rename(folder, described["texts"], moved)
    return folder / described["main"], {k: moved.get(v, v) for k, v in described["parameters"].items()}


# -- files -----------------------------------------------------------------------------------------------------------


def _of_file(path: Path, parameters: Mapping[str, Any]) -> PortableScene:
    import mitsuba as mi

    values = {str(k): str(v) for k, v in parameters.items()}
    _, folders, _, state = _parse(path, values)
    texts = [file for file in (Path(str(name)).absolute() for name in state.files) if file.is_file()]
    texts += [path.absolute()] if path.absolute() not in texts else []
    names = set(_names_in(state)) | {name for text in texts for name in _names_in_text(text, values)}
    named: dict[str, Path] = {}
    with _resolving(folders):
        resolver = mi.file_resolver()
        for name in sorted(names):
            found = Path(str(resolver.resolve(name)))
            if found.is_file():
                named[name] = found.absolute()
    for text in texts:
        if text not in named.values():
            named[os.path.relpath(text, path.parent.absolute())] = text
    inside = {name for name in named if not os.path.isabs(name)}
    # The scene is placed so deep that names with '..' stay within the folder of all files.
    depth = max((os.path.normpath(name).split(os.sep).count("..") for name in inside), default=0)
    scene = PurePosixPath(*(["inner"] * depth), ".")
    places = {name: _normal(scene / name) for name in inside}
    moved = {name: f"absolute/{k}/{Path(name).name}" for k, name in enumerate(sorted(named.keys() - inside))}
    main = next(places[name] for name, file in named.items() if file == path.absolute() and name in places)
    return PortableScene(
        {
            "main": main,
            "parameters": values,
            "moved": moved,
            "texts": [place for name, place in (places | moved).items() if named[name] in texts],
        },
        files={place: named[name] for name, place in (places | moved).items()},
    )


def _normal(place: PurePosixPath) -> str:
    return os.path.normpath(place).replace(os.sep, "/")


def _names_in(state: mi.parser.ParserState) -> Iterator[str]:
    """Texts among the properties of a scene's objects; some are names of files."""
    for node in state.nodes:
        yield from (value for value in read_properties(node.props).values() if isinstance(value, str) and value)


def _names_in_text(text: Path, parameters: Mapping[str, str]) -> Iterator[str]:
    """Texts in an XML file, for the names of files that are read while it is parsed."""
    root = ElementTree.parse(text).getroot()
    values = {e.get("name", ""): e.get("value", "") for e in root.iter("default")} | dict(parameters)
    for element in root.iter():
        for key in ("value", "filename"):
            if name := element.get(key):
                yield re.sub(r"\$\{?(\w+)\}?", lambda m: values.get(m[1], m[0]), name)


def _rename(folder: Path, texts: list[str], moved: Mapping[str, str]) -> None:
    """Replace absolute names in the XML files by the names of the files in ``folder``, and remove folders to search,
    whose files lie beside the scene."""
    from html import escape

    for place in texts:
        path = folder / place
        text = re.sub(r"<path\s[^>]*/>", "", path.read_text("utf-8"))
        for name, here in moved.items():
            for quote in "\"'":
                text = text.replace(f"{quote}{escape(name, False)}{quote}", f"{quote}{escape(here, False)}{quote}")
        path.unlink()  # it is a link to a shared file
        path.write_text(text, "utf-8")


# -- dictionaries ----------------------------------------------------------------------------------------------------


def _of_dictionary(source: Mapping[str, Any]) -> PortableScene:
    result = PortableScene({"moved": {}})
    result.description["dictionary"] = _encoded(dict(source), result, "scene")
    return result


def _encoded(value: Any, result: PortableScene, where: str) -> Any:
    import drjit as dr
    import mitsuba as mi

    def array(values: Any) -> str:
        key = str(len(result.arrays))
        result.arrays[key] = np.asarray(values)
        return key

    name = type(value).__name__
    if isinstance(value, str) and 0 < len(value) < 4096 and Path(value).suffix:
        path = Path(str(mi.file_resolver().resolve(value)))
        if path.is_file():
            place = f"files/{len(result.files)}/{path.name}"
            result.files[place], result.description["moved"][value] = path.absolute(), place
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, Mapping):
        return {str(k): _encoded(v, result, f"{where}.{k}") for k, v in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return {_KIND: "ndarray", "array": array(value)}
    if isinstance(value, MeshDescription):
        fields = {part.name: getattr(value, part.name) for part in dataclasses.fields(value)}
        return {_KIND: "MeshDescription", "fields": _encoded(fields, result, where)}
    if isinstance(value, mi.Bitmap):
        kept = {"pixel_format": value.pixel_format().name, "srgb_gamma": bool(value.srgb_gamma())}
        return {_KIND: "Bitmap", "array": array(value), **kept}
    if isinstance(value, mi.VolumeGrid):
        stream = mi.MemoryStream()
        value.write(stream)
        stream.seek(0)
        return {_KIND: "VolumeGrid", "array": array(np.frombuffer(stream.read(stream.size()), np.uint8))}
    if "Transform" in name and hasattr(value, "matrix"):
        kind = name if name.startswith("Scalar") else f"Scalar{name}"
        both = np.stack([np.array(value.matrix), np.array(value.inverse_transpose)])  # each has its own rounding
        return {_KIND: kind, "array": array(both)}
    if dr.is_array_v(value):
        is_plain = dr.is_tensor_v(value) or dr.is_jit_v(value) or name.startswith("Scalar")
        return {_KIND: name if is_plain else f"Scalar{name}", "array": array(value)}
    if isinstance(value, (list, tuple)):
        return [_encoded(v, result, f"{where}[{k}]") for k, v in enumerate(value)]
    raise SceneError(
        f"{where} is an object in memory ({name}), which cannot be sent to workers; describe it by a dictionary, or "
        "write the scene to a file"
    )


def _decoded(value: Any, arrays: Mapping[str, NDArray[Any]], moved: Mapping[str, str]) -> Any:
    import mitsuba as mi

    if isinstance(value, str):
        return moved.get(value, value)
    if isinstance(value, list):
        return [_decoded(v, arrays, moved) for v in value]
    if not isinstance(value, dict):
        return value
    if _KIND not in value:
        return {k: _decoded(v, arrays, moved) for k, v in value.items()}
    if value[_KIND] == "MeshDescription":
        return MeshDescription(**_decoded(value["fields"], arrays, moved))
    kind, array = value[_KIND], np.ascontiguousarray(arrays[value["array"]])
    if kind == "ndarray":
        return array
    if kind == "Bitmap":
        bitmap = mi.Bitmap(array, getattr(mi.Bitmap.PixelFormat, value["pixel_format"]))
        bitmap.set_srgb_gamma(value["srgb_gamma"])
        return bitmap
    if kind == "VolumeGrid":
        stream = mi.MemoryStream()
        stream.write(array.tobytes())
        stream.seek(0)
        return mi.VolumeGrid(stream)
    make: Any = getattr(mi, kind)
    if "Transform" in kind:
        matrix = type(make().matrix)
        return make(matrix(array[0].tolist()), matrix(array[1].tolist()))
    return make(array.tolist() if kind.startswith("Scalar") else array)
