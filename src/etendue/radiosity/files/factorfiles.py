"""Form factors in files: for SciPy and netCDF with everything, and for the programs that solve with view factors. Files
are written atomically."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, format_count, logger, sparse
from etendue.film import replacing
from etendue.formats import (
    Zone,
    check_idf_names,
    check_moose_names,
    elmer_lines,
    energyplus_json,
    energyplus_lines,
    moose_lines,
    netcdf_library,
    netcdf_metadata,
    openfoam_face_lines,
    openfoam_factor_lines,
    read_netcdf,
    read_view3d,
    save_arrays,
    table_lines,
    udales_lines,
    udales_sky_lines,
    view3d_lines,
    write_udales_netcdf,
)
from etendue.surfaces import Patches

from ..errors import RadiosityError
from ..factors.formfactors import NUMBERS, FormFactors, numbers_of
from ..factors.groups import row_names
from .netcdf import read_netcdf_form_factors, same_structure, write_form_factors

#: The program that has factors by zones.
_ZONED = "EnergyPlus"
#: Largest size of a file of text in bytes, and additional bytes of a non-zero number compared with a zero.
_MOST_TEXT, _ENTRY = 4e9, 10.0
#: A row sum that is less than this from 1 is accepted by programs that need closed rows.
_CLOSED = 1e-3
#: Relative difference of areas, and deviation of row sums from 1, of factors for given patches: of numbers in text.
_SAME_AREA, _WHOLE_ROW = 1e-4, 1e-3


@dataclass(frozen=True)
class FactorFormat:
    """A format of form factors.

    name: the suffix, or a pattern of the whole name. about: what it is. zero: bytes of a zero; 0 if zeros take none.
    lines: makes the lines of a text from the factors, their emissivities and the path; ``None`` for other files.
    names: checks names that the format requires, ``None`` if it requires none. is_closed: whether the program needs
    rows that sum to 1 without the sky.
    """

    name: str
    about: str
    zero: float = 0.0
    lines: Callable[[FormFactors, Array, Path], Iterable[str]] | None = None
    names: Callable[[list[str]], None] | None = None
    is_closed: bool = False

    def fits(self, path: Path) -> bool:
        """Whether a file of this name has the format."""
        return path.suffix.lower() == self.name if self.name.startswith(".") else fnmatchcase(path.name, self.name)


def _csv(factors: FormFactors, emissivity: Array, path: Path) -> Iterable[str]:
    more = {"sky": factors.sky} | ({} if factors.ground is None else {"ground": factors.ground})
    more |= ({"backs": factors.dark} if factors.dark.any() else {}) | {"area": factors.areas}
    if factors.sky_patches is not None:
        more |= {f"sky:{k}": share for k, share in enumerate(factors.sky_patches.T, 1)}
    return table_lines(factors.matrix, _names(factors), more)


def _view3d(factors: FormFactors, emissivity: Array, path: Path) -> Iterable[str]:
    return view3d_lines(factors.matrix, factors.areas, emissivity, not factors.outside.any())


def _names(factors: FormFactors) -> list[str]:
    return row_names(factors).tolist()


def _zone_names(factors: FormFactors, path: Path) -> list[str]:
    """The zones of the rows, or if they have none, one with the name of the file."""
    return [path.stem] if factors.zone is None else list(dict.fromkeys(factors.zone.tolist()))


def _zones(factors: FormFactors, path: Path) -> Iterator[Zone]:
    names, of = row_names(factors), factors.zone
    for zone in _zone_names(factors, path):
        ours = np.arange(len(names)) if of is None else np.flatnonzero(of == zone)
        yield Zone(zone, names[ours].tolist(), factors.matrix[ours][:, ours])


#: Formats of form factors. Names come before suffixes, since ``vf.nc.inp.201`` is a name.
FACTOR_FORMATS = (
    FactorFormat("vfsparse.inp.*", "uDALES", lines=lambda f, e, path: udales_lines(f.matrix)),
    FactorFormat("svf.inp.*", "sky view factors of uDALES", lines=lambda f, e, path: udales_sky_lines(f.sky)),
    FactorFormat("vf.nc.inp.*", "the transpose as netCDF, of uDALES", zero=4.0),
    FactorFormat("ViewFactors.dat*", "Elmer", lines=lambda f, e, path: elmer_lines(f.matrix)),
    FactorFormat("F", "OpenFOAM", lines=lambda f, e, path: openfoam_factor_lines(f.matrix)),
    FactorFormat("globalFaceFaces", "OpenFOAM", lines=lambda f, e, path: openfoam_face_lines(f.matrix)),
    FactorFormat(".npz", "arrays of NumPy"),
    FactorFormat(".vf", "text of View3D", zero=2.0, lines=_view3d),
    FactorFormat(".nc", "netCDF"),
    FactorFormat(".csv", "a table by names", zero=2.0, lines=_csv),
    FactorFormat(
        *(".idf", "EnergyPlus", 32.0, lambda f, e, path: energyplus_lines(_zones(f, path))),
        names=check_idf_names,
        is_closed=True,
    ),
    FactorFormat(
        *(".epjson", "EnergyPlus", 120.0, lambda f, e, path: energyplus_json(_zones(f, path))),
        names=lambda names: None,
        is_closed=True,
    ),
    FactorFormat(
        *(".i", "MOOSE", 2.0, lambda f, e, path: moose_lines(f.matrix, _names(f))),
        names=check_moose_names,
        is_closed=True,
    ),
)


def factor_format(path: str | os.PathLike[str]) -> FactorFormat:
    """The format that the name of a file decides. Raises :class:`RadiosityError` for other names,
    :class:`etendue.core.BackendError` for netCDF without its library."""
    place = Path(path)
    for known in FACTOR_FORMATS:
        if known.fits(place):
            if known.name == ".nc":
                netcdf_library(path)
            return known
    suffixes = ", ".join(known.name for known in FACTOR_FORMATS if known.name.startswith("."))
    names = ", ".join(known.name.replace("*", "NNN") for known in FACTOR_FORMATS if known.name.endswith(".*"))
    what = f"'{place.suffix}' is not known" if place.suffix else "it has no suffix"
    raise RadiosityError(
        f"the name of '{path}' decides its format: {what}; take {suffixes}, or the names {names}, ViewFactors.dat, F "
        "or globalFaceFaces"
    )


def check_factors(path: str | os.PathLike[str], factors: FormFactors) -> None:
    """Raise :class:`RadiosityError` if the format of a file cannot hold factors, as far as their number and names tell:
    text of more than 4 GB or than the free space of the disk, and rows without names for a program that knows surfaces
    by names; :class:`FormatError` for names that it cannot contain."""
    known = factor_format(path)
    _check_size(path, len(factors), factors.matrix.nnz, known.zero)
    if known.names is None:
        return
    names = [] if factors.name is None else factors.name.tolist()
    if not names or not all(names) or len(set(names)) < len(names):
        raise RadiosityError(
            f"'{path}' is for {known.about}, which knows surfaces by names: give each a name of its own, and ask for "
            "factors between groups (--groups, groups=True) if a surface has several faces"
        )
    known.names([*names, *(_zone_names(factors, Path(path)) if known.about == _ZONED else ())])
    if known.about == _ZONED and factors.zone is not None and "" in factors.zone:
        torn = names[factors.zone.tolist().index("")]
        raise RadiosityError(
            f"'{path}' is for {known.about}, which has the surfaces of each zone apart, and '{torn}' is of several "
            "zones: take other groups (--ids), or one zone (--zone)"
        )


def no_factors(patches: Patches) -> FormFactors:
    """Form factors of patches that see nothing, with their areas and names: to check what can be made of others."""
    n = len(patches)
    empty = sparse().csr_array((n, n))
    return FormFactors(empty, empty, np.zeros(n), patches.areas, np.zeros(n), **numbers_of(patches))


def _check_size(path: str | os.PathLike[str], patches: int, entries: int, zero: float) -> None:
    size = zero * patches**2 + _ENTRY * min(entries, patches**2) * (zero > 0)
    folder = Path(path).absolute().parent
    free = shutil.disk_usage(folder).free if folder.is_dir() else np.inf
    if size > min(free, _MOST_TEXT):
        there = f"there are {free / 1e9:.3g}" if size > free else f"more than {_MOST_TEXT / 1e9:g} are of no use"
        raise RadiosityError(
            f"'{path}' would have {patches} x {patches} numbers and {size / 1e9:.3g} GB, {there}: write .npz, where "
            "zeros take no place, or make patches larger"
        )


def save_form_factors(
    path: str | os.PathLike[str],
    factors: FormFactors,
    *,
    emissivity: ArrayLike = 1.0,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write form factors in the format that the name of ``path`` decides.

    ``.npz``: the matrix, for :func:`scipy.sparse.load_npz` and :func:`read_form_factors`, with ``errors`` (the standard
        error of each of its ``data``), ``areas``, ``sky``, ``lines``, ``emissivity``, if known ``ground``,
        ``sky_patches``, and ``face``, ``label``, ``name`` and ``zone`` of each row, and ``metadata`` (JSON).
    ``.nc``: netCDF with the content of ``.npz``: ``row_start``, ``column``, ``form_factor``, ``form_factor_error``,
        ``area``, ``sky_share``, ``ground_share``, ``sky_patch_share``, ``lines``, ``emissivity``, ``face``, ``label``,
        ``name``.
    ``.csv``: a table with names of rows and columns, then ``sky``, ``ground`` if it is apart, ``backs`` if light ends
        there, ``area``, and ``sky:1``, ``sky:2`` and so on, parts of ``sky``, if its patches are known.
    ``.vf``: the text format of View3D 3.2: a heading, areas, the full matrix row by row, emissivities. It does not
        contain the sky; rows of an open scene sum to less than 1. There is no place for numbers and names, but rows of
        empty patches are written, so that the rows are those of the faces.
    ``vfsparse.inp.NNN``, ``svf.inp.NNN``, ``vf.nc.inp.NNN``: uDALES; rows are all facets in the order of the mesh.
    ``.idf``, ``.epjson``: ``ZoneProperty:UserViewFactors:BySurfaceName`` of EnergyPlus, an object for each ``zone``; if
        the rows have none, one with the name of the file without suffix.
    ``.i``: a block of MOOSE. ``ViewFactors.dat``: Elmer. ``F``, ``globalFaceFaces``: OpenFOAM.

    emissivity: a number or (n,), written unchanged. metadata: values for JSON. A warning is given if a program needs
    rows that sum to 1 and these do not. Raises :class:`RadiosityError` for another name and the errors of
    :func:`check_factors`, :class:`etendue.core.OutputError` if the file cannot be written.
    """
    known = factor_format(path)
    try:
        emitted = np.broadcast_to(np.asarray(emissivity, dtype=np.float64), (len(factors),))
    except ValueError:
        raise RadiosityError(f"emissivity is a number or has one for each of {len(factors)} patches") from None
    check_factors(path, factors)
    missing = np.where(factors.areas > 0, np.abs(factors.row_sums() - factors.outside - 1), 0.0)
    if known.is_closed and missing.max(initial=0.0) > _CLOSED:
        _warn_of_open_rows(known, path, factors, missing)
    if known.lines is not None:
        matrix = factors.matrix.tocsr(copy=True)
        matrix.sort_indices()
        with replacing(path) as part, part.open("w", encoding="utf-8") as file:
            file.writelines(known.lines(replace(factors, matrix=matrix), emitted, Path(path)))
    elif known.name == ".nc":
        write_form_factors(path, factors, emitted, metadata)
    elif known.name == ".npz":
        _write_arrays(path, factors, emitted, metadata)
    else:
        write_udales_netcdf(path, factors.matrix)


