r"""Components of a picture: emission, direct light, caustics and indirect light, which add up to it.

The component of a path depends on the path alone, not on the technique that samples it. From the light L to the eye E,
with S for a scattering by a mirror or by smooth glass (a delta component of the material) and D for any other
scattering [Heckbert 1990]:

========= ================ =================================================================================
component paths            light
========= ================ =================================================================================
emission  L S* E           of lamps and the environment, seen directly or by mirrors and glass only
direct    L D S* E         that comes straight from a lamp to the first surface D that the camera sees
caustic   L S+ D S* E      that comes there from a lamp by mirrors and glass only
indirect  L .. D .. D S* E all other light
========= ================ =================================================================================

Mirrors and glass between the camera and the surface D do not count: a surface seen through them has the components
that it has when seen directly. Null surfaces are not vertices of a path.
"""

from __future__ import annotations

import enum
from typing import Final

import drjit as dr
import mitsuba as mi


class Component(enum.IntEnum):
    """Components by number."""

    EMISSION = 0
    DIRECT = 1
    CAUSTIC = 2
    INDIRECT = 3

    @property
    def layer(self) -> str:
        """Name of the component's layer."""
        return self.name.lower()


#: Names of the layers, by number.
COMPONENTS: Final[tuple[str, ...]] = tuple(component.layer for component in Component)
#: Layers of reflected light: all but emission.
REFLECTED: Final[tuple[str, ...]] = COMPONENTS[1:]


def after_scattering(seen: mi.UInt32, is_delta: mi.Bool) -> mi.UInt32:
    """Component of a light at the end of the next edge of a camera path, after a scattering at the end of this one.
    ``seen``: the component of a light at the end of this edge, EMISSION for the first edge."""
    by_mirror = dr.select(seen == int(Component.DIRECT), mi.UInt32(Component.CAUSTIC), seen)
    return dr.select(is_delta, by_mirror, reflected(seen))


def reflected(seen: mi.UInt32) -> mi.UInt32:
    """Component of light that comes straight from a lamp and is reflected, not by a mirror, at the end of an edge of a
    camera path."""
    return dr.select(seen == int(Component.EMISSION), mi.UInt32(Component.DIRECT), mi.UInt32(Component.INDIRECT))


def by_component(value: mi.Color3f, component: mi.UInt32) -> list[mi.Color3f]:
    """``value`` as a list over :data:`REFLECTED`, 0 except in its ``component``."""
    return [dr.select(component == number, value, 0.0) for number in range(Component.DIRECT, len(COMPONENTS))]


def after_light_scattering(arriving: mi.UInt32, is_delta: mi.Bool) -> mi.UInt32:
    """Component of the light that the next vertex of a light path reflects to the eye. ``arriving``: the component of
    this vertex; DIRECT at the first vertex, or 0 for a lamp that is distinguished from others, also DIRECT."""
    indirect = mi.UInt32(Component.INDIRECT)
    by_mirror = dr.select(arriving == indirect, indirect, mi.UInt32(Component.CAUSTIC))
    return dr.select(is_delta, by_mirror, indirect)
