"""Form factors between groups of patches, and names of rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import sparse
from etendue.surfaces import Patches

from ..errors import RadiosityError
from .formfactors import FormFactors, entries_of, inverse

#: The group of patches without a name.
UNNAMED = "unnamed"


def row_names(factors: FormFactors) -> NDArray[np.str_]:
    """(n,) names of the rows, each once: the name of the shape if it has no other patch, else this, or ``patch``, and
    the number of the row, as ``wall:7``."""
    names = np.full(len(factors), "") if factors.name is None else np.asarray(factors.name, dtype=str)
    known, place, count = np.unique(names, return_inverse=True, return_counts=True)
    alone = (known[place] != "") & (count[place] == 1)
    numbered = (f"{name or 'patch'}:{row}" for row, name in enumerate(names))
    made = [name if own else other for name, own, other in zip(names, alone, numbered, strict=True)]
    return np.array(made, dtype=str)


def group_index(factors: FormFactors, groups: ArrayLike | None = None) -> tuple[NDArray[np.str_], NDArray[np.int64]]:
    """Names of groups (g,), in the order of their first patches, and the group of each patch (n,).

    groups: (n,) names or numbers, patches with equal ones are a group; by default the names of their shapes, or if
    there are none their labels. Raises :class:`RadiosityError` for another number of them, and if there are none.
    """
    given: NDArray[Any] | None = None if groups is None else np.asarray(groups)
    if given is None:
        has_names = factors.name is not None and bool(factors.name.any())
        given = factors.name if has_names else factors.label
    if given is None:
        raise RadiosityError("these form factors have neither names nor labels of patches: give groups=")
    if given.shape != (len(factors),):
        raise RadiosityError(f"groups have one name or number for each of {len(factors)} patches, not {given.shape}")
    found, first, place = np.unique(given, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    names = np.array([str(name) or UNNAMED for name in found[order]], dtype=str)
    return names, rank[place.reshape(-1)]


def named_patch(patches: Patches, number: int) -> str:
    """A patch in words, with the group that it is in, as :func:`group_index` names it: ``patch 7 of group 'floor'``."""
    name = str(patches.names[number]) or (str(patches.labels[number]) if patches.labels[number] != number else "")
    return f"patch {number} of group '{name}'" if name else f"patch {number}"


def between_groups(factors: FormFactors, groups: ArrayLike | None = None) -> FormFactors:
    """Form factors between groups of patches: F_IJ = sum_i A_i sum_j F_ij / A_I over the patches i of group I and j of
    group J. Row sums, the sky and reciprocity are those of the patches.

    groups: see :func:`group_index`. The rows of the result have the names of the groups (``name``), the first face of
    each, and the index as label. Errors are the roots of summed squares, where both directions inside a group have
    the same lines; entries of a row vary against each other, so the true errors are smaller.
    """
    names, group = group_index(factors, groups)
    count, n = len(names), len(factors)
    gather = sparse().csr_array((np.ones(n), (group, np.arange(n))), shape=(count, n))
    areas = np.bincount(group, factors.areas, count).astype(np.float64)
    per_area = sparse().diags_array(inverse(areas)).tocsr()
    weigh = sparse().diags_array(factors.areas).tocsr()
    matrix = (per_area @ gather @ weigh @ factors.matrix @ gather.T).tocsr()
    noise = (weigh @ factors.errors).tocsr()
    variance = (gather @ (noise * noise) @ gather.T).tocsr()
    shared = (noise * noise.T.tocsr()).tocoo()
    inside = group[shared.row] == group[shared.col]
    twice = np.bincount(group[shared.row[inside]], shared.data[inside], count)
    errors = matrix.tocoo()
    squares = entries_of(variance, errors.row, errors.col) + np.where(errors.row == errors.col, twice[errors.row], 0.0)
    errors.data = np.sqrt(squares) * inverse(areas)[errors.row]
    mean = per_area @ gather @ weigh
    shares: dict[str, Any] = {name: mean @ share for name, share in factors.ends.items()}
    zone = None
    if factors.zone is not None:
        first = np.unique(group, return_index=True)[1]
        zone = factors.zone[first]
        zone[group[zone[group] != factors.zone]] = ""  # groups with patches of several zones
    face = None
    if factors.face is not None:
        face = np.full(count, factors.face.max())
        np.minimum.at(face, group, factors.face)
    return replace(
        factors,
        matrix=matrix,
        errors=errors.tocsr(),
        areas=areas,
        lines=np.bincount(group, factors.lines, count),
        face=face,
        label=np.arange(count),
        name=names,
        zone=zone,
        **shares,
    )
