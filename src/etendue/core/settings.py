"""Settings of methods: frozen dataclasses with checks, conversion to JSON and back, and parsing of ``-D name=value``.

A method declares its parameters once::

    @dataclass(frozen=True)
    class PathSettings(Settings):
        max_depth: int = setting(-1, "longest path in edges, -1 for unlimited", minimum=-1)

The command line, the Mitsuba plugin, the checkpoint and the manual page use this declaration.
"""

from __future__ import annotations

import dataclasses
import json
import math
import numbers
import os
from collections.abc import Callable, Iterable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, Self, get_type_hints

from .errors import OptionError, suggest

#: Greatest whole number of a setting: kernels hold them in 32 bits.
_MOST_INT = (1 << 31) - 1
#: Names of arguments elsewhere or earlier, and what they are here.
_ELSEWHERE: Mapping[str, str] = {
    "samples": "spp",
    "time": "seconds",
    "resume": "etendue.resume(file)",
    "define": "a keyword for each setting",
}


def setting(
    default: Any,
    doc: str,
    *,
    choices: tuple[str, ...] | None = None,
    minimum: float | None = None,
    maximum: float | None = None,
    above: float | None = None,
) -> Any:
    """A dataclass field with its one-line documentation and its allowed range.

    ``minimum`` and ``maximum`` are inclusive, ``above`` is an exclusive lower bound. A setting with an empty ``doc`` is
    one that the method finds itself, for checkpoints.
    """
    metadata = {"doc": doc, "choices": choices, "minimum": minimum, "maximum": maximum, "above": above}
    return dataclasses.field(default=default, metadata=metadata)


#: Names that are often taken for settings, and what they are.
_OF_SCENES: Mapping[str, str] = {
    name: f"it is an option of the run, --{meant}, not of a method; a $variable of the scene's XML is a parameter, -P"
    for name, meant in {"spp": "spp", "samples": "spp", "resx": "size", "resy": "size", "seed": "seed"}.items()
}