def _warn_of_open_rows(known: FactorFormat, path: str | os.PathLike[str], factors: FormFactors, missing: Array) -> None:
    """Say which rows do not sum to 1, in which zones, and why."""
    is_open = np.maximum(factors.outside, factors.dark) > _CLOSED
    where = ""
    if factors.zone is not None:
        zones = dict.fromkeys(factors.zone[missing > _CLOSED].tolist())
        where = f" in {format_count(len(zones), 'zone')} ({', '.join(zones)})"
    logger.warning(
        "%s takes rows that sum to 1 without the sky, and those of '%s' are off by at most %.2g%s, as of '%s': %s",
        *(known.about, path, missing.max(), where, row_names(factors)[np.argmax(missing)]),
        "close the mesh, which shows the sky or backs of faces (etendue check names turned ones, --orient turns them)"
        if is_open.any()
        else "repair them (--repair)",
    )


def _write_arrays(
    path: str | os.PathLike[str], factors: FormFactors, emitted: NDArray[Any], metadata: Mapping[str, Any] | None
) -> None:
    matrix, errors = same_structure(factors)
    # The names of the first six are those of SciPy.
    save_arrays(
        path,
        {
            "format": np.array(b"csr"),
            "_is_array": np.array(True),
            "shape": np.array(matrix.shape),
            "data": matrix.data,
            "indices": matrix.indices,
            "indptr": matrix.indptr,
            "errors": errors.data,
            "areas": factors.areas,
            **factors.ends,
            "lines": factors.lines,
            "emissivity": emitted,
            **{name: values for name, values in factors.numbers.items() if values is not None},
        },
        metadata,
    )


