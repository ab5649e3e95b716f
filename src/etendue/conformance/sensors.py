"""Tests of a sensor: points on a ray project back to its film position."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.scene import graph

from .report import Finding, Findings
from .surfaces import host, uniform

_RAYS = 4096
#: Accepted error of the projection in pixels.
_PIXELS = 0.05


def check_sensor(sensor: mi.Sensor, scene: mi.Scene, component: str | None = None, *, seed: int = 0) -> list[Finding]:
    """Test a ``mi.Sensor`` of a loaded scene: ``range`` (rays are finite, with directions of length 1) and
    ``projection`` (points on a ray project to the ray's film position; skipped for sensors without
    ``sample_direction``)."""
    rng = np.random.default_rng([seed, 0x5E45])
    findings = Findings(component or graph.describe(sensor, "sensor"))
    with findings.trying("interface"):
        film, aperture = uniform(rng, _RAYS, 2), uniform(rng, _RAYS, 2)
        ray, weight = sensor.sample_ray(0.0, uniform(rng, _RAYS, 1), film, aperture)
        direction, origin, weights = (host(v, _RAYS) for v in (ray.d, ray.o, weight))
        fine = np.isfinite(origin).all(1) & np.isfinite(weights).all(1) & (weights >= 0.0).all(1)
        fine &= np.abs(np.linalg.norm(direction, axis=1) - 1.0) < 1e-3
        findings.judge(
            "range",
            float((~fine).sum()),
            0.0,
            "all rays have a finite origin, a direction of length 1 and a weight that is not negative",
            f"{(~fine).sum()} of {_RAYS} rays are not finite, have a negative weight or a direction whose length is "
            "not 1; correct the sensor's transform",
        )
        with findings.trying("projection", required=False):
            _check_projection(findings, sensor, scene, ray, film, aperture, rng)
    return findings.rows


def _check_projection(
    findings: Findings,
    sensor: mi.Sensor,
    scene: mi.Scene,
    ray: mi.Ray3f,
    film: mi.Point2f,
    aperture: mi.Point2f,
    rng: np.random.Generator,
) -> None:
    extent = float(np.linalg.norm(np.asarray(scene.bbox().extents()).ravel()))
    it = dr.zeros(mi.Interaction3f, _RAYS)
    it.p = ray(mi.Float(rng.uniform(0.05, 1.0, _RAYS).astype(np.float32)) * extent)
    ds, _ = sensor.sample_direction(it, aperture)
    size = np.asarray(sensor.film().crop_size(), np.float64).ravel()
    visible = host(ds.pdf, _RAYS) > 0.0
    expected = host(film, _RAYS) * size
    distance = np.abs(host(ds.uv, _RAYS) - expected)[visible]
    inside = (np.minimum(expected, size - expected) > _PIXELS).all(1)
    lost = int((inside & ~visible).sum())  # points beyond the far plane are not visible
    figure = float(np.quantile(distance.max(1), 0.999)) if len(distance) else np.inf
    findings.judge(
        "projection",
        figure,
        _PIXELS,
        f"pixels between a ray's film position and the projection of its points ({lost} of {_RAYS} out of range)",
        f"points on a ray project to {figure:.2f} pixels from its film position, so splats of light paths are "
        "displaced; make sample_direction the inverse of sample_ray",
    )
