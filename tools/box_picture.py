"""Draw the box tree of the furnished room: transmittances of its regions along the lines of sight, in colours.

    python tools/box_picture.py docs/images/radiosity-boxes.png

Boxes are seen from outside; where a line of sight comes in, the colour is the transmittance of the region it crosses:
black 0, yellow 1.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from benchmarks.radiosity.boxes import Room

from etendue.core import use_variant
from etendue.display import false_colour, write_png
from etendue.radiosity import RayScene
from etendue.radiosity.hierarchical_multipath.casting import region, slab


def main(path: str, width: int = 640, height: int = 400) -> None:
    """Room, lines, picture."""
    use_variant()
    room = Room.of("room")
    method = room.method(True, 1 << 18)
    lists, patches = method.cast_lines(), room.patches
    low, high = patches.bounds
    eye, middle = low + (high - low) * [0.05, 0.04, 0.85], low + (high - low) * [0.6, 0.55, 0.15]
    forward = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    x, y = np.meshgrid(np.linspace(-0.85, 0.85, width), 0.85 * height / width * np.linspace(1, -1, height))
    ways = forward + x[..., None] * right + y[..., None] * np.cross(right, forward)
    ways = (ways / np.linalg.norm(ways, axis=2, keepdims=True)).reshape(-1, 3)
    scene = RayScene(patches)
    origins = np.broadcast_to(scene.local(eye), ways.shape)
    seen = scene.first_patches(origins, ways)
    normals = np.append(patches.normals, np.zeros((2, 3)), axis=0)[seen]
    grey = 0.25 + 0.6 * np.abs((normals * ways).sum(axis=1)) * np.append(patches.reflectance.mean(axis=1), [0, 0])[seen]
    picture = np.repeat(grey[:, None], 3, axis=1)
    nearest, through = np.full(len(ways), np.inf), np.full(len(ways), np.nan)
    options = method._options
    for part, transform in room.boxed.children:
        box = np.stack(part.bounds) + transform[:3, 3]
        transmittance = lists[part].transmittance
        for k, way in enumerate(ways):
            near, far = slab(box, eye, 1 / way)
            if 0 < near < far and near < nearest[k]:
                r = region(box, eye, way, near, False, options.grid, options.sectors, options.rings)
                nearest[k], through[k] = near, transmittance[r]
    inside = np.isfinite(nearest)
    # A scale that is even in transmittance, from one in logarithms.
    colours = false_colour(10 ** np.where(inside, through, 0.0).reshape(height, width), 1.0, 10.0)
    scale = 255.0 if np.asarray(colours).dtype == np.uint8 else 1.0
    picture[inside] = 0.45 * picture[inside] + 0.55 * np.asarray(colours, dtype=float).reshape(-1, 3)[inside] / scale
    write_png(path, (255 * np.clip(picture, 0, 1)).astype(np.uint8).reshape(height, width, 3))


if __name__ == "__main__":
    main(sys.argv[1])
