"""Density estimation: kernels, estimators, their errors, and neighbour search on device arrays. Independent of surfaces
and lights: the input is positions, weights and areas."""

from .bandwidth import cross_validation, normal_reference, silverman
from .boundary import Boundary
from .cells import FACINGS, Cells
from .diagnosis import Diagnosis, best_bandwidth, by_bootstrap, by_expansion, by_quadrature, by_repetition
from .errors import DensityError
from .estimator import Estimator
from .fixed import FixedKernel, Naive
from .histogram import BinnedKernel, Histogram
from .kernels import KERNELS, Kernel, kernel_of
from .nearest import NearestNeighbours
from .quadtrees import Quadtrees, QuadtreeSampler
from .samples import Samples, Surface
from .search.hashgrid import HashGrid, Query
from .search.kdtree import KdTree
from .search.leftbalanced import left_balanced, nearest
from .variable import AdaptiveKernel, SampleBandwidths, VariableKernel, relative_widths

__all__ = [
    "FACINGS",
    "KERNELS",
    "AdaptiveKernel",
    "BinnedKernel",
    "Boundary",
    "Cells",
    "DensityError",
    "Diagnosis",
    "Estimator",
    "FixedKernel",
    "HashGrid",
    "Histogram",
    "KdTree",
    "Kernel",
    "Naive",
    "NearestNeighbours",
    "QuadtreeSampler",
    "Quadtrees",
    "Query",
    "SampleBandwidths",
    "Samples",
    "Surface",
    "VariableKernel",
    "best_bandwidth",
    "by_bootstrap",
    "by_expansion",
    "by_quadrature",
    "by_repetition",
    "cross_validation",
    "kernel_of",
    "left_balanced",
    "nearest",
    "normal_reference",
    "relative_widths",
    "silverman",
]
