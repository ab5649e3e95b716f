"""Low-discrepancy point sets and sequences, and measures of them, independent of rendering."""

from .discrepancy import l2_discrepancy, star_discrepancy, star_discrepancy_bounds
from .independent import Independent, LatinHypercube
from .kronecker import ExactPiPowers, PiPowers, Weyl
from .mixed_radix import MixedRadix
from .owen import OwenSobolSource, sobol_2d
from .pointset import PointSet, PointSetError, RandomShift
from .radical import FaureBlockHalton, FaureHalton, Halton, Hammersley, faure_permutation, radical_inverse
from .sobol import OwenSobol, Sobol, direction_numbers
from .source import Coordinates, RadicalSource
from .table import has_size, point_set, point_sets
from .uniformity import consecutive, net_parameter, uniformity_score

__all__ = [
    "Coordinates",
    "ExactPiPowers",
    "FaureBlockHalton",
    "FaureHalton",
    "Halton",
    "Hammersley",
    "Independent",
    "LatinHypercube",
    "MixedRadix",
    "OwenSobol",
    "OwenSobolSource",
    "PiPowers",
    "PointSet",
    "PointSetError",
    "RadicalSource",
    "RandomShift",
    "Sobol",
    "Weyl",
    "consecutive",
    "direction_numbers",
    "faure_permutation",
    "has_size",
    "l2_discrepancy",
    "net_parameter",
    "point_set",
    "point_sets",
    "radical_inverse",
    "sobol_2d",
    "star_discrepancy",
    "star_discrepancy_bounds",
    "uniformity_score",
]
