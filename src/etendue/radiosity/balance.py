"""Whether the power that enters a scene leaves it again."""

from __future__ import annotations

import numpy as np

from etendue.core import Array, logger

from .solvers.system import Solution

#: An imbalance of power is a fault if it is above this share of the power, and above this multiple of its error. Backs
#: of lamps and other faces that are seen from behind absorb a few percent in many scenes that are in order.
_MOST, _ERRORS = 0.05, 5.0


def check_balance(solution: Solution, irradiance_error: Array | None) -> bool:
    """:func:`is_balanced` of a solution, with the error of the absorbed power that is due to that of the irradiance (n,
    c)."""
    if irradiance_error is None:
        return is_balanced(solution.imbalance, None)
    areas, absorptance = solution.patches.areas[:, None], 1 - solution.patches.reflectance
    enters = float((solution.power["emitted"] + solution.power["from_sky"]).sum())
    error = float(np.sqrt(((areas * absorptance * irradiance_error) ** 2).sum())) / enters
    return is_balanced(solution.imbalance, error)


def is_balanced(imbalance: float, error: float | None) -> bool:
    """Whether an imbalance of power, such as :attr:`Solution.imbalance`, may be due to errors of form factors; else it
    is a fault, and a warning is given. ``error``: the standard error, ``None`` if it is not known."""
    if not imbalance > max(_MOST, _ERRORS * (error or 0.0)):
        return True
    than = "" if error is None else f", far more than their standard error of {100 * error:.2g} %"
    logger.warning(
        "the power that enters the scene and the power that is absorbed or leaves it differ by %.2g %%%s: backs of "
        "faces absorb light, as faces are turned the wrong way or lie on each other; see etendue.radiosity.diagnose",
        *(100 * imbalance, than),
    )
    return False
