"""Film: reconstruction filters, error measures, multi-layer OpenEXR."""

from .errors import (
    ErrorHistory,
    block_average,
    relative_bias,
    relative_mse,
    relative_squared_error,
    rmse,
)
from .exr import read_exr, read_image, write_exr
from .filters import FilterSampler
from .output import replacing, write_bytes

__all__ = [
    "ErrorHistory",
    "FilterSampler",
    "block_average",
    "read_exr",
    "read_image",
    "relative_bias",
    "relative_mse",
    "relative_squared_error",
    "replacing",
    "rmse",
    "write_bytes",
    "write_exr",
]
