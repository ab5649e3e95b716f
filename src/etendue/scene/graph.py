"""Traversal of a Mitsuba scene graph: the contents of objects, and their names for messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi

#: C++ class names whose plugin name is not the lower-case name.
_PLUGIN_NAMES = {
    "SmoothDiffuse": "diffuse",
    "SmoothConductor": "conductor",
    "SmoothDielectric": "dielectric",
    "SmoothPlastic": "plastic",
    "MaskBSDF": "mask",
    "TwoSidedBRDF": "twosided",
    "LinearPolarizer": "polarizer",
    "CircularPolarizer": "circular",
    "LinearRetarder": "retarder",
    "PolarizedPlastic": "pplastic",
    "MeasuredPolarized": "measured_polarized",
    "AreaLight": "area",
    "PointLight": "point",
    "SpotLight": "spot",
    "ConstantBackgroundEmitter": "constant",
    "EnvironmentMapEmitter": "envmap",
    "DirectionalEmitter": "directional",
    "SunskyEmitter": "sunsky",
    "TimedSunskyEmitter": "timed_sunsky",
    "PerspectiveCamera": "perspective",
    "ThinLensCamera": "thinlens",
    "OrthographicCamera": "orthographic",
    "BatchSensor": "batch",
    "DistantSensor": "distant",
    "DistantSensorImpl": "distant",
    "BitmapTextureImpl": "bitmap",
    "PLYMesh": "ply",
    "OBJMesh": "obj",
    "SerializedMesh": "serialized",
    "ShapeGroupPlugin": "shapegroup",
    "HomogeneousMedium": "homogeneous",
    "HeterogeneousMedium": "heterogeneous",
    "TabulatedPhaseFunction": "tabphase",
    "BlendPhaseFunction": "blendphase",
    "PathIntegrator": "path",
    "DirectIntegrator": "direct",
    "ParticleTracerIntegrator": "ptracer",
    "VolumetricPathIntegrator": "volpath",
    "VolumetricMisPathIntegrator": "volpathmis",
}


@dataclass
class Contents:
    """What ``mi.traverse`` reports for one object: plain values, and child objects, in the object's order."""

    values: list[tuple[str, Any]] = field(default_factory=list)
    objects: list[tuple[str, mi.Object]] = field(default_factory=list)


@lru_cache(maxsize=8)
def _collector(variant: str) -> type:
    # A class per variant, as Mitsuba's types exist only once a variant is set.
    class Collector(mi.TraversalCallback):
        def __init__(self, owner: mi.Object) -> None:
            super().__init__()
            self.owner = owner
            self.contents = Contents()

        def put(self, name: str, value: Any, flags: mi.ParamFlags, cpptype: Any = None) -> None:
            if isinstance(value, mi.Object):
                self.contents.objects.append((name, value))
            elif value is not None:
                if cpptype is not None:
                    value = mi.get_property(value, cpptype, self.owner)
                self.contents.values.append((name, value))

    return Collector


def contents(item: mi.Object) -> Contents:
    """The direct contents of a Mitsuba object."""
    collector = _collector(mi.variant())(item)
    item.traverse(collector)
    return collector.contents


def below(item: mi.Object) -> Iterator[mi.Object]:
    """Every object under ``item``, each once, parents before children; ``item`` itself first."""
    seen: set[int] = set()
    keep = []  # wrappers must outlive the walk, or another object could reuse an id()
    stack = [item]
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        keep.append(node)
        yield node
        stack.extend(child for _, child in reversed(contents(node).objects))


def without_literals(root: mi.Object) -> None:
    """Make the numbers of ``root`` and of all below it variables of the device. Mitsuba leaves some as literals, such
    as the transformation of a rectangle: each value would need kernels of its own, also for reading it."""
    for item in below(root):
        for _, value in contents(item).values:
            if isinstance(value, dr.ArrayBase) or "Transform" in type(value).__name__:
                dr.make_opaque(value)  # each by itself: a kernel of thousands of numbers compiles for half a minute


def shapes(scene: mi.Scene) -> list[mi.Shape]:
    """Every shape of a scene, those inside shape groups included."""
    found = {id(shape): shape for shape in scene.shapes()}
    for _, child in contents(scene).objects:
        if isinstance(child, mi.Shape) and id(child) not in found:
            found |= {id(one): one for one in below(child) if isinstance(one, mi.Shape)}
    return list(found.values())


def materials(scene: mi.Scene) -> Iterator[mi.Object]:
    """Every material of a scene with its nested materials and textures."""
    for shape in shapes(scene):
        bsdf = shape.bsdf()
        if bsdf is not None:
            yield from below(bsdf)


def plugin_name(item: mi.Object) -> str:
    """The plugin name of an object in a scene file, such as ``roughconductor``."""
    own = getattr(item, "plugin_name", None)  # Python plugins may define it
    if isinstance(own, str):
        return own
    name = str(item.class_name()).split("[")[0]
    if type(item).__name__.endswith("Integrator") and name == "SamplingIntegrator":
        name = type(item).__name__  # Mitsuba's Python integrators
    return _PLUGIN_NAMES.get(name, name.removesuffix("Integrator").removesuffix("PhaseFunction").lower())


def name(item: mi.Object) -> str:
    """The id that the scene gave, empty if it gave none."""
    own = str(item.id())
    return "" if own.startswith(("_unnamed", "_arg_", "__root__")) else own


def describe(item: mi.Object, role: str) -> str:
    """``ROLE 'ID' of type 'PLUGIN'``, without the id if the scene gave none."""
    own, kind = name(item), plugin_name(item)
    return f"{role} '{own}' of type '{kind}'" if own else f"{role} of type '{kind}'"


def short(shape: mi.Shape) -> str:
    """A shape's name, or its type if it has none."""
    own = describe(shape, "shape")
    return own.partition(" of type")[0] if own.startswith("shape '") else own


def described_emitter(emitter: mi.Emitter) -> str:
    """A description of an emitter, with the shape that it is on."""
    own, shape = describe(emitter, "emitter"), emitter.get_shape()
    on_surface = shape is not None and mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface)
    return f"{own} on {short(shape)}" if on_surface else own
