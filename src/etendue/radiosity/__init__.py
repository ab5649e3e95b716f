"""Radiosity: patches, lines through them, form factors, solutions, and what others can do with them."""

from .abuffer import ABuffer, Backend
from .atlases import LIGHTMAP_MESHES, TexturedMesh, atlas, gltf_mesh, save_textured_mesh, scene_mesh
from .casting import REPLICATES, CastingSettings, LineCasting, PatchProblem
from .chained import ChainedRays
from .diagnosis import Diagnosis, diagnose
from .engine import LineEngine
from .errors import PatchError, RadiosityError
from .exact import exact_form_factors
from .formfactors import ESTIMATORS, Estimator, FormFactors, estimate, form_factors, pair_errors
from .gltf import GltfMesh, coloured_mesh, write_gltf
from .heat import STEFAN_BOLTZMANN, band_shares, gebhart_factors, thermal
from .lightmaps import Lightmap, check_coordinates, lightmap, save_lightmap
from .lines import GENERATORS, BoxWalls, Bundles, GreatCircle, LineGenerator, Lines, SpherePairs
from .local import LocalRays
from .localfactors import area_form_factors, local_form_factors
from .meshfiles import read_patches
from .mixing import MixedSegments, with_local_rays
from .multipath import Multipath, multipath, multipath_bundles
from .netcdf import read_segments, save_segments
from .particles import Particles, breadth_first, depth_first
from .patches import Patches
from .pictures import PICTURE_FILES, picture
from .raycasting import RayScene
from .results import (
    FORM_FACTOR_FILES,
    SOLUTION_FILES,
    check_file,
    check_text_size,
    read_form_factors,
    save_form_factors,
    save_solution,
)
from .scenes import scene_patches
from .segments import Segments
from .shot import FirstShot, first_shot, shot_at_patches, small_emitters
from .smoothing import VertexRadiosity, vertex_radiosity
from .solids import box, joined
from .solutionfiles import read_solution
from .solvers import SOLVERS, Solution, Solver, Transport, check_direct, solve
from .spiral import SpiralPoints

__all__ = [
    "ESTIMATORS",
    "FORM_FACTOR_FILES",
    "GENERATORS",
    "LIGHTMAP_MESHES",
    "PICTURE_FILES",
    "REPLICATES",
    "SOLUTION_FILES",
    "SOLVERS",
    "STEFAN_BOLTZMANN",
    "ABuffer",
    "Backend",
    "BoxWalls",
    "Bundles",
    "CastingSettings",
    "ChainedRays",
    "Diagnosis",
    "Estimator",
    "FirstShot",
    "FormFactors",
    "GltfMesh",
    "GreatCircle",
    "Lightmap",
    "LineCasting",
    "LineEngine",
    "LineGenerator",
    "Lines",
    "LocalRays",
    "MixedSegments",
    "Multipath",
    "Particles",
    "PatchError",
    "PatchProblem",
    "Patches",
    "RadiosityError",
    "RayScene",
    "Segments",
    "Solution",
    "Solver",
    "SpherePairs",
    "SpiralPoints",
    "TexturedMesh",
    "Transport",
    "VertexRadiosity",
    "area_form_factors",
    "atlas",
    "band_shares",
    "box",
    "breadth_first",
    "check_coordinates",
    "check_direct",
    "check_file",
    "check_text_size",
    "coloured_mesh",
    "depth_first",
    "diagnose",
    "estimate",
    "exact_form_factors",
    "first_shot",
    "form_factors",
    "gebhart_factors",
    "gltf_mesh",
    "joined",
    "lightmap",
    "local_form_factors",
    "multipath",
    "multipath_bundles",
    "pair_errors",
    "picture",
    "read_form_factors",
    "read_patches",
    "read_segments",
    "read_solution",
    "save_form_factors",
    "save_lightmap",
    "save_segments",
    "save_solution",
    "save_textured_mesh",
    "scene_mesh",
    "scene_patches",
    "shot_at_patches",
    "small_emitters",
    "solve",
    "thermal",
    "vertex_radiosity",
    "with_local_rays",
    "write_gltf",
]
