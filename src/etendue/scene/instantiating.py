"""From a parsed description to a scene of Mitsuba, with what Mitsuba would not get right by itself put in order."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.core import threads_for_files
from etendue.film import is_exr

from .curves import extend_curves
from .graph import plugin_name
from .lamps.environments import light_poles
from .parsing import read_properties, read_property

if TYPE_CHECKING:
    import mitsuba as mi


def instantiated(config: mi.parser.ParserConfig, state: mi.parser.ParserState) -> mi.Scene:
    """The scene of a parsed description. Environment maps that Mitsuba would not sample well get more rows, and the
    emitters ``sky`` the sphere around the scene, except those that are objects of the caller; curves become safe."""
    import mitsuba as mi

    given = [value for value in read_properties(state.root.props).values() if isinstance(value, mi.Emitter)]
    with threads_for_files() if _reads_openexr(state) else nullcontext():
        scene = mi.parser.instantiate(config, state)
    for emitter in scene.emitters():
        if emitter in given:
            continue
        light_poles(emitter)
        if plugin_name(emitter) == "sky":
            emitter.surround(scene.bbox())
    extend_curves(scene)
    return scene


def _reads_openexr(state: mi.parser.ParserState) -> bool:
    """Whether a file of the scene is one of OpenEXR, whatever its name."""
    import mitsuba as mi

    names = {read_property(node.props, "filename") for node in state.nodes if "filename" in node.props}
    paths = [Path(str(mi.file_resolver().resolve(name))) for name in names if isinstance(name, str)]
    return any(path.is_file() and is_exr(path) for path in paths)
