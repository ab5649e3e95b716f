"""Render bundled scenes by Mitsuba and by vcm for the same time, as the manual shows them.

python tools/gallery.py media|spectra [SECONDS [PICTURE]]    of a picture; by default 60 and docs/images/NAME.jpg
"""

from __future__ import annotations

import sys
import time

import mitsuba as mi
import numpy as np

import etendue
from etendue import display, scene

#: By name of the picture: the colours of its variant, its scenes, and Mitsuba's integrator for each.
GALLERIES = {
    "media": ("rgb", {"fog": "volpath", "aquarium": "volpath", "smoke": "volpathmis"}),
    "spectra": ("spectral", {"prism": "path", "diamond": "path"}),
}


def mitsuba_picture(name: str, plugin: str, seconds: float) -> np.ndarray:
    """A picture by Mitsuba, in parts of eight samples."""
    problem = scene.load(name)
    integrator = mi.load_dict({"type": plugin, "max_depth": problem.max_depth})
    begin, total, parts = time.perf_counter(), np.zeros((*problem.size[::-1], 3)), 0
    while time.perf_counter() - begin < seconds:
        part = mi.render(problem.scene, sensor=problem.sensor, integrator=integrator, spp=8, seed=parts)
        total += np.array(part, np.float64)[..., :3]
        parts += 1
    return (total / parts).astype(np.float32)


def main(name: str, seconds: str = "60", output: str = "") -> None:
    """Write the picture: a row a scene, Mitsuba on the left."""
    colours, scenes = GALLERIES[name]
    mi.set_variant(f"llvm_ad_{colours}")
    rows = []
    for one, plugin in scenes.items():
        ours = etendue.render(one, "vcm", seconds=float(seconds)).image[..., :3]
        stops = display.auto_exposure(ours)
        pair = [display.tonemap(picture, stops) for picture in (mitsuba_picture(one, plugin, float(seconds)), ours)]
        rows.append(np.concatenate(pair, axis=1))
    mi.Bitmap(np.concatenate(rows)).write(output or f"docs/images/{name}.jpg", quality=88)


if __name__ == "__main__":
    main(*sys.argv[1:])
