"""Changes to Mitsuba's parsed scene before its objects are built."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from typing import TYPE_CHECKING, Any

from etendue.core import SceneError

from .graph import plugin_name
from .plugins import object_type

if TYPE_CHECKING:
    import mitsuba as mi

Size = tuple[int, int]

#: Shapes that are meshes in files.
MESH_PLUGINS = ("ply", "obj", "serialized")
_CROP = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")


#: A change of Mitsuba's parsed scene, before its objects are built.
Change = Callable[["mi.parser.ParserState"], None]


def give_types(state: mi.parser.ParserState) -> None:
    """Give étendue's plugins in a parsed dictionary their types, which Mitsuba knows only once they are built."""
    import mitsuba as mi

    for node in state.nodes:
        if node.type == mi.ObjectType.Unknown and (known := object_type(node.props.plugin_name())) is not None:
            node.type = known
    value = read_properties(state.root.props).get("integrator")
    if isinstance(value, mi.Properties.ResolvedReference):
        node = state.nodes[value.index()]
        if node.type == mi.ObjectType.Unknown:
            node.type = mi.ObjectType.Integrator


def take_integrator(state: mi.parser.ParserState) -> tuple[str, int, dict[str, Any]]:
    """Remove the integrator from the scene; return its name, maximum depth and other plain parameters."""
    import mitsuba as mi

    root = state.root
    for key, value in read_properties(root.props).items():
        if isinstance(value, mi.Integrator):  # a dictionary may hold a built integrator
            del root.props[key]
            return built_integrator(value)
        if not isinstance(value, mi.Properties.ResolvedReference):
            continue
        node = state.nodes[value.index()]
        if node.type != mi.ObjectType.Integrator:
            continue
        del root.props[key]
        while inner := _children(node, mi.ObjectType.Integrator, state):
            node = inner[0][1]  # 'aov' and 'moment' contain the integrator
        plain = {k: v for k, v in read_properties(node.props).items() if isinstance(v, (bool, int, float, str))}
        return node.props.plugin_name(), int(plain.pop("max_depth", -1)), plain
    return "", -1, {}


def built_integrator(integrator: mi.Integrator) -> tuple[str, int, dict[str, Any]]:
    """Parameters of an integrator that is built already, from its description."""
    name = plugin_name(integrator)
    own = getattr(integrator, "options", None)  # étendue's own integrators
    if isinstance(own, dict):
        plain = dict(own)
        return name, int(plain.pop("max_depth", -1)), plain
    found = re.search(r"max_depth = (-?\d+)", str(integrator))
    depth = int(found.group(1)) if found else -1
    options = {"hide_emitters": True} if getattr(integrator, "hide_emitters", False) else {}
    return name, depth if depth < 2**31 else -1, options


def resize(state: mi.parser.ParserState, size: Size) -> None:
    """Give every film of the scene another size; a crop window keeps its proportions."""
    import mitsuba as mi

    for node in state.nodes:
        if node.type == mi.ObjectType.Film:
            props, values = node.props, read_properties(node.props)
            old = int(values.get("width", 768)), int(values.get("height", 576))
            if any(k in values for k in _CROP):
                window = [int(values.get(k, d)) for k, d in zip(_CROP, (0, 0, *old), strict=True)]
                for key, value in zip(_CROP, scaled_window(window, old, size), strict=True):
                    props[key] = value
            props["width"], props["height"] = size
        elif is_sensor(node) and not _has_film(node, state):
            node.props["film"] = mi.load_dict({"type": "hdrfilm", "width": size[0], "height": size[1]})


def scaled_window(window: list[int], old: Size, new: Size) -> tuple[int, int, int, int]:
    """Offset and size of a crop window (x, y, width, height) on a film of another size; never empty."""
    edges = []
    for axis in (0, 1):
        scale = new[axis] / max(old[axis], 1)
        low = min(round(window[axis] * scale), new[axis] - 1)
        high = min(max(round((window[axis] + window[2 + axis]) * scale), low + 1), new[axis])
        edges.append((low, high - low))
    (x, width), (y, height) = edges
    return x, y, width, height


def check_films(state: mi.parser.ParserState, name: str) -> None:
    """Raise :class:`SceneError` for a film without pixels, which Mitsuba reports as a wrong field of view."""
    import mitsuba as mi

    for node in state.nodes:
        if node.type == mi.ObjectType.Film:
            values = read_properties(node.props)
            for key in ("width", "height", "crop_width", "crop_height"):
                if key in values and int(values[key]) < 1:
                    raise SceneError(f"{name}: the film's {key} is {values[key]}; it must be at least 1")


