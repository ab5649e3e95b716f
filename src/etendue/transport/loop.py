"""Loops whose body is traced once.

If the body of a symbolic loop leaves a variable of its state unchanged, Dr.Jit traces the body a second time and treats
the variable as a constant. Tracing takes tens of milliseconds a pass in a scene with many materials, and most walks
have such a variable: the time of the ray, the relative index of refraction in a scene without glass, the number of the
lane. Therefore an opaque zero, whose value Dr.Jit does not know, is added to variables that the body has not changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi

S = TypeVar("S")


def loop_traced_once(state: S, going: Callable[[S], mi.Bool], body: Callable[[S], S], label: str) -> S:
    """``dr.while_loop`` of one state, a dataclass; ``body`` may change the state in place."""
    constant = [_is_literal(part) for part in _parts(state)]
    zero = dr.opaque(mi.UInt32, 0)

    def step(s: S) -> tuple[S]:
        before = [part.index for part in _parts(s)]
        return (_changed(body(s), zip(before, constant, strict=True), zero),)

    (state,) = dr.while_loop((state,), going, step, label=label)
    return state


def _is_literal(part: Any) -> bool:
    return bool(part.state == dr.VarState.Literal)


def _parts(value: Any) -> Iterator[Any]:
    """The variables of a state."""
    if is_dataclass(value):
        for field in fields(value):
            yield from _parts(getattr(value, field.name))
    elif isinstance(value, dict):
        for part in value.values():
            yield from _parts(part)
    elif isinstance(value, (list, tuple)) or (dr.is_array_v(value) and dr.depth_v(value) > 1):
        for part in value:
            yield from _parts(part)
    elif isinstance(value, mi.Ray3f):
        for part in (value.o, value.d, value.maxt, value.time, value.wavelengths):
            yield from _parts(part)
    elif dr.is_array_v(value):
        yield value


def _changed(value: Any, earlier: Iterator[tuple[int, bool]], zero: mi.UInt32) -> Any:
    """The state ``value``, with ``zero`` added to each variable that is the same as at the start of the body, or that
    is a literal both before the loop and now. ``earlier``: for each variable, its index at the start of the body and
    whether it was a literal before the loop."""

    def part_of(part: Any) -> Any:
        return _changed(part, earlier, zero)

    if is_dataclass(value):
        for field in fields(value):
            setattr(value, field.name, part_of(getattr(value, field.name)))
    elif isinstance(value, dict):
        return {name: part_of(part) for name, part in value.items()}
    elif isinstance(value, (list, tuple)):
        return type(value)(map(part_of, value))
    elif isinstance(value, mi.Ray3f):
        for name in ("o", "d", "maxt", "time", "wavelengths"):
            setattr(value, name, part_of(getattr(value, name)))
    elif dr.is_array_v(value) and dr.depth_v(value) > 1:
        for i, part in enumerate(value):
            value[i] = part_of(part)
    elif dr.is_array_v(value):
        index, was_literal = next(earlier)
        if value.index == index or (was_literal and _is_literal(value)):
            return value | (zero > 0) if dr.is_mask_v(value) else value + type(value)(zero)
    return value
