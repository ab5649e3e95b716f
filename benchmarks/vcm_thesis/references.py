"""How the references of the experiments are made."""

from __future__ import annotations

from etendue.core import OptionError

from ..measuring import Record
from ..options import Out, Seconds, Size
from ..references import Recipe, remade
from .options import ALL, OUT, SIZE, ReferenceMethod, ReferenceRadius, Scenes
from .scenes import SCENES

#: ``vcm`` merges like what is measured, and shares its blur; the others do not, and are noisier.
METHODS = ("vcm", "bpt", "path")


def recipe(scene: str, method: str = "vcm", millimetres: float = 5.0) -> Recipe:
    """That of a scene by its name: our settings, and other seeds than the experiments have. ``millimetres``: first
    radius of ``vcm``. The diffuse scene always takes ``path``, which is best there."""
    if method not in METHODS:
        raise OptionError(f"references are made by {', '.join(METHODS)}, not by '{method}'")
    if scene == "diffuse":
        return Recipe(scene, SCENES[scene], "path")
    if method != "vcm":
        return Recipe(scene, SCENES[scene], method, mark=method)
    settings = {"radius": millimetres / 1000.0, "radius_unit": "absolute"}
    remark, mark = f", first radius {millimetres:g} mm", f"vcm-{millimetres:g}mm"
    return Recipe(scene, SCENES[scene], "vcm", settings, remark, mark)


def remake(
    scenes: Scenes = ALL,
    size: Size = SIZE,
    seconds: Seconds = 60.0,
    method: ReferenceMethod = "vcm",
    millimetres: ReferenceRadius = 5.0,
    out: Out = OUT,
) -> Record:
    """The references anew, and their noise."""
    return remade([(recipe(name, method, millimetres), size) for name in scenes], seconds, out)
