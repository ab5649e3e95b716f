"""How messages name inputs: as arguments in Python, as options on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from etendue.core import OptionError, is_number


class Wording:
    """Names of arguments in Python; the command line has a subclass.

    Attributes
    ----------
    mesh_light: how to give light to a mesh.
    lightmap: how to request a lightmap.
    """

    mesh_light = "read it by etendue.radiosity.read_patches, with emission, temperature or sky"
    lightmap = "name the file of one, as lightmap='room.exr'"

    def option(self, name: str) -> str:
        """The argument ``name``."""
        return f"{name}="

    def limit(self, name: str) -> str:
        """The limit ``name`` of a budget."""
        return name

    def resume(self, checkpoint: Path, limit: str = "", count: int = 0) -> str:
        """How to resume a checkpoint, up to ``count`` of ``limit`` if that is given."""
        return f"resume='{checkpoint}'" + (f", {limit}={count}" if limit else "")

    def check_count(self, name: str, value: Any) -> None:
        """Raise :class:`OptionError` unless the limit ``name`` is ``None`` or a whole number of at least 1."""
        if value is not None and not (is_number(value) and float(value).is_integer() and value >= 1):
            raise OptionError(f"a budget in {self.limit(name)} must be a whole number of at least 1, not {value!r}")

    def check_either(self, one: str, value: Any, other: str, value_of_other: Any) -> None:
        """As :meth:`check_count` for two limits, of which at most one may be given."""
        self.check_count(one, value)
        self.check_count(other, value_of_other)
        if value is not None and value_of_other is not None:
            raise OptionError(f"{self.option(one)} and {self.option(other)} limit the same; give one of them")


PYTHON = Wording()
