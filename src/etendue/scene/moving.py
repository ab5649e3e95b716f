"""Transforms a parsed scene into another space: all positions and lengths, in double precision."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, as_array, logger

from .builtin.table import BundledScene
from .graph import below, contents, describe, plugin_name
from .instantiating import instantiated
from .parsing import MESH_PLUGINS, merge_meshes, nodes_below, read_properties
from .space import SENSORS, RenderSpace, half_diagonal, largest_offset, warn_of_offsets, warn_of_steps

if TYPE_CHECKING:
    import mitsuba as mi

#: What Mitsuba's parser reads: a file, a bundled scene, or a dictionary.
Described: TypeAlias = Path | BundledScene | Mapping[str, Any]

#: Shapes with a ``to_world``; ``shapegroup`` is placed by its instances, ``merge`` has shapes below it.
_SHAPES = (*MESH_PLUGINS, "rectangle", "cube", "disk", "sphere", "cylinder", "sdfgrid", "instance")
_GROUPS = ("shapegroup", "merge")
_LAMPS = ("point", "spot")  #: lights with an intensity in watts per steradian
#: Parameters of sensors that are lengths, and the defaults of the parameters that every sensor has.
_LENGTHS = ("near_clip", "far_clip", "focus_distance", "aperture_radius")
_DEFAULTS = {"near_clip": 1e-2, "far_clip": 1e4}


def moved(
    scene: mi.Scene,
    sensor: mi.Sensor,
    space: RenderSpace,
    source: Described,
    name: str,
    config: mi.parser.ParserConfig,
    state: mi.parser.ParserState,
) -> tuple[mi.Scene, RenderSpace]:
    """The scene of the parsed ``state`` in ``space``. ``scene`` is the same scene without transformation; it is
    returned, with a warning, if an element cannot be moved."""

    why = _obstacle(state, scene)
    if why is not None:
        warn_of_offsets(scene, sensor, name, why)
        return scene, RenderSpace()
    size = half_diagonal(scene)
    x, y, z = space.centre
    logger.info(
        f"{name} is rendered around ({x:g}, {y:g}, {z:g}) and scaled by {space.scale:g}: in its own coordinates, "
        f"rays would start up to {largest_offset(scene):.2g} off surfaces. Lengths stay in the scene's units"
    )
    if isinstance(source, Mapping):
        warn_of_steps(
            name, _largest_single(source), size, "give transforms as mi.ScalarTransform4d, or put it near the origin"
        )
    _move(state, space, scene)
    warn_of_steps(name, _largest_coordinate(state, space), size, "put the vertices of its files near the origin")
    merge_meshes(state)
    return instantiated(config, state), space


def _obstacle(state: mi.parser.ParserState, scene: mi.Scene) -> str | None:
    """Why a parsed scene cannot be moved, ``None`` if it can; ``scene`` is the scene built from it."""
    import mitsuba as mi

    inside = _in_groups(state)
    for index, node in enumerate(state.nodes):
        kind = node.props.plugin_name()
        if node.type == mi.ObjectType.Shape and index not in inside and kind not in (*_SHAPES, *_GROUPS):
            return f"a shape of type '{kind}' is not moved"
        if node.type == mi.ObjectType.Unknown and kind not in SENSORS and "to_world" in read_properties(node.props):
            return f"'{kind}' is not moved, because its type is not known"
        for value in read_properties(node.props).values():
            if isinstance(value, mi.Object) and (fixed := _fixed(value)):
                return f"{fixed} is not moved, because it is built already"
    lamps = [plugin_name(e) for e in _lamps(scene)]
    if lamps != [node.props.plugin_name() for node in _lamp_nodes(state)]:
        return "its point and spot lights cannot be matched with those of the file"
    return None


def _move(state: mi.parser.ParserState, space: RenderSpace, scene: mi.Scene) -> None:
    """Transform a parsed scene into ``space``; radiances and irradiances do not change. ``scene`` is the scene built
    without the transformation, from which intensities are read."""
    import mitsuba as mi

    square = space.scale**2
    for node, lamp in zip(list(_lamp_nodes(state)), _lamps(scene), strict=True):
        texture = dict(contents(lamp).objects)["intensity"]
        value = np.asarray(texture.eval(dr.zeros(mi.SurfaceInteraction3f)), dtype=float).ravel()
        node.props["intensity"] = mi.ScalarColor3d(*(square * value))
    inside = _in_groups(state)
    for index, node in enumerate(state.nodes):
        props = node.props
        match props.plugin_name():
            case kind if kind in _SHAPES and index not in inside:
                _move_shape(props, space)
            case "gridvolume" | "constvolume":
                _move_shape(props, space)
            case kind if kind in SENSORS:
                _move_sensor(props, space)
            case "point" | "spot" | "projector" | "luminaire" as kind:
                _move_frame(props, space)
                if kind == "projector":  # irradiance at the distance 1
                    _scale(props, ["scale"], square, {"scale": 1.0})
                if kind == "luminaire":
                    _scale(props, ["dimming"], square, {"dimming": 1.0})
            case "homogeneous" | "heterogeneous":  # extinction per length
                _scale(props, ["scale"], 1.0 / space.scale, {"scale": 1.0})
            case "bumpmap":  # heights
                _scale(props, ["scale"], space.scale, {"scale": 1.0})


def _largest_coordinate(state: mi.parser.ParserState, space: RenderSpace) -> float:
    """Approximately the largest vertex coordinate in the mesh files of a scene that was moved into ``space``, in the
    scene's original units: these files have single precision."""
    import mitsuba as mi

    moved = [n for n in state.nodes if n.type == mi.ObjectType.Shape and n.props.plugin_name() in MESH_PLUGINS]
    return max((float(np.abs(_matrix(n.props)[:3, 3]).max()) for n in moved), default=0.0) / space.scale


