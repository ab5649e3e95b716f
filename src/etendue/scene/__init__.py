"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, étendue's Mitsuba plugins."""

from . import graph, meshes
from .builtin.table import BundledScene, bundled, bundled_scene
from .camera import MOVABLE, Camera
from .capability import check
from .changes.edits import ParameterChanges, name_elements
from .changes.parameters import SceneEditor, SceneParameter
from .editing import Change, LightEdits, add_plugin, colour, described_lights, is_described, scene_xml
from .fingerprint import fingerprint
from .graph import materials
from .lamps.radiance import sphere_point, sphere_point_facing, surface_point, uniform_point, varies
from .lamps.table import Light, LightTable
from .loading import Source, checked_size, described, integrator_of, load, locate
from .parsing import is_sensor
from .parts import load_part, part_files, shape_boxes, unmerged
from .plugins import composed_bsdf, register
from .portable import PortableScene, portable, restored
from .problem import Problem
from .resizing import resized
from .space import RenderSpace, warn_of_offsets, warn_of_steps
from .watching import Parameters, parameters, view

__all__ = [
    "MOVABLE",
    "BundledScene",
    "Camera",
    "Change",
    "Light",
    "LightEdits",
    "LightTable",
    "ParameterChanges",
    "Parameters",
    "PortableScene",
    "Problem",
    "RenderSpace",
    "SceneEditor",
    "SceneParameter",
    "Source",
    "add_plugin",
    "bundled",
    "bundled_scene",
    "check",
    "checked_size",
    "colour",
    "composed_bsdf",
    "described",
    "described_lights",
    "fingerprint",
    "graph",
    "integrator_of",
    "is_described",
    "is_sensor",
    "load",
    "load_part",
    "locate",
    "materials",
    "meshes",
    "name_elements",
    "parameters",
    "part_files",
    "portable",
    "register",
    "resized",
    "restored",
    "scene_xml",
    "shape_boxes",
    "sphere_point",
    "sphere_point_facing",
    "surface_point",
    "uniform_point",
    "unmerged",
    "varies",
    "view",
    "warn_of_offsets",
    "warn_of_steps",
]
