"""A picture of a tree of spheres, from above."""

from __future__ import annotations

import colorsys
from pathlib import Path

import numpy as np

from etendue.radiosity import SphereTree

from ..measuring import console

#: Width of the picture, and the margin around it, in pixels.
_WIDTH, _MARGIN = 480, 12


def save(path: Path, tree: SphereTree, title: str) -> None:
    """Write an SVG: the faces of the objects, and a circle for each sphere, in a colour for each level."""
    patches, objects = tree.objects.patches, tree.objects
    low = (tree.centres - tree.radii[:, None])[:, :2].min(axis=0)
    high = (tree.centres + tree.radii[:, None])[:, :2].max(axis=0)
    scale = _WIDTH / (high - low).max()
    size = np.ceil((high - low) * scale + 2 * _MARGIN).astype(int)

    def place(points: np.ndarray) -> np.ndarray:
        """Pixels, y downwards."""
        moved = (points[..., :2] - low) * scale + _MARGIN
        moved[..., 1] = size[1] - moved[..., 1]
        return moved

    room = place(np.array(patches.bounds))
    corner, extent = room.min(axis=0), np.abs(np.diff(room, axis=0)[0])
    shapes = [
        f'<rect x="{corner[0]:.1f}" y="{corner[1]:.1f}" width="{extent[0]:.1f}" height="{extent[1]:.1f}" '
        'fill="#f6f6f4" stroke="#999"/>'
    ]
    of_face = objects.of_patch[patches.front]
    for face in patches.faces[of_face >= 0]:
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in place(patches.vertices[face]))
        shapes.append(f'<polygon points="{corners}" fill="#8886" stroke="#555" stroke-width="0.5"/>')
    deepest = max(int(tree.levels.max()), 1)
    for (x, y), radius, level in zip(place(tree.centres), tree.radii * scale, tree.levels, strict=True):
        red, green, blue = (int(255 * c) for c in colorsys.hls_to_rgb(0.62 * (1 - level / deepest), 0.42, 0.75))
        shapes.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="rgb({red},{green},{blue})" '
            f'stroke-width="{2.2 - 1.4 * level / deepest:.2f}"/>'
        )
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size[0]}" height="{size[1]}" style="background:#fff">'
        f"<title>{title}</title>" + "".join(shapes) + "</svg>\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(svg, encoding="utf-8")
    console.print(f"plot: {path}", style="dim")
