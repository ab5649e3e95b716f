"""The camera of a session: its pose, movements, and the sensor that has it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, OptionError, as_array
from etendue.scene import Problem, RenderSpace, centre_of, corners_of, graph

from .protocol import number, numbers

if TYPE_CHECKING:
    import mitsuba as mi

#: Field of view in degrees that zooming stays within.
_FOV = 1.0, 150.0
#: Smallest angle between the view and the direction up when orbiting, in radians.
_POLE = 0.02
#: Largest cosine between the picture's horizontal and an axis that it shows upright.
_LEVEL = 1e-3
#: Smallest distance of the target relative to the scene's size.
_NEAREST = 1e-4


@dataclass(frozen=True)
class Pose:
    """Position and direction of the camera, in render space.

    ``up`` is the axis of orbiting. ``own`` (3x3) is the part of the scene's transform besides position and direction (a
    roll, a mirror, a scale), and is kept. ``fov``: horizontal field of view in degrees; ``None`` for a
    sensor without one. ``flat``: the sensor is orthographic, and the first two columns of ``own`` contain the size
    of its view.
    """

    origin: Array
    target: Array
    up: Array
    own: Array
    fov: float | None
    size: float  #: half the diagonal of the scene
    flat: bool = False
    pivot: Array | None = None  #: the point around which the camera orbits, if it is not the target

    @classmethod
    def of(cls, problem: Problem) -> Pose:
        """The pose of the sensor of a scene. The target is the point in the middle of the picture."""
        low, high = corners_of(problem.scene)
        size = float(np.linalg.norm(high - low)) / 2
        size = size if 0 < size < math.inf else 1.0
        matrix = _matrix(problem.sensor)
        origin, forward = matrix[:3, 3], _normalized(matrix[:3, 2])
        camera_up = matrix[:3, 1]
        # Of the axes that the picture shows upright, the most upright one; without such an axis, of all axes.
        upright = np.abs(_normalized(matrix[:3, 0])) < _LEVEL
        axis = int(np.argmax(np.abs(camera_up) * (upright if (upright & (camera_up != 0.0)).any() else 1.0)))
        up = np.zeros(3)
        up[axis] = math.copysign(1.0, camera_up[axis])
        if abs(forward @ up) > math.cos(_POLE):
            up = _normalized(camera_up)
        values = dict(graph.contents(problem.sensor).values)
        fov = float(np.asarray(values["x_fov"]).ravel()[0]) if "x_fov" in values else None
        flat = graph.plugin_name(problem.sensor) == "orthographic"
        target = origin + forward * _seen(problem, origin, forward, size)
        pose = cls(origin, target, up, np.eye(3), fov, size, flat)
        own = np.asarray(np.linalg.solve(pose._frame(), matrix[:3, :3]), dtype=np.float64)
        return replace(pose, own=own)

    # ------------------------------------------------------------------ movements

    def moved(self, message: Mapping[str, Any]) -> Pose:
        """The pose after the movements of a ``camera`` message. Raises :class:`OptionError`."""
        pose = self
        if "orbit" in message:
            pose = pose.orbited(*numbers(message, "orbit", 2))
        if "look" in message:
            pose = pose.turned(*numbers(message, "look", 2))
        if "pan" in message:
            right, up = numbers(message, "pan", 2)
            pose = pose.shifted(right, up, 0.0)
        if "fly" in message:
            pose = pose.shifted(*numbers(message, "fly", 3))
        if "dolly" in message:
            pose = pose.approached(number(message, "dolly"))
        if "zoom" in message:
            pose = pose.zoomed(number(message, "zoom"))
        if "roll" in message:
            pose = pose.rolled(number(message, "roll"))
        if not all(np.isfinite(v).all() for v in (pose.origin, pose.target, pose.up)):
            raise OptionError("the camera cannot be moved that far")
        return pose

    def orbited(self, right: float, up: float) -> Pose:
        """Move the camera to the right and up around the pivot, which keeps its place in the picture if that is
        possible."""
        turn = _swing(self.origin - self.target, self.up, right, up)
        pivot = self.target if self.pivot is None else self.pivot
        return replace(self, origin=pivot + turn @ (self.origin - pivot), target=pivot + turn @ (self.target - pivot))

    def turned(self, right: float, up: float) -> Pose:
        """Turn the view to the right and up, in place."""
        view = self.target - self.origin
        return replace(self, target=self.origin + _swing(view, self.up, -right, up) @ view)

    def shifted(self, right: float, up: float, forward: float) -> Pose:
        """Move camera and target, in units of their distance; in a flat view, sideways in units of its width."""
        left, above, ahead = self._frame().T
        across = 2.0 * float(np.linalg.norm(self.own[:, 0])) if self.flat else self.distance
        step = (-right * left + up * above) * across + forward * ahead * self.distance
        return replace(self, origin=self.origin + step, target=self.target + step)

    def approached(self, by: float) -> Pose:
        """Move nearer to the target: the logarithm of the distance, or of the size of a flat view, decreases by
        ``by``."""
        factor = math.exp(-max(-50.0, min(50.0, by)))
        if self.flat:
            width = float(np.linalg.norm(self.own[:, 0]))
            wanted = min(max(width * factor, _NEAREST * self.size), self.size / _NEAREST)
            return replace(self, own=self.own * [wanted / width, wanted / width, 1.0])
        distance = max(self.distance * factor, _NEAREST * self.size)
        return replace(self, origin=self.target - _normalized(self.target - self.origin) * distance)

    def zoomed(self, by: float) -> Pose:
        """Make the field of view smaller. Without a field of view, as :meth:`approached`."""
        if self.fov is None:
            return self.approached(by)
        low, high = _FOV
        return replace(self, fov=min(max(self.fov * math.exp(-max(-50.0, min(50.0, by))), low), high))

    def rolled(self, by: float) -> Pose:
        """Turn the up axis around the view direction."""
        return replace(self, up=_rotation(_normalized(self.target - self.origin), by) @ self.up)

    @property
    def distance(self) -> float:
        """Distance of the target from the camera."""
        return float(np.linalg.norm(self.target - self.origin))

    # ------------------------------------------------------------------ for sensors and pages

    def matrix(self) -> Array:
        """The transform of the sensor, 4x4."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._frame() @ self.own
        matrix[:3, 3] = self.origin
        return matrix

    def _frame(self) -> Array:
        """Columns: left, up and forward, of length 1."""
        forward = _normalized(self.target - self.origin)
        left = np.cross(self.up, forward)
        length = np.linalg.norm(left)
        if length < 1e-9:  # the view is along the axis: any direction will do
            left = np.cross(np.eye(3)[int(np.argmin(np.abs(forward)))], forward)
            length = np.linalg.norm(left)
        left = left / length
        return np.stack([left, np.cross(forward, left), forward], axis=1)

    def plain(self, problem: Problem) -> dict[str, Any]:
        """The pose in the scene's own coordinates, for pages and files."""
        space = problem.space
        up = self.matrix()[:3, 1]
        return {
            "origin": space.to_scene(self.origin).tolist(),
            "target": space.to_scene(self.target).tolist(),
            "up": _normalized(up).tolist(),
            "fov": self.fov,
        }

    def placed(self, message: Mapping[str, Any], problem: Problem) -> Pose:
        """The pose with values in the form of :meth:`plain`. Raises :class:`OptionError`."""
        pose, space = self, problem.space
        if "origin" in message:
            pose = replace(pose, origin=space.from_scene(numbers(message, "origin", 3)))
        if "target" in message:
            pose = replace(pose, target=space.from_scene(numbers(message, "target", 3)), pivot=None)
        if pose.distance < 1e-12 * pose.size:
            raise OptionError("the camera's target is its origin; move one of them")
        if "up" in message:
            axis = np.array(numbers(message, "up", 3))
            view = pose.target - pose.origin
            if np.linalg.norm(np.cross(axis, view)) <= 1e-6 * np.linalg.norm(axis) * np.linalg.norm(view):
                raise OptionError("the camera's up is zero or along its view; choose another one")
            pose = replace(pose, up=_normalized(axis), own=_upright(pose.own))
        if message.get("fov") is not None and pose.fov is not None:
            fov = number(message, "fov")
            if not 0.0 < fov < 180.0:
                raise OptionError(f"a camera's fov is an angle between 0 and 180 degrees, not {fov:g}")
            pose = replace(pose, fov=fov)
        return pose

    def carried(self, old: RenderSpace, new: RenderSpace) -> Pose:
        """The same pose in another render space."""
        if old == new:
            return self
        scale = new.scale / old.scale
        origin, target = (new.from_scene(old.to_scene(point)) for point in (self.origin, self.target))
        own = self.own * [scale, scale, 1.0] if self.flat else self.own
        pivot = None if self.pivot is None else new.from_scene(old.to_scene(self.pivot))
        return replace(self, origin=origin, target=target, own=own, size=self.size * scale, pivot=pivot)

    @property
    def is_plain(self) -> bool:
        """Whether position, target, up and field of view describe the whole pose."""
        own = self.own
        return bool(np.allclose(own @ own.T, np.eye(3), atol=1e-4) and np.linalg.det(own) > 0)


