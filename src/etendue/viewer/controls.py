"""Controls made from settings dataclasses: a list of fields with help, range and choices, as the page shows them.

A field is ``{name, kind, doc, default}`` with ``kind`` one of ``bool``, ``int``, ``float``, ``choice``, ``text``, and
``choices``, ``minimum``, ``maximum``, ``above`` where the setting has them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, get_type_hints

from etendue import methods
from etendue.core import Settings

_KINDS = {bool: "bool", int: "int", float: "float"}
#: Settings that the viewer chooses or has other controls for.
_ELSEWHERE = ("map",)


def fields(settings: type[Settings]) -> list[dict[str, Any]]:
    """The fields of a settings class, in the order of their declaration."""
    hints = get_type_hints(settings)
    result = []
    for field in dataclasses.fields(settings):
        if field.name in _ELSEWHERE:
            continue
        limits = field.metadata
        kind = "choice" if limits.get("choices") else _KINDS.get(hints[field.name], "text")
        row = {"name": field.name, "kind": kind, "doc": limits.get("doc", ""), "default": field.default}
        row |= {key: limits[key] for key in ("choices", "minimum", "maximum", "above") if limits.get(key) is not None}
        result.append(row)
    return result


def method_list() -> list[dict[str, Any]]:
    """Name, a line about it, and the fields of every method."""
    return [
        {"name": name, "about": _first_line(method), "fields": fields(method.Settings)}
        for name, method in methods.table().items()
    ]


def changed(settings: type[Settings], values: Mapping[str, Any]) -> dict[str, Any]:
    """The ``values`` that differ from the defaults. Raises :class:`OptionError` for values that are not valid."""
    checked, default = settings.from_mapping(values), settings()
    return {name: getattr(checked, name) for name in values if getattr(checked, name) != getattr(default, name)}


def _first_line(method: type) -> str:
    return (method.__doc__ or "").strip().split("\n")[0]
