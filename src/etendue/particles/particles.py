"""Particles: hits of light paths on surfaces, with their flux."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import InNotebooks, short_repr

from .errors import ParticleError

#: Type and shape of a row of each field, in the order of the fields.
LAYOUT: dict[str, tuple[str, tuple[int, ...]]] = {
    "position": ("<f4", (3,)),
    "direction": ("<f4", (3,)),
    "power": ("<f4", (3,)),
    "shape": ("<u4", ()),
    "primitive": ("<u4", ()),
    "uv": ("<f4", (2,)),
    "path": ("<u4", ()),
    "bounce": ("<u4", ()),
}
#: Bytes of a particle whose fields are not packed.
RAW_BYTES = sum(np.dtype(kind).itemsize * int(np.prod(shape)) for kind, shape in LAYOUT.values())
#: Words of four bytes of a particle.
WORDS = RAW_BYTES // 4

#: Particles as words, (n, ``WORDS``) uint32: the fields of a row one after the other, floats by their bits.
Rows = NDArray[np.uint32]


def columns_of(name: str) -> slice:
    """The columns of a field in :data:`Rows`."""
    first = 0
    for known, (_, shape) in LAYOUT.items():
        end = first + int(np.prod(shape))
        if known == name:
            return slice(first, end)
        first = end
    raise KeyError(name)


@short_repr
@dataclass(frozen=True)
class Particles(InNotebooks):
    """Hits of light paths on surfaces. The summed power of the particles on a surface estimates its incident flux.

    Attributes
    ----------
    position: (n, 3) float32, in the scene's units.
    direction: (n, 3) float32, unit vector of flight, towards the surface.
    power: (n, 3) float32, incident flux in W: red, green, blue; already divided by the number of paths.
    shape: (n,) uint32, index in ``scene.shapes()``.
    primitive: (n,) uint32, triangle of a mesh; 0 for other shapes. In an instance, numbers count the primitives of all
        shapes of its group.
    uv: (n, 2) float32, parameters on the primitive: the barycentric coordinates of the second and third vertex on a
        triangle, surface parameters of other shapes in [0, 1]^2.
    path: (n,) uint32, number of the light path within its pass.
    bounce: (n,) uint32, edges from the light; 1 is direct light.

    Raises :class:`ParticleError` if the arrays do not have these shapes.
    """

    position: NDArray[np.float32]
    direction: NDArray[np.float32]
    power: NDArray[np.float32]
    shape: NDArray[np.uint32]
    primitive: NDArray[np.uint32]
    uv: NDArray[np.float32]
    path: NDArray[np.uint32]
    bounce: NDArray[np.uint32]

    def __post_init__(self) -> None:
        count = len(self.position)
        for name, (kind, row) in LAYOUT.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=kind)
            if array.shape != (count, *row):
                raise ParticleError(f"'{name}' of {count} particles has the shape {(count, *row)}, not {array.shape}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: slice | NDArray[np.bool_] | NDArray[np.integer]) -> Particles:
        return Particles(*(getattr(self, f.name)[index] for f in fields(self)))

    @classmethod
    def empty(cls) -> Particles:
        """No particles."""
        return cls(*(np.zeros((0, *row), kind) for kind, row in LAYOUT.values()))

    @classmethod
    def joined(cls, parts: Sequence[Particles]) -> Particles:
        """The particles of ``parts``, one after the other."""
        if not parts:
            return cls.empty()
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    @classmethod
    def of_rows(cls, rows: Rows, scale: float = 1.0) -> Particles:
        """Particles of :data:`Rows`, with their power times ``scale``."""
        arrays: dict[str, Any] = {}
        for name, (kind, shape) in LAYOUT.items():
            array = np.ascontiguousarray(rows[:, columns_of(name)]).view(kind)
            arrays[name] = array.reshape(len(rows), *shape)
        if scale != 1.0:
            arrays["power"] = (arrays["power"] * np.float64(scale)).astype(np.float32)
        return cls(**arrays)

    @property
    def rows(self) -> Rows:
        """These particles as :data:`Rows`."""
        result = np.empty((len(self), WORDS), np.uint32)
        for name in LAYOUT:
            result[:, columns_of(name)] = getattr(self, name).view(np.uint32).reshape(len(self), -1)
        return result
