"""An office at dusk: luminaires from a photometric file, the sky in the windows, and the light on the desks in lux.

    python examples/office.py [folder [seconds]]

writes lamp.ies, office.jpg, a picture beside the illuminance at the height of the desks, and desks.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
from PIL import Image

import etendue
from etendue.display import auto_exposure, tonemap
from etendue.lighting import Meters

SIZE = (8.0, 6.0, 2.8)
DESK = 0.74
LAMPS = [(x, y, 2.3) for x in (2.0, 4.0, 6.0) for y in (1.5, 4.0)]


def write_lamp(path: Path) -> None:
    """A pendant luminaire of LM-63: wide downwards, across its axis, and a part of its light to the ceiling."""
    gamma, planes = np.arange(0.0, 181.0, 5.0), np.arange(0.0, 91.0, 15.0)
    g, c = np.meshgrid(np.deg2rad(gamma), np.deg2rad(planes))
    down = np.maximum(np.cos(g), 0.0) * (1.0 + 1.2 * np.sin(g) ** 2 * np.sin(c) ** 2) * np.exp(-((g / 1.15) ** 8))
    candela = 900.0 * down + 180.0 * np.maximum(-np.cos(g), 0.0) ** 0.5
    rows = [gamma, planes, *candela]
    numbers = "\n".join(" ".join(f"{v:.1f}" for v in row) for row in rows)
    head = "IESNA:LM-63-2002\n[LUMINAIRE] Pendant\nTILT=NONE\n"
    path.write_text(f"{head}1 -1 1 {len(gamma)} {len(planes)} 1 2 0.3 1.2 0.05\n1 1 36\n{numbers}\n")


def office(lamp: Path) -> dict:
    """A room with two windows, six desks and six luminaires."""
    place = mi.ScalarTransform4f

    def matt(r: float, g: float, b: float) -> dict:
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [r, g, b]}}}

    def slab(low: tuple[float, ...], high: tuple[float, ...], material: dict) -> dict:
        middle, half = 0.5 * (np.array(low) + high), 0.5 * (np.array(high) - low)
        return {"type": "cube", "to_world": place().translate(middle.tolist()).scale(half.tolist()), "bsdf": material}

    x, y, z = SIZE
    wall, wood, floor = matt(0.62, 0.6, 0.56), matt(0.5, 0.36, 0.24), matt(0.24, 0.22, 0.2)
    scene: dict = {
        "type": "scene",
        "floor": slab((0, 0, -0.1), (x, y, 0), floor),
        "ceiling": slab((0, 0, z), (x, y, z + 0.1), matt(0.8, 0.8, 0.8)),
        "west": slab((-0.2, 0, 0), (0, y, z), wall),
        "east": slab((x, 0, 0), (x + 0.2, y, z), wall),
        "south": slab((0, -0.2, 0), (x, 0, z), wall),
        # The north wall has two windows.
        "sill": slab((0, y, 0), (x, y + 0.2, 0.9), wall),
        "lintel": slab((0, y, 2.4), (x, y + 0.2, z), wall),
        **{
            f"pier{k}": slab((a, y, 0.9), (b, y + 0.2, 2.4), wall)
            for k, (a, b) in enumerate(((0, 1), (3.7, 4.3), (7, 8)))
        },
        "sky": {"type": "sky", "kind": 12, "sun_direction": [1, -0.2, 0.05], "diffuse_illuminance": 300.0},
        "sensor": {
            "type": "perspective",
            "fov": 75.0,
            "to_world": place().look_at([0.35, 0.3, 1.7], [5.2, 4.2, 1.0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 640, "height": 480},
        },
    }
    screen = {
        "type": "roughplastic",
        "diffuse_reflectance": {"type": "rgb", "value": [0.02, 0.02, 0.025]},
        "alpha": 0.1,
    }
    for k, (a, b) in enumerate((a, b) for a in (1.2, 3.4, 5.6) for b in (1.1, 3.7)):
        scene[f"desk{k}"] = slab((a, b, DESK - 0.03), (a + 1.5, b + 0.8, DESK), wood)
        scene[f"legs{k}"] = slab((a + 0.1, b + 0.35, 0), (a + 1.4, b + 0.45, DESK - 0.03), matt(0.3, 0.3, 0.3))
        scene[f"screen{k}"] = slab((a + 0.5, b + 0.65, DESK + 0.1), (a + 1.1, b + 0.68, DESK + 0.45), screen)
    for k, position in enumerate(LAMPS):
        turned = place().translate(list(position))
        scene[f"lamp{k}"] = {"type": "luminaire", "filename": str(lamp), "to_world": turned}
        # The body of the lamp; its light starts below it.
        scene[f"body{k}"] = slab(
            (position[0] - 0.6, position[1] - 0.12, 2.33),
            (position[0] + 0.6, position[1] + 0.12, 2.36),
            matt(0.7, 0.7, 0.7),
        )
    return scene


def main(folder: str = ".", seconds: str = "60") -> None:
    """Write the picture and the table."""
    mi.set_variant("llvm_ad_rgb")
    place = Path(folder)
    write_lamp(place / "lamp.ies")
    scene = office(place / "lamp.ies")
    desks = Meters.grid((0.1, 0.1, DESK + 0.01), (SIZE[0] - 0.2, 0, 0), (0, SIZE[1] - 0.2, 0), (104, 78))
    read = etendue.measure(
        scene, desks, method="bpt", seconds=float(seconds), save=place / "desks.csv", photometric=True
    )
    print(read.summary(photometric=True))
    image = etendue.render(scene, "auto", seconds=float(seconds)).image
    left = Image.fromarray(tonemap(image, auto_exposure(image), "agx"))
    right = Image.fromarray(read.picture(photometric=True))
    right = right.resize((round(right.width * left.height / right.height), left.height))
    both = Image.new("RGB", (left.width + right.width, left.height))
    both.paste(left)
    both.paste(right, (left.width, 0))
    both.save(place / "office.jpg", quality=90)


if __name__ == "__main__":
    main(*sys.argv[1:])
