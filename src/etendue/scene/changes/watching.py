"""Detects whether a scene was edited, without reading its arrays."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any

from ..graph import contents

if TYPE_CHECKING:
    import mitsuba as mi


class Parameters:
    """The current parameters that ``mi.traverse`` reports for ``root`` and everything below it.

    Two objects are equal if nothing was edited in between. Scalars are compared by value, arrays by the index of their
    Dr.Jit variable, as ``SceneParameters.update`` does. References to the variables are kept, so that their indices are
    not reused, and a write into a variable (``dr.scatter``, ``params[key][i] = x``) goes to a copy with another index.
    Writes through a NumPy view of an array are not detected.

    ``apart``: types of objects that are left out, with everything below them. No references to objects are kept.
    """

    def __init__(self, root: mi.Object, apart: tuple[type, ...] = ()) -> None:
        self._held: list[Any] = []
        found: list[Hashable] = []
        seen: set[int] = set()
        alive, stack = [root], [root]  # wrappers must outlive the walk, or another object could reuse an id()
        while stack:
            inside = contents(item := stack.pop())
            found.append(str(item.class_name()))
            found += [(name, self._identity(value)) for name, value in inside.values]
            for _, child in inside.objects:
                if id(child) not in seen and not isinstance(child, apart):
                    seen.add(id(child))
                    alive.append(child)
                    stack.append(child)
        self._found = tuple(found)

    def hold(self, variable: mi.EmitterPtr) -> None:
        """Include an array that is not a parameter in the comparison."""
        self._found += (self._identity(variable),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Parameters) and self._found == other._found

    __hash__ = None  # type: ignore[assignment]  # mutable by hold()

    def _identity(self, value: Any) -> Hashable:
        import drjit as dr

        if "Transform" in type(value).__name__:
            value = value.matrix
        if not dr.is_jit_v(value):
            return repr(value)
        if dr.is_tensor_v(value):
            return value.shape, self._identity(value.array)
        if dr.depth_v(value) > 1:
            return tuple(self._identity(part) for part in value)
        held = dr.detach(value)
        self._held.append(held)
        return int(held.index)


def parameters(scene: mi.Scene) -> Parameters:
    """The parameters of a scene on which pictures through any sensor depend."""
    import mitsuba as mi

    found = Parameters(scene, (mi.Sensor, mi.Integrator))
    found.hold(scene.emitters_dr())  # distinguishes scenes made of the same arrays
    return found


def view(sensor: mi.Sensor) -> Parameters:
    """The parameters of a sensor and its film."""
    import mitsuba as mi

    return Parameters(sensor, (mi.Sampler,))
