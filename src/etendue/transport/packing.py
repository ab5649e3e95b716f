"""Unit vectors in few numbers, and light in packets of four."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.scene import Packet


def packed_direction(d: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
    """A unit vector as two numbers, by the octahedral map [Cigolle 2014]."""
    inverse = dr.rcp(dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z))
    u, v = d.x * inverse, d.y * inverse
    folded_u, folded_v = dr.copysign(1.0 - dr.abs(v), u), dr.copysign(1.0 - dr.abs(u), v)
    return dr.select(d.z < 0.0, folded_u, u), dr.select(d.z < 0.0, folded_v, v)


def unpacked_direction(u: mi.Float, v: mi.Float) -> mi.Vector3f:
    """Inverse of :func:`packed_direction`."""
    z = 1.0 - dr.abs(u) - dr.abs(v)
    beyond = dr.maximum(-z, 0.0)
    return mi.Vector3f(dr.normalize(mi.Vector3f(u - dr.copysign(beyond, u), v - dr.copysign(beyond, v), z)))


def packed_normal(n: mi.Vector3f) -> mi.Float:
    """A unit vector as one number, with an error of up to 3e-5."""
    u, v = packed_direction(n)
    words = [mi.UInt32(dr.round((x + 1.0) * 32767.0)) for x in (u, v)]
    return dr.reinterpret_array(mi.Float, words[0] | (words[1] << 16))


def unpacked_normal(packed: mi.Float) -> mi.Vector3f:
    """Inverse of :func:`packed_normal`."""
    word = dr.reinterpret_array(mi.UInt32, packed)
    u, v = ((mi.Float(x) - 32767.0) * (1.0 / 32767.0) for x in (word & 0xFFFF, word >> 16))
    return unpacked_direction(u, v)


def packed_light(light: mi.Spectrum) -> tuple[list[mi.Float], mi.Float | None]:
    """(three numbers of light for a packet; the fourth, of spectral light only)."""
    numbers = [*light, *[mi.Float(0.0)] * 2]
    return numbers[:3], light[3] if dr.size_v(light) > 3 else None


def unpacked_light(packet: mi.Vector4f, fourth: mi.Float | None) -> mi.Spectrum:
    """Inverse of :func:`packed_light`."""
    return mi.Spectrum(*[*packet.xyz, fourth][: dr.size_v(mi.Spectrum)])


def packed_sum(light: mi.Color3f | mi.Spectrum) -> mi.Vector4f:
    """A colour, or light at four wavelengths, to be added to others in memory."""
    return mi.Vector4f(*light, *[0.0] * (4 - len(light)))


def unpacked_sum(packed: mi.Vector4f, packet: Packet) -> mi.Color3f | mi.Spectrum:
    """Inverse of :func:`packed_sum`."""
    return mi.Color3f(packed.xyz) if packet.bands is None else mi.Spectrum(*packed)
