"""View factors of zones as objects ``ZoneProperty:UserViewFactors:BySurfaceName`` of EnergyPlus."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import FormatError

if TYPE_CHECKING:
    import scipy.sparse

_OBJECT = "ZoneProperty:UserViewFactors:BySurfaceName"
#: The field of the name in recent versions; earlier ones have ``zone_or_zonelist_name``.
_ZONE = "zone_or_zonelist_or_space_or_spacelist_name"


def check_idf_names(names: Sequence[str]) -> None:
    """Raise :class:`FormatError` for a name that a text of EnergyPlus cannot contain."""
    for name in names:
        if re.search(r"[,;!\n]", name):
            raise FormatError(f"EnergyPlus has no names with ',', ';' or '!', as '{name}': rename it")


@dataclass(frozen=True)
class Zone:
    """A zone, or another enclosure: its name, the names of its n surfaces, and F (n, n) from the row to the column."""

    name: str
    surfaces: Sequence[str]
    matrix: scipy.sparse.csr_array


def energyplus_lines(zones: Iterable[Zone]) -> Iterator[str]:
    """Lines of an IDF file, an object for each zone: its name, then for every pair of surfaces, also of one with
    itself, the names of both and F. Raises :class:`FormatError` for names that it cannot contain."""
    for zone in zones:
        check_idf_names([zone.name, *zone.surfaces])
        yield f"{_OBJECT},\n  {zone.name},\n"
        last = len(zone.surfaces) ** 2 - 1
        for k, (first, second, factor) in enumerate(_pairs(zone)):
            yield f"  {first}, {second}, {factor:.8f}{';' if k == last else ','}\n"


def energyplus_json(zones: Iterable[Zone]) -> Iterator[str]:
    """The same as epJSON, in the schema of recent versions."""
    objects = {}
    for zone in zones:
        factors = [
            {"from_surface": first, "to_surface": second, "view_factor": round(factor, 8)}
            for first, second, factor in _pairs(zone)
        ]
        objects[f"view factors {zone.name}"] = {_ZONE: zone.name, "view_factors": factors}
    yield json.dumps({_OBJECT: objects}, indent=1) + "\n"


def _pairs(zone: Zone) -> Iterator[tuple[str, str, float]]:
    for i, first in enumerate(zone.surfaces):
        row = zone.matrix[[i]].toarray()[0]
        for second, factor in zip(zone.surfaces, row.tolist(), strict=True):
            yield first, second, factor
