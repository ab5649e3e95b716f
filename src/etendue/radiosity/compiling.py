"""Loops compiled by Numba, which release Python's lock."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from etendue.core import BackendError


def compiled(loops: str = "kernels") -> ModuleType:
    """A module of loops compiled by Numba; raises :class:`BackendError` if Numba is not installed."""
    try:
        return import_module(f".{loops}", __package__)
    except ImportError as error:
        raise BackendError(
            f"loops of radiosity on the CPU are compiled by numba, which cannot be loaded ({error}): "
            "pip install 'etendue[radiosity]'"
        ) from error
