"""Calls of a function for the emitters or the materials of one scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from etendue.core import on_device

from .graph import shapes
from .packet import hero_chosen


class Members:
    """Some objects of one scene, each with a number, its key.

    Calls by pointer and ``dr.dispatch`` visit every object of the process. The kernel then contains the emitters and
    materials of all scenes that exist, and the process crashes if someone has kept an emitter and not its scene: such
    an emitter has a pointer to a shape that was deleted. :meth:`call` visits these objects only.

    The objects are not referenced: a scene may reference its integrator, and this an instance of this class. They are
    looked up while a kernel is traced, when the scene must exist.

    Parameters
    ----------
    kind: class of pointers, ``mi.EmitterPtr`` or ``mi.BSDFPtr``.
    ids: number of each object in Dr.Jit's registry, which is the value of a pointer.
    keys: key of each object, different small integers.
    kept: objects that no scene keeps.
    """

    def __init__(self, kind: type, ids: ArrayLike, keys: ArrayLike, kept: Sequence[mi.Object] = ()) -> None:
        self._kind, self._kept = kind, kept
        self.ids, keys = np.asarray(ids, np.uint32), np.asarray(keys, np.uint32)
        place = np.full(int(keys.max(initial=0)) + 1, len(keys), np.uint32)
        place[keys] = np.arange(len(keys))
        self._place = on_device(mi.UInt32, place)

    def __len__(self) -> int:
        return len(self.ids)

    def call(self, key: mi.UInt32, function: Callable[..., Any], *arguments: Any, active: mi.Bool) -> Any:
        """``function(object, *arguments, active)`` of the object with a key, in each lane; zero in lanes that are not
        active, or whose key no object has."""
        place = dr.gather(mi.UInt32, self._place, key, active)
        targets = [partial(function, self._object(number)) for number in self.ids]
        with hero_chosen():
            if len(self) > 1:
                return dr.switch(place, targets, *arguments, active & (place < len(self)))
            # The label is part of a function's text. A function with the same text in a call of several objects would
            # otherwise have the same name, and LLVM refuses to define it twice.
            return dr.switch(mi.UInt32(0), targets, *arguments, active & (place < 1), label="the only object")

    def _object(self, number: int) -> mi.Object:
        return dr.reinterpret_array(self._kind, mi.UInt32(int(number)))[0]


@dataclass
class Material:
    """The material of a point of a scene, one lane each."""

    pointer: mi.BSDFPtr
    of_scene: Members  #: see :func:`bsdfs`
    #: Lanes in a medium, whose material is a phase function; None in scenes without media that scatter.
    in_medium: mi.Bool | None = None

    def flags(self) -> mi.UInt32:
        """``mi.BSDFFlags``."""
        return self.pointer.flags()

    def call(self, function: Callable[..., Any], *arguments: Any, active: mi.Bool | bool = True) -> Any:
        """``function(bsdf, *arguments, active)``; zero where not active, and where there is no material."""
        key = dr.reinterpret_array(mi.UInt32, self.pointer)
        return self.of_scene.call(key, function, *arguments, active=mi.Bool(active))


def emitters(scene: mi.Scene) -> Members:
    """The emitters of a scene by their pointers."""
    ids = np.asarray(dr.reinterpret_array(mi.UInt32, scene.emitters_dr()))
    return Members(mi.EmitterPtr, ids, ids)


def bsdfs(scene: mi.Scene, sensor: mi.Sensor | None = None) -> Members:
    """The BSDFs of a scene's shapes, and of the surfaces of meters, by their pointers. Those inside other BSDFs are
    left out: no ray finds them."""
    own = [bsdf for shape in shapes(scene) if (bsdf := shape.bsdf()) is not None]
    white = measured_on(sensor)
    if white is not None:
        own.append(white)
    spare = [] if own else [mi.load_dict({"type": "diffuse"})]  # an empty part of a divided scene: never found
    ids = {int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0]) for bsdf in own or spare}
    return Members(mi.BSDFPtr, sorted(ids), sorted(ids), spare)


def measured_on(sensor: mi.Sensor | None) -> mi.BSDF | None:
    """The material of the surfaces at whose points a sensor measures irradiance; None for other sensors."""
    return getattr(sensor, "surface", None)
