"""Conformance tests: whether the components of a scene have the properties that all methods require."""

from .bsdfs import check_bsdf
from .emitters import check_emitter
from .functions import check_function
from .rays import check_ray_casting
from .report import Finding, Report, Verdict
from .scenes import check
from .sensors import check_sensor
from .statistics import DensityFit, fit_density
from .textures import check_textures

__all__ = [
    "DensityFit",
    "Finding",
    "Report",
    "Verdict",
    "check",
    "check_bsdf",
    "check_emitter",
    "check_function",
    "check_ray_casting",
    "check_sensor",
    "check_textures",
    "fit_density",
]
