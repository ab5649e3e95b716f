"""Render the bundled scenes of the theses as one sheet of small pictures, as docs/scenes.md shows them.

python tools/scene_sheet.py [SECONDS [PICTURE]]    of a scene; by default 60 and docs/images/scenes.jpg
"""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np

import etendue
from etendue import display
from etendue.scene.builtin.theses import SCENES

SIZE, ACROSS = (240, 180), 5


def main(arguments: list[str]) -> None:
    """Write the picture."""
    seconds = float(arguments[0] if arguments else 60.0)
    output = arguments[1] if len(arguments) > 1 else "docs/images/scenes.jpg"
    pictures = []
    for name, *_ in SCENES:
        image = etendue.render(name, "auto", seconds=seconds, size=SIZE).image
        pictures.append(display.tonemap(image, "auto"))
        print(name)
    blank = np.full_like(pictures[0], 255)
    pictures += [blank] * (-len(pictures) % ACROSS)
    rows = [np.concatenate(pictures[k : k + ACROSS], axis=1) for k in range(0, len(pictures), ACROSS)]
    mi.Bitmap(np.concatenate(rows)).write(output, quality=88)


if __name__ == "__main__":
    main(sys.argv[1:])
