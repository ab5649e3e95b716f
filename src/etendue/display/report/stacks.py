"""Data of the viewer on a page: pictures of one size, each with layers, and how they are shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..colours import false_colour_stops
from ..curves import CURVES, TABLE_RANGE
from .packing import Layer, packed

#: Relative squared errors that error maps show as black and as yellow: errors of 1 % and of ten times a pixel's value.
ERROR_RANGE = (1e-4, 1e2)


@dataclass(frozen=True)
class Stack:
    """A picture of the viewer. The first of ``layers`` is the picture itself."""

    name: str
    layers: Sequence[Layer]


def viewer_data(
    stacks: Sequence[Stack], exposure: float, curve: str, room: int, reference: int | None = None, pair: bool = True
) -> dict[str, Any]:
    """Data for ``pictures.js`` in about ``room`` characters.

    ``stacks`` are of one size. ``reference`` is the number of the stack with which others are compared. Layers that do
    not fit are left out and named in ``missing``. Without ``pair`` one picture is shown at a time.
    """
    height, width = stacks[0].layers[0].values.shape[:2]
    pictures = [stack.layers[0] for stack in stacks]
    more = [(number, layer) for number, stack in enumerate(stacks) for layer in stack.layers[1:]]
    shown, others = packed(pictures, [layer for _, layer in more], room)
    layers = [[data] for data in shown]
    missing = []
    for (number, layer), data in zip(more, others, strict=True):
        if data is None:
            missing.append(f"{layer.name} of {stacks[number].name}")
        else:
            layers[number].append(data)
    return {
        "width": width,
        "height": height,
        "pictures": [{"name": s.name, "layers": made} for s, made in zip(stacks, layers, strict=True)],
        "reference": reference,
        "pair": pair and len(stacks) > 1,
        "left": 0,
        "right": min(1, len(stacks) - 1),
        "exposure": exposure,
        "curve": curve,
        "range": TABLE_RANGE,
        "curves": {name: known.tables() for name, known in CURVES.items()},
        "colours": false_colour_stops(),
        "errors": ERROR_RANGE,
        "missing": missing,
    }
