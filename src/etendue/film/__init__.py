"""Film: reconstruction filters, error measures, multi-layer OpenEXR."""

from .cells import CellGrid
from .developing import ESTIMATORS, FILM_COLUMNS, Development
from .errors import (
    LUMINANCE,
    block_average,
    luminance_rmse,
    relative_bias,
    relative_mse,
    relative_squared_error,
    rmse,
)
from .exr import channel_names, layer_path, read_exr, read_image, write_exr, write_layers
from .filters import PixelFilter
from .flip import flip, flip_error, flip_is_installed
from .output import check_writable, replacing, write_bytes
from .pyramid import LONGER, Technique

__all__ = [
    "ESTIMATORS",
    "FILM_COLUMNS",
    "LONGER",
    "LUMINANCE",
    "CellGrid",
    "Development",
    "PixelFilter",
    "Technique",
    "block_average",
    "channel_names",
    "check_writable",
    "flip",
    "flip_error",
    "flip_is_installed",
    "layer_path",
    "luminance_rmse",
    "read_exr",
    "read_image",
    "relative_bias",
    "relative_mse",
    "relative_squared_error",
    "replacing",
    "rmse",
    "write_bytes",
    "write_exr",
    "write_layers",
]
