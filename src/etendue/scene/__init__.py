"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, étendue's Mitsuba plugins."""

from . import graph, meshes
from .builtin.table import BundledScene, bundled, bundled_scene
from .camera import MOVABLE, Camera
from .capability import check, is_dark
from .changes.edits import ParameterChanges, name_elements
from .changes.parameters import SceneEditor, SceneParameter
from .changes.watching import Parameters, parameters, view
from .editing import Change, LightEdits, add_plugin, colour, described_lights, is_described, scene_xml
from .fingerprint import fingerprint
from .graph import materials
from .lamps.placement import lamps_in_surfaces, remarks_on, warn_of_lamps
from .lamps.places import LightsAt
from .lamps.radiance import (
    front,
    has_cells,
    is_smooth,
    sphere_point,
    sphere_point_facing,
    surface_point,
    uniform_point,
)
from .lamps.rays import own_ray
from .lamps.table import Light, LightTable
from .loading import Source, checked_size, described, integrator_of, load, locate
from .members import Material, Members, bsdfs, emitters
from .meshes import box, joined
from .models.reading import emits
from .parsing import is_sensor
from .parts import load_part, part_files, shape_boxes, unmerged
from .plugins import composed_bsdf, register
from .portable import PortableScene, portable, restored
from .problem import Problem
from .resizing import resized
from .space import RenderSpace, warn_of_offsets, warn_of_steps

__all__ = [
    "MOVABLE",
    "BundledScene",
    "Camera",
    "Change",
    "Light",
    "LightEdits",
    "LightTable",
    "LightsAt",
    "Material",
    "Members",
    "ParameterChanges",
    "Parameters",
    "PortableScene",
    "Problem",
    "RenderSpace",
    "SceneEditor",
    "SceneParameter",
    "Source",
    "add_plugin",
    "box",
    "bsdfs",
    "bundled",
    "bundled_scene",
    "check",
    "checked_size",
    "colour",
    "composed_bsdf",
    "described",
    "described_lights",
    "emits",
    "emitters",
    "fingerprint",
    "front",
    "graph",
    "has_cells",
    "integrator_of",
    "is_dark",
    "is_described",
    "is_sensor",
    "is_smooth",
    "joined",
    "lamps_in_surfaces",
    "load",
    "load_part",
    "locate",
    "materials",
    "meshes",
    "name_elements",
    "own_ray",
    "parameters",
    "part_files",
    "portable",
    "register",
    "remarks_on",
    "resized",
    "restored",
    "scene_xml",
    "shape_boxes",
    "sphere_point",
    "sphere_point_facing",
    "surface_point",
    "uniform_point",
    "unmerged",
    "view",
    "warn_of_lamps",
    "warn_of_offsets",
    "warn_of_steps",
]
