"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, étendue's Mitsuba plugins."""

from . import graph, meshes
from .builtin.table import BundledScene, bundled, bundled_scene
from .camera import Camera
from .capability import check
from .changes.edits import SceneChanges, change_lines
from .changes.lights import LIGHTS, example_light
from .changes.parameters import SceneEditor, SceneParameter
from .fingerprint import fingerprint
from .graph import materials
from .lamps.radiance import sphere_point, surface_point, uniform_point, varies
from .lamps.table import Light, LightTable
from .loading import Source, integrator_of, load, locate, resized
from .plugins import composed_bsdf, register
from .portable import PortableScene, portable, restored
from .problem import Problem
from .space import RenderSpace, warn_of_offsets, warn_of_steps
from .watching import Parameters, parameters, view

__all__ = [
    "LIGHTS",
    "BundledScene",
    "Camera",
    "Light",
    "LightTable",
    "Parameters",
    "PortableScene",
    "Problem",
    "RenderSpace",
    "SceneChanges",
    "SceneEditor",
    "SceneParameter",
    "Source",
    "bundled",
    "bundled_scene",
    "change_lines",
    "check",
    "composed_bsdf",
    "example_light",
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
    "surface_point",
    "uniform_point",
    "varies",
    "view",
    "warn_of_offsets",
    "warn_of_steps",
]
