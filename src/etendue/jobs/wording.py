"""How messages name inputs: as arguments in Python, as options on the command line."""

from __future__ import annotations

from pathlib import Path


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

    def resume(self, checkpoint: Path, limit: str, count: int) -> str:
        """How to resume a checkpoint up to ``count`` of ``limit``."""
        return f"resume='{checkpoint}', {limit}={count}"


PYTHON = Wording()
