"""Where techniques put what they bring: layers of radiance of the camera paths, splats of the light paths, pyramids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ..camera import SplatPlace, Splats
from .mis import Techniques
from .pyramid import Pyramid


@dataclass
class Brought:
    """What a technique brings, one lane each."""

    weighted: Sequence[mi.Color3f]  #: complete with the weight, one a merging radius
    alone: mi.Color3f  #: without a weight, for a pyramid
    active: mi.Bool  #: where ``weighted`` counts
    seen: mi.Bool  #: where ``alone`` counts


@dataclass(kw_only=True)
class Sink:
    """What takes the contributions of a walk."""

    pyramid: Pyramid | None = None  #: gets them technique by technique, those of the first radius


@dataclass(kw_only=True)
class CameraSink(Sink):
    """Takes what camera paths find: radiance by layer, a part of the state of their loop."""

    split_layers: bool  #: keep technique families apart
    more_radii: tuple[str, ...] = ()  #: layers of the pictures of the merging radii after the first

    def begin(self, techniques: Techniques, pixel: mi.UInt32, importance: mi.Color3f) -> dict[str, mi.Color3f]:
        """Layers without light. A pyramid is filled on the way, so it is told the pixel and the weight of each path."""
        self._pixel, self._importance = pixel, importance
        # Not literal zeros: Dr.Jit takes a layer that no material adds to for a constant, then stumbles over it.
        names = (*self.families(techniques), *self.more_radii)
        return {name: mi.Color3f(dr.opaque(mi.Float, 0.0)) for name in names}

    def families(self, techniques: Techniques) -> tuple[str, ...]:
        """What the picture is the sum of: technique families, or the picture itself."""
        if not self.split_layers:
            return ("image",)
        t = techniques
        used = (("next_event", t.next_event), ("connection", t.connection), ("merge", t.merge))
        return ("emission", *(name for name, on in used if on))

    def add(self, layers: dict[str, mi.Color3f], family: str, values: Sequence[mi.Color3f], active: mi.Bool) -> None:
        """Add contributions of a family, one a radius, to its layers."""
        for name, value in zip((family if self.split_layers else "image", *self.more_radii), values, strict=True):
            layers[name][active] += value

    def show(self, s: mi.UInt32, t: mi.UInt32, brought: Brought, merged: bool = False) -> None:
        """Add a contribution to the pyramid. ``s``, ``t``: vertices of the two sub-paths."""
        if self.pyramid is None:
            return
        weighted = dr.select(brought.active, brought.weighted[0], 0.0)
        pixel, importance = self._pixel, self._importance
        self.pyramid.add(merged, s, t, pixel, weighted * importance, brought.alone * importance, brought.seen)


@dataclass(kw_only=True)
class SplatSink(Sink):
    """Takes what light paths splat."""

    splats: Splats
    paths_per_sample: mi.Float  #: light paths for a camera path of a pixel; a pyramid holds means over these

    def add(self, s: mi.UInt32, place: SplatPlace, brought: Brought) -> mi.Bool:
        """Add the splat of a light sub-path of ``s`` vertices; returns where it is not finite, and left out."""
        if self.pyramid is not None:
            scale = dr.rcp(self.paths_per_sample)
            weighted = dr.select(brought.active, brought.weighted[0] * scale, 0.0)
            self.pyramid.add_splat(s, place, weighted, brought.alone * scale, brought.seen)
        finite = mi.Bool(True)
        for value in brought.weighted:
            finite &= dr.all(dr.isfinite(value))
        self.splats.add(place, brought.weighted, brought.active & finite)
        return brought.active & ~finite
