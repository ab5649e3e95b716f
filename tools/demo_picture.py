"""Put the pictures of `etendue demo` side by side, as the README shows them.

    python tools/demo_picture.py [FOLDER [PICTURE]]    by default demo-output and docs/images/demo.png

Both have one exposure, that of the right one, and are averaged until the file is small enough for a web page.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from etendue import display, film

MOST_BYTES = 600_000
GAP = 4  #: pixels of white between the two
ORDER = ("path", "vcm")


def main(arguments: list[str]) -> int:
    """Write the picture; the exit status."""
    folder = Path(arguments[0] if arguments else "demo-output")
    output = Path(arguments[1] if len(arguments) > 1 else "docs/images/demo.png")
    pictures = [film.read_image(folder / f"{name}.exr") for name in ORDER]
    exposure = display.auto_exposure(pictures[-1])
    for factor in range(1, 9):
        width, height = (n // factor * factor for n in (pictures[0].shape[1], pictures[0].shape[0]))
        small = [film.block_average(picture[:height, :width], factor) for picture in pictures]
        mapped = [display.tonemap(picture, exposure) for picture in small]
        gap = np.full((mapped[0].shape[0], GAP, 3), 255, np.uint8)
        data = display.encode_png(np.concatenate([mapped[0], gap, mapped[1]], axis=1))
        if len(data) <= MOST_BYTES:
            film.write_bytes(output, data)
            print(f"{output}: {len(data) / 1000:.0f} kB, pictures averaged in blocks of {factor}")
            return 0
    print(f"no factor makes the picture smaller than {MOST_BYTES} bytes", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
