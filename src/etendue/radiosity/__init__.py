"""Radiosity: lines through patches, form factors, solutions, and their files and lightmaps.

Names of :mod:`etendue.surfaces` (patches, meshes, maps) and :mod:`etendue.formats` (glTF) that radiosity uses are
exported here, too.
"""

from etendue.formats import FormatError as FormatError, GltfMesh as GltfMesh, write_gltf as write_gltf
from etendue.surfaces import (
    AMBIENT_TERMS as AMBIENT_TERMS,
    LIGHTMAP_MESHES as LIGHTMAP_MESHES,
    STEFAN_BOLTZMANN as STEFAN_BOLTZMANN,
    AmbientTerm as AmbientTerm,
    Lightmap as Lightmap,
    MeshDiagnosis as MeshDiagnosis,
    Objects as Objects,
    PatchError as PatchError,
    Patches as Patches,
    RayScene as RayScene,
    SurfaceError as SurfaceError,
    TexturedMesh as TexturedMesh,
    VertexRadiosity as VertexRadiosity,
    atlas as atlas,
    band_shares as band_shares,
    box as box,
    check_coordinates as check_coordinates,
    diagnose as diagnose,
    find_objects as find_objects,
    gltf_mesh as gltf_mesh,
    joined as joined,
    orientation as orientation,
    read_patches as read_patches,
    save_lightmap as save_lightmap,
    save_textured_mesh as save_textured_mesh,
    scene_mesh as scene_mesh,
    scene_patches as scene_patches,
    thermal as thermal,
    vertex_radiosity as vertex_radiosity,
)

