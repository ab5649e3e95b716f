"""Surfaces: patches and faces, read from meshes and scenes; ray casting; values and lightmaps on surfaces."""

from etendue.scene import box, joined

from .ambient import (
    AMBIENT_TERMS,
    CLASS_NORMALS,
    AmbientTerm,
    class_factors,
    class_light,
    class_weights,
    incoming,
)
from .coincident import REACH_OF_PAIRS, Coincident, box_tree, is_interior, surfaces_of
from .diagnosis import MeshDiagnosis, diagnose
from .errors import PatchError, SurfaceError
from .faces import face_vectors, triangles
from .heat import STEFAN_BOLTZMANN, band_shares, thermal
from .lightmaps.atlases import (
    LIGHTMAP_MESHES,
    TexturedMesh,
    atlas,
    gltf_mesh,
    mesh_normals,
    save_textured_mesh,
    scene_mesh,
)
from .lightmaps.colours import shown_exposure, vertex_colours
from .lightmaps.textures import Lightmap, check_coordinates, lightmap_from, lightmap_of, save_lightmap
from .maps.cells import HistogramBuilder, PatchMap
from .maps.files import check_place, read_map, save_map, solution_map
from .maps.kernels import KernelBuilder, variable_bandwidths
from .maps.nearest import PARTICLE_BYTES, NearestMap
from .maps.places import MapSurfaces
from .maps.protocol import Irradiance, SurfaceMap, SurfaceParticles, irradiance_at
from .maps.widths import rule_bandwidths
from .objects import Objects, find_objects
from .patches import Patches
from .places import PatchSurfaces, Place, SurfaceValues
from .rays.raycasting import STEP, Hits, RayScene
from .rays.sides import Sides, across, around, cosine_law
from .rays.sources import BATCH, RaySource, columns, cosine_lanes, even_lanes, pairs_of
from .readers.meshfiles import read_patches
from .readers.sceneparts import has_instances, scene_parts
from .readers.scenepatches import scene_patches
from .readers.tessellation import shape_triangles
from .savedpatches import differences, saved_patches
from .smoothing import VertexRadiosity, face_sides, vertex_radiosity
from .spheres import bounding_sphere, joint_sphere

__all__ = [
    "AMBIENT_TERMS",
    "BATCH",
    "CLASS_NORMALS",
    "LIGHTMAP_MESHES",
    "PARTICLE_BYTES",
    "REACH_OF_PAIRS",
    "STEFAN_BOLTZMANN",
    "STEP",
    "AmbientTerm",
    "Coincident",
    "HistogramBuilder",
    "Hits",
    "Irradiance",
    "KernelBuilder",
    "Lightmap",
    "MapSurfaces",
    "MeshDiagnosis",
    "NearestMap",
    "Objects",
    "PatchError",
    "PatchMap",
    "PatchSurfaces",
    "Patches",
    "Place",
    "RayScene",
    "RaySource",
    "Sides",
    "SurfaceError",
    "SurfaceMap",
    "SurfaceParticles",
    "SurfaceValues",
    "TexturedMesh",
    "VertexRadiosity",
    "across",
    "around",
    "atlas",
    "band_shares",
    "bounding_sphere",
    "box",
    "box_tree",
    "check_coordinates",
    "check_place",
    "class_factors",
    "class_light",
    "class_weights",
    "columns",
    "cosine_lanes",
    "cosine_law",
    "diagnose",
    "differences",
    "even_lanes",
    "face_sides",
    "face_vectors",
    "find_objects",
    "gltf_mesh",
    "has_instances",
    "incoming",
    "irradiance_at",
    "is_interior",
    "joined",
    "joint_sphere",
    "lightmap_from",
    "lightmap_of",
    "mesh_normals",
    "pairs_of",
    "read_map",
    "read_patches",
    "rule_bandwidths",
    "save_lightmap",
    "save_map",
    "save_textured_mesh",
    "saved_patches",
    "scene_mesh",
    "scene_parts",
    "scene_patches",
    "shape_triangles",
    "shown_exposure",
    "solution_map",
    "surfaces_of",
    "thermal",
    "triangles",
    "variable_bandwidths",
    "vertex_colours",
    "vertex_radiosity",
]
