"""Denoisers of linear pictures: filters on the device, non-local means, Intel Open Image Denoise; one table of them."""

from .pictures import Features, Picture, component_names, find_features
from .registry import DENOISERS, Denoiser, denoiser
from .restoring import restored

__all__ = ["DENOISERS", "Denoiser", "Features", "Picture", "component_names", "denoiser", "find_features", "restored"]