def factors_of_patches(path: str | os.PathLike[str], patches: Patches) -> FormFactors:
    """:func:`read_form_factors` of ``patches``. Raises :class:`RadiosityError` if there are others, warns of rows that
    do not sum to 1."""
    factors = read_form_factors(path)
    if len(factors) != len(patches):
        raise RadiosityError(
            f"'{path}' has {len(factors)} rows, and there are {len(patches)} patches: read the mesh as for the "
            "form factors (max_area, ids, two_sided)"
        )
    other = np.flatnonzero(np.abs(factors.areas - patches.areas) > _SAME_AREA * patches.areas)
    if len(other):
        raise RadiosityError(
            f"'{path}' is of other patches: row {other[0]} has the area {factors.areas[other[0]]:.6g}, and patch "
            f"{other[0]} has {patches.areas[other[0]]:.6g}"
        )
    off = np.abs(factors.row_sums() + factors.dark - 1)[patches.areas > 0].max(initial=0.0)
    if off > _WHOLE_ROW:
        logger.warning("row sums of '%s' are off by up to %.2g, and the power of the solution with them", path, off)
    return factors


def read_form_factors(path: str | os.PathLike[str]) -> FormFactors:
    """Read a file that :func:`save_form_factors` wrote as ``.npz`` or ``.nc``, or a file of View3D, ``.vf``.

    View3D's factors have no errors, no names and no sky: unless the file is said to be of an enclosure, the sky is what
    is missing in a row. Raises :class:`RadiosityError` for another file, :class:`FormatError` for one that is damaged.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        return read_netcdf_form_factors(path)
    if suffix == ".vf":
        return _read_view3d(path)
    try:
        with np.load(path, allow_pickle=False) as saved:
            structure, shape = (saved["indices"], saved["indptr"]), tuple(saved["shape"])
            matrix, errors = (sparse().csr_array((saved[name], *structure), shape=shape) for name in ("data", "errors"))
            more = {name: saved[name] for name in (*NUMBERS, "dark", "ground", "sky_patches") if name in saved}
            return FormFactors(matrix, errors, saved["sky"], saved["areas"], saved["lines"], **more)
    except FileNotFoundError:
        raise RadiosityError(f"there is no file of form factors '{path}'") from None
    except (OSError, KeyError, ValueError, EOFError, AttributeError, TypeError, BadZipFile) as error:
        raise RadiosityError(f"'{path}' is not a file of form factors that save_form_factors wrote as .npz") from error


def read_notes(path: str | os.PathLike[str]) -> tuple[Array, dict[str, Any]]:
    """The emissivities (n,) and the metadata in a file of form factors that :func:`save_form_factors` wrote as ``.npz``
    or ``.nc``. Raises :class:`RadiosityError` for another file, :class:`FormatError` for one that is damaged."""
    if Path(path).suffix.lower() == ".nc":
        emissivity = np.asarray(read_netcdf(path, "form factors", ("emissivity",))["emissivity"])
        return emissivity, netcdf_metadata(path)
    try:
        with np.load(path, allow_pickle=False) as saved:
            return np.asarray(saved["emissivity"]), json.loads(str(saved["metadata"]))
    except (OSError, KeyError, ValueError, EOFError, TypeError, BadZipFile) as error:
        raise RadiosityError(f"'{path}' is not a file of form factors that save_form_factors wrote as .npz") from error


def _read_view3d(path: str | os.PathLike[str]) -> FormFactors:
    found = read_view3d(path)
    n = len(found.areas)
    matrix = sparse().csr_array(found.matrix)
    errors = matrix.copy()
    errors.data = np.zeros_like(errors.data)
    sky = np.zeros(n) if found.is_closed else np.clip(1 - found.matrix.sum(axis=1), 0.0, None)
    return FormFactors(matrix, errors, sky * (found.areas > 0), found.areas, np.zeros(n, np.int64))
