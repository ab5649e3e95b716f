"""Integrals over boxes: functions and their algebra, and general integrators."""

from .backend import Backend, DeviceBackend, HostBackend, array_namespace
from .chains import ChainDiagnosis, autocorrelation, autocorrelation_time, diagnose, split_r_hat
from .densities import (
    AxisBins,
    CellGrid,
    Density,
    Factor,
    PlaneBins,
    ProductDensity,
    Tabulated,
    Warp,
    bin_values,
    warp_rows,
)
from .densities.binning import damp, rebin, smooth
from .errors import IntegrationError
from .estimate import Estimate, Integrator, average, combine
from .functions import Box, Domain, Integrand, constant, coordinate
from .metropolis import Chains, Independent, Metropolis, Mixture, Proposal, ScaledStep, UniformStep
from .nested import integral
from .plain import ControlVariate, HitOrMiss, Importance, MeanSample
from .primary import Layout, Move, PrimarySource, Slot
from .recursive import RecursiveStratified
from .regions import Regions
from .rejection import Accepted, Rejection
from .stratified import PointSequence, QuasiMonteCarlo, Stratified
from .vegas import Vegas

__all__ = [
    "Accepted",
    "AxisBins",
    "Backend",
    "Box",
    "CellGrid",
    "ChainDiagnosis",
    "Chains",
    "ControlVariate",
    "Density",
    "DeviceBackend",
    "Domain",
    "Estimate",
    "Factor",
    "HitOrMiss",
    "HostBackend",
    "Importance",
    "Independent",
    "Integrand",
    "IntegrationError",
    "Integrator",
    "Layout",
    "MeanSample",
    "Metropolis",
    "Mixture",
    "Move",
    "PlaneBins",
    "PointSequence",
    "PrimarySource",
    "ProductDensity",
    "Proposal",
    "QuasiMonteCarlo",
    "RecursiveStratified",
    "Regions",
    "Rejection",
    "ScaledStep",
    "Slot",
    "Stratified",
    "Tabulated",
    "UniformStep",
    "Vegas",
    "Warp",
    "array_namespace",
    "autocorrelation",
    "autocorrelation_time",
    "average",
    "bin_values",
    "combine",
    "constant",
    "coordinate",
    "damp",
    "diagnose",
    "integral",
    "rebin",
    "smooth",
    "split_r_hat",
    "warp_rows",
]
