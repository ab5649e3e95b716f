"""Thermal conditions of groups of patches from tables: one for all times, and loads that change with the hour."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, suggest
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..heat import Conditions

#: Columns of numbers; ``power`` is a flux times the area of the group. Those that loads may change come first.
_LOADS = ("temperature", "flux", "power", "ambient", "conductance")
_COLUMNS = (*_LOADS, "emissivity")
#: Column of groups whose patches have one temperature, and its values; and of loads, the temperature of the sky.
_JOINT, _ANSWERS, _SKY = "isothermal", {"yes": True, "no": False, "": False}, "surroundings"
#: Columns that become conditions of patches as they are.
_OF_PATCHES = ("temperature", "flux", "conductance", "ambient")
#: The row of all groups without one of their own.
_OTHERS = "*"


def read_conditions(
    path: Path, names: Sequence[str], group: NDArray[np.int64], patches: Patches, loads: Path | None = None
) -> tuple[Conditions, list[str]]:
    """Conditions of patches (n,) whose ``group`` has one of ``names``, and the names of cases.

    path: a table with the columns ``group`` and some of ``temperature`` (K), ``flux`` (W/m^2, or ``adiabatic``),
    ``power`` (W of the whole group), ``conductance`` (W/(m^2 K)), ``ambient`` (K) and ``emissivity`` (by default that
    of the mesh, one minus its reflectance; 1 of coloured patches). In place of it, columns such as ``emissivity:0-4``
    and ``emissivity:4-inf`` are of bands of wavelengths in micrometres. ``isothermal`` (yes or no): whether the patches
    of the group have one temperature, as of a good conductor. The group ``*`` is every other one.
    loads: a table of cases, such as hours: the first column names them, ``GROUP:COLUMN`` takes the place of a number of
    the other table, but for emissivities, and ``surroundings`` is the temperature of the sky.

    Raises :class:`RadiosityError` for groups that are not there or have no condition, and for what is no number.
    """
    heads, rows = _table(path)
    if not heads or heads[0].lower() != "group":
        raise RadiosityError(f"{path}: the first column is 'group', not '{heads[0] if heads else ''}'")
    heads = [head.lower() for head in heads]
    bands = [head for head in heads if head.startswith("emissivity:")]
    for k, head in enumerate(heads[1:], 1):
        if head not in (*_COLUMNS, *bands, _JOINT):
            raise RadiosityError(f"{path} has a column '{head}'; {suggest(head, (*_COLUMNS, _JOINT))}")
        if head in heads[:k]:
            raise RadiosityError(f"{path} has two columns '{head}'")
    edges = _edges(path, bands, "emissivity" in heads)
    found: dict[str, dict[str, float]] = {}
    joint: dict[str, bool] = {}
    for number, row in rows:
        name = row[0]
        if name != _OTHERS and name not in names:
            raise RadiosityError(f"{path}, line {number}: there is no group '{name}'; {suggest(name, names)}")
        if name in found:
            raise RadiosityError(f"{path}, line {number}: group '{name}' has a row above, too")
        cells = dict(zip(heads[1:], row[1:], strict=True))
        if (answer := cells.pop(_JOINT, "").lower()) not in _ANSWERS:
            raise RadiosityError(f"{path}, line {number}: {_JOINT} is 'yes' or 'no', not '{answer}'")
        joint[name] = _ANSWERS[answer]
        found[name] = {head: _number(path, number, head, cell) for head, cell in cells.items() if cell}
    if lacking := [name for name in names if name not in found and _OTHERS not in found]:
        raise RadiosityError(f"{path} has no row of group '{lacking[0]}'; give it one, or '*' for all others")
    table = [{**found.get(name, found.get(_OTHERS, {}))} for name in names]
    cases, changes, sky = ([""], {}, None) if loads is None else _loads(loads, names)
    values = {column: np.full((len(names), len(cases)), np.nan) for column in (*_COLUMNS, *bands)}
    for g, known in enumerate(table):
        for column, value in known.items():
            values[column][g] = value
    for (g, column), series in changes.items():
        values[column][g] = series
    sizes = np.bincount(group, patches.areas, len(names))
    per_area = values["power"] / np.where(sizes > 0, sizes, 1.0)[:, None]
    values["flux"] = np.where(np.isnan(per_area), values["flux"], per_area)
    is_joint = np.array([joint.get(name, joint.get(_OTHERS, False)) for name in names])
    _check(path, names, values, bands)
    for g in np.flatnonzero((sizes == 0) & (is_joint | ~np.isnan(per_area).all(axis=1))).tolist():
        what = _JOINT if is_joint[g] else "power"
        raise RadiosityError(f"{path}: group '{names[g]}' has no area, but {what} needs one: give it a flux alone")
    for column in ("flux", "conductance", "ambient"):
        values[column] = np.nan_to_num(values[column])
    of_patches: dict[str, Any] = {column: values[column][group] for column in _OF_PATCHES}
    own = 1 - patches.reflectance if patches.channels == 1 else np.ones((len(patches), 1))
    emissivity = values["emissivity"] if not bands else np.stack([values[band][:, 0] for band in bands], axis=1)
    of_patches["emissivity"] = np.where(np.isnan(emissivity[group]), own, emissivity[group])
    if is_joint.any():
        of_patches["nodes"] = np.where(is_joint[group], group, -1)
    return Conditions(**of_patches, edges=edges, surroundings=0.0 if sky is None else sky), cases


def _edges(path: Path, bands: list[str], is_grey: bool) -> Array | None:
    """Edges in metres of the bands of columns such as ``emissivity:0-4``, in ascending order; ``None`` without any."""
    if not bands:
        return None
    if is_grey:
        raise RadiosityError(f"{path} has a column 'emissivity' and others of bands: give one or the other")
    limits = []
    for band in bands:
        low, _, high = band.partition(":")[2].partition("-")
        try:
            limits.append((float(low), float(high)))
        except ValueError:
            raise RadiosityError(f"{path}: '{band}' is no band in micrometres, as emissivity:0-4") from None
    limits_of = dict(zip(bands, limits, strict=True))
    bands.sort(key=limits_of.__getitem__)
    limits.sort()
    edges = [0.0, *(high for _, high in limits)]
    if [low for low, _ in limits] != edges[:-1] or any(low >= high for low, high in limits) or edges[-1] < np.inf:
        named = ", ".join(bands)
        raise RadiosityError(f"{path}: {named} do not go on from 0 to inf, as emissivity:0-4 and emissivity:4-inf")
    return np.array(edges) * 1e-6


def _check(path: Path, names: Sequence[str], values: dict[str, Array], bands: list[str]) -> None:
    """Raise :class:`RadiosityError` for conditions that lack something, or exclude each other."""
    has = {column: np.asarray(np.isfinite(array).any(axis=1)) for column, array in values.items()}
    for g, name in enumerate(names):
        kinds = [column for column in ("temperature", "flux", "conductance") if has[column][g]]
        where = f"{path}: group '{name}'"
        if not kinds:
            raise RadiosityError(f"{where} has no temperature, flux (0 or 'adiabatic' for none), power or conductance")
        if "temperature" in kinds and len(kinds) > 1:
            raise RadiosityError(f"{where} has a temperature and a {kinds[1]}: give one of the two")
        if has["conductance"][g] != has["ambient"][g]:
            raise RadiosityError(f"{where}: a conductance and the temperature of its ambient belong together")
        for column in kinds:
            if np.isnan(values[column][g]).any():
                raise RadiosityError(f"{where} has no {column} in case {int(np.isnan(values[column][g]).argmax()) + 1}")
        lacking = [band for band in bands if not has[band][g]]
        if lacking and len(lacking) < len(bands):
            raise RadiosityError(f"{where} has no {lacking[0]}, but an emissivity of another band: give it all")


def _loads(path: Path, names: Sequence[str]) -> tuple[list[str], dict[tuple[int, str], Array], Array | None]:
    """Names of cases, numbers (c,) by the number of a group and a column, and temperatures of the sky (c,), if any."""
    heads, rows = _table(path)
    if not rows:
        raise RadiosityError(f"{path} has no rows")
    lines_of: dict[str, int] = {}
    for line, row in rows:
        if not row[0]:
            raise RadiosityError(f"{path}, line {line}: a case has no name in the first column")
        if row[0] in lines_of:
            raise RadiosityError(f"{path}, line {line}: case '{row[0]}' is in line {lines_of[row[0]]}, too")
        lines_of[row[0]] = line
    series: dict[tuple[str, str], Array] = {}
    for k, head in enumerate(heads[1:], 1):
        name, _, column = head.rpartition(":")
        column = column.strip().lower()
        if column != _SKY and name not in names:
            raise RadiosityError(f"{path}: column '{head}' is no GROUP:COLUMN of a group; {suggest(name, names)}")
        if column not in (_LOADS if name else (_SKY,)):
            raise RadiosityError(f"{path}: column '{head}' must end in {', '.join(_LOADS)}")
        numbers = []
        for line, row in rows:
            if not row[k]:
                raise RadiosityError(f"{path}, line {line}: column '{head}' has no number")
            numbers.append(_number(path, line, column, row[k]))
        if (name, column) in series:
            raise RadiosityError(f"{path} has two columns '{head}'")
        series[name, column] = np.array(numbers)
    sky = series.pop(("", _SKY), None)
    return list(lines_of), {(names.index(name), column): numbers for (name, column), numbers in series.items()}, sky


def _table(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The heads of the columns, and the number of the line and the cells of each row."""
    try:
        text = path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise RadiosityError(f"there is no table {path}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RadiosityError(f"{path} cannot be read as text: {error}") from None
    head = text.partition("\n")[0]
    delimiter = next((c for c in ";\t" if c in head), ",")
    lines = csv.reader(text.splitlines(), delimiter=delimiter)
    rows = [(number, [cell.strip() for cell in row]) for number, row in enumerate(lines, 1) if any(map(str.strip, row))]
    if not rows:
        raise RadiosityError(f"{path} is empty")
    for number, row in rows:
        if len(row) != len(rows[0][1]):
            raise RadiosityError(f"{path}, line {number} has {len(row)} cells, not {len(rows[0][1])}")
    return rows[0][1], rows[1:]


def _number(path: Path, line: int, column: str, cell: str) -> float:
    if column.lower() == "flux" and cell.lower() == "adiabatic":
        return 0.0
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise RadiosityError(f"{path}, line {line}: {column} '{cell}' is no number")
    return value
