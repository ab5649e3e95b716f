"""Tests of the faces of a mesh file: for lines, form factors and whatever has an inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from etendue.surfaces import (
    MeshDiagnosis,
    Patches,
    check_patch_file,
    diagnose,
    named_faces,
    orientation,
    read_patches,
    save_patches,
)

from .report import Finding, Findings


def check_mesh(path: Path, seed: int = 0, orient: str | None = None, save: Path | None = None) -> list[Finding]:
    """Test the faces of a mesh file; ``orient``: after they were turned ``outward`` or ``inward``, as
    :func:`etendue.surfaces.read_patches` does; ``save``: a file for them, see :func:`etendue.surfaces.save_patches`.

    The tests are ``faces`` (with an area, none given twice), ``overlaps`` (none on each other that face the same way),
    ``edges`` (every edge has two faces) and ``orientation`` (fronts are outside of solids, or all inside of rooms; see
    :func:`etendue.surfaces.orientation`). Open edges are a warning: light leaves through them. Raises
    :class:`etendue.surfaces.PatchError` for a file that cannot be read.
    """
    if save is not None:
        check_patch_file(save)
    patches = read_patches(path, orient=orient)
    if save is not None:
        save_patches(save, patches)
    found = diagnose(patches)
    findings = Findings(f"mesh {path.name}")
    empty = int(np.count_nonzero(patches.empty))
    findings.judge(
        *("faces", float(empty), 0.0, "every face has an area, and none is given twice"),
        f"{empty} faces have no area or are given twice; they are left out: remove them",
    )
    clashes = f" ({found.overlaps[0, 0]} and {found.overlaps[0, 1]})" if len(found.overlaps) else ""
    findings.judge(
        *("overlaps", float(len(found.overlaps)), 0.0, "no faces lie on each other and face the same way"),
        f"{len(found.overlaps)} pairs of faces lie on each other and face the same way{clashes}: cut one",
    )
    is_whole = _check_edges(findings, found)
    _check_orientation(findings, patches, is_whole, len(found.flipped_edges) > 0, seed)
    return findings.rows


def _check_edges(findings: Findings, found: MeshDiagnosis) -> bool:
    """Whether every edge has two faces, however these are turned."""
    counts = {
        "of one face: the mesh is open": len(found.open_edges),
        "of more than two faces": len(found.crowded_edges),
        "between faces that are turned differently": len(found.flipped_edges),
    }
    if any(counts.values()):
        told = ", and ".join(f"{count} edges are {what}" for what, count in counts.items() if count)
        findings.warn("edges", float(sum(counts.values())), 0.0, told)
        return len(found.open_edges) + len(found.crowded_edges) == 0
    findings.judge("edges", 0.0, 0.0, "every edge has two faces", "")
    return True


def _check_orientation(findings: Findings, patches: Patches, is_whole: bool, is_mixed: bool, seed: int) -> None:
    both = {side: orientation(patches, inward=side == "inward", seed=seed) for side in ("outward", "inward")}
    side = min(both, key=lambda side: len(both[side].wrong))
    # What is wrong both ways is an open sheet that faces down, which may be meant unless its faces differ.
    down = np.intersect1d(both["outward"].wrong, both["inward"].wrong)
    wrong = both[side].wrong if is_mixed else np.setdiff1d(both[side].wrong, down)
    undecided = both[side].undecided
    bad = (
        f"most fronts are turned {side}, but {len(wrong)} are not: {named_faces(wrong)} (counted from 0); --orient "
        f"{side} turns them, here with -o in a new file, and in form-factors, radiosity and heat"
    )
    if len(wrong) and not is_whole:
        findings.warn("orientation", float(len(wrong)), 0.0, bad)
    else:
        findings.judge("orientation", float(len(wrong)), 0.0, f"fronts are turned {side}", bad)
    if len(undecided):
        what = f"{len(undecided)} faces see the outside from both sides: {named_faces(undecided)} (counted from 0)"
        findings.warn("sheets", float(len(undecided)), 0.0, what)
