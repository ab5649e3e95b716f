"""What stands in several rooms: seats, plants, books, glasses, pictures, lamps. Every thing stands on y = 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..pieces import (
    Array,
    Dict,
    Range,
    Vector,
    camera,
    glass,
    glazed,
    matt,
    metal,
    mirror,
    palette,
    rectangle,
    textured,
)
from ..solids import GAP, Model, Part, about, box, cushion, smooth_normals, turned

_MATT = (
    "cloth .16 .27 .32, pillow .70 .38 .12, pale-pillow .68 .62 .52, light-wood .50 .36 .22, white .76 .74 .70, "
    "leaf .09 .24 .06, grey .30 .31 .33, book-0 .42 .10 .08, book-1 .10 .20 .36, book-2 .62 .54 .38, book-3 .10 .26 .16"
)
MATERIALS: dict[str, Dict] = {
    **palette(matt, _MATT),
    **palette(glazed, "dark-wood .16 .085 .045, china .72 .70 .66, black .02 .02 .022"),
    **palette(glass, "glass 1.5, amber 1.5 .98 .72 .35, sea 1.5 .62 .90 .84"),
    "brass": metal("Au", 0.12),
    "steel": metal("Cr", 0.15),
    "mirror": mirror(),
}


def view(origin: Vector, target: Vector, fov: float) -> Dict:
    """A camera whose pixels are independent, as experiments need them."""
    return camera(origin, target, fov, (640, 480), "box", near_clip=0.05)


def furniture(**more: Dict) -> Model:
    """An empty model of these materials and ``more``."""
    return Model(MATERIALS | more)


def seat(seats: int = 2, width: float = 2.0, depth: float = 0.88) -> Model:
    """A sofa or an armchair, whose back is at low z."""
    model = furniture()
    each = width / seats
    model.add("cloth", box((width, 0.24, depth), 0.03), (0, 0.24, 0))
    model.add("cloth", box((width, 0.62, 0.2), 0.07, 5), (0, 0.52, 0.11 - depth / 2))
    for k in range(seats):
        x = (k - (seats - 1) / 2) * (each - 0.05)
        model.add("cloth", cushion((each - 0.09, 0.17, depth - 0.22), 0.06, 0.035), (x, 0.44, 0.1))
        model.add("cloth", cushion((each - 0.1, 0.19, 0.44), 0.07, 0.05), (x, 0.72, -0.19), about(0, 76))
    for side in (-1, 1):
        model.add("cloth", box((0.2, 0.46, depth), 0.07, 5), (side * (width / 2 + 0.03), 0.38, 0))
        for end in (-1, 1):
            leg = turned("0,0 2,0 2.8,13 0,13", 24)
            model.add("dark-wood", leg, (side * (width / 2 - 0.08), GAP, end * (depth / 2 - 0.08)))
    return model


def pillow(model: Model, material: str, at: Vector, turn: float, tilt: float) -> None:
    """Leaning against the back of a seat."""
    model.add(material, cushion((0.4, 0.1, 0.4), 0.045, 0.06), at, about(1, turn) @ about(0, tilt))


def wine_glass(model: Model, x: float, y: float, z: float) -> None:
    """Thin glass on a stem."""
    outside, inside = "0,0 3.4,0 3.4,.3 .6,1 .45,8 3,10 4,14 3.1,20", "2.95,20 3.8,14 2.8,10.3 0,9.2"
    model.add("glass", turned(f"{outside} {inside}", 72), (x, y, z))


def books(model: Model, rng: np.random.Generator, at: Vector, first: float, last: float) -> None:
    """A row along x on a board whose top is at ``at``."""
    x, y, z = at
    while first < last:
        thick, tall = rng.uniform(0.02, 0.045), rng.uniform(0.2, 0.31)
        book = box((thick, tall, rng.uniform(0.16, 0.24)), 0.003, 1)
        model.add(f"book-{rng.integers(0, 4)}", book, (x + first + thick / 2, y + GAP + tall / 2, z - 0.02))
        first += thick + 0.002


def plant(model: Model, x: float, z: float, height: float = 1.0, y: float = 0.0) -> None:
    """Blades in a china pot."""
    model.add("china", turned("0,0 13,0 18,30 19,32 17,32 15,26 0,26", 64), (x, y + GAP, z))
    rng = np.random.default_rng(8)
    for k in range(26):
        lean, length = rng.uniform(8.0, 52.0), height * rng.uniform(0.55, 0.95)
        model.add("leaf", _blade(lean, length), (x, y + 0.25, z), about(1, 137.5 * k))


def _blade(lean: float, length: float) -> Part:
    """It rises and bends over, a thin lens in section."""
    points, faces, _ = box((1.0, 1.0, 1.0), 0.05, 2, 10)
    t = points[:, 1] + 0.5
    width = 0.052 * np.sin(np.pi * np.clip(t, 0.03, 0.99)) ** 0.7 * (1.0 - 0.5 * t)
    angle = np.radians(lean) * (0.35 + 1.2 * t)
    out = length * t * np.sin(angle) + 0.003 * points[:, 2]
    bent = np.stack([points[:, 0] * 2 * width, length * t * np.cos(angle), out], -1)
    return bent, faces, smooth_normals(bent, faces)


def framed(model: Model, material: str, size: Range, at: ArrayLike, turn: Array, frame: str) -> None:
    """A mirror or a picture in a frame, which looks along z before it is turned."""
    (width, height), centre = size, np.asarray(at)
    model.add(material, box((width, height, 0.008)), centre, turn)
    for side in (-1, 1):
        upright, beam = box((0.06, height + 0.12, 0.04), 0.012), box((width, 0.06, 0.04), 0.012)
        model.add(frame, upright, centre + turn @ np.array([side * (width / 2 + 0.03), 0.0, 0.005]), turn)
        model.add(frame, beam, centre + turn @ np.array([0.0, side * (height / 2 + 0.03), 0.005]), turn)


def painting(model: Model, seed: int, at: Vector, turn: Array) -> Dict:
    """A view of hills in a wooden frame; the canvas."""
    framed(model, "black", (0.84, 0.56), at, turn, "dark-wood")
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:1:96j, 0:1:144j][..., None]
    pixels = np.array([0.62, 0.52, 0.36]) * (1 - y) + np.array([0.75, 0.70, 0.55]) * y
    for layer in range(4):
        waves = rng.uniform(0, 2 * np.pi, 3) + x * rng.uniform(2, 14, 3)
        hill = np.array([0.30, 0.38, 0.40]) * (1 - layer / 4) + np.array([0.14, 0.20, 0.07]) * layer / 4
        pixels[y[..., 0] > 0.42 + 0.14 * layer + np.sin(waves) @ [0.05, 0.03, 0.02]] = hill
    corner, along, across = (turn @ np.array(v) for v in ([-0.42, -0.28, 0.012], [0.84, 0, 0], [0, 0.56, 0]))
    return rectangle(np.array(at) + corner, along, across, textured(pixels[::-1]))  # v goes up


def skirting(model: Model, x: Range, z: Range) -> None:
    """White boards along the side walls and the back wall."""
    for at, side in ((x[0], 1), (x[1], -1)):
        model.add("white", box((0.015, 0.09, z[1] - z[0]), 0.003), (at + side * 0.0085, 0.046, (z[0] + z[1]) / 2))
    width = x[1] - x[0] - 0.04
    model.add("white", box((width, 0.09, 0.015), 0.003), ((x[0] + x[1]) / 2, 0.046, z[0] + 0.0085))
