"""NumPy arrays in one file, with metadata."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from etendue.film import replacing


def save_arrays(path: str | os.PathLike[str], arrays: Mapping[str, Any], metadata: Mapping[str, Any] | None) -> None:
    """Write ``.npz`` atomically, with ``metadata`` (values for JSON) under that name."""
    text = np.array(json.dumps(dict(metadata or {})))
    with replacing(path) as part, part.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays, metadata=text)
