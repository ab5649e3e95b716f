"""Radiosity: patches, lines through them, form factors. What sees a picture is unknown here."""

from .abuffer import ABuffer, Backend
from .chained import ChainedRays
from .diagnosis import Diagnosis, diagnose
from .engine import LineEngine
from .errors import PatchError, RadiosityError
from .formfactors import ESTIMATORS, Estimator, FormFactors, estimate, form_factors, pair_errors
from .heat import STEFAN_BOLTZMANN, band_shares, gebhart_factors, thermal
from .lines import GENERATORS, BoxWalls, Bundles, GreatCircle, LineGenerator, Lines, SpherePairs
from .local import LocalRays
from .localfactors import area_form_factors, local_form_factors
from .meshfiles import read_patches
from .multipath import FirstShot, Multipath, first_shot, multipath, multipath_bundles
from .particles import Particles, breadth_first, depth_first
from .patches import Patches
from .raycasting import RayScene
from .results import (
    FORM_FACTOR_FILES,
    SOLUTION_FILES,
    check_file,
    read_form_factors,
    save_form_factors,
    save_solution,
)
from .scenes import scene_patches
from .segments import Segments
from .smoothing import VertexRadiosity, vertex_radiosity
from .solids import box, joined
from .solvers import SOLVERS, Solution, Solver, Transport, solve

__all__ = [
    "ESTIMATORS",
    "FORM_FACTOR_FILES",
    "GENERATORS",
    "SOLUTION_FILES",
    "SOLVERS",
    "STEFAN_BOLTZMANN",
    "ABuffer",
    "Backend",
    "BoxWalls",
    "Bundles",
    "ChainedRays",
    "Diagnosis",
    "Estimator",
    "FirstShot",
    "FormFactors",
    "GreatCircle",
    "LineEngine",
    "LineGenerator",
    "Lines",
    "LocalRays",
    "Multipath",
    "Particles",
    "PatchError",
    "Patches",
    "RadiosityError",
    "RayScene",
    "Segments",
    "Solution",
    "Solver",
    "SpherePairs",
    "Transport",
    "VertexRadiosity",
    "area_form_factors",
    "band_shares",
    "box",
    "breadth_first",
    "check_file",
    "depth_first",
    "diagnose",
    "estimate",
    "first_shot",
    "form_factors",
    "gebhart_factors",
    "joined",
    "local_form_factors",
    "multipath",
    "multipath_bundles",
    "pair_errors",
    "read_form_factors",
    "read_patches",
    "save_form_factors",
    "save_solution",
    "scene_patches",
    "solve",
    "thermal",
    "vertex_radiosity",
]
