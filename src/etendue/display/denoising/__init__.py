"""Denoisers of linear pictures: filters on the device, non-local means, Intel Open Image Denoise; one table of them."""

from .choosing import RADIUS as RADIUS, Filter as Filter, parse_filters as parse_filters
from .pictures import (
    Features as Features,
    Picture as Picture,
    component_names as component_names,
    find_features as find_features,
    part_names as part_names,
)
from .registry import DENOISERS as DENOISERS, Denoiser as Denoiser, denoiser as denoiser
from .restoring import restored as restored
