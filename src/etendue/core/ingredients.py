"""What a worker makes a problem from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass
class Ingredients:
    """Plain values, arrays and files from which a worker makes a problem. ``open`` is the name ``module:name`` of a
    function of (ingredients, folder) that returns the problem; the files are at their places in the folder."""

    open: str
    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)


def numbers_for_json(value: Any) -> Any:
    """A value that JSON does not know as numbers, lists or text; for the argument ``default`` of ``json.dumps``."""
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else str(value)
