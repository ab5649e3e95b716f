"""Render the bundled scenes of media by Mitsuba and by vcm for the same time, as docs/media.md shows them.

python tools/media_pictures.py [SECONDS [PICTURE]]    of a picture; by default 60 and docs/images/media.jpg
"""

from __future__ import annotations

import sys
import time

import mitsuba as mi
import numpy as np

import etendue
from etendue import display, scene

SCENES = {"fog": "volpath", "aquarium": "volpath", "smoke": "volpathmis"}  #: and Mitsuba's integrator


def mitsuba_picture(name: str, seconds: float) -> np.ndarray:
    """A picture by Mitsuba, in parts of eight samples."""
    problem = scene.load(name)
    integrator = mi.load_dict({"type": SCENES[name], "max_depth": problem.max_depth})
    begin, total, parts = time.perf_counter(), np.zeros((*problem.size[::-1], 3)), 0
    while time.perf_counter() - begin < seconds:
        part = mi.render(problem.scene, integrator=integrator, spp=8, seed=parts)
        total += np.array(part, np.float64)[..., :3]
        parts += 1
    return (total / parts).astype(np.float32)


def main(arguments: list[str]) -> None:
    """Write the picture: a row a scene, Mitsuba on the left."""
    seconds = float(arguments[0] if arguments else 60.0)
    output = arguments[1] if len(arguments) > 1 else "docs/images/media.jpg"
    rows = []
    for name in SCENES:
        ours = etendue.render(name, "vcm", seconds=seconds).image[..., :3]
        stops = display.auto_exposure(ours)
        pair = [display.tonemap(picture, stops) for picture in (mitsuba_picture(name, seconds), ours)]
        rows.append(np.concatenate(pair, axis=1))
    mi.Bitmap(np.concatenate(rows)).write(output, quality=88)


if __name__ == "__main__":
    main(sys.argv[1:])
