"""The radiosity system B = E + rho F B, solved on form factors or on segments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from etendue.core import Array, InNotebooks, free_memory, short_repr
from etendue.lighting import photometric
from etendue.surfaces import AmbientTerm, Patches

from ..ambient.spreading import spread
from ..compiling import compiled
from ..errors import RadiosityError
from ..factors.formfactors import FormFactors
from ..lines.segments import Segments
from .absorption import Ends, absorbed
from .shot import FirstShot

if TYPE_CHECKING:
    import scipy.sparse

Solver = Literal["jacobi", "gauss-seidel", "southwell", "conjugate-gradient", "direct"]
SOLVERS: tuple[Solver, ...] = ("jacobi", "gauss-seidel", "southwell", "conjugate-gradient", "direct")


class Transport(Ends, Protocol):
    """The transport operator: :class:`FormFactors` or :class:`Segments`."""

    @property
    def exchange_weights(self) -> Array | None:
        """(n,) ``w`` with w_i F_ij = w_j F_ji, or ``None`` if there are none."""
        ...


@short_repr
@dataclass(frozen=True)
class Solution(InNotebooks):
    """Radiosities of patches.

    ``radiosity``: (n, c) light that leaves, per area. ``irradiance``: (n, c) light that arrives, per area.
    ``sky_share``: (n,). ``residuals``: after each iteration, the largest absolute residual of the system in units of
    the largest emission or light from the sky. With a ``shot`` it is that of the system for the remaining light.
    """

    patches: Patches
    radiosity: Array
    irradiance: Array
    sky_share: Array
    residuals: tuple[float, ...]
    shot: FirstShot | None = None

    @property
    def residual(self) -> float:
        """The last residual; NaN for an ambient solution, which solves no system."""
        return self.residuals[-1] if self.residuals else float("nan")

    @property
    def illuminance(self) -> Array:
        """(n,) in lx, see :func:`etendue.lighting.photometric`."""
        return photometric(self.irradiance)

    @property
    def luminous_exitance(self) -> Array:
        """(n,) in lm/m^2; divided by pi it is the luminance of the patches in cd/m^2."""
        return photometric(self.radiosity)

    @cached_property
    def power(self) -> dict[str, Array]:
        """(c,) each: ``emitted`` by patches and lamps of a shot, ``from_sky``, ``absorbed``, ``to_sky``."""
        areas = self.patches.areas[:, None]
        to_sky = (areas * self.sky_share[:, None] * self._by_lines).sum(axis=0)
        emitted = (areas * self.patches.emission).sum(axis=0)
        if self.shot is not None:
            emitted = emitted - (areas * self.shot.emission).sum(axis=0) + self.shot.sent
        return {
            "emitted": emitted,
            "from_sky": (areas * self.sky_share[:, None] * self.patches.sky).sum(axis=0),
            "absorbed": (areas * (1 - self.patches.reflectance) * self.irradiance).sum(axis=0),
            "to_sky": to_sky if self.shot is None else to_sky + self.shot.to_sky,
        }

    def irradiance_error(self, segments: Segments) -> Array:
        """(n, c) standard error of the irradiance from lines and shot, for the last bounce only, which is nearly all of
        it. ``segments``: the segments used for the solution. Raises :class:`RadiosityError` for one batch."""
        error = segments.gather_error(self._by_lines, self.patches.sky)
        return error if self.shot is None else np.hypot(error, self.shot.error)

    @property
    def _by_lines(self) -> Array:
        """Radiosity that lines transport."""
        return self.radiosity if self.shot is None else self.radiosity - self.shot.emission

    @property
    def net_power(self) -> Array:
        """(n, c) power that each patch sends minus what arrives: the heat that keeps it at its temperature."""
        return self.patches.areas[:, None] * (self.radiosity - self.irradiance)

    @property
    def imbalance(self) -> float:
        """Difference of input and output power, relative to the input: zero if form factors are reciprocal and their
        rows sum to 1, else about as large as their errors."""
        come = self.power["emitted"] + self.power["from_sky"]
        gone = self.power["absorbed"] + self.power["to_sky"]
        return float(np.abs(come - gone).sum() / come.sum())


def solve(
    patches: Patches,
    transport: Transport,
    solver: Solver = "jacobi",
    *,
    shot: FirstShot | None = None,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    ambient: AmbientTerm | None = None,
) -> Solution:
    """Radiosities of patches, by form factors or segments.

    ====================== ============================================================================================
    ``jacobi``             one bounce of all light per iteration; also on segments
    ``gauss-seidel``       the same, using updated values at once; on form factors
    ``southwell``          progressive shooting: the patch of most unshot power first [Cohen 1988]; on form factors. An
                           iteration is as many shots as there are patches
    ``conjugate-gradient`` few iterations at high reflectance; on segments, and on form factors that are reciprocal
    ``direct``             elimination, a channel at a time; on form factors of some thousand patches
    ====================== ============================================================================================

    shot: from :func:`first_shot`: light of emitters sent by rays. The system is then solved for the reflected part:
        B = E + R, R = rho (D + F R), with the irradiance D of the shot in place of F E.
    tolerance: of the residual, see :class:`Solution`.
    ambient: spread the light that is left after ``max_iterations`` by this ambient term, instead of raising an error.
        The solution then also depends on the term, and ``max_iterations`` of 2 or 3 may suffice.

    Patches of reflectance 1 (adiabatic walls) absorb nothing; their light must be able to reach a patch that does, the
    sky or the back of a face.

    Raises :class:`RadiosityError` if nothing emits, if light can never be absorbed, if a solver does not support the
    transport, if a shot belongs to other patches, or if the solver has not converged after ``max_iterations`` and there
    is no ``ambient`` term.
    """
    if len(transport.outside) != len(patches):
        raise RadiosityError(f"there are {len(patches)} patches, but the transport is that of {len(transport.outside)}")
    if not (patches.emission.any() or patches.sky.any() or (shot is not None and shot.irradiance.any())):
        raise RadiosityError("no patch emits light, nor does the sky: give one of them an emission above zero")
    if solver not in SOLVERS:
        raise RadiosityError(f"there is no solver {solver!r}; there are: {', '.join(SOLVERS)}")
    if max_iterations < 1:
        raise RadiosityError(f"a solution needs at least one iteration, not {max_iterations}: set max_iterations")
    if solver in ("gauss-seidel", "southwell", "direct") and not isinstance(transport, FormFactors):
        raise RadiosityError(f"{solver} needs form factors; on segments there are jacobi and conjugate-gradient")
    rest = absorbed(patches if shot is None else after_shot(shot, patches), transport)
    steps = _STEPS[solver](rest, transport)
    scale = max(rest.emission.max(), rest.sky.max()) or 1.0  # a shot at black patches leaves nothing
    residuals = []
    for _ in range(max_iterations):
        radiosity, irradiance = steps.step()
        left = rest.emission + rest.reflectance * irradiance - radiosity
        residuals.append(float(np.abs(left).max() / scale))
        is_last = ambient is not None and len(residuals) == max_iterations
        if residuals[-1] <= tolerance or is_last:
            if ambient is not None:
                spread_out = spread(patches, patches.areas[:, None] * left, ambient, transport.outside)
                radiosity, irradiance = radiosity + left + rest.reflectance * spread_out, irradiance + spread_out
            if shot is not None:
                radiosity, irradiance = radiosity + shot.emission, irradiance + shot.irradiance
            return Solution(patches, radiosity, irradiance, transport.outside, tuple(residuals), shot)
    raise RadiosityError(
        f"{solver} has a residual of {residuals[-1]:.2g} after {max_iterations} iterations, not {tolerance:g}: allow "
        "more, or take conjugate-gradient where reflectance is high"
    )


def check_direct(patches: int) -> None:
    """Raise :class:`RadiosityError` if the direct solution for this number of patches does not fit into memory."""
    free = free_memory()
    if free is not None and 24 * patches**2 > free:
        raise RadiosityError(
            f"direct solution of {patches} patches needs {24e-9 * patches**2:.1f} GB, "
            f"{free / 1e9:.1f} GB are free: take another solver"
        )


def after_shot(shot: FirstShot, patches: Patches) -> Patches:
    """Patches that emit their remaining light and the reflected light of the shot. Raises :class:`RadiosityError` for a
    shot of other patches."""
    if shot.emission.shape != patches.emission.shape or not np.array_equal(shot.patches.areas, patches.areas):
        raise RadiosityError("the first shot is that of other patches: shoot from the patches of the solution")
    left = patches.emission - shot.emission
    if (left < 0).any():
        raise RadiosityError("the first shot sent more light than the patches emit: repeat it for this emission")
    return patches.with_properties(emission=left + patches.reflectance * shot.irradiance)


class _Steps(ABC):
    """A solver between two iterations."""

    def __init__(self, patches: Patches, transport: Transport) -> None:
        self.patches, self.transport = patches, transport
        self.emission, self.reflectance = patches.emission, patches.reflectance
        self.radiosity = self.emission.copy()
        self.irradiance = transport.gather(self.radiosity, patches.sky)

    @abstractmethod
    def step(self) -> tuple[Array, Array]:
        """Radiosity and irradiance after another iteration."""

    @property
    def matrix(self) -> scipy.sparse.csr_array:
        """F as CSR; :func:`solve` has checked that the transport is a matrix."""
        assert isinstance(self.transport, FormFactors)
        return self.transport.matrix

    @property
    def known(self) -> Array:
        """Emission, and reflected light of the sky."""
        return self.emission + self.reflectance * self.transport.outside[:, None] * self.patches.sky


class _Gathering(_Steps):
    """A solver that changes the radiosity; the irradiance is gathered afterwards."""

    def step(self) -> tuple[Array, Array]:
        self.improve()
        self.irradiance = self.transport.gather(self.radiosity, self.patches.sky)
        return self.radiosity, self.irradiance

    @abstractmethod
    def improve(self) -> None:
        """Change the radiosity."""


class _Jacobi(_Gathering):
    def improve(self) -> None:
        self.radiosity = self.emission + self.reflectance * self.irradiance


class _GaussSeidel(_Gathering):
    def improve(self) -> None:
        f = self.matrix
        compiled().gauss_seidel(f.indptr, f.indices, f.data, self.reflectance, self.known, self.radiosity)


class _Southwell(_Gathering):
    def __init__(self, patches: Patches, transport: Transport) -> None:
        super().__init__(patches, transport)
        self.columns = self.matrix.tocsc()
        self.radiosity = self.known
        self.unshot = self.radiosity.copy()

    def improve(self) -> None:
        f, areas = self.columns, self.patches.areas
        compiled().shoot(
            *(f.indptr, f.indices, f.data, areas, self.reflectance, self.unshot, self.radiosity), len(areas)
        )


class _ConjugateGradient(_Steps):
    """With B = E + sqrt(rho) y and symmetric W F: (W - sqrt(rho) W F sqrt(rho)) y = sqrt(rho) W H(E), where H(E) is the
    irradiance from emission and sky; preconditioned by W. All channels are solved together."""

    def __init__(self, patches: Patches, transport: Transport) -> None:
        super().__init__(patches, transport)
        weights = transport.exchange_weights
        if weights is None:
            raise RadiosityError(
                "conjugate-gradient needs reciprocal form factors (estimator 'F3', 'F4', 'reciprocal' or 'pooled', or "
                "repaired()), or segments"
            )
        self.weights, self.root = weights[:, None], np.sqrt(self.reflectance)
        self.residual = self.root * self.irradiance  # divided by W, the preconditioner
        self.direction = self.residual.copy()
        self.square = self._dot(self.residual, self.residual)

    def step(self) -> tuple[Array, Array]:
        gathered = self.transport.gather(self.root * self.direction, np.zeros(1))
        product = self.direction - self.root * gathered
        curvature = self._dot(self.direction, product)
        length = np.divide(self.square, curvature, out=np.zeros_like(self.square), where=curvature > 0)
        self.radiosity = self.radiosity + length * self.root * self.direction
        self.irradiance = self.irradiance + length * gathered
        self.residual = self.residual - length * product
        before, self.square = self.square, self._dot(self.residual, self.residual)
        ratio = np.divide(self.square, before, out=np.zeros_like(before), where=before > 0)
        self.direction = self.residual + ratio * self.direction
        return self.radiosity, self.irradiance

    def _dot(self, a: Array, b: Array) -> Array:
        return (self.weights * a * b).sum(axis=0)


class _Direct(_Gathering):
    def improve(self) -> None:
        n = len(self.patches)
        check_direct(n)
        dense, known = np.asarray(self.matrix.todense()), self.known
        for c in range(known.shape[1]):
            system = np.eye(n) - self.reflectance[:, c : c + 1] * dense
            self.radiosity[:, c] = np.linalg.solve(system, known[:, c])


_STEPS: dict[Solver, Callable[[Patches, Transport], _Steps]] = {
    "jacobi": _Jacobi,
    "gauss-seidel": _GaussSeidel,
    "southwell": _Southwell,
    "conjugate-gradient": _ConjugateGradient,
    "direct": _Direct,
}
