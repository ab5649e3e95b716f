"""Density estimation: kernels, estimators, their errors, and neighbour search on device arrays. Independent of surfaces
and lights: the input is positions, weights and areas."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .bandwidth import (
        cross_validation as cross_validation,
        normal_reference as normal_reference,
        silverman as silverman,
    )
    from .boundary import Boundary as Boundary
    from .boxes import BoxDensity as BoxDensity, Boxes as Boxes, fit_boxes as fit_boxes
    from .cells import FACINGS as FACINGS, Cells as Cells
    from .diagnosis import (
        Diagnosis as Diagnosis,
        best_bandwidth as best_bandwidth,
        by_bootstrap as by_bootstrap,
        by_expansion as by_expansion,
        by_quadrature as by_quadrature,
        by_repetition as by_repetition,
    )
    from .errors import DensityError as DensityError
    from .estimator import Estimator as Estimator
    from .fixed import FixedKernel as FixedKernel, Naive as Naive
    from .histogram import BinnedKernel as BinnedKernel, Histogram as Histogram
    from .kernels import KERNELS as KERNELS, Kernel as Kernel, kernel_of as kernel_of
    from .lines import (
        LEAST_LINES as LEAST_LINES,
        LineCells as LineCells,
        LineDensity as LineDensity,
        fit_lines as fit_lines,
    )
    from .nearest import NearestNeighbours as NearestNeighbours
    from .quadtrees import Quadtrees as Quadtrees, QuadtreeSampler as QuadtreeSampler
    from .samples import Samples as Samples, Surface as Surface
    from .search.hashgrid import HashGrid as HashGrid, Query as Query
    from .search.kdtree import KdTree as KdTree
    from .variable import (
        AdaptiveKernel as AdaptiveKernel,
        SampleBandwidths as SampleBandwidths,
        VariableKernel as VariableKernel,
        relative_widths as relative_widths,
    )
else:
    __getattr__, __dir__ = on_use(__name__)
