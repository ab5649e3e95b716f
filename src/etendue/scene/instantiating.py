"""From a parsed description to a scene of Mitsuba, with what Mitsuba would not get right by itself put in order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from etendue.core import threads_for_files

from .curves import extend_curves
from .graph import plugin_name
from .lamps.environments import light_poles
from .parsing import read_properties

if TYPE_CHECKING:
    import mitsuba as mi


def instantiated(config: mi.parser.ParserConfig, state: mi.parser.ParserState) -> mi.Scene:
    """The scene of a parsed description. Environment maps that Mitsuba would not sample well get more rows, and the
    emitters ``sky`` the sphere around the scene, except those that are objects of the caller; curves become safe."""
    import mitsuba as mi

    given = [value for value in read_properties(state.root.props).values() if isinstance(value, mi.Emitter)]
    with threads_for_files():
        scene = mi.parser.instantiate(config, state)
    for emitter in scene.emitters():
        if emitter in given:
            continue
        light_poles(emitter)
        if plugin_name(emitter) == "sky":
            emitter.surround(scene.bbox())
    extend_curves(scene)
    return scene
