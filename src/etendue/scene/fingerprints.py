"""A digest of a scene: the same in every process, different if a parameter changes.

It walks the scene graph as ``mi.traverse`` does and hashes names, values and class names from the leaves up. Object
names, file paths and addresses are excluded; shapes and emitters enter as a sorted multiset, since Mitsuba's mesh
merging orders them by address.
"""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Any

from etendue.core import as_array

from .graph import contents, plugin_name, shapes
from .space import METERS

if TYPE_CHECKING:
    import mitsuba as mi

#: Lines of an object's description without influence on its appearance: file names, and a mean summed on the device.
_VOLATILE = re.compile(r"^\s*(name|filename|mean) = .*$", re.MULTILINE)
#: Values that only other integrators use.
_IGNORED = {"silhouette_sampling_weight", "allow_thread_reordering"}


def fingerprint(scene: mi.Scene, sensor: mi.Sensor | None, extra: str = "") -> str:
    """Hex digest (32 characters) of every shape, material, texture and emitter of ``scene``, and of ``sensor`` if
    that is given.

    ``extra`` is hashed as well: properties that the loader reads but the loaded scene does not report. Sampler and
    sample count are excluded.
    """
    digests: dict[mi.Object, bytes] = {}
    every_shape = shapes(scene)
    parts = sorted(_digest(s, digests) for s in every_shape)
    parts += sorted(_digest(e, digests) for e in scene.emitters())
    if sensor is not None:
        parts.append(_sensor_digest(sensor))
    parts.append(extra.encode())
    return _hash(parts).hex()


def _hash(parts: list[bytes]) -> bytes:
    h = hashlib.blake2b(digest_size=16)
    for part in parts:
        h.update(len(part).to_bytes(8, "little"))  # so that the borders between parts enter the digest
        h.update(part)
    return h.digest()


def _digest(item: mi.Object, digests: dict[mi.Object, bytes]) -> bytes:
    import mitsuba as mi

    known = digests.get(item)
    if known is not None:
        return known
    inside = contents(item)
    parts = [str(item.class_name()).encode()]
    for name, value in inside.values:
        if name not in _IGNORED:
            parts += [name.encode(), _bytes(value)]
    for role, child in inside.objects:
        # Shapes name their parts by role; a shape group by id, which is arbitrary.
        parts += [b"" if isinstance(child, mi.Shape) else role.encode(), _digest(child, digests)]
    if isinstance(item, mi.Shape):
        if isinstance(item, mi.Mesh):
            parts.append(bytes([item.has_face_normals(), item.has_flipped_normals()]))
    elif not isinstance(item, mi.Emitter):
        parts.append(_description(item))
    result = _hash(parts)
    digests[item] = result
    return result


def _sensor_digest(sensor: mi.Sensor) -> bytes:
    film = sensor.film()
    parts = [str(sensor.class_name()).encode(), _description(film.rfilter()), bytes([film.sample_border()])]
    if plugin_name(sensor) in METERS:  # which do not report their place
        parts.append(_description(sensor))
    for item in (sensor, film):
        for name, value in contents(item).values:
            parts += [name.encode(), _bytes(value)]
    for name, band in contents(film).objects:
        parts += [name.encode(), _digest(band, {})]
    return _hash(parts)


def _description(item: mi.Object) -> bytes:
    """An object's description: it contains settings that ``traverse`` does not report, such as a microfacet
    distribution."""
    try:
        text = str(item)
    except Exception:  # a Python plugin without to_string cannot be printed
        text = type(item).__name__
    return _VOLATILE.sub("", text).encode()


def _bytes(value: Any) -> bytes:
    if isinstance(value, (bool, int, float, str)):
        return repr(value).encode()
    array = as_array(value)
    return str((array.shape, array.dtype.str)).encode() + array.tobytes()
