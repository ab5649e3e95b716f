"""The scenes of three theses, modelled anew: Castro 2002 (global lines), Leeson 2001 (a framework for Monte Carlo),
and one of the Czech Technical University of about 2013 on VCM. They name what is in their scenes, but no measures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from . import blocks
from .bathroom import bathroom
from .car import car
from .hallway import hallway
from .living_room import living_room, sitting_room
from .mirror_balls import mirror_balls
from .offices import diffuse_office, glossy_office
from .plain import cornell_specular, diffuse_room, glass_of_water, silver_ring

_CTU, _LEESON, _CASTRO = "thesis on VCM, CTU", "Leeson 2001", "Castro 2002"

#: Name, description, thesis and place in it, builder.
_ROWS = (
    ("mirror-balls", "polished balls and rings by two small lamps", _CTU, "table 5.6, appendix D", mirror_balls),
    ("living-room", "a sofa, glass on a table, a mirror, small lamps", _CTU, "table 5.7, appendix D", living_room),
    ("bathroom", "tiles, chrome, a mirror and water in the sun", _CTU, "figure 1.1, appendix D", bathroom),
    ("hallway", "a long passage with a polished floor, lit by sconces", _CTU, "appendix D", hallway),
    ("car", "a car under a sky with a low sun", _CTU, "appendix D", car),
    ("diffuse-room", "matt blocks and balls under a broad lamp", _CTU, "table 5.1", diffuse_room),
    ("cornell-specular", "the Cornell box with a tall box by Phong", _LEESON, "figures 6.7, 6.11", cornell_specular),
    ("ring", "a silver ring on a floor, a caustic with a cusp inside", _LEESON, "figure 6.12", silver_ring),
    ("glass-of-water", "a glass of water and its caustics", _LEESON, "figure 6.23", glass_of_water),
    ("sitting-room", "a sofa, a television, two windows", _LEESON, "figures 6.8, 6.9", sitting_room),
    ("diffuse-office", "desks by lamps that shine at the ceiling", _LEESON, "section 6.3", diffuse_office),
    ("glossy-office", "the same with a glossy floor", _LEESON, "figures 6.13, 6.14", glossy_office),
    ("six-cubes", "six grey cubes in a room", _CASTRO, "figures 3.2 to 3.7", blocks.six_cubes),
    ("room", "a table, chairs, a desk, coloured walls", _CASTRO, "figures 3.2 to 3.7, 5.7", blocks.room),
    ("four-chairs", "a table with four chairs", _CASTRO, "figure 3.13", blocks.four_chairs),
    ("nine-cubes", "nine cubes, two groups of four", _CASTRO, "table 4.1", blocks.nine_cubes),
    ("test-one", "a cube and a pyramid", _CASTRO, "tables 4.4, 4.5", blocks.test_one),
    ("office", "six desks with chairs, two shelves", _CASTRO, "figure 5.9", blocks.office),
    ("bleed-box", "a white cube between a red and a green wall", _CASTRO, "figure 6.5", blocks.bleed_box),
    ("curved", "a ball, a column, half a pipe", _CASTRO, "figure 6.6", blocks.curved),
    ("curved-colour", "the same between coloured walls", _CASTRO, "figure 6.7", lambda: blocks.curved(colour=True)),
    ("three-lamps", "three booths with unequal lamps", _CASTRO, "figure 6.8", blocks.three_lamps),
)


def _of(build: Callable[..., Any]) -> Callable[[], dict[str, Any]]:
    return lambda: found.scene() if isinstance(found := build(), blocks.Blocks) else found


#: Name, description and builder of each.
SCENES = [(name, f"{text} ({thesis}, {place})", _of(build)) for name, text, thesis, place, build in _ROWS]
