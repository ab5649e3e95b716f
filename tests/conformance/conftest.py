"""One scene at a time: Dr.Jit compiles a virtual call for every object alive, those of other scenes included."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def _forget_scenes() -> Iterator[None]:
    """Free the scenes of a test before the next one compiles its kernels."""
    yield
    gc.collect()
