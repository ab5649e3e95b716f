"""Recorded rays as lines and points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.film import LUMINANCE
from etendue.transport import Edge, Rays

#: Most edges of a kind that are sent to a page; of more, every k-th is sent.
_MOST = 50_000


def lines(rays: Rays) -> dict[str, NDArray[Any]]:
    """Arrays for the page, one row per edge: its ends (edges, 2, 3), kind, event at its end, number in its path, number
    of the path, and the luminance of its value."""
    kept = np.zeros(len(rays), bool)
    for kind in Edge:
        place = np.flatnonzero(rays.kind == kind)
        kept[place[:: max(1, -(-len(place) // _MOST))]] = True
    drawn = rays[kept]
    return {
        "edges": np.stack([drawn.start, drawn.end], axis=1),
        "kind": drawn.kind,
        "event": drawn.event,
        "number": np.minimum(drawn.number, 255).astype(np.uint8),
        "path": drawn.path,
        "value": _luminance(drawn.value),
    }


def hits(rays: Rays, paths: int) -> dict[str, NDArray[Any]]:
    """Photons: hits of light paths on surfaces with a component without delta functions. Position (n, 3), power (n, 3)
    in watts, its luminance (n,), edges from the light (n,). ``paths``: number of the light paths."""
    found = rays[(rays.kind == Edge.LIGHT) & rays.smooth]
    power = found.value / np.float32(paths)
    number = np.minimum(found.number, 255).astype(np.uint8)
    return {"points": found.end, "power": power, "value": _luminance(power), "number": number}


def _luminance(colour: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    return (colour @ np.asarray(LUMINANCE, dtype=np.float64)).astype(np.float32)
