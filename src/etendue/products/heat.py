"""Temperatures and heat of groups of patches, and their files."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue import film
from etendue.core import Array, OptionError, checked_path, format_count, logger
from etendue.display import write_png
from etendue.formats import save_arrays, write_mesh
from etendue.radiosity import FormFactors, HeatBalance
from etendue.surfaces import face_sides

from .files import PathLike, check_files, listed
from .patchpictures import patch_picture

_SUFFIXES = (".csv", ".npz", ".vtu", ".png")
_OF_ONE_CASE = (".vtu", ".png")
#: Columns of a group.
_COLUMNS = ("area", "temperature", "lowest", "highest", "heat", "flux")
#: What follows the name of a column in a table.
_UNITS = {"area": "m2", "temperature": "K", "lowest": "K", "highest": "K", "heat": "W", "flux": "W_m2"}
#: Heat below this share of the radiation that a group sends, at most, is that of rounding, and written as 0.
_ROUNDING = 1e-9
#: Share of the surroundings in what patches see, above which a mesh is open.
_OPEN = 1e-9
#: Share of the sky that is worth a warning if its temperature is not given.
_COLD = 1e-3


@dataclass(repr=False)
class HeatResult:
    """Temperatures and heat of patches, by groups ``names`` (``group``: of each patch), in ``cases`` such as hours."""

    balance: HeatBalance
    factors: FormFactors
    names: list[str]
    group: NDArray[np.int64]
    cases: list[str]

    def table(self) -> dict[str, Array]:
        """For each group (g, c): ``area`` in m^2; ``temperature``, the mean over the area, ``lowest`` and ``highest``
        in kelvin, NaN for groups without one; ``heat`` that it sends into the enclosure in W, and ``flux``, heat per
        area."""
        found, areas, count = self.balance, self.balance.patches.areas, len(self.names)
        shape = (count, found.heat.shape[1])
        area = np.bincount(self.group, areas, count)
        of = np.argsort(self.group, kind="stable")
        parts = np.split(of, np.cumsum(np.bincount(self.group, minlength=count))[:-1])
        made = {name: np.full(shape, np.nan) for name in _COLUMNS}
        made["area"][:] = area[:, None]
        for g, members in enumerate(parts):
            kept = members[areas[members] > 0]
            if len(kept) == 0:
                continue
            t = found.temperature[kept]
            made["temperature"][g] = np.average(t, axis=0, weights=areas[kept])
            made["lowest"][g], made["highest"][g] = t.min(axis=0), t.max(axis=0)
            made["heat"][g] = found.heat[kept].sum(axis=0)
            made["flux"][g] = made["heat"][g] / area[g]
        return made

    def save(self, path: PathLike) -> None:
        """Write ``.csv``, a row for each group, or with several cases for each case, with the unit in the head of each
        column, as ``temperature_K``; ``.npz``, arrays by patch; or, of
        one case, ``.vtu``, faces with temperatures for ParaView, or ``.png``, temperatures in false colours
        (:func:`patch_picture`). Raises :class:`OptionError` for another suffix, :class:`OutputError` if the file cannot
        be written."""
        path = check_heat_file(checked_path(path), len(self.cases))
        if path.suffix.lower() == ".csv":
            with film.replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(self._rows())
        elif path.suffix.lower() == ".npz":
            of_groups = {f"group_{name}": values for name, values in self.table().items()}
            names = {"names": np.array(self.names, dtype=str), "cases": np.array(self.cases, dtype=str)}
            patches = self.balance.patches
            place = {"group": self.group, "areas": patches.areas, "centres": patches.centres, "sky": self._sky}
            save_arrays(path, self._of_patches() | of_groups | names | place, {})
        elif path.suffix.lower() == ".png":
            write_png(path, patch_picture(self.balance.patches, self.balance.temperature[:, 0], "K"))
        else:
            patches = self.balance.patches
            corners, patch = face_sides(patches)
            cells = self._of_patches() | {"patch": np.arange(len(patches)), "face": patches.face}
            write_mesh(path, "vtu", patches.vertices, corners, {}, {name: v[patch] for name, v in cells.items()})

    @property
    def _sky(self) -> Array:
        """(c,) radiosity of the surroundings, from the heat that they receive; 0 of a closed mesh."""
        areas, found = self.balance.patches.areas, self.balance
        outward = areas * self.factors.outside
        sent, whole = outward @ found.radiosity - found.to_sky, outward.sum()
        seen: Array = sent / whole if whole > _OPEN * areas.sum() else np.zeros_like(sent)
        return np.maximum(seen, 0.0)

    def _of_patches(self) -> dict[str, Any]:
        found = self.balance
        names = ("temperature", "heat", "radiosity", "irradiance")
        return {name: getattr(found, name) for name in names} | {"net_flux": found.radiosity - found.irradiance}

    def _rows(self) -> list[list[Any]]:
        table = self.table()
        sent = np.abs(self.balance.radiosity)
        by_group = np.bincount(self.group, self.balance.patches.areas * sent.max(axis=1))
        for name, scale in (("heat", by_group.max()), ("flux", sent.max())):
            table[name][np.abs(table[name]) < _ROUNDING * scale] = 0.0
        if len(self.cases) == 1:
            rows = [[name, *(_text(table[c][g, 0]) for c in _COLUMNS)] for g, name in enumerate(self.names)]
            return [["group", *map(_head, _COLUMNS)], *rows]
        pairs = [(g, c) for g in range(len(self.names)) for c in ("temperature", "heat")]
        heads = ["case", *(f"{self.names[g]}:{_head(c)}" for g, c in pairs)]
        return [heads, *([case, *(_text(table[c][g, k]) for g, c in pairs)] for k, case in enumerate(self.cases))]

    def summary(self) -> str:
        """One line."""
        found = self.balance
        t = found.temperature[np.isfinite(found.temperature)]
        cases = f", {len(self.cases)} cases" if len(self.cases) > 1 else ""
        words = (
            f"{format_count(len(self.names), 'group')}{cases}: {t.min():.2f} to {t.max():.2f} K"
            if len(t)
            else "no temperatures"
        )
        newton = f"{found.steps} steps of Newton's method, " if found.steps > 1 else ""
        return (
            f"{words}, {newton}residual {found.residual:.1g}, heat that is lost or gained {found.imbalance.max():.2g} "
            "of all"
        )


def warn_of_cold_sky(factors: FormFactors) -> None:
    """Say how much of what patches see is the sky, whose temperature nobody has given."""
    share = float(factors.areas @ factors.outside / factors.areas.sum())
    if share > _COLD:
        logger.warning(
            "%.3g %% of what the surfaces see is the sky, which is taken to be at 0 K: give its temperature "
            "(--surroundings, surroundings=), or close the mesh",
            100 * share,
        )


def check_heat_file(path: PathLike, cases: int = 1) -> Path:
    """The path of a file of :meth:`HeatResult.save`. Raises :class:`OptionError`."""
    checked = Path(path)
    if checked.suffix.lower() not in _SUFFIXES:
        raise OptionError(f"heat is written as {', '.join(_SUFFIXES)}, not as '{checked.name}'; change the name")
    if checked.suffix.lower() in _OF_ONE_CASE and cases > 1:
        raise OptionError(f"'{checked.name}' has room for one case; write .csv or .npz, or leave out the loads")
    return checked


def heat_files(save: PathLike | Sequence[PathLike], cases: int) -> tuple[Path, ...]:
    """Checked files of a result. Raises :class:`OptionError` and :class:`OutputError`."""
    files = listed(save)
    for path in files:
        check_heat_file(path, cases)
    check_files(files)
    return files


def _head(column: str) -> str:
    """The head of a column: its name and unit."""
    return f"{column}_{_UNITS[column]}"


def _text(value: float) -> str:
    return f"{value:.9g}" if np.isfinite(value) else ""
