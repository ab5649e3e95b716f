"""Make the reference picture of the demonstration scene, ``src/etendue/scene/builtin/data/caustics.exr``.

    python tools/demo_reference.py [--samples 1400]

It is vcm like the picture on show, as no other method makes light that is focused both on its way from the lamp and
to the eye, but with a smaller first radius, undiscounted weights, as many light as camera paths and another seed.
Stored as half floats: 11 bits are far finer than the noise that is measured against it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

import etendue
from etendue import film

TARGET = Path(__file__).parents[1] / "src" / "etendue" / "scene" / "builtin" / "data" / "caustics.exr"
SETTINGS: dict[str, Any] = {
    "light_paths": 1.0,
    "radius": 1.0,
    "radius_unit": "pixel",
    "eta_discount": 1.0,
    "alpha": 0.7,
    "split_layers": False,
}


def main() -> None:
    """Render and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1400, help="a pixel; 15 minutes on two cores")
    parser.add_argument("--picture", help="take this EXR, rendered with the same settings, instead of rendering")
    arguments = parser.parse_args()
    if arguments.picture:
        image = film.read_image(arguments.picture)
    else:
        image = etendue.render("caustics", "vcm", spp=arguments.samples, seed=4242, **SETTINGS).image
    TARGET.parent.mkdir(exist_ok=True)
    channels = {"RGB": np.ascontiguousarray(image[..., :3]).astype(np.float16)}
    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(TARGET))


if __name__ == "__main__":
    main()
