"""Densities that can be sampled, evaluated and learned."""

from .factors import (
    AxisBins,
    CellGrid,
    Factor,
    PlaneBins,
    Tabulated,
    Warped,
    bin_values,
    bisect,
    warp_rows,
)
from .product import Density, ProductDensity, Warp

__all__ = [
    "AxisBins",
    "CellGrid",
    "Density",
    "Factor",
    "PlaneBins",
    "ProductDensity",
    "Tabulated",
    "Warp",
    "Warped",
    "bin_values",
    "bisect",
    "warp_rows",
]