def held_back(problem: Problem, before: Pose, after: Pose) -> Pose:
    """``after``, or ``before`` if a surface is between the two places of the camera."""
    import drjit as dr
    import mitsuba as mi

    way = after.origin - before.origin
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return after
    ends = mi.Point3f(*before.origin.tolist()), mi.Vector3f(*(way / length).tolist()), mi.Float(length)
    dr.make_opaque(ends)  # as literals they would make a kernel for each movement
    ray = mi.Ray3f(*ends[:2])
    ray.maxt = ends[2]
    return before if bool(np.asarray(problem.scene.ray_test(ray)).ravel()[0]) else after


def is_placed(sensor: mi.Sensor, pose: Pose) -> bool:
    """Whether a sensor has the pose. It then need not be placed again: prepared methods share its variables, and
    kernels with other ones are compiled anew."""
    values = dict(graph.contents(sensor).values)
    fov = np.asarray(values.get("x_fov", pose.fov), dtype=np.float32)
    return bool(
        (_matrix(sensor) == np.float32(pose.matrix())).all() and (fov == np.asarray(pose.fov, np.float32)).all()
    )


def place(sensor: mi.Sensor, pose: Pose) -> None:
    """Give a sensor the pose. Matrices stay variables of the kernels, which are not compiled again."""
    import mitsuba as mi

    parameters = mi.traverse(sensor)
    parameters["to_world"] = mi.Transform4f(mi.ScalarTransform4f(pose.matrix()))
    if pose.fov is not None and "x_fov" in parameters:
        parameters["x_fov"] = mi.Float(pose.fov)
    parameters.update()


