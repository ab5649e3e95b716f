"""Ambient terms as solutions, and for the light that other solutions leave unshot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from etendue.core import Array
from etendue.surfaces import AmbientTerm, Patches

from ..errors import RadiosityError
from ..solvers.multipath import Multipath
from ..solvers.shot import FirstShot
from ..solvers.system import Solution, after_shot
from .spreading import spread
from .subscenes import SubScene, hierarchical_ambient


def ambient_solution(
    patches: Patches, term: AmbientTerm = "fuzzy", scene: SubScene | None = None, shot: FirstShot | None = None
) -> Solution:
    """Radiosities without lines: all light that patches emit, spread by an ambient term [Castro 2002, ch. 6].

    scene: the patches as a tree of sub-scenes (:func:`sub_scenes`), between which light passes through walls of boxes.
    shot: light that rays have sent (:func:`first_shot`): shadows of lamps are then right, and only reflected light is
    ambient.

    Ambient irradiance depends only on the normals of patches (and on their sub-scene): there are no shadows, and no
    light is lost. Raises :class:`RadiosityError` if no patch emits, if there is a sky (only lines can find which
    patches see it), or if a shot belongs to other patches.
    """
    if patches.sky.any():
        raise RadiosityError("an ambient term does not know what sees the sky: cast lines, or leave the sky out")
    if not patches.emission.any():
        raise RadiosityError("no patch emits light: give one an emission above zero")
    rest = patches if shot is None else after_shot(shot, patches)
    power = patches.areas[:, None] * rest.emission
    if scene is None:
        irradiance = spread(patches, power, term)
    else:
        irradiance = hierarchical_ambient(patches, scene, power, term).irradiance
    if shot is not None:
        irradiance = irradiance + shot.irradiance
    radiosity = patches.emission + patches.reflectance * irradiance
    return Solution(patches, radiosity, irradiance, np.zeros(len(patches)), (), shot)


def finished(patches: Patches, result: Multipath, term: AmbientTerm = "fuzzy", lost: Array | None = None) -> Multipath:
    """The result of multipath with its unshot power spread by an ambient term. ``lost``: see :func:`spread`."""
    irradiance = spread(patches, result.unshot, term, lost)
    absorbed = (patches.areas[:, None] * (1 - patches.reflectance) * irradiance).sum(axis=0)
    return replace(
        result,
        radiosity=result.radiosity + patches.reflectance * irradiance,
        unshot=np.zeros_like(result.unshot),
        absorbed=result.absorbed + absorbed,
        to_sky=result.to_sky + result.unshot.sum(axis=0) - absorbed,
    )
