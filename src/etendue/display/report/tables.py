"""Tables of a page, and how numbers are written in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from etendue.core import format_number


@dataclass(frozen=True)
class Column:
    """A column with a text for each row; ``best``: the row to mark."""

    heading: str
    texts: Sequence[str]
    best: int | None = None

    @classmethod
    def numbers(cls, heading: str, values: Sequence[float]) -> Column:
        """Numbers of which the smallest is marked."""
        finite = [v for v in values if math.isfinite(v)]
        best = list(values).index(min(finite)) if len(finite) > 1 else None
        return cls(heading, [number_text(v) for v in values], best)

    @classmethod
    def shares(cls, heading: str, values: Sequence[float]) -> Column:
        """Signed shares in per cent."""
        return cls(heading, [f"{100.0 * v:+.2f} %".replace("-", "−") if math.isfinite(v) else "–" for v in values])

    @classmethod
    def times(cls, heading: str, values: Sequence[float]) -> Column:
        """Seconds."""
        return cls(heading, [time_text(v) if math.isfinite(v) else "–" for v in values])


@dataclass(frozen=True)
class Row:
    """A fact of several pictures; ``differs`` if its values differ and the row is to be marked."""

    name: str
    texts: Sequence[str]
    differs: bool


@dataclass(frozen=True)
class FactTable:
    """Facts as rows, pictures as columns."""

    headings: Sequence[str]
    rows: Sequence[Row]


def fact_table(names: Sequence[str], facts: Sequence[Mapping[str, Any]], mark: bool = False) -> FactTable | None:
    """Facts of pictures; one column if all values agree, ``None`` without facts.

    ``mark`` marks the rows in which the pictures that have the fact differ.
    """
    keys = list(dict.fromkeys(key for each in facts for key in each))
    if not keys:
        return None
    same = len(facts) > 1 and all(each == facts[0] for each in facts)
    shown = [("all pictures", facts[0])] if same else list(zip(names, facts, strict=True))
    rows = []
    for key in keys:
        texts = [value_text(each[key]) if key in each else "–" for _, each in shown]
        present = {text for text, (_, each) in zip(texts, shown, strict=True) if key in each}
        rows.append(Row(key.replace("_", " "), texts, mark and len(present) > 1))
    return FactTable([name for name, _ in shown], rows)


def settings_tables(
    names: Sequence[str], settings: Sequence[Mapping[str, Any]], defaults: Sequence[Mapping[str, Any]]
) -> tuple[FactTable | None, FactTable | None]:
    """Settings that differ from their defaults or from each other, and all settings; ``None`` for an empty table.

    The first table shows the default beside a value that differs from it. Rows in which pictures differ are marked.
    """
    every = fact_table(names, settings, mark=True)
    if every is None:
        return None, None
    keys = list(dict.fromkeys(key for each in settings for key in each))
    pairs = list(zip(settings, defaults, strict=True))
    rows = []
    for key in keys:
        values = {value_text(each[key]) for each in settings if key in each}
        if len(values) > 1 or any(_is_changed(key, *pair) for pair in pairs):
            rows.append(Row(key.replace("_", " "), [_with_default(key, *pair) for pair in pairs], len(values) > 1))
    return (FactTable(list(names), rows) if rows else None), every


def _is_changed(key: str, settings: Mapping[str, Any], defaults: Mapping[str, Any]) -> bool:
    return key in settings and key in defaults and settings[key] != defaults[key]


def _with_default(key: str, settings: Mapping[str, Any], defaults: Mapping[str, Any]) -> str:
    if key not in settings:
        return "–"
    text = value_text(settings[key])
    return f"{text} (default {value_text(defaults[key])})" if _is_changed(key, settings, defaults) else text


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one level with dotted names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(flatten(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def value_text(value: Any) -> str:
    """A setting or fact as text: yes and no, short numbers, lists with commas."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or value == "":
        return "–"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f") if abs(value) >= 10_000 else str(value)
    if isinstance(value, float):
        if value.is_integer() and 10_000 <= abs(value) < 1e15:
            return value_text(int(value))
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(value_text(v) for v in value)
    return str(value)


#: Numbers on pages and in progress look the same.
number_text = format_number


def time_text(seconds: float) -> str:
    """``45 ms``, ``0.45 s``, ``4.2 s``, ``45 s``, ``3 min 20 s``, ``2 h 5 min``."""
    if 0.0 < seconds < 0.0995:
        return f"{1000.0 * seconds:.2g} ms"
    if 0.0 < seconds < 0.995:
        return f"{seconds:.2f} s"
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