def texture_details(state: mi.parser.ParserState) -> str:
    """Text parameters of textures (interpolation, wrapping), which a loaded texture does not report."""
    import mitsuba as mi

    rows = []
    for node in state.nodes:
        if node.type == mi.ObjectType.Texture:
            values = sorted(read_properties(node.props).items())
            texts = [f"{k}={v}" for k, v in values if isinstance(v, str) and k != "filename"]
            rows += [f"{node.props.plugin_name()}:{','.join(texts)}"] if texts else []
    return "\n".join(sorted(rows))


def merge_meshes(state: mi.parser.ParserState) -> None:
    """Let Mitsuba merge meshes of the same material, which makes rays slightly faster.

    Emitting meshes are not merged: Mitsuba orders merged meshes by address, and the order of emitters determines which
    one a random number picks, so the same seed would give another picture in another process.
    """
    import mitsuba as mi

    root = state.root.props
    keys = []
    for key, node in _children(state.root, mi.ObjectType.Shape, state):
        if node.props.plugin_name() in MESH_PLUGINS and not _has_endpoint(node, state):
            keys.append(key)
    if len(keys) < 2:
        return
    merge = mi.parser.SceneNode()
    merge.type = mi.ObjectType.Shape
    merge.props.set_plugin_name("merge")
    for key in keys:
        merge.props[key] = root[key]
        del root[key]
    index = len(state.nodes)
    state.nodes.append(merge)
    state.root.props["_etendue_merged"] = mi.Properties.ResolvedReference(index)


def name_shapes(state: mi.parser.ParserState) -> None:
    """Give ids by order to the shapes of a parsed scene that have none: ``shape 1`` is the first shape."""
    import mitsuba as mi

    children = _children(state.root, mi.ObjectType.Shape, state)
    known = {node.props.id() for _, node in children}
    for number, (_, node) in enumerate(children, 1):
        if not node.props.id():
            name = f"shape {number}"
            node.props.set_id(name if name not in known else f"{name} of the file")


def keep_shapes(state: mi.parser.ParserState, wanted: Collection[str]) -> None:
    """Remove all shapes from a parsed scene except shapes with an id in ``wanted``, shapes that emit or carry a sensor,
    and groups, which their instances need."""
    import mitsuba as mi

    for key, node in _children(state.root, mi.ObjectType.Shape, state):
        needed = _has_endpoint(node, state) or node.props.plugin_name() == "shapegroup"
        if not needed and node.props.id() not in wanted:
            del state.root.props[key]


def _has_endpoint(shape: mi.parser.SceneNode, state: mi.parser.ParserState) -> bool:
    """Whether a shape has an emitter or a sensor, described or built."""
    import mitsuba as mi

    described = (mi.ObjectType.Emitter, mi.ObjectType.Sensor)
    return any(
        state.nodes[value.index()].type in described
        if isinstance(value, mi.Properties.ResolvedReference)
        else isinstance(value, mi.Endpoint)
        for value in read_properties(shape.props).values()
    )


def read_properties(props: mi.Properties) -> dict[str, Any]:
    """The properties of a node, read without marking them as used, because Mitsuba reports unused ones as misspelt."""
    return {key: read_property(props, key) for key in props.keys()}  # noqa: SIM118


def nodes_below(state: mi.parser.ParserState, starts: Iterable[mi.parser.SceneNode]) -> set[int]:
    """Indices of the nodes below those that are given."""
    import mitsuba as mi

    stack, found = list(starts), set[int]()
    while stack:
        for value in read_properties(stack.pop().props).values():
            if isinstance(value, mi.Properties.ResolvedReference) and value.index() not in found:
                found.add(value.index())
                stack.append(state.nodes[value.index()])
    return found


def read_property(props: mi.Properties, key: str) -> Any:
    """One property, read in the same way."""
    used = props.was_queried(key)
    value = props[key]
    props.mark_queried(key, used)
    return value


def _children(
    node: mi.parser.SceneNode, wanted: mi.ObjectType, state: mi.parser.ParserState
) -> list[tuple[str, mi.parser.SceneNode]]:
    """(property name, node) of the children of type ``wanted`` that are nodes of the parser."""
    import mitsuba as mi

    found = []
    for key, value in read_properties(node.props).items():
        if isinstance(value, mi.Properties.ResolvedReference):
            child = state.nodes[value.index()]
            if child.type == wanted:
                found.append((key, child))
    return found


def is_sensor(node: mi.parser.SceneNode) -> bool:
    """Whether a node of a parsed scene is a sensor."""
    import mitsuba as mi

    return node.type == mi.ObjectType.Sensor


def _has_film(sensor: mi.parser.SceneNode, state: mi.parser.ParserState) -> bool:
    import mitsuba as mi

    built = any(isinstance(v, mi.Film) for v in read_properties(sensor.props).values())
    return built or bool(_children(sensor, mi.ObjectType.Film, state))
