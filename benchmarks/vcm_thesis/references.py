"""How the references of the experiments are made."""

from __future__ import annotations

from ..references import Recipe
from .scenes import SCENES

#: VCM with the radius of the thesis's sweep that blurs least, our other settings and other seeds than the experiments;
#: path tracing where everything is matt: it is unbiased, and best there.
_MERGING = {"radius": 0.005, "radius_unit": "absolute"}


def recipe(scene: str) -> Recipe:
    """That of a scene by its name."""
    if scene == "diffuse":
        return Recipe(scene, SCENES[scene], "path")
    return Recipe(scene, SCENES[scene], "vcm", _MERGING, ", first radius 5 mm")
