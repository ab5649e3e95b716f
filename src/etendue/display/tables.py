"""Tables of the comparison page, and how numbers are written in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Column:
    """A column of one number per picture; of relMSE-like columns the smallest is marked."""

    heading: str
    values: Sequence[float]
    percent: bool = False
    seconds: bool = False

    def text(self, value: float) -> str:
        """One value as the table shows it."""
        if not math.isfinite(value):
            return "–"
        if self.seconds:
            return time_text(value)
        return f"{100.0 * value:+.2f} %".replace("-", "−") if self.percent else number_text(value)

    def best(self) -> int | None:
        """Index of the value to mark, if one stands out."""
        finite = [v for v in self.values if math.isfinite(v)]
        if self.percent or self.seconds or len(finite) < 2:
            return None
        return list(self.values).index(min(finite))


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


def number_text(value: float, digits: int = 3) -> str:
    """``digits`` significant digits, never in exponent form for what a page shows: 0.00123, 45.6, 1230."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    if abs(value) < 1e-5 or abs(value) >= 1e7:
        return f"{value:.{digits - 1}e}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{round(value, decimals):.{decimals}f}"


def time_text(seconds: float) -> str:
    """``4.2 s``, ``45 s``, ``3 min 20 s``, ``2 h 5 min``."""
    if seconds < 10.0:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
