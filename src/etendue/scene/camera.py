"""A camera that replaces position and field of view of a scene's sensor."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import OptionError, is_number

from .graph import plugin_name
from .parsing import read_properties

if TYPE_CHECKING:
    import mitsuba as mi

#: Sensors with a position, a direction and a field of view.
MOVABLE = ("perspective", "thinlens")

Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Camera:
    """Position, view direction and field of view of a perspective or thin-lens sensor, in world space.

    ``origin`` and ``target`` must be given together; without them the scene's position and direction are kept. ``up``
    is the direction that is up in the picture. ``fov`` is the field of view of the whole film in degrees, along the
    ``fov_axis`` as in Mitsuba: ``x``, horizontal, or ``y``; without it the scene's field of view is kept. Raises
    :class:`OptionError` for invalid values.
    """

    origin: Sequence[float] | None = None
    target: Sequence[float] | None = None
    up: Sequence[float] = (0.0, 1.0, 0.0)
    fov: float | None = None
    fov_axis: str = "x"

    def __post_init__(self) -> None:
        for name in ("origin", "target", "up"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, _point(name, value))
        if (self.origin is None) != (self.target is None):
            raise OptionError("a camera needs both origin and target; give both, or none to keep the scene's")
        if self.origin is not None and self.target is not None:
            view = np.subtract(self.target, self.origin)
            if not view.any():
                raise OptionError(f"the camera's target is its origin, {list(self.origin)}; move one of them")
            up = np.asarray(self.up)
            if np.linalg.norm(np.cross(view, up)) <= 1e-6 * np.linalg.norm(view) * np.linalg.norm(up):
                raise OptionError(f"the camera's up, {list(self.up)}, is zero or along its view; choose another one")
        fov = self.fov
        if fov is not None and not (is_number(fov) and 0.0 < fov < 180.0):
            raise OptionError(f"a camera's fov is an angle between 0 and 180 degrees, not {fov!r}")
        if self.fov_axis not in ("x", "y"):
            raise OptionError(f"a camera's fov_axis is x or y, not {self.fov_axis!r}")

    def to_dict(self) -> dict[str, Any]:
        """The arguments of an equal camera, ready for JSON."""
        return {k: v for k, v in dataclasses.asdict(self).items() if v is not None}

    def move_sensors(self, state: mi.parser.ParserState) -> None:
        """Move every movable sensor of a parsed scene; only the sensor that is rendered matters."""
        import mitsuba as mi

        for node in state.nodes:
            props = node.props
            if node.type != mi.ObjectType.Sensor or props.plugin_name() not in MOVABLE:
                continue
            if self.origin is not None and self.target is not None:
                place = mi.ScalarTransform4d().look_at(list(self.origin), list(self.target), list(self.up))
                props["to_world"] = place
            if self.fov is not None:
                if "focal_length" in read_properties(props):
                    del props["focal_length"]
                props["fov"] = float(self.fov)
                props["fov_axis"] = self.fov_axis


def check_movable(sensor: mi.Sensor, name: str) -> None:
    """Raise :class:`OptionError` if a camera cannot replace the position of ``sensor`` of the scene ``name``."""
    kind = plugin_name(sensor)
    if kind not in MOVABLE:
        raise OptionError(
            f"the sensor of {name} is '{kind}', but a camera can replace {' and '.join(MOVABLE)} only; leave it out"
        )


def _point(name: str, value: Any) -> Point:
    numbers = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else []
    if len(numbers) != 3 or not all(map(is_number, numbers)):
        raise OptionError(f"a camera's {name} is three numbers such as [0, 1, 4], not {value!r}")
    x, y, z = map(float, numbers)
    return x, y, z