@dataclasses.dataclass(frozen=True)
class Settings:
    """Base of every settings class. Construction checks types and ranges and raises :class:`OptionError`."""

    def __post_init__(self) -> None:
        for field, kind in self._fields():
            value = _coerce(field, kind, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
            _check_range(field, value)

    @classmethod
    def _fields(cls) -> list[tuple[dataclasses.Field[Any], type]]:
        hints = get_type_hints(cls)
        return [(f, hints[f.name]) for f in dataclasses.fields(cls)]

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], owner: str = "") -> Self:
        """Build from names to values; a value may be a string as typed on the command line.

        Raises :class:`OptionError` on an unknown name and suggests the nearest known one.
        """
        for name in values:
            if name not in cls.names():
                hint = suggest(name, cls.names(), "it has")
                if name in _OF_SCENES:
                    hint = _OF_SCENES[name]
                raise OptionError(f"{owner or cls.__name__} has no option '{name}'; {hint}")
        return cls(**values)

    @classmethod
    def check_arguments(
        cls, values: Iterable[str], owner: str, function: Callable[..., Any], elsewhere: Mapping[str, str] | None = None
    ) -> None:
        """Raise :class:`OptionError` for a name among ``values`` that no setting has, where ``function`` takes settings
        as further arguments: its own arguments may have been meant. ``elsewhere`` maps further names of arguments in
        other functions to their names here."""
        known = {**_ELSEWHERE, **(elsewhere or {})}
        parameters = signature(function).parameters.values()
        own = [parameter.name for parameter in parameters if parameter.kind != parameter.VAR_KEYWORD]
        for name in values:
            if name in cls.names():
                continue
            if (meant := known.get(name)) is not None:
                raise OptionError(f"there is no argument '{name}'; did you mean '{known.get(meant, meant)}'?")
            hint = suggest(name, [*own, *cls.names()], "")
            if not hint.startswith("did"):
                hint = f"it has: {', '.join(row[0] for row in cls.describe())}"
            raise OptionError(f"{owner} has no option '{name}'; {hint}")

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """The names of all settings, in the order of their declaration."""
        return tuple(field.name for field in dataclasses.fields(cls))

    def replace(self, **changes: Any) -> Self:
        """A copy with some values changed, checked again."""
        return self.from_mapping(self.to_dict() | changes)

    def to_dict(self) -> dict[str, Any]:
        """Plain names to plain values, ready for JSON."""
        return dataclasses.asdict(self)

    def to_json(self) -> str:
        """One line of JSON with sorted names; equal settings give equal text."""
        return json.dumps(self.to_dict(), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Inverse of :meth:`to_json`. Raises :class:`OptionError` if ``text`` is not a JSON object of settings."""
        try:
            values = json.loads(text)
        except json.JSONDecodeError as error:
            raise OptionError(f"settings of {cls.__name__} are not JSON: {error}") from None
        if not isinstance(values, dict):
            raise OptionError(f"settings of {cls.__name__} must be a JSON object, not '{text}'")
        return cls.from_mapping(values)

    @classmethod
    def describe(cls) -> list[tuple[str, str, Any, str]]:
        """Rows ``(name, type, default, doc)`` for manual pages, of the settings that have a documentation."""
        rows = []
        for field, kind in cls._fields():
            if not field.metadata["doc"]:
                continue
            choices = field.metadata.get("choices")
            rows.append(
                (field.name, "|".join(choices) if choices else kind.__name__, field.default, field.metadata["doc"])
            )
        return rows


def _coerce(field: dataclasses.Field[Any], kind: type, value: Any) -> Any:
    """``value`` as ``kind``; strings are parsed as on the command line."""
    try:
        if kind is bool:
            return _truth(value)
        if value is False or value == "false":  # --no-shot: none of it
            value = 0
        if isinstance(value, bool):
            raise ValueError
        if kind is int:
            if isinstance(value, float) and not value.is_integer():
                raise ValueError
            return int(value)
        return kind(value)
    except (ValueError, TypeError):
        raise OptionError(f"option '{field.name}' must be {_article(kind)}, not '{value}'") from None


def _truth(value: Any) -> bool:
    words = {"true": True, "1": True, "yes": True, "on": True, "false": False, "0": False, "no": False, "off": False}
    text = str(value).lower()
    if text not in words:
        raise ValueError
    return words[text]


def _article(kind: type) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number"}.get(kind, kind.__name__)


def _check_range(field: dataclasses.Field[Any], value: Any) -> None:
    limits = field.metadata
    choices = limits.get("choices")
    if choices and value not in choices:
        raise OptionError(f"option '{field.name}' must be one of {', '.join(choices)}, not '{value}'")
    if type(value) is int and abs(value) > _MOST_INT:
        raise OptionError(f"option '{field.name}' must be from {-_MOST_INT} to {_MOST_INT}, not {value}")
    if type(value) in (int, float):
        if not math.isfinite(value):
            raise OptionError(f"option '{field.name}' must be finite, not {value}")
        for key, ok, words in (
            ("minimum", lambda v, m: v >= m, "at least"),
            ("maximum", lambda v, m: v <= m, "at most"),
            ("above", lambda v, m: v > m, "above"),
        ):
            bound = limits.get(key)
            if bound is not None and not ok(value, bound):
                raise OptionError(f"option '{field.name}' must be {words} {bound:g}, not {value:g}")


# Python counts ``True`` as a number; no option accepts it as one.


def is_number(value: Any) -> bool:
    """Whether ``value`` is a finite real number of Python or NumPy, and not a truth value."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)


def checked_path(value: Any, what: str = "a file") -> Path:
    """``value`` as a path. Raises :class:`OptionError` if it is none."""
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        raise OptionError(f"{what} is named by a text or a path, not {value!r}")
    return Path(value)


def is_whole(value: Any) -> bool:
    """Whether ``value`` has an integer type of Python or NumPy, and is not a truth value."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)
