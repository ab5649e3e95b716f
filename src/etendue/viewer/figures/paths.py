"""Recorded paths as lines."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.film import LUMINANCE
from etendue.transport import Event, Tracks


def lines(tracks: Tracks) -> dict[str, NDArray[Any]]:
    """Arrays for the page: every edge as two points (edges, 2, 3), with the luminance of its throughput, the event at
    its end, its number in the path and the path; and the edges to light points that next event estimation reached
    (lights, 2, 3), with the luminance that they bring and the path."""
    events, positions = tracks.events, tracks.positions
    there = events[:, 1:] != Event.NONE
    path, edge = np.nonzero(there)
    ends = np.stack([positions[path, edge], positions[path, edge + 1]], axis=1)
    lit_path, lit = np.nonzero(np.isfinite(tracks.light).all(axis=2))
    seen = np.stack([positions[lit_path, lit], tracks.light[lit_path, lit]], axis=1)
    return {
        "edges": ends.astype(np.float32),
        "throughput": _luminance(tracks.throughput[path, edge + 1]),
        "event": events[path, edge + 1].astype(np.uint8),
        "number": (edge + 1).astype(np.uint8),
        "path": path.astype(np.uint32),
        "lights": seen.astype(np.float32),
        "brought": _luminance(tracks.direct[lit_path, lit]),
        "light_path": lit_path.astype(np.uint32),
    }


def hits(tracks: Tracks) -> dict[str, NDArray[Any]]:
    """Photons: hits of light paths on surfaces with a component without delta functions. Position (n, 3), power (n, 3)
    in watts, its luminance (n,), edges from the light (n,)."""
    _, edge = np.nonzero(tracks.smooth)
    power = tracks.throughput[tracks.smooth] / len(tracks)
    points = tracks.positions[tracks.smooth]
    return {"points": points, "power": power, "value": _luminance(power), "number": edge.astype(np.uint8)}


def _luminance(colour: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    return (colour @ np.asarray(LUMINANCE, dtype=np.float64)).astype(np.float32)
