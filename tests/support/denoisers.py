"""Denoisers whose library may be missing."""

from __future__ import annotations

import importlib.util

import pytest


def needs(name: str) -> None:
    """Skip without the library of a denoiser."""
    if name == "oidn" and importlib.util.find_spec("mitsuba_oidn") is None:
        pytest.skip("mitsuba-oidn is not installed")
