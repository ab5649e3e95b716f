"""What takes part in the experiments: random path tracing, the adaptive integrators and Markov chains on the same
integrand."""

from __future__ import annotations

from typing import Any

from ..measuring import Record
from ..options import Out, Seconds
from ..racing import Entrant
from ..references import Recipe, remade
from .options import ALL, OUT, PictureSize, Scenes
from .scenes import SCENES, SIZES

#: Camera paths of a pass; VEGAS learns after each.
PER_PASS = 16
#: Scenes whose materials the thesis did not sample.
WITHOUT_BSDF = ("cornell-specular",)


def integrand(name: str) -> dict[str, Any]:
    """Settings that all on a scene have in common."""
    return {
        "sampler": "independent",
        "samples_per_pass": PER_PASS,
        "bsdf_sampling": name not in WITHOUT_BSDF,
    }


def of_the_thesis(name: str) -> list[Entrant]:
    """Random path tracing, VEGAS, recursive stratification and Metropolis sampling on the film as the thesis compares
    them, on independent numbers. Chains have path tracing of the same integrand beside them, for the scale."""
    common = integrand(name)
    return [
        Entrant("random", "path", common),
        Entrant("vegas", "vegas", common | {"groups": "light; bounce1; bounce2"}),
        Entrant("stratified", "stratified", common | {"parameters": "light1 bounce1"}),
        Entrant("film Metropolis", "film_metropolis", common),
    ]


def ours(name: str) -> list[Entrant]:
    """What we have beside: chains blended with independent paths, on the same integrand; even numbers, directions by
    the materials; ``guided`` learns where light comes from."""
    common = {"samples_per_pass": PER_PASS}
    return [
        Entrant("pssmlt", "pssmlt", integrand(name)),
        Entrant("path, our settings", "path", common),
        Entrant("guided, our settings", "guided", common),
    ]


def recipe(name: str) -> Recipe:
    """How the reference of a scene is made: unbiased; with light paths where its caustic needs them."""
    return Recipe(name, SCENES[name], "bpt" if name in ("ring", "sitting-room") else "path")


def remake(scenes: Scenes = ALL, size: PictureSize = None, seconds: Seconds = 60.0, out: Out = OUT) -> Record:
    """The references anew, and their noise."""
    return remade([(recipe(name), size or SIZES[name]) for name in scenes], seconds, out)
