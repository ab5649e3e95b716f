"""Low-discrepancy point sets and sequences, and measures of them, independent of rendering."""

from .discrepancy import (
    l2_discrepancy as l2_discrepancy,
    star_discrepancy as star_discrepancy,
    star_discrepancy_bounds as star_discrepancy_bounds,
)
from .independent import Independent as Independent, LatinHypercube as LatinHypercube
from .kronecker import ExactPiPowers as ExactPiPowers, PiPowers as PiPowers, Weyl as Weyl
from .mixed_radix import MixedRadix as MixedRadix
from .owen import OwenSobolSource as OwenSobolSource, sobol_2d as sobol_2d
from .pointset import PointSet as PointSet, PointSetError as PointSetError, RandomShift as RandomShift
from .radical import (
    FaureBlockHalton as FaureBlockHalton,
    FaureHalton as FaureHalton,
    Halton as Halton,
    Hammersley as Hammersley,
    faure_permutation as faure_permutation,
    radical_inverse as radical_inverse,
)
from .sobol import OwenSobol as OwenSobol, Sobol as Sobol, direction_numbers as direction_numbers
from .source import Coordinates as Coordinates, RadicalSource as RadicalSource
from .table import has_size as has_size, point_set as point_set, point_sets as point_sets
from .uniformity import consecutive as consecutive, net_parameter as net_parameter, uniformity_score as uniformity_score
