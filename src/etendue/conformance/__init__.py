"""Conformance tests: whether the components of a scene have the properties that all methods require."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .bsdfs import check_bsdf as check_bsdf
    from .emitters import check_emitter as check_emitter
    from .functions import check_function as check_function
    from .meshes import check_mesh as check_mesh
    from .rays import check_ray_casting as check_ray_casting
    from .report import Finding as Finding, Report as Report, Verdict as Verdict
    from .scenes import check as check
    from .sensors import check_sensor as check_sensor
    from .statistics import DensityFit as DensityFit, fit_density as fit_density
    from .textures import check_textures as check_textures
else:
    __getattr__, __dir__ = on_use(__name__)
