"""Optional libraries, imported at first use; if one is missing, the error names the extra that installs it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from .errors import BackendError


def library(name: str, purpose: str, extra: str = "radiosity") -> Any:
    """The module ``name``. Raises :class:`BackendError` if it cannot be imported; the message says for which
    ``purpose`` it is needed and which extra of étendue installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise BackendError(f"{purpose} needs {name}, which is not installed: pip install 'etendue[{extra}]'") from error


def sparse() -> Any:
    """``scipy.sparse``; raises :class:`BackendError` if that is not installed."""
    return library("scipy.sparse", "a matrix of form factors, or of values at vertices,")
