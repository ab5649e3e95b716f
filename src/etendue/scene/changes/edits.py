"""Changes of a scene as plain values, which are made to the parsed scene before its objects are built."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

from etendue.core import OptionError, SceneError, is_number, suggest

from ..parsing import read_properties
from .lights import added_nodes, light_dict
from .values import COLOUR, NUMBER, TEXTURE, TRANSFORM, VECTOR, Value, for_file

if TYPE_CHECKING:
    import mitsuba as mi

#: Names of vectors that are no colours.
_VECTORS = frozenset({"position", "direction"})
#: Parameters of shapes that their transform holds, once it is read from a built scene.
_IN_TRANSFORM = ("center", "radius", "p0", "p1", "flip_normals_by_scale")


@dataclass(frozen=True)
class SceneChanges:
    """What differs from the scene of a file or a dictionary.

    values: new values of parameters, by the name that ``mi.traverse`` gives them in a scene that was loaded with
        changes (possibly none): a number, a list of numbers, or the path of a picture for a texture.
    added: lights by name, see :func:`light_dict`.
    removed: names of elements of the scene.
    """

    values: Mapping[str, Value] = field(default_factory=dict)
    added: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    removed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "removed", tuple(self.removed))
        for key, value in self.values.items():
            if not (is_number(value) or isinstance(value, str) or _is_numbers(value)):
                raise OptionError(f"the value of '{key}' is a number, a list of numbers or a file, not {value!r}")
        for name, light in self.added.items():
            light_dict(name, light)

    def __bool__(self) -> bool:
        return bool(self.values or self.added or self.removed)

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Self:
        """Inverse of :meth:`to_dict`. Raises :class:`OptionError` for another form."""
        unknown = plain.keys() - {"values", "added", "removed"}
        if unknown:
            raise OptionError(f"changes of a scene are values, added and removed, not {', '.join(sorted(unknown))}")
        values, added = plain.get("values", {}), plain.get("added", {})
        removed = plain.get("removed", ())
        if not isinstance(values, Mapping) or not isinstance(added, Mapping) or isinstance(removed, str):
            raise OptionError("changes of a scene are a table of values, a table of added lights, a list of names")
        return cls(dict(values), {k: dict(v) for k, v in added.items()}, tuple(map(str, removed)))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON or TOML; empty parts are left out."""
        parts = {
            "values": dict(self.values),
            "added": {name: dict(light) for name, light in self.added.items()},
            "removed": list(self.removed),
        }
        return {name: part for name, part in parts.items() if part}

    def with_value(self, key: str, value: Value | None) -> Self:
        """With another value of a parameter; ``None``: that of the file."""
        values = {k: v for k, v in self.values.items() if k != key}
        return replace(self, values=values if value is None else values | {key: value})

    def with_light(self, name: str, light: Mapping[str, Any]) -> Self:
        """With a further light."""
        return replace(self, added={**self.added, name: dict(light)})

    def without(self, name: str) -> Self:
        """Without an element, and without the changes of its parameters."""
        values = {k: v for k, v in self.values.items() if not k.startswith(f"{name}.")}
        if name in self.added:
            return replace(self, values=values, added={k: v for k, v in self.added.items() if k != name})
        return replace(self, values=values, removed=(*self.removed, name))

    def __call__(self, state: mi.parser.ParserState) -> None:
        """Name the elements of a parsed scene, and change it. Raises :class:`OptionError` for a name that it does not
        have."""
        name_elements(state)
        for name in self.removed:
            _remove(state, name)
        for name, light in self.added.items():
            if name in _elements(state):
                raise OptionError(f"the scene has an element '{name}' already; give the light another name")
            added_nodes(state, name, light_dict(name, light))
        for key, value in self.values.items():
            _set(state, key, value)


def name_elements(state: mi.parser.ParserState) -> None:
    """Give elements without a name one that is the same whenever the file is read: its type and a number."""
    taken = {node.props.id() for node in state.nodes}
    for node in _elements(state, unnamed=True).values():
        number, kind = 1, node.props.plugin_name()
        while f"{kind}-{number}" in taken:
            number += 1
        taken.add(name := f"{kind}-{number}")
        node.props.set_id(name)


