"""Pictures as an eye sees them: directions and solid angles of their pixels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from etendue.core import Array, is_number

from .errors import LightingError

Projection = Literal["perspective", "spherical"]
PROJECTIONS: tuple[Projection, ...] = ("perspective", "spherical")


@dataclass(frozen=True)
class View:
    """How a picture shows what is in front of an eye, which looks at the middle of the picture.

    Directions are in the frame of Mitsuba's cameras: x to the left of the picture, y up in it, z along the line of
    sight. Only the hemisphere z > 0 counts; pixels across its border have the part of them that is in it.

    Attributes
    ----------
    projection: ``perspective``, or ``spherical``: latitude and longitude, as of the sensor of that name, from the
        zenith in the first row to the nadir in the last.
    fov: degrees from edge to edge. ``perspective``: of the sensor, between 0 and 180. ``spherical``: of longitude; 360
        (the default), or less for the columns in the middle only; 180 is the hemisphere.
    fov_axis: ``x`` if ``fov`` is that of the width of a perspective picture, ``y`` if of the height. Pixels are square.

    Raises :class:`LightingError` for other values.
    """

    projection: Projection
    fov: float | None = None
    fov_axis: Literal["x", "y"] = "x"

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            raise LightingError(f"a view is {' or '.join(PROJECTIONS)}, not {self.projection!r}")
        if self.fov_axis not in ("x", "y"):
            raise LightingError(f"fov_axis of a view is x or y, not {self.fov_axis!r}")
        spherical = self.projection == "spherical"
        if self.fov is None and spherical:
            object.__setattr__(self, "fov", 360.0)
        if self.fov is None:
            raise LightingError("a perspective view needs its field of view; give fov, in degrees")
        if not is_number(self.fov) or not (0.0 < self.fov <= 360.0 if spherical else 0.0 < self.fov < 180.0):
            most = "0 to 360" if spherical else "between 0 and 180"
            raise LightingError(f"the field of view of a {self.projection} picture is {most} degrees, not {self.fov!r}")

    @classmethod
    def of_sensor(cls, sensor: Mapping[str, Any]) -> View:
        """The view of a picture, from what its metadata tell as ``sensor``. Raises :class:`LightingError` for sensors
        that are no eye, and for parts of a film, whose middle is not the line of sight."""
        kind = sensor.get("type")
        if sensor.get("crop_size") != sensor.get("size") or "principal_point_offset" in sensor:
            raise LightingError("the middle of the picture is not that of its camera; render the whole film, centred")
        if kind in ("perspective", "thinlens"):
            return cls("perspective", sensor.get("fov"))
        if kind == "spherical":
            return cls("spherical")
        raise LightingError(f"the picture is of the sensor '{kind}', which is no eye; take spherical or perspective")

    def pixels(self, height: int, width: int) -> tuple[Array, Array, Array]:
        """Of a picture of this size: directions of the pixels' centres (height, width, 3), of unit length; their solid
        angles (height, width), in sr; and these weighted by the cosine to the line of sight, whose sum over the
        hemisphere is pi. The latter two are exact, without what is behind the eye."""
        assert self.fov is not None
        u, v = np.arange(width + 1) / width, np.arange(height + 1) / height
        if self.projection == "spherical":
            return _spherical(np.deg2rad(self.fov) * (u - 0.5), math.pi * v)
        half = math.tan(0.5 * math.radians(self.fov))
        across = half if self.fov_axis == "x" else half * width / height
        return _perspective(across * (1.0 - 2.0 * u), across * height / width * (1.0 - 2.0 * v))


def _spherical(azimuth: Array, polar: Array) -> tuple[Array, Array, Array]:
    """Pixels between azimuths, to the right of the line of sight, and angles from the zenith."""
    a, t = 0.5 * (azimuth[1:] + azimuth[:-1]), 0.5 * (polar[1:] + polar[:-1])
    flat = np.stack([-np.sin(a), np.zeros_like(a), np.cos(a)], axis=-1)
    directions = np.sin(t)[:, None, None] * flat + np.cos(t)[:, None, None] * np.array([0.0, 1.0, 0.0])
    inside = np.clip(azimuth, -0.5 * math.pi, 0.5 * math.pi)
    solid = np.diff(-np.cos(polar))[:, None] * np.diff(inside)
    # The cosine to the line of sight is sin t cos a.
    projected = np.diff(0.5 * polar - 0.25 * np.sin(2.0 * polar))[:, None] * np.diff(np.sin(inside))
    return directions, solid, projected


def _perspective(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Pixels between lines of the plane z = 1."""
    centres = np.meshgrid(0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1]))
    directions = np.stack([*centres, np.ones_like(centres[0])], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    px, py = np.meshgrid(x, y)
    a, b = np.hypot(1.0, px), np.hypot(1.0, py)
    # Of the rectangle from the line of sight to (px, py): its solid angle, and pi times its configuration factor.
    solid = np.arctan(px * py / np.hypot(a, py))
    projected = 0.5 * (px / a * np.arctan(py / a) + py / b * np.arctan(px / b))
    solid, projected = (np.diff(np.diff(corner, axis=0), axis=1) for corner in (solid, projected))
    return directions, solid, projected
