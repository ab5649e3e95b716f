"""Outputs of the techniques: layers of radiance of the camera paths, splats of the light paths, the pyramid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..camera import SplatPlace, Splats
from .mis import Techniques
from .pyramid import Pyramid


@dataclass
class Contribution:
    """Contribution of one technique, one lane a path."""

    weighted: Sequence[mi.Color3f]  #: with its weight, one a merging radius
    alone: mi.Color3f  #: without a weight, for the pyramid
    active: mi.Bool  #: lanes that add ``weighted``
    visible: mi.Bool  #: lanes that add ``alone``


@dataclass(kw_only=True)
class Sink:
    """Output of a walk."""

    pyramid: Pyramid | None = None  #: adds contributions of the first radius by technique


@dataclass(kw_only=True)
class CameraSink(Sink):
    """Adds contributions of camera paths to layers of radiance, which are part of the loop state."""

    split_layers: bool  #: a layer for each technique family
    more_radii: tuple[str, ...] = ()  #: names of the layers of the merging radii after the first

    def begin(self, techniques: Techniques, pixel: mi.UInt32, importance: mi.Color3f) -> dict[str, mi.Color3f]:
        """Initial layers. ``pixel`` and ``importance`` of the paths are kept for the pyramid."""
        self._pixel, self._importance = pixel, importance
        # Opaque, because Dr.Jit fails on literal zeros in a loop if no material of the scene adds to a layer.
        names = (*self.families(techniques), *self.more_radii)
        return {name: mi.Color3f(dr.opaque(mi.Float, 0.0)) for name in names}

    def families(self, techniques: Techniques) -> tuple[str, ...]:
        """Names of the layers whose sum is the picture."""
        if not self.split_layers:
            return ("image",)
        t = techniques
        used = (("next_event", t.next_event), ("connection", t.connection), ("merge", t.merge))
        return ("emission", *(name for name, on in used if on))

    def add(self, layers: dict[str, mi.Color3f], family: str, values: Sequence[mi.Color3f], active: mi.Bool) -> None:
        """Add values of a technique family, one a radius."""
        for name, value in zip((family if self.split_layers else "image", *self.more_radii), values, strict=True):
            layers[name][active] += value

    def show(self, s: mi.UInt32, t: mi.UInt32, contribution: Contribution, merged: bool = False) -> None:
        """Add a contribution to the pyramid, if there is one. ``s``, ``t``: vertices of the light and camera
        sub-paths."""
        if self.pyramid is None:
            return
        weighted = dr.select(contribution.active, contribution.weighted[0], 0.0)
        pixel, importance = self._pixel, self._importance
        self.pyramid.add(
            merged, s, t, pixel, weighted * importance, contribution.alone * importance, contribution.visible
        )


@dataclass(kw_only=True)
class SplatSink(Sink):
    """Adds contributions of light paths to the pixels."""

    splats: Splats
    paths_per_sample: mi.Float  #: light paths per camera path of a pixel, by which splats in the pyramid are divided

    def add(self, s: mi.UInt32, place: SplatPlace, contribution: Contribution) -> mi.Bool:
        """Add the splat of a light sub-path of ``s`` vertices. Returns the mask of values that are not finite and
        therefore not added."""
        if self.pyramid is not None:
            scale = dr.rcp(self.paths_per_sample)
            weighted = dr.select(contribution.active, contribution.weighted[0] * scale, 0.0)
            self.pyramid.add_splat(s, place, weighted, contribution.alone * scale, contribution.visible)
        finite = mi.Bool(True)
        for value in contribution.weighted:
            finite &= dr.all(dr.isfinite(value))
        self.splats.add(place, contribution.weighted, contribution.active & finite)
        return contribution.active & ~finite
