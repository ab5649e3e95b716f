"""Changes to the lights of a parsed scene, and scenes written as XML."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from etendue.core import OptionError, SceneError, threads_for_files
from etendue.film import replacing

from .builtin.table import BundledScene
from .loading import _is_loaded, _parse, _resolving, locate, use_variant_of
from .meshes import MeshDescription
from .models.reading import is_model, model
from .parsing import Change, Size, give_types, read_properties, resize

if TYPE_CHECKING:
    import mitsuba as mi

#: Scales that Mitsuba's writer writes rightly.
_SCALES = (1 / 50, 50.0)
#: Functions that write files, by path.
_Writing = dict[Path, Callable[[Path], None]]


@dataclass(frozen=True)
class LightEdits:
    """Changes to the lights of a scene. ``removed``: numbers of lights in its description; ``added``: dictionaries of
    plugins, each added under its ``id``, with a suffix if the scene has that id already."""

    removed: frozenset[int] = frozenset()
    added: tuple[Mapping[str, Any], ...] = field(default=())

    def __bool__(self) -> bool:
        return bool(self.removed or self.added)

    def __call__(self, state: mi.parser.ParserState) -> None:
        """Apply the changes to a parsed scene."""
        for number, (owner, key, _) in enumerate(list(_emitters(state))):
            if number in self.removed:
                del (state.root if owner is None else owner).props[key]
        for number, plugin in enumerate(self.added):
            taken = {*read_properties(state.root.props), *(node.props.id() for node in state.nodes)}
            name = str(plugin.get("id", f"added-light-{number + 1}"))
            while name in taken:
                name += "-again"
            add_plugin(state, name, {key: value for key, value in plugin.items() if key != "id"})


def described_lights(source: Any, parameters: Mapping[str, Any] | None = None) -> list[str]:
    """A name for each light in a scene's description: its plugin, and its id or, if it is on a shape, the shape's id.

    Raises :class:`SceneError` for a loaded scene, and for a scene that cannot be parsed.
    """
    *_, state = _parse(_locate(source), parameters)
    names = []
    for owner, key, emitter in _emitters(state):
        own = (_id(emitter.props) or _plain(key)) if owner is None else _id(owner.props)
        names.append(f"{emitter.props.plugin_name()} {own}".strip())
    return names


def add_plugin(state: mi.parser.ParserState, key: str, plugin: Mapping[str, Any]) -> None:
    """Add an object to a parsed scene by its dictionary. Raises :class:`SceneError` if Mitsuba cannot parse it."""
    import mitsuba as mi

    config = mi.parser.ParserConfig(mi.variant())
    try:
        own = mi.parser.parse_dict(config, {"type": "scene", key: dict(plugin)})
        mi.parser.transform_resolve(config, own)
        give_types(own)
    except (RuntimeError, ValueError, TypeError) as error:
        raise SceneError(f"'{plugin.get('type')}' cannot be added: {error}") from error
    shift = len(state.nodes) - 1  # the root is left out
    for node in list(own.nodes)[1:]:
        _shift(node.props, shift)
        state.nodes.append(node)
    for name, value in read_properties(own.root.props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            state.root.props[name] = mi.Properties.ResolvedReference(value.index() + shift)


def is_described(source: Any) -> bool:
    """Whether a scene is a file, a bundled scene or a dictionary, not a loaded ``mi.Scene``."""
    return not _is_loaded(source)


def scene_xml(
    source: Any,
    parameters: Mapping[str, Any] | None = None,
    change: Change | None = None,
    size: Size | None = None,
    folder: Path | None = None,
) -> str:
    """The XML of a scene after a ``change``, with a film of ``size`` if that is given; file names in it are absolute.

    Objects in memory, meshes of bundled scenes (:class:`MeshDescription`), bitmaps and grids, are written to
    ``folder``, which is created if needed. Raises :class:`SceneError` for a loaded scene, for other objects in memory,
    for any objects in memory without a ``folder``, and for a scene that cannot be parsed; :class:`OutputError` if a
    file cannot be written.
    """
    import mitsuba as mi

    name, folders, state, writing = _described(source, parameters, folder)
    if change is not None:
        change(state)
    if size is not None and any(node.type == mi.ObjectType.Film for node in state.nodes):
        resize(state, size)
    with _resolving(folders):
        _name_absolutely(state)
        writing |= _without_arrays(state, folder)
        matrices = _without_scales(state)
        try:
            text = _with_names(str(mi.parser.write_string(state)), state)
        except (RuntimeError, ValueError, TypeError) as error:
            why = re.sub(r"\s+", " ", str(error)).strip()
            raise SceneError(f"the scene {name} cannot be written as XML: {why}") from error
    for mark, matrix in matrices.items():
        text = text.replace(mark, matrix)
    for file, write in writing.items():
        with contextlib.suppress(OSError):  # writing to the folder reports the failure
            file.parent.mkdir(exist_ok=True)
        with replacing(file) as part:
            write(part)
    return text


def _without_scales(state: mi.parser.ParserState) -> dict[str, str]:
    """Replace transforms of a large or small scale by marks; returns the matrix of each mark, both as XML.

    Mitsuba's writer takes transforms apart by a fixed number of iterations, which are too few for them: it writes a
    scale of 800 as one of 934, with another rotation.
    """
    import mitsuba as mi

    matrices: dict[str, str] = {}
    for node in state.nodes:
        for key, value in read_properties(node.props).items():
            if isinstance(value, mi.ScalarTransform4d):
                matrix = np.array(value.matrix, dtype=np.float64)
                sizes = np.linalg.svd(matrix[:3, :3], compute_uv=False)
                if sizes[0] > _SCALES[1] or sizes[-1] < _SCALES[0]:
                    mark = 123456789 + len(matrices)
                    node.props[key] = mi.ScalarTransform4d().translate([mark, -mark, mark])
                    numbers = " ".join(map(repr, matrix.ravel().tolist()))
                    matrices[f'<translate x="{mark}" y="-{mark}" z="{mark}" />'] = f'<matrix value="{numbers}" />'
    return matrices


def _with_names(text: str, state: mi.parser.ParserState) -> str:
    """XML in which the elements of the scene have their ids. Mitsuba writes only ids that are referred to, and gives
    shapes without an id another name whenever the file is read."""
    import mitsuba as mi

    below = read_properties(state.root.props).values()
    nodes = [state.nodes[value.index()] for value in below if isinstance(value, mi.Properties.ResolvedReference)]
    root = ElementTree.fromstring(text)
    elements = [element for element in root if element.tag == "ref" or "type" in element.attrib]
    if len(elements) != len(nodes):
        return text
    for element, node in zip(elements, nodes, strict=True):
        if element.tag != "ref" and _id(node.props):
            element.set("id", _id(node.props))
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _without_arrays(state: mi.parser.ParserState, folder: Path | None) -> _Writing:
    """Replace bitmaps and grids in memory by files in ``folder``; returns the functions that write the files."""
    import mitsuba as mi

    writing: _Writing = {}
    for number, node in enumerate(state.nodes):
        values = read_properties(node.props)
        for key, value in values.items():
            if isinstance(value, mi.Bitmap) and key == "bitmap":
                kind, is_raw = node.props.plugin_name(), bool(values.get("raw", False))
                # PNG has the sRGB curve, which a raw texture does not undo.
                as_bytes = value.component_format() == mi.Struct.Type.UInt8 and (is_raw or value.srgb_gamma())
                ending = "png" if as_bytes else "exr"
                file = _in(folder, f"{_id(node.props) or kind}-{number}.{ending}", f"a picture of '{kind}'")
                writing[file] = partial(_write_bitmap, value, is_raw)
                del node.props[key]
                node.props["filename"] = str(file)
            elif isinstance(value, mi.VolumeGrid) and key == "grid":
                kind = node.props.plugin_name()
                file = _in(folder, f"{_id(node.props) or kind}-{number}.vol", f"a grid of '{kind}'")
                writing[file] = partial(_write_grid, value)
                del node.props[key]
                node.props["filename"] = str(file)
            elif isinstance(value, mi.Object):
                what = f"'{_id(node.props) or node.props.plugin_name()}' has '{key}'"
                raise SceneError(
                    f"{what}, an object in memory ({type(value).__name__}), which cannot be written as XML; describe "
                    "it by a dictionary"
                )
    return writing


def _write_grid(grid: mi.VolumeGrid, path: Path) -> None:
    grid.write(str(path))


def _write_bitmap(bitmap: mi.Bitmap, is_raw: bool, path: Path) -> None:
    """Write a bitmap as PNG, or as OpenEXR with the linear values that the plugin uses; ``raw`` values are kept."""
    import mitsuba as mi

    if path.suffix == ".png":
        bitmap.write(str(path))
        return
    own = mi.Bitmap(bitmap)
    if is_raw:
        own.set_srgb_gamma(False)
    with threads_for_files():
        own.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False).write(str(path))


def _in(folder: Path | None, name: str, what: str) -> Path:
    """The path of the file for an object that a scene has in memory."""
    if folder is None:
        raise SceneError(f"the scene has {what} in memory, which XML cannot hold; give a folder for its files")
    return folder.absolute() / re.sub(r"[^\w.-]", "_", name)


def _described(
    source: Any, parameters: Mapping[str, Any] | None, folder: Path | None
) -> tuple[str, mi.FileResolver, mi.parser.ParserState, _Writing]:
    """(name, where its files are searched, parsed description, functions that write its meshes to ``folder``) of a
    scene."""
    found = _locate(source)
    found = model(found) if is_model(found) else found
    writing: _Writing = {}
    if not isinstance(found, BundledScene):
        name, folders, _, state = _parse(found, parameters)
        return name, folders, state, writing
    described = found.describe()
    for key, value in described.items():
        if isinstance(value, MeshDescription):
            file = _in(folder, f"{key}.ply", f"the mesh '{key}'")
            writing[file], described[key] = value.write, value.of_file(file)
    _, folders, _, state = _parse(described, parameters)
    return found.name, folders, state, writing


def _locate(source: Any) -> Any:
    """The file, bundled scene or dictionary that the parser reads. Raises :class:`SceneError` for a loaded scene."""
    use_variant_of(source)
    if _is_loaded(source):
        raise SceneError("a scene in memory has no description; give its file or its dictionary")
    return locate(source, lambda _: None) if isinstance(source, (str, os.PathLike)) else source


def _name_absolutely(state: mi.parser.ParserState) -> None:
    import mitsuba as mi

    resolver = mi.file_resolver()
    for node in state.nodes:
        for key, value in read_properties(node.props).items():
            if isinstance(value, str) and 0 < len(value) < 4096 and Path(value).suffix:
                found = Path(str(resolver.resolve(value)))
                if found.is_file():
                    node.props[key] = str(found.absolute())


def _emitters(state: mi.parser.ParserState) -> Iterator[tuple[mi.parser.SceneNode | None, str, mi.parser.SceneNode]]:
    """(shape, property, node) of the lights of a scene: first lights without a shape, then lights on shapes."""
    import mitsuba as mi

    shapes = []
    for key, value in read_properties(state.root.props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            node = state.nodes[value.index()]
            if _is_emitter(node):
                yield None, key, node
            elif node.type == mi.ObjectType.Shape:
                shapes.append(node)
    for shape in shapes:
        for key, value in read_properties(shape.props).items():
            if isinstance(value, mi.Properties.ResolvedReference) and _is_emitter(state.nodes[value.index()]):
                yield shape, key, state.nodes[value.index()]


def _is_emitter(node: mi.parser.SceneNode) -> bool:
    import mitsuba as mi

    return node.type == mi.ObjectType.Emitter


def _shift(props: mi.Properties, by: int) -> None:
    import mitsuba as mi

    for key, value in read_properties(props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            props[key] = mi.Properties.ResolvedReference(value.index() + by)


def _id(props: mi.Properties) -> str:
    return _plain(str(props.id()))


def _plain(name: str) -> str:
    """A name that the scene gave, "" for one that Mitsuba made up."""
    return "" if name.startswith(("_unnamed", "_arg_", "__root__", "_etendue")) else name


def colour(values: Any) -> dict[str, Any]:
    """An RGB colour of a scene dictionary. Raises :class:`OptionError` for negative values."""
    red, green, blue = (float(v) for v in values)
    if min(red, green, blue) < 0.0:
        raise OptionError(f"a colour of light is not negative, as {[red, green, blue]} is")
    return {"type": "rgb", "value": [red, green, blue]}
