"""The pictures of a page, with their metadata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError

Image = NDArray[np.float32]


@dataclass
class Entry:
    """One picture of a page.

    ``image`` is (height, width, 3) linear radiance. ``metadata`` is that of a ``Result``: ``settings`` and ``versions``
    (mappings) get tables of their own, ``seconds`` and ``passes`` go to the caption, everything else is listed.
    ``error_history`` holds rows (seconds, relMSE) or (seconds, relMSE, its standard error). ``layers`` are further
    pictures to show, by name. ``defaults`` are the default settings, ``command`` is a command that repeats the picture.
    """

    name: str
    image: Image
    metadata: Mapping[str, Any] = field(default_factory=dict)
    error_history: Sequence[tuple[float, ...]] = ()
    layers: Mapping[str, Image] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    command: str = ""


def check_entries(entries: Sequence[Entry], reference: Image | None) -> None:
    """Raise :class:`OptionError` without a picture, for two pictures of one name, and for different sizes."""
    if not entries:
        raise OptionError("a comparison needs at least one picture")
    names = [e.name for e in entries]
    if len(set(names)) < len(names):
        raise OptionError(f"pictures of a comparison need different names, not {', '.join(names)}")
    shapes = {e.name: e.image.shape for e in entries} | ({} if reference is None else {"reference": reference.shape})
    if len(set(shapes.values())) > 1 or any(len(s) != 3 or s[2] != 3 for s in shapes.values()):
        listed = ", ".join(f"{name} is {' x '.join(map(str, shape))}" for name, shape in shapes.items())
        raise OptionError(f"pictures of a comparison need one size with three channels; {listed}")
