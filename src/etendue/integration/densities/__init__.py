"""Densities that can be sampled, evaluated and learned."""

from .factors import (
    AxisBins as AxisBins,
    CellGrid as CellGrid,
    Factor as Factor,
    PlaneBins as PlaneBins,
    Tabulated as Tabulated,
    Warped as Warped,
    bin_values as bin_values,
    bisect as bisect,
    warp_rows as warp_rows,
)
from .product import Density as Density, ProductDensity as ProductDensity, Warp as Warp
