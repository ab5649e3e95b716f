"""Film: reconstruction filters, error measures, components of a picture, multi-layer OpenEXR."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .cells import CellGrid as CellGrid
    from .components import (
        COMPONENTS as COMPONENTS,
        REFLECTED as REFLECTED,
        Component as Component,
        after_light_scattering as after_light_scattering,
        after_scattering as after_scattering,
        by_component as by_component,
        reflected as reflected,
    )
    from .cryptomatte import is_matte as is_matte, matte_attributes as matte_attributes, matte_layers as matte_layers
    from .developing import ESTIMATORS as ESTIMATORS, FILM_COLUMNS as FILM_COLUMNS, Development as Development
    from .errors import (
        LUMINANCE as LUMINANCE,
        block_average as block_average,
        luminance_rmse as luminance_rmse,
        relative_bias as relative_bias,
        relative_mse as relative_mse,
        relative_squared_error as relative_squared_error,
    )
    from .exr import (
        BANDS as BANDS,
        channel_names as channel_names,
        is_exr as is_exr,
        layer_path as layer_path,
        read_exr as read_exr,
        read_image as read_image,
        refuse_bands as refuse_bands,
        write_exr as write_exr,
        write_layers as write_layers,
    )
    from .filters import PixelFilter as PixelFilter
    from .fireflies import without_fireflies as without_fireflies
    from .layers import (
        ALBEDO as ALBEDO,
        ALPHA as ALPHA,
        NORMAL as NORMAL,
        SHAPE as SHAPE,
        is_variance as is_variance,
        variance_of as variance_of,
    )
    from .output import (
        check_writable as check_writable,
        is_writing as is_writing,
        replacing as replacing,
        write_bytes as write_bytes,
    )
    from .perceived import flip as flip, flip_error as flip_error, flip_is_installed as flip_is_installed
    from .pyramid import LONGER as LONGER, Technique as Technique
else:
    __getattr__, __dir__ = on_use(__name__)
