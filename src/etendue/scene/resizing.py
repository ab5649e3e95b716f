"""Films of another size for sensors of loaded scenes."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import OptionError, as_array

from .graph import contents, plugin_name
from .parsing import Size, scaled_window
from .problem import Problem
from .space import SENSORS

if TYPE_CHECKING:
    import mitsuba as mi


def resized(problem: Problem, size: Size, pinhole: bool = False) -> Problem:
    """The same view of the same scene on a film whose window has (width, height) ``size``, without loading again.
    ``pinhole``: without the aperture of a thin lens."""
    film = [int(v) for v in problem.sensor.film().size()]
    whole = tuple(max(1, round(f * s / w)) for f, s, w in zip(film, size, problem.size, strict=True))
    sensor = resized_sensor(problem.sensor, (whole[0], whole[1]), pinhole)
    width, height = (int(v) for v in sensor.film().crop_size())
    return replace(problem, sensor=sensor, size=(width, height))


def resized_sensor(sensor: mi.Sensor, size: Size, pinhole: bool = False) -> mi.Sensor:
    """A copy of a sensor with a film of another size; ``pinhole``: without the aperture of a thin lens.

    Changing the film through ``mi.traverse`` would alter the user's scene and leave the sensor with its old resolution.
    """
    import mitsuba as mi

    kind = plugin_name(sensor)
    if kind not in SENSORS:
        raise OptionError(
            f"a '{kind}' sensor of a loaded scene cannot be given another size; load the scene at that size"
        )
    film = sensor.film()
    old = int(film.size()[0]), int(film.size()[1])
    window = [int(v) for v in (*film.crop_offset(), *film.crop_size())]
    x, y, width, height = scaled_window(window, old, size)
    values = dict(contents(sensor).values)
    matrix = as_array(values.pop("to_world")).astype(np.float64).reshape(4, 4)
    plain: dict[str, Any] = {
        k: float(np.asarray(v).ravel()[0]) for k, v in values.items() if k not in ("x_fov", "shutter_open_time")
    }
    if pinhole and kind == "thinlens":
        kind = "perspective"
        del plain["aperture_radius"], plain["focus_distance"]
    plain["shutter_close"] = plain.get("shutter_open", 0.0) + float(values["shutter_open_time"])
    if "x_fov" in values:
        plain |= {"fov": float(np.asarray(values["x_fov"]).ravel()[0]), "fov_axis": "x"}
    bands = dict(contents(film).objects)  # of a specfilm
    pixel_format = None if bands else re.search(r"pixel_format = (\w+)", str(film))
    return mi.load_dict(
        {
            "type": kind,
            "to_world": mi.ScalarTransform4f(matrix),
            "sampler": sensor.sampler().clone(),
            "film": {
                "type": plugin_name(film),
                "width": size[0],
                "height": size[1],
                "crop_offset_x": x,
                "crop_offset_y": y,
                "crop_width": width,
                "crop_height": height,
                "sample_border": bool(film.sample_border()),
                "component_format": "float32",
                "filter": film.rfilter(),
                **({"pixel_format": pixel_format.group(1)} if pixel_format else {}),
                **bands,
            },
            **plain,
        }
    )
