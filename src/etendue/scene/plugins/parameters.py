"""Scalar parameters of the plugins, checked when they are read and when a user changes them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import OptionError, is_number


def number(props: mi.Properties, key: str, default: float) -> mi.Float:
    """The plugin parameter ``key`` as a float on the device. Raises :class:`OptionError` for anything but a number."""
    value = props.get(key, default)
    if not is_number(value):
        found = value if isinstance(value, float) else f"a {type(value).__name__}"
        raise OptionError(f"'{props.plugin_name()}': '{key}' is a number, not {found}; give one value")
    return mi.Float(float(value))


def check_range(owner: str, key: str, value: mi.Float, low: float, strict: bool = False) -> None:
    """Raise :class:`OptionError` unless ``value`` is one finite number of at least (``strict``: above) ``low``."""
    array = np.asarray(value, dtype=np.float64).ravel()
    fits = array.size == 1 and np.isfinite(array[0]) and (array[0] > low if strict else array[0] >= low)
    if not fits:
        bound = f"above {low:g}" if strict else f"at least {low:g}"
        raise OptionError(f"'{owner}': '{key}' is {np.array2string(array)}; it must be one number {bound}")


def make_opaque(*values: mi.Float) -> None:
    """Make values opaque, so that a change does not recompile kernels."""
    dr.make_opaque(*values)


def block(name: str, **rows: object) -> str:
    """The description of a plugin in Mitsuba's style."""
    lines = []
    for key, value in rows.items():
        text = str(value).replace("\n", "\n  ")
        lines.append(f"  {key} = {text}")
    return f"{name}[\n" + ",\n".join(lines) + "\n]"
