"""B-spline curves, made safe to hit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from etendue.core import as_array

from .graph import plugin_name, shapes

if TYPE_CHECKING:
    import mitsuba as mi


def extend_curves(scene: mi.Scene) -> None:
    """Add a segment without thickness behind the last one of every ``bsplinecurve``. At a hit on the very end of the
    shape, Mitsuba 3.9.1 reads the segment behind it, and would leave its memory (its pull request 1928)."""
    import mitsuba as mi

    if all(plugin_name(shape) != "bsplinecurve" for shape in shapes(scene)):
        return
    parameters = mi.traverse(scene)
    for key in list(parameters.keys()):
        if not key.endswith(".segment_indices") or plugin_name(parameters.properties[key][2]) != "bsplinecurve":
            continue
        shape, segments = key.removesuffix("segment_indices"), as_array(parameters[key])
        points = as_array(parameters[shape + "control_points"]).reshape(-1, 4)
        last = points[segments[-1] :]
        if not last[:, 3].any():  # it was extended before
            continue
        last = last * [1.0, 1.0, 1.0, 0.0]
        parameters[shape + "control_points"] = mi.Float(np.vstack([points, last]).astype(np.float32).ravel())
        parameters[key] = mi.UInt32(np.append(segments, len(points)).astype(np.uint32))
        parameters[shape + "control_point_count"] = len(points) + len(last)
    parameters.update()
