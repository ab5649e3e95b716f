"""Patches from the arrays of a file, and their differences from others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .patches import Patches

#: Vertices differ by less than this, in radii of the scene, and colours and areas by less than that, relatively: errors
#: of single precision.
_SAME, _SAME_COLOUR = 1e-5, 1e-3


def saved_patches(arrays: Mapping[str, NDArray[Any]], **properties: Any) -> Patches:
    """Patches from their ``vertices``, ``faces``, ``front`` and ``back``, and in files of this version ``other_side``
    and ``face``. ``properties`` are arguments of :class:`Patches`. Raises :class:`KeyError` for a missing array.
    """
    front, faces = arrays["front"].astype(np.int64), arrays["faces"].astype(np.int64)
    if "other_side" in arrays:
        other = arrays["other_side"]
        two_sided = other[(other < 0) | (other > np.arange(len(other)))] >= 0
    else:  # a file of an earlier version, without empty patches
        two_sided = np.zeros(int(front.max()) + 1, dtype=bool)
        two_sided[front[arrays["back"] >= 0]] = True
    # Empty patches have a face that is left out.
    patch = np.concatenate([front, np.setdiff1d(np.arange(len(two_sided)), front)])
    return Patches(
        arrays["vertices"],
        np.concatenate([faces, np.zeros((len(patch) - len(front), 4), np.int64)]),
        ids=patch,
        two_sided=two_sided,
        left_out=np.arange(len(front), len(patch)),
        numbers=arrays["face"].astype(np.int64)[patch] if "face" in arrays else None,
        obstacles=np.flatnonzero(patch < 0),
        **properties,
    )


def differences(saved: Patches, patches: Patches, *, divided: bool = False, light: bool = True) -> list[str]:
    """What distinguishes ``saved`` patches from others, in words; empty if they are the same but for rounding.

    divided: whether the saved ones may be parts of the others; only their extent is compared if so. light: whether
    reflectance, emission and sky are compared.
    """
    if divided and len(saved.faces) != len(patches.faces):
        return _of_extent(saved, patches)
    return _of_faces(saved, patches) or (_of_light(saved, patches) if light else [])


def _of_extent(there: Patches, here: Patches) -> list[str]:
    apart = np.abs(np.subtract(here.bounds, there.bounds)).max()
    area, other = here.face_areas.sum(), there.face_areas.sum()
    different = [f"its box differs by {apart:.3g}"] if apart > _SAME * here.sphere[1] else []
    return different + ([f"its area is {other:.6g}, not {area:.6g}"] if abs(other - area) > _SAME_COLOUR * area else [])


def _of_faces(there: Patches, here: Patches) -> list[str]:
    if len(here) != len(there) or len(here.faces) != len(there.faces):
        count = f"{len(there)} patches of {len(there.faces)} faces, not {len(here)} of {len(here.faces)}"
        return [f"it has {count}"]
    moved = np.linalg.norm(here.vertices[here.faces] - there.vertices[there.faces], axis=2).max(axis=1)
    moved = moved > _SAME * here.sphere[1]
    if moved.any():
        return [f"{np.count_nonzero(moved)} of {len(moved)} faces are elsewhere, the first is face {np.argmax(moved)}"]
    same = np.array_equal(here.front, there.front) and np.array_equal(here.back, there.back)
    return [] if same else ["faces belong to other patches"]


def _of_light(there: Patches, here: Patches) -> list[str]:
    different = []
    for name in ("reflectance", "emission", "sky"):
        ours, theirs = getattr(here, name), getattr(there, name)
        if ours.shape != theirs.shape:
            different.append(f"{name} has {theirs.shape[-1]} channels, not {ours.shape[-1]}")
            continue
        off = np.abs(ours - theirs) > _SAME_COLOUR * max(float(np.abs(ours).max()), 1e-300)
        if off.any():
            rows = np.asarray(off.any(axis=-1))
            of = f" of {np.count_nonzero(rows)} of {rows.size} patches" if name != "sky" else ""
            different.append(f"the {name}{of} differs")
    return different