def _elements(state: mi.parser.ParserState, unnamed: bool = False) -> dict[str, mi.parser.SceneNode]:
    """The nodes directly below the scene, by name; or those without a name, by their property."""
    import mitsuba as mi

    found = {}
    for key, value in read_properties(state.root.props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            node = state.nodes[value.index()]
            if unnamed == (not node.props.id()):
                found[key if unnamed else node.props.id()] = node
    return found


def _remove(state: mi.parser.ParserState, name: str) -> None:
    import mitsuba as mi

    for key, value in read_properties(state.root.props).items():
        if isinstance(value, mi.Properties.ResolvedReference) and state.nodes[value.index()].props.id() == name:
            del state.root.props[key]
            return
    raise OptionError(f"the scene has no element '{name}' to remove; {suggest(name, _elements(state))}")


def _set(state: mi.parser.ParserState, key: str, value: Value) -> None:
    """Change a property of a node. Raises :class:`OptionError` if the key leads to none."""
    elements = _elements(state)
    name = next((name for name in sorted(elements, key=len, reverse=True) if key.startswith(f"{name}.")), None)
    if name is None:
        raise OptionError(f"the scene has no element for '{key}'; {suggest(key.split('.')[0], elements)}")
    node, path = elements[name], key[len(name) + 1 :].split(".")
    if path[-1] == "value" and len(path) > 1:
        path.pop()
    kind = _kind_of(path[-1], value)
    if path[-1] == "data":  # the picture of a texture or of an environment map
        path[-1] = "filename"
    while len(path) > 1:
        node = _child(state, node, path.pop(0), key)
    _put(node.props, path[0], kind, value)


def _put(props: mi.Properties, name: str, kind: str, value: Value) -> None:
    """Set a property, and remove those that describe the same thing in another way."""
    before = read_properties(props)
    instead: tuple[str, ...] = ()
    plugin = props.plugin_name()
    if name == "eta" and kind == NUMBER and plugin != "conductor":
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
    if name == "eta" and kind == NUMBER and not plugin.startswith(("principled", "conductor")):
        props["int_ior"], props["ext_ior"] = float(value), 1.0  # type: ignore[arg-type]
    else:
        props[name] = for_file(kind, value)


def _child(state: mi.parser.ParserState, node: mi.parser.SceneNode, name: str, key: str) -> mi.parser.SceneNode:
    """The node below ``node`` that a built object calls ``name``: materials and textures without a name in the file are
    numbered by their place."""
    import mitsuba as mi

    children = {}
    for own, value in read_properties(node.props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            children[own] = state.nodes[value.index()]
    if name in children:
        return children[name]
    for words, kind in (
        (("bsdf", "brdf"), mi.ObjectType.BSDF),
        (("emitter",), mi.ObjectType.Emitter),
        (("texture", "normalmap"), mi.ObjectType.Texture),
    ):
        if any(word in name for word in words):
            of_kind = [child for child in children.values() if child.type == kind]
            number = re.search(r"_(\d+)$", name)
            place = min(int(number[1]) if number else 0, len(of_kind) - 1)
            if of_kind:
                return of_kind[place]
    raise SceneError(f"'{key}' cannot be found in the scene's file, so it cannot be changed there")


def _kind_of(name: str, value: Value) -> str:
    if isinstance(value, str):
        return TEXTURE
    if is_number(value):
        return NUMBER
    assert isinstance(value, list)
    return TRANSFORM if len(value) in (9, 16) else VECTOR if name in _VECTORS else COLOUR


def _is_numbers(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) in (3, 9, 16) and all(map(is_number, value))


def change_lines(changes: SceneChanges) -> Iterator[str]:
    """The changes in words, a line each."""
    for name, light in changes.added.items():
        yield f"{name} added ({light.get('type')})"
    for name in changes.removed:
        yield f"{name} removed"
    for key, value in changes.values.items():
        shown = " ".join(f"{v:g}" for v in value) if isinstance(value, list) else value
        yield f"{key.removesuffix('.value')} = {shown}"
