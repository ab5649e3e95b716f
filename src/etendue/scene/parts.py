"""Parts of a scene: some of its shapes, for processes that do not load the whole scene."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from etendue.core import Array, SceneError, UnsupportedError, use_variant

from .bounds import corners_of
from .changes.transforms import settle_transforms
from .instantiating import instantiated
from .loading import Source, _is_loaded, _mitsuba_errors, _parse, _problem, _resolving, _sensor, locate
from .parsing import keep_shapes, name_shapes, nodes_below, read_properties, take_integrator
from .portables import PortableScene
from .problem import Problem


def load_part(source: Source, shapes: Collection[str], parameters: Mapping[str, Any] | None = None) -> Problem:
    """Load some shapes of a scene: only shapes with ids in ``shapes``, shapes that emit and shape groups are built, and
    only their files are read. Errors as :func:`load`."""
    use_variant()

    name, folders, config, state = _parsed(source, parameters)
    keep_shapes(state, shapes)
    settle_transforms(state, name)
    with _resolving(folders), _mitsuba_errors(name):
        integrator, depth, options = take_integrator(state)
        scene = instantiated(config, state)
    # In the coordinates of the whole scene, not in a render space of the part.
    return _problem(scene, _sensor(scene, 0, name), integrator, depth, options, name, None, "")


def unmerged(state: Any) -> None:
    """A ``change`` for :func:`load`: the shapes of a changed scene are not merged, so that they keep their names and
    order; shapes without a name get one."""
    name_shapes(state)


def shape_boxes(problem: Problem) -> tuple[list[str], Array]:
    """(ids, boxes (n, 6): lower and upper corner) of the shapes of a scene loaded without merging.

    Raises :class:`UnsupportedError` for a scene whose shapes cannot be named, or whose coordinates were changed."""
    shapes = list(problem.scene.shapes())
    ids = [str(shape.id()) for shape in shapes]
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        raise UnsupportedError(f"{problem.source} has several shapes with the id '{twice}'; give each its own")
    if not problem.space.is_own:
        raise UnsupportedError(f"{problem.source} is rendered in other coordinates than its own, and cannot be cut")
    return ids, np.array([np.concatenate(corners_of(shape)) for shape in shapes]).reshape(-1, 6)


def part_files(
    scene: PortableScene, source: Source, shapes: Collection[str], parameters: Mapping[str, Any] | None = None
) -> dict[str, Path]:
    """The files of a portable scene that a part of it needs."""
    use_variant()
    *_, whole = _parsed(source, parameters)
    *_, part = _parsed(source, parameters)
    keep_shapes(part, shapes)
    reached = nodes_below(part, [part.root])
    every = [_texts(node) for node in whole.nodes]
    needed = set().union(*(every[k] for k in reached))
    dropped = {Path(text).name for text in set().union(*every) - needed}
    kept = {Path(text).name for text in needed}
    return {place: path for place, path in scene.files.items() if path.name not in dropped - kept}


def _parsed(source: Source, parameters: Mapping[str, Any] | None) -> Any:
    if _is_loaded(source):
        raise SceneError("a scene in memory has no parts that can be loaded; give its file or its dictionary")
    found = locate(source) if isinstance(source, (str, os.PathLike)) else source
    parsed = _parse(found, parameters)
    name_shapes(parsed[-1])
    return parsed


def _texts(node: Any) -> set[str]:
    return {value for value in read_properties(node.props).values() if isinstance(value, str) and value}
