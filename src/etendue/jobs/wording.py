"""How messages name what users give: arguments in Python, options on the command line."""

from __future__ import annotations

from pathlib import Path


class Wording:
    """The words of Python. The command line has its own."""

    #: How light is given to a mesh that has none.
    mesh_light = "read it by etendue.radiosity.read_patches, with emission, temperature or sky"
    #: How a lightmap is asked for.
    lightmap = "name the file of one, as lightmap='room.exr'"

    def option(self, name: str) -> str:
        """The option that gives the argument ``name``."""
        return f"{name}="

    def limit(self, name: str) -> str:
        """What the limit ``name`` of a budget is in."""
        return name

    def resume(self, checkpoint: Path, bundles: int) -> str:
        """How to go on with a checkpoint, to as many bundles as it has."""
        return f"resume='{checkpoint}', bundles={bundles}"


PYTHON = Wording()
