"""Outputs of the techniques: layers of radiance of the camera paths, splats of the light paths, the pyramid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.film import COMPONENTS, REFLECTED, Component

from ..camera import SplatPlace, Splats
from .kinds import component_of
from .pyramid import Pyramid
from .techniques import Techniques


@dataclass
class Contribution:
    """Contribution of one technique, one lane per path."""

    weighted: Sequence[mi.Spectrum]  #: with its weight, one per merging radius
    alone: mi.Spectrum  #: without a weight, for the pyramid
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
    components: bool = False  #: a layer for each component
    more_radii: tuple[str, ...] = ()  #: names of the layers of the merging radii after the first

    def begin(self, techniques: Techniques, pixel: mi.UInt32, importance: mi.Spectrum) -> dict[str, mi.Spectrum]:
        """Initial layers. ``pixel`` and ``importance`` of the paths are kept for the pyramid."""
        self._pixel, self._importance = pixel, importance
        # Opaque, because Dr.Jit fails on literal zeros in a loop if no material of the scene adds to a layer.
        names = (*self.families(techniques), *self.more_radii)
        return {name: mi.Spectrum(dr.opaque(mi.Float, 0.0)) for name in names}

    def families(self, techniques: Techniques) -> tuple[str, ...]:
        """Names of the layers whose sum is the picture."""
        if self.components:
            return COMPONENTS
        if not self.split_layers:
            return ("image",)
        t = techniques
        used = (("next_event", t.next_event), ("connection", t.connection), ("merge", t.merge))
        return ("emission", *(name for name, on in used if on))

    def add(
        self,
        layers: dict[str, mi.Spectrum],
        family: str,
        values: Sequence[mi.Spectrum],
        active: mi.Bool,
        component: mi.UInt32 | int | None,
    ) -> None:
        """Add values of a technique family and a component, one per radius."""
        self.add_first(layers, family, values[0], active, component)
        self.add_more(layers, values[1:], active)

    def add_first(
        self,
        layers: dict[str, mi.Spectrum],
        family: str,
        value: mi.Spectrum,
        active: mi.Bool,
        component: mi.UInt32 | int | None,
    ) -> None:
        """Add a value of the first radius."""
        if not self.components:
            layers[family if self.split_layers else "image"][active] += value
            return
        for number, name in enumerate(COMPONENTS):
            if not isinstance(component, int):
                layers[name][active & (component == number)] += value
            elif component == number:
                layers[name][active] += value

    def add_more(self, layers: dict[str, mi.Spectrum], values: Sequence[mi.Spectrum], active: mi.Bool) -> None:
        """Add values of the radii after the first."""
        for name, value in zip(self.more_radii, values, strict=True):
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
    components: bool = False  #: the first images are those of ``film.REFLECTED``, instead of one image of all light

    def add(self, s: mi.UInt32, place: SplatPlace, contribution: Contribution, kind: mi.UInt32) -> mi.Bool:
        """Add the splat of a light sub-path of ``s`` vertices, the last of which is of a ``kind``. Returns the mask of
        values that are not finite and therefore not added."""
        if self.pyramid is not None:
            scale = dr.rcp(self.paths_per_sample)
            weighted = dr.select(contribution.active, contribution.weighted[0] * scale, 0.0)
            self.pyramid.add_splat(s, place, weighted, contribution.alone * scale, contribution.visible)
        finite = mi.Bool(True)
        for value in contribution.weighted:
            finite &= dr.all(dr.isfinite(value))
        active = contribution.active & finite
        if self.components:
            image = component_of(kind) - int(Component.DIRECT)
            self.splats.add_to(image, place, contribution.weighted[0], active)
            self.splats.add(place, contribution.weighted[1:], active, first=len(REFLECTED))
        else:
            self.splats.add(place, contribution.weighted, active)
        return contribution.active & ~finite
