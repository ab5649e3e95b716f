"""Where shapes and scenes are."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from etendue.core import Array


def corners_of(item: mi.Scene | mi.Shape) -> tuple[Array, Array]:
    """Lower and upper corner of the box around a shape, or around all shapes of a scene.

    Mitsuba 3.9 loads rectangles of one material as one mesh that does not know where they are, and leaves them out of
    its own boxes, that of the scene included."""
    box = mi.ScalarBoundingBox3f(item.bbox())
    for shape in item.shapes() if isinstance(item, mi.Scene) else [item]:
        if shape.class_name() == "Mesh" and shape.vertex_count() > 0:
            numbers = np.asarray(shape.vertex_positions_buffer())  # axis by axis, which is fast for millions
            for corner in (np.min, np.max):
                box.expand(mi.ScalarPoint3f(*(float(corner(numbers[axis::3])) for axis in range(3))))
    return np.array(box.min, np.float64).ravel(), np.array(box.max, np.float64).ravel()


def centre_of(scene: mi.Scene) -> Array:
    """The middle of that box; not a number without shapes."""
    with np.errstate(invalid="ignore"):
        result: Array = np.mean(corners_of(scene), axis=0)
        return result
