"""What takes part in the experiments: the thesis's methods with its settings, on its scenes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from etendue import scene

from ..racing import Entrant
from .scenes import SCENES

#: What the thesis sets, or does without a switch: as many light paths as pixels, connections with every vertex of the
#: light path of the same number, weights by the number of light paths, alpha = 2/3, all photons merged, roulette
#: by albedo. Where it is silent: our defaults.
THESIS: Mapping[str, Any] = {
    "light_paths": 1.0,
    "light_source": "path",
    "eta_discount": 1.0,
    "diffuse_photons": 1.0,
    "alpha": 2.0 / 3.0,
    "direct_light": "all",
    "roulette": "albedo",
    "rr_depth": 1,
}
#: Settings of Russian roulette: that of the thesis, and ours.
ROULETTE: Mapping[str, Mapping[str, Any]] = {"albedo": {}, "throughput": {"roulette": "throughput", "rr_depth": 2}}
#: The merge radius where the thesis gives none, in metres: the middle one of its sweep.
RADIUS = 0.012


def merging(method: str, radius: float = RADIUS, **more: Any) -> dict[str, Any]:
    """Settings of ``bpt``, ``bpm`` or ``vcm`` as in the thesis; ``radius`` is in metres."""
    if method == "bpt":
        return {**THESIS, **more}
    return {**THESIS, "radius": radius, "radius_unit": "absolute", **more}


def the_four(radius: float = RADIUS, roulette: str = "albedo") -> list[Entrant]:
    """VCM, BPT, BPM and PT as the thesis compares them: VCM without merging at the first camera vertex."""
    own = ROULETTE[roulette]
    return [
        Entrant("vcm", "vcm", merging("vcm", radius, merge_first=False, **own)),
        Entrant("bpt", "bpt", merging("bpt", **own)),
        Entrant("bpm", "bpm", merging("bpm", radius, **own)),
        Entrant("path", "path"),
    ]


def open_scene(name: str, size: tuple[int, int]) -> scene.Problem:
    """A scene of the experiments, loaded at a size."""
    return scene.load(SCENES[name](), size=size)
