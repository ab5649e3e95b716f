"""Data of the shapes of a scene that particles need: names, areas, and the frames of triangles and rectangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.scene import Problem, corners_of, graph

if TYPE_CHECKING:
    import mitsuba as mi


@dataclass
class Surfaces:
    """The shapes of a scene, on the host.

    names: the id of each shape in the scene, or its type and index. areas: in the scene's units squared, NaN for
    instances.
    frames: (m, 9) float32, corner and two edges of each primitive of the ``framed`` shapes, in their order, in the
    scene's units: a point is ``corner + u edge_1 + v edge_2``. boxes: (n, 6), lower and upper corner of each shape.
    """

    names: list[str]
    areas: Array
    primitives: NDArray[np.int64]  #: number of primitives of each shape
    framed: NDArray[np.bool_]  #: shapes whose primitives have frames
    frames: NDArray[np.float32]
    boxes: Array

    def __post_init__(self) -> None:
        # Shapes with frames come first, so that the number of a primitive is the row of its frame.
        self._order = order = np.argsort(~self.framed, kind="stable")
        #: Number of the first primitive of each shape.
        self.first = np.zeros(len(self.names), np.int64)
        self.first[order] = np.cumsum(self.primitives[order]) - self.primitives[order]
        #: Number of all primitives.
        self.total = int(self.primitives.sum())

    def __len__(self) -> int:
        return len(self.names)

    def shape_of(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """The shapes of the primitives with these numbers."""
        place = np.searchsorted(self.first[self._order], numbers, side="right") - 1
        return np.asarray(self._order[place])

    def describe(self) -> dict[str, Any]:
        """All but the frames as plain values, for JSON."""
        return {
            "names": self.names,
            "areas": [float(area) if np.isfinite(area) else None for area in self.areas],
            "primitives": [int(n) for n in self.primitives],
            "framed": [bool(is_framed) for is_framed in self.framed],
            "boxes": [[float(x) for x in box] for box in self.boxes],
        }

    @classmethod
    def described(cls, known: dict[str, Any], frames: NDArray[np.float32]) -> Surfaces:
        """Inverse of :meth:`describe`."""
        return cls(
            [str(name) for name in known["names"]],
            np.array([np.nan if area is None else area for area in known["areas"]]),
            np.array(known["primitives"], np.int64),
            np.array(known["framed"], bool),
            frames,
            np.array(known["boxes"], np.float64).reshape(-1, 6),
        )


class SurfaceTable:
    """:class:`Surfaces` of a loaded scene, and the numbers of shapes by the pointers of hits."""

    def __init__(self, problem: Problem) -> None:
        shapes = list(problem.scene.shapes())
        scale = problem.space.scale
        names, areas, primitives, framed, frames, boxes = [], [], [], [], [], []
        for index, shape in enumerate(shapes):
            corners = _frames(shape)
            names.append(graph.name(shape) or f"{graph.plugin_name(shape)} {index}")
            areas.append(_area(shape, corners) / scale**2)
            # An instance has the primitives of its group.
            count = int(shape.effective_primitive_count()) if graph.plugin_name(shape) == "instance" else 1
            primitives.append(len(corners) if corners is not None else max(1, count))
            framed.append(corners is not None)
            boxes.append(np.ravel([problem.space.to_scene(corner) for corner in corners_of(shape)]))
            if corners is not None:
                frames.append(np.concatenate([problem.space.to_scene(corners[:, :3]), corners[:, 3:] / scale], axis=1))
        self.surfaces = Surfaces(
            names,
            np.array(areas),
            np.array(primitives, np.int64),
            np.array(framed, bool),
            np.concatenate([np.zeros((0, 9)), *frames]).astype(np.float32),
            np.array(boxes).reshape(-1, 6),
        )
        every = graph.shapes(problem.scene)
        most = max(map(_pointer, every), default=0) + 1  # a part of a scene may have no shapes
        #: Index of a shape by the registry number of its pointer; 0 for the shapes inside groups.
        self.number_of_pointer = np.zeros(most, np.uint32)
        self.number_of_pointer[list(map(_pointer, shapes))] = np.arange(len(shapes))
        #: By registry number: whether hits on a shape report barycentric coordinates.
        self.is_mesh_pointer = np.zeros(most, bool)
        self.is_mesh_pointer[list(map(_pointer, every))] = list(map(_is_mesh, every))
        #: By registry number: number of the first primitive of a shape within its group; 0 for shapes without a group.
        self.first_of_pointer = np.zeros(most, np.uint32)
        for group in (shape for shape in every if graph.plugin_name(shape) == "shapegroup"):
            members = [shape for shape in graph.below(group) if shape in every and shape is not group]
            counts = [int(shape.effective_primitive_count()) for shape in members]
            self.first_of_pointer[list(map(_pointer, members))] = np.cumsum([0, *counts])[:-1]


def _pointer(shape: mi.Shape) -> int:
    import drjit as dr
    import mitsuba as mi

    return int(np.asarray(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))).ravel()[0])


def _is_mesh(shape: mi.Shape) -> bool:
    """Whether hits report triangles: a 'rectangle' is a mesh to Mitsuba, but its hits do not."""
    return bool(shape.is_mesh()) and "vertex_positions" in dict(graph.contents(shape).values)


def _frames(shape: mi.Shape) -> Array | None:
    """(n, 9) corner and edges of the primitives in render space; ``None`` for curved shapes."""
    import drjit as dr
    import mitsuba as mi

    if _is_mesh(shape):
        points = np.asarray(shape.vertex_positions_buffer(), np.float64).reshape(-1, 3)
        corners = points[np.asarray(shape.faces_buffer()).reshape(-1, 3)]
        return np.concatenate([corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
    if graph.plugin_name(shape) != "rectangle":
        return None
    ps = shape.eval_parameterization(mi.Point2f([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]), ray_flags=+mi.RayFlags.All)
    dr.eval(ps.p)
    points = np.array(ps.p, np.float64).reshape(3, 3).T
    return np.concatenate([points[0], points[1] - points[0], points[2] - points[0]])[None]


def _area(shape: mi.Shape, frames: Array | None) -> float:
    if frames is None:
        try:
            area = np.asarray(shape.surface_area(), np.float64).ravel()
        except RuntimeError:  # instances and some curves have no area
            return float("nan")
        return float(area[0])
    sizes = np.linalg.norm(np.cross(frames[:, 3:6], frames[:, 6:9]), axis=1)
    return float(sizes.sum() * (0.5 if _is_mesh(shape) else 1.0))
