"""Film: reconstruction filters, error measures, components of a picture, multi-layer OpenEXR."""

from .cells import CellGrid
from .components import (
    COMPONENTS,
    REFLECTED,
    Component,
    after_light_scattering,
    after_scattering,
    by_component,
    reflected,
)
from .cryptomatte import is_matte, matte_attributes, matte_layers
from .developing import ESTIMATORS, FILM_COLUMNS, Development
from .errors import (
    LUMINANCE,
    block_average,
    luminance_rmse,
    relative_bias,
    relative_mse,
    relative_squared_error,
)
from .exr import channel_names, layer_path, read_exr, read_image, write_exr, write_layers
from .filters import PixelFilter
from .fireflies import without_fireflies
from .flip import flip, flip_error, flip_is_installed
from .layers import ALBEDO, NORMAL, SHAPE, is_variance, variance_of
from .output import check_writable, is_writing, replacing, write_bytes
from .pyramid import LONGER, Technique

__all__ = [
    "ALBEDO",
    "COMPONENTS",
    "ESTIMATORS",
    "FILM_COLUMNS",
    "LONGER",
    "LUMINANCE",
    "NORMAL",
    "REFLECTED",
    "SHAPE",
    "CellGrid",
    "Component",
    "Development",
    "PixelFilter",
    "Technique",
    "after_light_scattering",
    "after_scattering",
    "block_average",
    "by_component",
    "channel_names",
    "check_writable",
    "flip",
    "flip_error",
    "flip_is_installed",
    "is_matte",
    "is_variance",
    "is_writing",
    "layer_path",
    "luminance_rmse",
    "matte_attributes",
    "matte_layers",
    "read_exr",
    "read_image",
    "reflected",
    "relative_bias",
    "relative_mse",
    "relative_squared_error",
    "replacing",
    "variance_of",
    "without_fireflies",
    "write_bytes",
    "write_exr",
    "write_layers",
]