def _largest_single(described: Mapping[str, Any]) -> float:
    """The largest translation among the single-precision transforms in a scene dictionary."""
    largest = 0.0
    for value in described.values():
        if isinstance(value, Mapping):
            largest = max(largest, _largest_single(value))
        elif "Transform4f" in type(value).__name__:
            largest = max(largest, float(np.abs(as_array(value).astype(float).reshape(4, 4)[:3, 3]).max()))
    return largest


def _move_shape(props: mi.Properties, space: RenderSpace) -> None:
    import mitsuba as mi

    matrix = _matrix(props)
    # The transform takes positions that single precision would round.
    values = read_properties(props)
    match props.plugin_name():
        case "sphere" if "center" in values:
            matrix = matrix @ _translation(values["center"])
            del props["center"]
        case "cylinder" if {"p0", "p1"} & values.keys():
            p0, p1 = (np.asarray(values.get(k, d), float).ravel() for k, d in (("p0", (0, 0, 0)), ("p1", (0, 0, 1))))
            matrix = matrix @ _translation(p0)
            props["p0"], props["p1"] = mi.ScalarPoint3d(0.0), mi.ScalarPoint3d(*(p1 - p0))
    matrix[:3, :3] *= space.scale
    matrix[:3, 3] = space.from_scene(matrix[:3, 3])
    props["to_world"] = mi.ScalarTransform4d(matrix)


def _move_sensor(props: mi.Properties, space: RenderSpace) -> None:
    import mitsuba as mi

    _move_frame(props, space)
    _scale(props, _LENGTHS, space.scale, _DEFAULTS)
    if props.plugin_name() == "orthographic":  # the transform contains the size of the view
        matrix = _matrix(props)
        matrix[:3, :2] *= space.scale
        props["to_world"] = mi.ScalarTransform4d(matrix)


def _move_frame(props: mi.Properties, space: RenderSpace) -> None:
    """Move a sensor or a light, keeping its size and direction."""
    import mitsuba as mi

    values = read_properties(props)
    if "position" in values:
        props["position"] = mi.ScalarPoint3d(*space.from_scene(np.asarray(values["position"], float).ravel()))
        return
    matrix = _matrix(props)
    matrix[:3, 3] = space.from_scene(matrix[:3, 3])
    props["to_world"] = mi.ScalarTransform4d(matrix)


def _scale(props: mi.Properties, keys: Iterable[str], factor: float, defaults: dict[str, float]) -> None:
    values = defaults | read_properties(props)
    for key in keys:
        if key in values:
            props[key] = factor * float(values[key])


def _matrix(props: mi.Properties) -> Array:
    transform = read_properties(props).get("to_world")
    return np.eye(4) if transform is None else as_array(transform).astype(np.float64).reshape(4, 4)


def _translation(offset: ArrayLike) -> Array:
    matrix = np.eye(4)
    matrix[:3, 3] = np.asarray(offset, dtype=float).ravel()
    return matrix


def _in_groups(state: mi.parser.ParserState) -> set[int]:
    """Indices of the nodes below shape groups."""
    return nodes_below(state, (node for node in state.nodes if node.props.plugin_name() == "shapegroup"))


def _lamp_nodes(state: mi.parser.ParserState) -> Iterator[mi.parser.SceneNode]:
    """Nodes of point and spot lights, in the scene's order."""
    import mitsuba as mi

    for value in read_properties(state.root.props).values():
        if isinstance(value, mi.Properties.ResolvedReference):
            node = state.nodes[value.index()]
            if node.props.plugin_name() in _LAMPS:
                yield node


def _lamps(scene: mi.Scene) -> list[mi.Emitter]:
    return [e for e in scene.emitters() if plugin_name(e) in _LAMPS]


def _fixed(built: mi.Object) -> str | None:
    """The part of a built object of a dictionary that has a position or a length; ``None`` if there is none."""
    import mitsuba as mi

    for item in below(built):
        kind = plugin_name(item)
        surface = isinstance(item, mi.Emitter) and mi.has_flag(item.flags(), mi.EmitterFlags.Surface)
        if isinstance(item, mi.Shape) or surface:
            return describe(item, "shape" if isinstance(item, mi.Shape) else "emitter")
        if isinstance(item, (mi.Medium, mi.Volume)) and kind != "constvolume":
            return describe(item, "medium" if isinstance(item, mi.Medium) else "volume")
        if isinstance(item, mi.Sensor) or kind in (*_LAMPS, "projector", "luminaire", "bumpmap"):
            return describe(item, "sensor" if isinstance(item, mi.Sensor) else "plugin")
    return None
