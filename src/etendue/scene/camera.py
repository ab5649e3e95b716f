"""A camera that replaces position and field of view of a scene's sensor."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import OptionError, as_array, is_number

from .graph import contents, plugin_name
from .parsing import read_properties
from .space import SENSORS

if TYPE_CHECKING:
    import mitsuba as mi

    from .problem import Problem

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


def described_sensor(problem: Problem) -> dict[str, Any] | None:
    """What the sensor of a problem shows, as plain values for the metadata of a picture; ``None`` if it is no camera.

    ``type``: the plugin. ``to_world``: rows of the matrix from its own coordinates to those of the scene: x to the left
    of the picture, y up, z ahead. ``fov``: field of view of the width of the film in degrees, of perspective cameras.
    ``size``, ``crop_size``, ``crop_offset``: of film and crop window in pixels; ``principal_point_offset``: if the
    camera does not look at the middle of the film.
    """
    sensor, kind = problem.sensor, plugin_name(problem.sensor)
    if kind not in SENSORS:
        return None
    values, film = dict(contents(sensor).values), sensor.film()
    matrix = as_array(sensor.world_transform()).astype(np.float64).reshape(4, 4)
    matrix[:3, 3] = problem.space.to_scene(matrix[:3, 3])
    made: dict[str, Any] = {"type": kind, "to_world": [[float(f"{x:.9g}") for x in row] for row in matrix]}
    if "x_fov" in values:
        made["fov"] = float(f"{as_array(values['x_fov']).ravel()[0]:.7g}")
    for name in ("size", "crop_size", "crop_offset"):
        made[name] = [int(n) for n in np.asarray(getattr(film, name)()).ravel()]
    offset = [float(as_array(values.get(f"principal_point_offset_{axis}", 0.0)).ravel()[0]) for axis in "xy"]
    return made | ({"principal_point_offset": offset} if any(offset) else {})


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
