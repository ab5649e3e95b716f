"""Checks of values from users. Python counts ``True`` as a number; no option accepts it as one."""

from __future__ import annotations

import math
import numbers
from typing import Any


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite real number of Python or NumPy, and not a truth value."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)


def is_whole(value: Any) -> bool:
    """Whether ``value`` has an integer type of Python or NumPy, and is not a truth value."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)