def projection(problem: Problem, pose: Pose) -> list[list[float]] | None:
    """The matrix (4x4) from points in render space to pixels of the picture, in homogeneous coordinates (x, y, depth,
    w); ``None`` for a sensor that has no such matrix."""
    kind = graph.plugin_name(problem.sensor)
    film = problem.sensor.film()
    width, height = (float(v) for v in film.size())
    x, y = (float(v) for v in film.crop_offset())
    to_camera = np.linalg.inv(pose.matrix())
    known = dict(graph.contents(problem.sensor).values)
    x, y = (
        before + extent * float(np.asarray(known.get(f"principal_point_offset_{axis}", 0.0)).ravel()[0])
        for before, extent, axis in ((x, width, "x"), (y, height, "y"))
    )
    half = np.array([[width / 2, 0, 0, width / 2 - x], [0, width / 2, 0, height / 2 - y], [0, 0, 1, 0], [0, 0, 0, 1]])
    if kind in ("perspective", "thinlens") and pose.fov is not None:
        scale = 1.0 / math.tan(math.radians(pose.fov) / 2)
        film_of = np.array([[-scale, 0, 0, 0], [0, -scale, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]])
    elif kind == "orthographic":
        film_of = np.diag([-1.0, -1.0, 1.0, 1.0])
    else:
        return None
    matrix: list[list[float]] = (half @ film_of @ to_camera).tolist()
    return matrix


def _matrix(sensor: mi.Sensor) -> Array:
    values = dict(graph.contents(sensor).values)
    return np.array(as_array(values["to_world"]), dtype=np.float64).reshape(4, 4)


def _seen(problem: Problem, origin: Array, forward: Array, size: float) -> float:
    """Distance ahead of the surface in the middle of the picture; without one, distance of the scene's middle."""
    import mitsuba as mi

    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    hit = problem.scene.ray_intersect_preliminary(ray)
    start, way = (np.asarray(v, dtype=np.float64).ravel()[:3] for v in (ray.o, ray.d))
    distance = float(np.asarray(hit.t).ravel()[0])  # from the near plane
    if math.isfinite(distance) and (ahead := float((start + distance * way - origin) @ forward)) > 0:
        return ahead
    middle = centre_of(problem.scene)
    away = float(np.linalg.norm(middle - start))
    return away if 0 < away < math.inf else size


def _swing(offset: Array, axis: Array, right: float, up: float) -> Array:
    """The rotation (3, 3) that turns a vector around the axis and towards the axis, but not across it."""
    around = _rotation(axis, right)
    offset = around @ offset
    length = float(np.linalg.norm(offset))
    angle = math.acos(min(1.0, max(-1.0, float(offset @ axis) / length)))
    side = np.cross(axis, offset)
    if np.linalg.norm(side) < 1e-9 * length:
        return around
    wanted = min(max(angle - up, _POLE), math.pi - _POLE)
    tilted: Array = _rotation(_normalized(side), wanted - angle) @ around
    return tilted


def _upright(own: Array) -> Array:
    """``own`` without its roll: the picture's vertical is the up axis."""
    sine, cosine = own[0, 1], own[1, 1]
    length = math.hypot(sine, cosine)
    if length == 0.0:
        return own
    c, s = cosine / length, sine / length
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ own


def _rotation(axis: Array, angle: float) -> Array:
    """The rotation (3, 3) around an axis of length 1, by Rodrigues' formula."""
    x, y, z = axis
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Array = np.eye(3) + math.sin(angle) * across + (1.0 - math.cos(angle)) * (across @ across)
    return turned


def _normalized(vector: ArrayLike) -> Array:
    v = np.asarray(vector, dtype=np.float64)
    result: Array = v / np.linalg.norm(v)
    return result
