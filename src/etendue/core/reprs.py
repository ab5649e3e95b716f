"""Short texts of objects that hold arrays."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

T = TypeVar("T", bound=type)

#: Longest text of a value that is shown as it is.
_LONGEST = 60


def short_repr(kind: T) -> T:
    """A decorator of dataclasses: their text shows arrays by their shapes."""
    kind.__repr__ = _short  # type: ignore[method-assign,assignment]
    return kind


def _short(thing: Any) -> str:
    parts = [f"{field.name}={_text(getattr(thing, field.name))}" for field in dataclasses.fields(thing) if field.repr]
    return f"{type(thing).__name__}({', '.join(parts)})"


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {_text(inner)}' for name, inner in value.items())}}}"
    if getattr(value, "shape", ()):
        return f"<{' x '.join(map(str, value.shape))}>"
    text = repr(value)
    return text if len(text) <= _LONGEST else f"<{len(value)}>" if hasattr(value, "__len__") else type(value).__name__
