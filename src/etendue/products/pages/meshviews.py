"""Views of patches for pages and notebooks: from outside through the backs of walls, and through the scene's camera."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.display import MeshView, mesh_picture

if TYPE_CHECKING:
    from etendue.radiosity import Patches
    from etendue.scene import Problem

Index = NDArray[np.int64]

#: Directions of the views from outside, in terms of right, ahead and up.
_DIRECTIONS = {"from the front": (-0.5, 0.75, -0.55), "from the back": (0.5, -0.75, -0.55)}


def mesh_views(patches: Patches, problem: Problem | None, aspect: float) -> list[MeshView]:
    """The camera's view, if the scene has a perspective one, and two from outside."""
    camera = None if problem is None else camera_view(problem)
    if camera is not None:
        frame = _frame(camera)
    else:  # patches of scenes have named shapes, and mostly y up; other meshes have z up
        frame = np.eye(3)[:, [0, 2, 1]] * [1.0, -1.0, 1.0] if patches.shape_names else np.eye(3)
    outside = [
        MeshView.around(name, patches.vertices, frame @ np.array(direction), frame[:, 2], aspect)
        for name, direction in _DIRECTIONS.items()
    ]
    return [camera, *outside] if camera is not None else outside


def _frame(camera: MeshView) -> NDArray[np.float64]:
    """Columns right, ahead and up: up is the axis that is most upright in the picture, ahead is level."""
    across, down, corner = np.linalg.inv(camera.matrix).T
    axis = int(np.argmax(np.abs(down)))
    up = -np.sign(down[axis]) * np.eye(3)[axis]
    ahead = corner + (across + down) / 2.0
    ahead = ahead - (ahead @ up) * up
    if np.linalg.norm(ahead) < 1e-6 * np.linalg.norm(corner):
        ahead = np.roll(up, 1)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(ahead, up), ahead, up], axis=1)


def camera_view(problem: Problem) -> MeshView | None:
    """The view of a scene's camera, from the rays through the corners of its picture; ``None`` for a sensor that is not
    perspective."""
    from etendue.scene import graph

    if graph.plugin_name(problem.sensor) not in ("perspective", "thinlens"):
        return None
    eye, ahead = _ray(problem, 0.5, 0.5)
    corners = [_ray(problem, u, v)[1] for u, v in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]
    return MeshView.from_corners("camera", eye, [way / (way @ ahead) for way in corners])


def _ray(problem: Problem, u: float, v: float) -> tuple[Any, Any]:
    """Origin and direction, in the scene's own coordinates, of the camera's ray through a point of the picture."""
    import mitsuba as mi

    ray, _ = problem.sensor.sample_ray(mi.Float(0.0), mi.Float(0.5), mi.Point2f(u, v), mi.Point2f(0.5))
    origin, way = (np.array(x, dtype=np.float64).ravel() for x in (ray.o, ray.d))
    return problem.space.to_scene(origin[None])[0], way


def seen_patches(patches: Patches, view: MeshView, size: tuple[int, int]) -> Index:
    """(height, width): number of the patch at each pixel, -1 for none."""
    faces = mesh_picture(patches.vertices, patches.faces, view, size, patches.back >= 0)
    owners = np.concatenate([patches.front, patches.back, [-1]])
    return owners[faces]  # -1 is the last


def on_pixels(values: NDArray[np.float64], seen: Index, outside: float = 0.0) -> NDArray[np.float32]:
    """Values of patches, (n,) or (n, c), at the pixels that show them."""
    filled = np.concatenate([values, np.full((1, *values.shape[1:]), outside)])
    return filled[seen].astype(np.float32)