from .ambient.solutions import ambient_solution as ambient_solution, finished as finished
from .ambient.spreading import spread as spread
from .ambient.subscenes import (
    HierarchicalAmbient as HierarchicalAmbient,
    SubScene as SubScene,
    hierarchical_ambient as hierarchical_ambient,
    sub_scenes as sub_scenes,
    sub_scenes_of as sub_scenes_of,
)
from .balance import check_balance as check_balance, is_balanced as is_balanced
from .casting import (
    REPLICATES as REPLICATES,
    SEGMENTS as SEGMENTS,
    CastingSettings as CastingSettings,
    LineCasting as LineCasting,
)
from .castlines import CastLines as CastLines
from .errors import RadiosityError as RadiosityError
from .factors.corrections import (
    Correction as Correction,
    check_threshold as check_threshold,
    corrected as corrected,
)
from .factors.exact import (
    EXACT_TOLERANCE as EXACT_TOLERANCE,
    exact_form_factors as exact_form_factors,
    exact_seconds as exact_seconds,
)
from .factors.formfactors import (
    ESTIMATORS as ESTIMATORS,
    Estimator as Estimator,
    FormFactors as FormFactors,
    entry_bytes as entry_bytes,
    estimate as estimate,
    form_factors as form_factors,
    pair_errors as pair_errors,
)
from .factors.gebhart import gebhart_factors as gebhart_factors
from .factors.groups import between_groups as between_groups, group_index as group_index, row_names as row_names
from .factors.localfactors import area_form_factors as area_form_factors, local_form_factors as local_form_factors
from .factors.rows import joined_rows as joined_rows, known_rows as known_rows
from .factors.skyparts import sky_parts as sky_parts
from .factors.zones import joined_zones as joined_zones
from .files.colours import coloured_mesh as coloured_mesh
from .files.conditions import read_conditions as read_conditions
from .files.factorfiles import (
    FACTOR_FORMATS as FACTOR_FORMATS,
    FactorFormat as FactorFormat,
    check_factors as check_factors,
    factor_format as factor_format,
    factors_of_patches as factors_of_patches,
    no_factors as no_factors,
    read_form_factors as read_form_factors,
    read_notes as read_notes,
    save_form_factors as save_form_factors,
)
from .files.netcdf import read_segments as read_segments, save_segments as save_segments
from .files.pointfiles import (
    check_point_file as check_point_file,
    read_light as read_light,
    save_point_factors as save_point_factors,
)
from .files.results import (
    SOLUTION_FILES as SOLUTION_FILES,
    check_file as check_file,
    save_solution as save_solution,
)
from .files.solutionfiles import read_solution as read_solution, solution_metadata as solution_metadata
from .files.sunfiles import check_sun_file as check_sun_file, save_sunlight as save_sunlight
from .gradients import Gradient as Gradient, gradient as gradient, gradient_error as gradient_error
from .heat import Conditions as Conditions, HeatBalance as HeatBalance, heat_balance as heat_balance
from .hierarchical_factors.allocation import (
    allocated as allocated,
    area_shares as area_shares,
    least_error_shares as least_error_shares,
)
from .hierarchical_factors.casting import (
    HierarchicalCasting as HierarchicalCasting,
    HierarchicalCastingSettings as HierarchicalCastingSettings,
)
from .hierarchical_factors.lines import TreeBundles as TreeBundles, TreeRays as TreeRays
from .hierarchical_factors.segments import (
    PartialSegments as PartialSegments,
    partial_form_factors as partial_form_factors,
)
from .hierarchical_factors.tree import SphereTree as SphereTree, sphere_tree as sphere_tree
from .hierarchical_multipath.divided.around import DividedMultipath as DividedMultipath
from .hierarchical_multipath.divided.units import check_divisible as check_divisible
from .hierarchical_multipath.grouping import GroupSettings as GroupSettings, grouped as grouped
from .hierarchical_multipath.method import (
    BoxSettings as BoxSettings,
    HierarchicalMultipath as HierarchicalMultipath,
    HierarchicalMultipathSettings as HierarchicalMultipathSettings,
    PartProblem as PartProblem,
)
from .hierarchical_multipath.parts import Part as Part, part_boxes as part_boxes
from .hierarchical_multipath.reading import (
    instanced_patches as instanced_patches,
    part_of as part_of,
    scene_part as scene_part,
)
from .hierarchical_multipath.solution import (
    HierarchicalSolution as HierarchicalSolution,
    relative_error as relative_error,
)
from .lightmaps import lightmap as lightmap
from .lines.abuffer import ABuffer as ABuffer, Backend as Backend
from .lines.bundling import Split as Split, split_for as split_for
from .lines.chained import ChainedRays as ChainedRays
from .lines.engine import LineEngine as LineEngine
from .lines.generators import (
    GENERATORS as GENERATORS,
    BoxWalls as BoxWalls,
    Bundles as Bundles,
    GreatCircle as GreatCircle,
    LineGenerator as LineGenerator,
    Lines as Lines,
    SpherePairs as SpherePairs,
)
from .lines.local import LocalRays as LocalRays
from .lines.mixing import MixedSegments as MixedSegments, with_local_rays as with_local_rays
from .lines.segments import Segments as Segments
from .lines.spiral import SpiralPoints as SpiralPoints
from .pointfactors import (
    PointFactors as PointFactors,
    point_factors as point_factors,
    point_factors_to_error as point_factors_to_error,
)
from .pointviews import PointViews as PointViews, point_views as point_views
from .problem import PatchProblem as PatchProblem
from .solvers.daylight import daylight_of_patches as daylight_of_patches
from .solvers.lamps import lamp_light as lamp_light
from .solvers.multipath import Multipath as Multipath, multipath as multipath, multipath_bundles as multipath_bundles
from .solvers.multipath_passes import MultipathPasses as MultipathPasses, MultipathSettings as MultipathSettings
from .solvers.particles import (
    ParticleSolution as ParticleSolution,
    breadth_first as breadth_first,
    depth_first as depth_first,
)
from .solvers.shot import (
    FirstShot as FirstShot,
    first_shot as first_shot,
    shot_at_patches as shot_at_patches,
    small_emitters as small_emitters,
)
from .solvers.system import (
    SOLVERS as SOLVERS,
    Solution as Solution,
    Solver as Solver,
    Transport as Transport,
    check_direct as check_direct,
    solve as solve,
)
from .solvers.values import (
    check_colours as check_colours,
    irradiance_on as irradiance_on,
    radiosity_on as radiosity_on,
)
from .sources import (
    GROUPINGS as GROUPINGS,
    PartSource as PartSource,
    PatchSource as PatchSource,
    part_ingredients as part_ingredients,
)
from .sunlight import Sunlight as Sunlight, sunlight as sunlight
