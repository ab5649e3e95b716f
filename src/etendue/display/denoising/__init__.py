"""Denoisers of linear pictures: filters on the device, non-local means, Intel Open Image Denoise; one table of them."""

from .choosing import RADIUS, Filter, parse_filters
from .pictures import Features, Picture, component_names, find_features, part_names
from .registry import DENOISERS, Denoiser, denoiser
from .restoring import restored

__all__ = [
    "DENOISERS",
    "RADIUS",
    "Denoiser",
    "Features",
    "Filter",
    "Picture",
    "component_names",
    "denoiser",
    "find_features",
    "parse_filters",
    "part_names",
    "restored",
]
