"""A method of one's own: ambient occlusion, with budgets, checkpoints, `compare` and a Mitsuba plugin by the base
class.

    python examples/occlusion.py [folder]

writes occlusion.png, the bundled Cornell box with glass: the unoccluded share of the hemisphere above each point.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

import etendue
from etendue.core import setting
from etendue.display import tonemap, write_png
from etendue.methods import ImageMethod, ImageSettings, Layer, total
from etendue.transport import dimensions as dim


@dataclass(frozen=True)
class OcclusionSettings(ImageSettings):
    """Settings of ``occlusion``: those of every method, and ``reach``."""

    reach: float = setting(0.0, "how far a surface hides, in units of the scene; 0: any distance", minimum=0.0)


class Occlusion(ImageMethod):
    r"""Unoccluded share of the hemisphere above each point, weighted by the cosine.

    .. math:: A(x) = \frac{1}{\pi} \int V(x, \omega) \cos\theta \, d\omega
    """

    name: ClassVar[str] = "occlusion"
    Settings: ClassVar[type[ImageSettings]] = OcclusionSettings

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """One direction for each camera path. Random numbers are requested by vertex and component."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, _, _ = self.camera.primary(lanes // samples, source)
        si = self.scene.ray_intersect(ray)
        normal = dr.mulsign(si.n, -dr.dot(si.n, ray.d))  # towards the camera
        up = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*source.next_2d(1, dim.DIRECTION)))
        out = mi.Ray3f(si.spawn_ray(mi.Frame3f(normal).to_world(up)))
        if self.settings.reach > 0.0:
            out.maxt = mi.Float(self.settings.reach * self.problem.space.scale)  # scenes may be scaled on load
        is_seen = si.is_valid() & ~self.scene.ray_test(out, si.is_valid())
        value = mi.Color3f(dr.select(is_seen, 1.0, 0.0))
        rays = dr.select(si.is_valid(), mi.UInt32(2), mi.UInt32(1))
        dr.eval(value, rays)
        counters = {"rays": total(rays), "paths": float(len(lanes)), "nonfinite": 0.0}
        return {"image": self.image(value, seed, iteration)}, counters


def run(scene: Any, size: tuple[int, int], spp: int, **settings: Any) -> np.ndarray:
    """The picture (height, width, 3)."""
    etendue.register(Occlusion)
    return etendue.render(scene, "occlusion", size=size, spp=spp, **settings).image


def main(folder: str = ".") -> None:
    """Write the picture."""
    write_png(Path(folder) / "occlusion.png", tonemap(run("cornell-glass", (256, 256), 64, reach=1.0)))


if __name__ == "__main__":
    main(*sys.argv[1:])
