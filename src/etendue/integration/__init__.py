"""Integrals over boxes: functions and their algebra, and general integrators."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .backend import (
        Backend as Backend,
        DeviceBackend as DeviceBackend,
        HostBackend as HostBackend,
        array_namespace as array_namespace,
    )
    from .chains import (
        ChainDiagnosis as ChainDiagnosis,
        autocorrelation as autocorrelation,
        autocorrelation_time as autocorrelation_time,
        diagnose as diagnose,
        split_r_hat as split_r_hat,
    )
    from .densities import (
        AxisBins as AxisBins,
        CellGrid as CellGrid,
        Density as Density,
        Factor as Factor,
        PlaneBins as PlaneBins,
        ProductDensity as ProductDensity,
        Tabulated as Tabulated,
        Warp as Warp,
        bin_values as bin_values,
        warp_rows as warp_rows,
    )
    from .densities.binning import damp as damp, rebin as rebin, smooth as smooth
    from .errors import IntegrationError as IntegrationError
    from .estimate import Estimate as Estimate, Integrator as Integrator, average as average, combine as combine
    from .functions import (
        Box as Box,
        Domain as Domain,
        Integrand as Integrand,
        constant as constant,
        coordinate as coordinate,
    )
    from .metropolis import (
        Chains as Chains,
        Independent as Independent,
        Metropolis as Metropolis,
        Mixture as Mixture,
        Proposal as Proposal,
        ScaledStep as ScaledStep,
        UniformStep as UniformStep,
    )
    from .nested import integral as integral
    from .plain import (
        ControlVariate as ControlVariate,
        HitOrMiss as HitOrMiss,
        Importance as Importance,
        MeanSample as MeanSample,
    )
    from .primary import Layout as Layout, Move as Move, PrimarySource as PrimarySource, Slot as Slot
    from .recursive import RecursiveStratified as RecursiveStratified
    from .regions import Regions as Regions
    from .rejection import Accepted as Accepted, Rejection as Rejection
    from .stratified import PointSequence as PointSequence, QuasiMonteCarlo as QuasiMonteCarlo, Stratified as Stratified
    from .vegas import Vegas as Vegas
else:
    __getattr__, __dir__ = on_use(__name__)
