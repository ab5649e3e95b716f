"""Changes of a scene's parameters as plain values, made to the parsed scene before its objects are built."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, SceneError, is_number, suggest

from ..parsing import read_properties
from .values import COLOUR, NUMBER, TEXTURE, TRANSFORM, VECTOR, Value, for_file

if TYPE_CHECKING:
    import mitsuba as mi

#: Names of vectors that are not colours.
_VECTORS = frozenset({"position", "direction"})
#: Properties of shapes that the transform of a built shape includes.
_IN_TRANSFORM = ("center", "radius", "p0", "p1")


@dataclass(frozen=True)
class ParameterChanges:
    """New values of parameters, by the name that ``mi.traverse`` gives them in a scene whose elements all have names
    (:func:`name_elements`): a number, a list of numbers, or the path of a picture for a texture.

    Called with a parsed scene, it makes the changes. Raises :class:`OptionError` for a value of another form, and for
    a name that the scene does not have.
    """

    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key, value in self.values.items():
            if not (is_number(value) or isinstance(value, str) or _is_numbers(value)):
                raise OptionError(f"the value of '{key}' is a number, a list of numbers or a file, not {value!r}")
        lists = {key: list(value) if isinstance(value, tuple) else value for key, value in self.values.items()}
        object.__setattr__(self, "values", lists)

    def __call__(self, state: mi.parser.ParserState) -> None:
        """Change a parsed scene."""
        name_elements(state)
        for key, value in self.values.items():
            _set(state, key, value)


def name_elements(state: mi.parser.ParserState) -> None:
    """Name the elements of a parsed scene that have no name by their type and a number among all objects of this type.
    The names are the same whenever the file is read."""
    import mitsuba as mi

    below = read_properties(state.root.props).values()
    elements = {value.index() for value in below if isinstance(value, mi.Properties.ResolvedReference)}
    taken = {node.props.id() for node in state.nodes}
    counts: Counter[str] = Counter()
    for index, node in enumerate(state.nodes):
        kind = node.props.plugin_name()
        counts[kind] += 1
        if index in elements and not node.props.id():
            name = f"{kind}-{counts[kind]}"
            node.props.set_id(f"{name}-unnamed" if name in taken else name)


def _elements(state: mi.parser.ParserState) -> dict[str, mi.parser.SceneNode]:
    """The nodes directly below the scene, by name."""
    import mitsuba as mi

    below = read_properties(state.root.props).values()
    nodes = [state.nodes[value.index()] for value in below if isinstance(value, mi.Properties.ResolvedReference)]
    return {node.props.id(): node for node in nodes}


def _set(state: mi.parser.ParserState, key: str, value: Value) -> None:
    """Change a property of a node. Raises :class:`OptionError` if the key leads to none."""
    import mitsuba as mi

    elements = _elements(state)
    name = next((name for name in sorted(elements, key=len, reverse=True) if key.startswith(f"{name}.")), None)
    if name is None:
        raise OptionError(f"the scene has no element for '{key}'; {suggest(key.split('.')[0], elements)}")
    node, path = elements[name], key[len(name) + 1 :].split(".")
    while path[-1] == "value" and len(path) > 1:
        path.pop()
    kind = _kind_of(path[-1], value)
    if path[-1] == "data":  # the picture of a texture or of an environment map
        path[-1] = "filename"
    while len(path) > 1:
        node = _child(state, node, path.pop(0), key)
    volume = _children(state, node).get(path[0])
    if volume is not None and volume.type == mi.ObjectType.Volume:
        node, path = volume, ["value"]
    _put(node.props, path[0], kind, value)


def _put(props: mi.Properties, name: str, kind: str, value: Value) -> None:
    """Set a property, and remove properties that describe the same quantity in another way."""
    before = read_properties(props)
    instead: tuple[str, ...] = ()
    plugin = props.plugin_name()
    is_metal = "conductor" in plugin
    if name == "eta" and kind == NUMBER and not is_metal:
        instead = ("int_ior", "ext_ior", "specular")
    elif name == "specular":
        instead = ("eta",)
    elif name in ("eta", "k"):
        instead = ("material",)
    elif name == "to_world":
        instead = (*_IN_TRANSFORM, "position", "direction")
    elif name == "position":
        instead = ("to_world",)
    elif name == "filename":
        instead = ("bitmap", "data")
    elif name == "alpha":
        instead = ("alpha_u", "alpha_v")
    for other in (*instead, name):
        if other in before:
            del props[other]
    if name == "eta" and kind == NUMBER and not is_metal and not plugin.startswith("principled"):
        props["int_ior"], props["ext_ior"] = float(value), 1.0  # type: ignore[arg-type]
    else:
        props[name] = for_file(kind, value)


def _child(state: mi.parser.ParserState, node: mi.parser.SceneNode, name: str, key: str) -> mi.parser.SceneNode:
    """The node below ``node`` that a built object calls ``name``: materials and textures without a name in the file are
    numbered by their place."""
    import mitsuba as mi

    children = _children(state, node)
    for known in (name, name.removesuffix("_medium")):
        if known in children:
            return children[known]
    for words, kind in (
        (("bsdf", "brdf"), mi.ObjectType.BSDF),
        (("emitter",), mi.ObjectType.Emitter),
        (("texture", "normalmap"), mi.ObjectType.Texture),
        (("phase_function",), mi.ObjectType.PhaseFunction),
    ):
        if any(word in name for word in words):
            of_kind = [child for child in children.values() if child.type == kind]
            number = re.search(r"_(\d+)$", name)
            place = min(int(number[1]) if number else 0, len(of_kind) - 1)
            if of_kind:
                return of_kind[place]
    raise SceneError(f"'{key}' cannot be found in the scene's file, so it cannot be changed there")


def _children(state: mi.parser.ParserState, node: mi.parser.SceneNode) -> dict[str, mi.parser.SceneNode]:
    """The nodes below a node, by the names of its properties."""
    import mitsuba as mi

    found = read_properties(node.props).items()
    return {own: state.nodes[v.index()] for own, v in found if isinstance(v, mi.Properties.ResolvedReference)}


def _kind_of(name: str, value: Value) -> str:
    if isinstance(value, str):
        return TEXTURE
    if is_number(value):
        return NUMBER
    assert isinstance(value, list)
    return TRANSFORM if len(value) in (9, 16) else VECTOR if name in _VECTORS else COLOUR


def _is_numbers(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) in (3, 9, 16) and all(map(is_number, value))
