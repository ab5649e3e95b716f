"""Distances of faces along a line below which rounding must not decide their order, in radii of the scene."""

from __future__ import annotations

#: Of any two faces.
GAP = 2e-7
#: Of faces that lie back to back: their distance, that of rounding in single precision, is larger along a flat line.
PAIR_GAP = 1e-5
