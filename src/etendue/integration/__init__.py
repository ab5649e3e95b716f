"""Integrals over boxes: functions and their algebra, and integrators that know nothing of what they integrate."""

from .backend import Backend, DeviceBackend, HostBackend, library
from .densities import AxisBins, CellGrid, Density, PlaneBins, ProductDensity, Warp
from .errors import IntegrationError
from .estimate import Estimate, Integrator, combine
from .functions import Box, Domain, Integrand, constant, coordinate
from .plain import ControlVariate, HitOrMiss, Importance, MeanSample
from .recursive import RecursiveStratified
from .vegas import Vegas
