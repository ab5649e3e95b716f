"""Libraries that only some users need: imported when something takes them; where one is absent, its extra is named."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import BackendError


def library(name: str, purpose: str, extra: str = "radiosity") -> Any:
    """The module ``name``; raises :class:`BackendError` if it cannot be imported, which says for what ``purpose`` it is
    needed and which extra of étendue installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise BackendError(f"{purpose} takes {name}, which is not here: pip install 'etendue[{extra}]'") from error


def sparse() -> Any:
    """``scipy.sparse``; raises :class:`BackendError` if that is not installed."""
    return library("scipy.sparse", "a matrix of form factors, or of values at vertices,")
