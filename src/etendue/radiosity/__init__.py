"""Radiosity: lines through patches, form factors, solutions, and their files and lightmaps.

Names of :mod:`etendue.surfaces` (patches, meshes, maps) and :mod:`etendue.formats` (glTF) that radiosity uses are
exported here, too.
"""

from etendue.formats import FormatError, GltfMesh, write_gltf
from etendue.surfaces import (
    AMBIENT_TERMS,
    LIGHTMAP_MESHES,
    STEFAN_BOLTZMANN,
    AmbientTerm,
    Lightmap,
    MeshDiagnosis,
    Objects,
    PatchError,
    Patches,
    RayScene,
    SurfaceError,
    TexturedMesh,
    VertexRadiosity,
    atlas,
    band_shares,
    box,
    check_coordinates,
    diagnose,
    find_objects,
    gltf_mesh,
    joined,
    read_patches,
    save_lightmap,
    save_textured_mesh,
    scene_mesh,
    scene_patches,
    thermal,
    vertex_radiosity,
)

from .ambient.solutions import ambient_solution, finished
from .ambient.spreading import spread
from .ambient.subscenes import HierarchicalAmbient, SubScene, hierarchical_ambient, sub_scenes, sub_scenes_of
from .balance import check_balance, is_balanced
from .casting import REPLICATES, CastingSettings, LineCasting
from .castlines import CastLines
from .errors import RadiosityError
from .factors.exact import exact_form_factors
from .factors.formfactors import ESTIMATORS, Estimator, FormFactors, entry_bytes, estimate, form_factors, pair_errors
from .factors.gebhart import gebhart_factors
from .factors.localfactors import area_form_factors, local_form_factors
from .files.colours import coloured_mesh
from .files.netcdf import read_segments, save_segments
from .files.results import (
    FORM_FACTOR_FILES,
    SOLUTION_FILES,
    check_file,
    check_text_size,
    read_form_factors,
    save_form_factors,
    save_solution,
)
from .files.solutionfiles import read_solution, solution_metadata
from .hierarchical_factors.allocation import MAIN_SHARE, allocated, area_shares, least_error_shares
from .hierarchical_factors.casting import HierarchicalCasting, HierarchicalCastingSettings
from .hierarchical_factors.lines import TreeBundles, TreeRays
from .hierarchical_factors.segments import PartialSegments, partial_form_factors
from .hierarchical_factors.tree import SphereTree, sphere_tree
from .hierarchical_multipath.divided.around import DividedMultipath
from .hierarchical_multipath.divided.units import check_divisible
from .hierarchical_multipath.grouping import GroupSettings, grouped
from .hierarchical_multipath.method import HierarchicalMultipath, HierarchicalMultipathSettings, PartProblem
from .hierarchical_multipath.parts import Part, part_boxes
from .hierarchical_multipath.reading import instanced_patches, part_of, scene_part
from .hierarchical_multipath.solution import HierarchicalSolution, relative_error
from .lightmaps import lightmap
from .lines.abuffer import ABuffer, Backend
from .lines.chained import ChainedRays
from .lines.engine import LineEngine
from .lines.generators import (
    GENERATORS,
    SINGLE_LINES,
    BoxWalls,
    Bundles,
    GreatCircle,
    LineGenerator,
    Lines,
    SpherePairs,
)
from .lines.local import LocalRays
from .lines.mixing import MixedSegments, with_local_rays
from .lines.segments import Segments
from .lines.sequences import LINE_POINTS
from .lines.spiral import SpiralPoints
from .problem import PatchProblem
from .solvers.absorption import check_absorption
from .solvers.multipath import Multipath, multipath, multipath_bundles
from .solvers.multipath_passes import MultipathPasses, MultipathSettings
from .solvers.particles import Particles, breadth_first, depth_first
from .solvers.shot import FirstShot, first_shot, shot_at_patches, small_emitters
from .solvers.system import SOLVERS, Solution, Solver, Transport, check_direct, solve
from .solvers.values import check_colours, radiosity_on

__all__ = [
    "AMBIENT_TERMS",
    "ESTIMATORS",
    "FORM_FACTOR_FILES",
    "GENERATORS",
    "LIGHTMAP_MESHES",
    "LINE_POINTS",
    "MAIN_SHARE",
    "REPLICATES",
    "SINGLE_LINES",
    "SOLUTION_FILES",
    "SOLVERS",
    "STEFAN_BOLTZMANN",
    "ABuffer",
    "AmbientTerm",
    "Backend",
    "BoxWalls",
    "Bundles",
    "CastLines",
    "CastingSettings",
    "ChainedRays",
    "DividedMultipath",
    "Estimator",
    "FirstShot",
    "FormFactors",
    "FormatError",
    "GltfMesh",
    "GreatCircle",
    "GroupSettings",
    "HierarchicalAmbient",
    "HierarchicalCasting",
    "HierarchicalCastingSettings",
    "HierarchicalMultipath",
    "HierarchicalMultipathSettings",
    "HierarchicalSolution",
    "Lightmap",
    "LineCasting",
    "LineEngine",
    "LineGenerator",
    "Lines",
    "LocalRays",
    "MeshDiagnosis",
    "MixedSegments",
    "Multipath",
    "MultipathPasses",
    "MultipathSettings",
    "Objects",
    "Part",
    "PartProblem",
    "PartialSegments",
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
    "SphereTree",
    "SpiralPoints",
    "SubScene",
    "SurfaceError",
    "TexturedMesh",
    "Transport",
    "TreeBundles",
    "TreeRays",
    "VertexRadiosity",
    "allocated",
    "ambient_solution",
    "area_form_factors",
    "area_shares",
    "atlas",
    "band_shares",
    "box",
    "breadth_first",
    "check_absorption",
    "check_balance",
    "check_colours",
    "check_coordinates",
    "check_direct",
    "check_divisible",
    "check_file",
    "check_text_size",
    "coloured_mesh",
    "depth_first",
    "diagnose",
    "entry_bytes",
    "estimate",
    "exact_form_factors",
    "find_objects",
    "finished",
    "first_shot",
    "form_factors",
    "gebhart_factors",
    "gltf_mesh",
    "grouped",
    "hierarchical_ambient",
    "instanced_patches",
    "is_balanced",
    "joined",
    "least_error_shares",
    "lightmap",
    "local_form_factors",
    "multipath",
    "multipath_bundles",
    "pair_errors",
    "part_boxes",
    "part_of",
    "partial_form_factors",
    "radiosity_on",
    "read_form_factors",
    "read_patches",
    "read_segments",
    "read_solution",
    "relative_error",
    "save_form_factors",
    "save_lightmap",
    "save_segments",
    "save_solution",
    "save_textured_mesh",
    "scene_mesh",
    "scene_part",
    "scene_patches",
    "shot_at_patches",
    "small_emitters",
    "solution_metadata",
    "solve",
    "sphere_tree",
    "spread",
    "sub_scenes",
    "sub_scenes_of",
    "thermal",
    "vertex_radiosity",
    "with_local_rays",
    "write_gltf",
]
