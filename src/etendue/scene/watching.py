"""Whether a scene was edited since it was last looked at, told without reading a number of it."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from .graph import contents


class Parameters:
    """The parameters that ``mi.traverse`` shows of ``root`` and all below it, as they are now.

    Two of them are equal if nothing was edited between. Scalars are compared by value, arrays by the number of their
    Dr.Jit variable, as ``SceneParameters.update`` does. The variables are held, so that their numbers are not given to
    others, and so that a write into one (``dr.scatter``, ``params[key][i] = x``) goes to a copy with another number.
    Numbers written through a NumPy view of an array are not seen.

    ``apart``: types of objects that are left out with all below them. Objects themselves are not held.
    """

    def __init__(self, root: Any, apart: tuple[type, ...] = ()) -> None:
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

    def hold(self, variable: Any) -> None:
        """Take an array that is no parameter into the comparison."""
        self._found += (self._identity(variable),)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Parameters) and self._found == other._found

    __hash__ = None  # type: ignore[assignment]  # what is compared is held, not frozen

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


def parameters(scene: Any) -> Parameters:
    """Those of a scene that a picture through any sensor depends on."""
    import mitsuba as mi

    found = Parameters(scene, (mi.Sensor, mi.Integrator))
    found.hold(scene.emitters_dr())  # tells scenes apart that are made of the same arrays
    return found


def view(sensor: Any) -> Parameters:
    """Those of a sensor and its film."""
    import mitsuba as mi

    return Parameters(sensor, (mi.Sampler,))
