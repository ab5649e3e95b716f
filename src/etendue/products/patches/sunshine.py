"""Direct light of suns on the patches of a source, and its files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from etendue.engine import silent
from etendue.lighting import Suns
from etendue.radiosity import PatchSource, Sunlight, check_sun_file, save_sunlight, sunlight

from ..files import PathLike, Writing, about, check_files, listed


def make_sunlight(
    source: PatchSource,
    suns: Suns,
    outputs: PathLike | Sequence[PathLike] = (),
    tell: Callable[[str], object] = silent,
    on_patches: Callable[[Any], object] = silent,
    **options: Any,
) -> Sunlight:
    """See :func:`etendue.radiosity.sunlight`, whose ``options`` are. ``tell`` receives the current step, ``on_patches``
    the patches beforehand. Raises the errors of files before anything is computed."""
    files: tuple[Path, ...] = tuple(check_sun_file(path) for path in listed(outputs))
    check_files(files)
    problem = source.open(tell)
    on_patches(problem.patches)
    found = sunlight(problem.patches, suns, tell=tell, **options)
    writing = Writing()
    for path in files:
        with writing.attempt(f"write '{path}'"):
            save_sunlight(path, found, metadata=about(problem.source, suns=len(suns), **options))
    writing.finish()
    return found
