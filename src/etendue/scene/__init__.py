"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, étendue's Mitsuba plugins."""

from . import graph, meshes
from .builtin.table import BundledScene, bundled, bundled_scene
from .camera import Camera
from .capability import check
from .fingerprint import fingerprint
from .graph import materials
from .lamps.radiance import sphere_point, sphere_point_facing, surface_point, uniform_point, varies
from .lamps.table import Light, LightTable
from .loading import Source, integrator_of, load, locate, resized
from .plugins import composed_bsdf, register
from .portable import PortableScene, portable, restored
from .problem import Problem
from .space import RenderSpace, warn_of_offsets, warn_of_steps
from .watching import Parameters, parameters, view

__all__ = [
    "BundledScene",
    "Camera",
    "Light",
    "LightTable",
    "Parameters",
    "PortableScene",
    "Problem",
    "RenderSpace",
    "Source",
    "bundled",
    "bundled_scene",
    "check",
    "composed_bsdf",
    "fingerprint",
    "graph",
    "integrator_of",
    "load",
    "locate",
    "materials",
    "meshes",
    "parameters",
    "portable",
    "register",
    "resized",
    "restored",
    "sphere_point",
    "sphere_point_facing",
    "surface_point",
    "uniform_point",
    "varies",
    "view",
    "warn_of_offsets",
    "warn_of_steps",
]
