"""Lights that are added to a scene: described by a few plain values, made as nodes of the parsed scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from etendue.core import Array, OptionError, suggest

from .values import COLOUR, NUMBER, TEXTURE, VECTOR, Range, checked, for_file

if TYPE_CHECKING:
    import mitsuba as mi

#: Kinds of lights: the parameters of each with kind and range. ``radiance`` is in W/(m^2 sr), ``intensity`` in W/sr.
LIGHTS: Final[Mapping[str, Mapping[str, tuple[str, Range]]]] = {
    "point": {"position": (VECTOR, Range()), "intensity": (COLOUR, Range(0.0))},
    "area": {
        "position": (VECTOR, Range()),
        "target": (VECTOR, Range()),
        "size": (NUMBER, Range(0.0, above=True)),
        "radiance": (COLOUR, Range(0.0)),
    },
    "constant": {"radiance": (COLOUR, Range(0.0))},
    "envmap": {"filename": (TEXTURE, Range()), "scale": (NUMBER, Range(0.0))},
}


def light_dict(name: str, light: Mapping[str, Any]) -> dict[str, Any]:
    """Check the description of a light: ``type``, a key of :data:`LIGHTS`, and all parameters of that kind. An area
    light is a square of side ``size`` that shines from ``position`` towards ``target``.

    Returns a scene dictionary of it. Raises :class:`OptionError` for anything else."""
    kind = str(light.get("type"))
    if kind not in LIGHTS:
        raise OptionError(f"the light '{name}' has no type that can be added; {suggest(kind, LIGHTS)}")
    if not name or "." in name or name != name.strip():
        raise OptionError(f"a light needs a name without points, not '{name}'")
    known = LIGHTS[kind]
    for key in light.keys() - {"type"}:
        if key not in known:
            raise OptionError(f"a light of type '{kind}' has no '{key}'; {suggest(key, known, 'it has')}")
    values = {}
    for key, (of, allowed) in known.items():
        if key not in light:
            raise OptionError(f"the light '{name}' of type '{kind}' needs a '{key}'")
        values[key] = checked(f"{name}.{key}", of, allowed, light[key])
    made = {key: for_file(of, values[key]) for key, (of, _) in known.items()}
    if kind != "area":
        return {"type": kind, **made}
    import mitsuba as mi

    place = _facing(name, np.array(values["position"]), np.array(values["target"]), float(values["size"]))  # type: ignore[arg-type]
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4d(place.tolist()),
        "emitter": {"type": "area", "radiance": made["radiance"]},
        "bsdf": {"type": "diffuse", "reflectance": mi.ScalarColor3d(0.0)},
    }


def added_nodes(state: mi.parser.ParserState, name: str, description: Mapping[str, Any]) -> None:
    """Add the element of a scene dictionary to a parsed scene."""
    import mitsuba as mi

    index = _node(state, name, description, mi.ObjectType.Shape if "emitter" in description else mi.ObjectType.Emitter)
    state.root.props[name] = mi.Properties.ResolvedReference(index)


def example_light(kind: str, centre: Array, radius: float, number: int) -> tuple[str, dict[str, Any]]:
    """Name and description of a light to begin with, in the upper half of a scene with this bounding sphere."""
    above = [float(v) for v in centre + np.array([0.0, 0.5 * radius, 0.0])]
    flux = float(radius**2)
    values: dict[str, Any] = {
        "position": above,
        "target": [float(v) for v in centre],
        "size": 0.2 * float(radius),
        "intensity": [flux] * 3,
        "radiance": [1.0] * 3 if kind == "constant" else [20.0] * 3,
        "scale": 1.0,
        "filename": "",
    }
    if kind not in LIGHTS:
        raise OptionError(f"there is no light of type '{kind}'; {suggest(kind, LIGHTS)}")
    return f"{kind}-light-{number}", {"type": kind} | {key: values[key] for key in LIGHTS[kind]}


def _node(state: mi.parser.ParserState, name: str, description: Mapping[str, Any], kind: mi.ObjectType) -> int:
    import mitsuba as mi

    kinds = {"emitter": mi.ObjectType.Emitter, "bsdf": mi.ObjectType.BSDF}
    node = mi.parser.SceneNode()
    node.type = kind
    node.props.set_plugin_name(description["type"])
    node.props.set_id(name)
    for key, value in description.items():
        if isinstance(value, Mapping):
            index = _node(state, f"{name}-{key}", value, kinds[key])
            node.props[key] = mi.Properties.ResolvedReference(index)
        elif key != "type":
            node.props[key] = str(Path(value).absolute()) if key == "filename" else value
    state.nodes.append(node)
    return len(state.nodes) - 1


def _facing(name: str, position: Array, target: Array, size: float) -> Array:
    """The transform of a square whose normal points to ``target``."""
    way = target - position
    length = float(np.linalg.norm(way))
    if length == 0.0:
        raise OptionError(f"the light '{name}' stands where it shines to; move its position or its target")
    normal = way / length
    side = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = 0.5 * size * side, 0.5 * size * np.cross(normal, side), normal
    matrix[:3, 3] = position
    return matrix
