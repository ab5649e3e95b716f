"""Film: reconstruction filters, error measures, multi-layer OpenEXR."""

from .filters import FilterSampler

__all__ = ["FilterSampler"]
