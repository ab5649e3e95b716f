"""How light arrives at a light vertex."""

from __future__ import annotations

import enum

import drjit as dr
import mitsuba as mi

from etendue.film import Component, after_light_scattering

#: Solid-angle density up to which a scattering is wide. A diffuse surface has 1 / pi at most.
WIDE = 0.5


class Kind(enum.IntEnum):
    """Kind of the light that arrives at a light vertex: its ``film.Component`` for an eye that sees the vertex, and for
    some, how it was sent. Light directly from a beam, which next event cannot sample, is distinguished from other
    direct light, and indirect light by whether the last scattering was wide."""

    BEAM = 0
    DIRECT = Component.DIRECT
    CAUSTIC = Component.CAUSTIC
    INDIRECT = Component.INDIRECT
    DIFFUSE = 4  #: indirect light after a wide scattering
    UNMERGED = 5  #: the same, of a vertex that is drawn not to be merged


def after(kind: mi.UInt32, pdf: mi.Float, is_delta: mi.Bool) -> mi.UInt32:
    """Kind at the vertex that follows one of ``kind``; ``pdf``: density of the scattering there."""
    following = after_light_scattering(dr.minimum(kind, mi.UInt32(Kind.INDIRECT)), is_delta)
    return dr.select(is_wide(pdf, is_delta), mi.UInt32(Kind.DIFFUSE), following)


def is_wide(pdf: mi.Float, is_delta: mi.Bool | bool = False) -> mi.Bool:
    """Whether a scattering of a solid-angle density is wide."""
    return (pdf <= WIDE) & ~mi.Bool(is_delta)


def component_of(kind: mi.UInt32) -> mi.UInt32:
    """The ``film.Component`` of a kind; that of a beam is DIRECT."""
    return dr.clip(kind, mi.UInt32(Component.DIRECT), mi.UInt32(Component.INDIRECT))
