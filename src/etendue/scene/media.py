"""Participating media of a scene: extinction and scattering by the pointer of a medium; phase functions as materials.

Only homogeneous media so far. A medium is given by its number in Dr.Jit's registry, which is the value of a pointer to
it; 0 is no medium.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, UnsupportedError, on_device

from .graph import describe, shapes
from .members import Members, bsdfs

#: In place of the number of a medium that is not known.
UNKNOWN = (1 << 32) - 1
#: Numbers of a medium on the device: three colours.
_COLUMNS = 9


def media_of(scene: mi.Scene, sensor: mi.Sensor | None = None) -> list[mi.Medium]:
    """The media of a scene, each once: those of its shapes, emitters and sensors, and that of ``sensor``."""
    found: list[mi.Medium] = []
    for medium in _media(scene, sensor):
        if medium is not None and medium not in found:
            found.append(medium)
    return found


def _media(scene: mi.Scene, sensor: mi.Sensor | None) -> Iterator[mi.Medium | None]:
    for shape in shapes(scene):
        yield shape.interior_medium()
        yield shape.exterior_medium()
    for end in (*scene.emitters(), *scene.sensors(), sensor):
        if end is not None:
            yield end.get_medium()


def coefficients(medium: mi.Medium) -> tuple[Array, Array]:
    """(extinction, scattering) of a homogeneous medium by colour channel, per unit of length, on the host."""
    scattering, _, extinction = medium.get_scattering_coefficients(dr.zeros(mi.MediumInteraction3f))
    return np.array(extinction, np.float64).ravel(), np.array(scattering, np.float64).ravel()


def scatters(medium: mi.Medium) -> bool:
    """Whether a homogeneous medium scatters light, in any colour."""
    return bool(coefficients(medium)[1].any())


def medium_behind(si: mi.SurfaceInteraction3f, direction: mi.Vector3f, medium: mi.UInt32) -> mi.UInt32:
    """The medium on the side of a surface to which a direction leads; ``medium`` if the surface bounds none."""
    behind = dr.reinterpret_array(mi.UInt32, si.target_medium(direction))
    return dr.select(si.is_medium_transition(), behind, medium)


def refuse_media(scene: mi.Scene, what: str, sensor: mi.Sensor | None = None) -> None:
    """Raise :class:`UnsupportedError` if a scene has media. ``what``: the subject of the message, in the plural."""
    if found := media_of(scene, sensor):
        raise UnsupportedError(
            f"{what} know no participating media, but the scene has {describe(found[0], 'medium')}; remove the "
            "'interior' and 'exterior' of its shapes, or render a picture by 'path' or 'vcm'"
        )


class Media:
    """The media of one scene as device arrays.

    Walks sample free paths in media that scatter, with the *sampled* extinction: that of the medium, by a colour
    channel. In media that only absorb it is 0: a walk crosses them, and its throughput is multiplied by their
    transmittance.

    The media are not referenced, as :class:`Members` are not; their phase functions are.

    Parameters
    ----------
    found: the media, at least one.
    sensor: that of the camera paths.
    outside: number of the medium that the rays of each emitter start in, or UNKNOWN, if it depends on the ray.
    """

    def __init__(
        self, scene: mi.Scene, found: Sequence[mi.Medium], sensor: mi.Sensor | None, outside: Sequence[int]
    ) -> None:
        numbers = [number_of(medium) for medium in found]
        rows = np.zeros((max(numbers) + 1, _COLUMNS))
        materials = np.zeros(len(rows), np.uint32)
        kept, ids = [], []
        for number, medium in zip(numbers, found, strict=True):
            extinction, scattering = coefficients(medium)
            sampled = extinction if scattering.any() else 0.0 * extinction
            rows[number] = np.concatenate([extinction, sampled, scattering])
            if scattering.any():
                kept.append(_phase_material(mi.variant())(medium.phase_function()))
                materials[number] = _pointer(kept[-1])
                ids.append(int(materials[number]))
        #: Whether a medium scatters light.
        self.scatters = bool(kept)
        #: Whether the sampled extinctions do not depend on the colour; they are numbers then.
        self.is_grey = bool((rows[:, 3:6] == rows[:, 3:4]).all())
        #: The largest extinction of a medium that scatters, on the host.
        self.densest = float(rows[:, 3:6].max())
        self._rows, self._materials = on_device(mi.Float, rows), on_device(mi.UInt32, materials)
        #: The medium that camera paths start in.
        self.of_sensor = dr.opaque(mi.UInt32, number_of(sensor.get_medium()) if sensor is not None else 0)
        #: Whether a lamp is in several media.
        self.divides_lamps = UNKNOWN in outside
        self._of_light = on_device(mi.UInt32, list(outside) or [0])
        #: The materials of the scene, and the phase functions as such.
        self.bsdfs = bsdfs(scene)
        if kept:
            ids = [*self.bsdfs.ids, *ids]
            self.bsdfs = Members(mi.BSDFPtr, ids, ids, kept)

    def outside(self, light: mi.UInt32) -> mi.UInt32:
        """The medium that rays from the light with a number start in, or UNKNOWN."""
        return dr.gather(mi.UInt32, self._of_light, light)

    def is_unknown(self, medium: mi.UInt32) -> mi.Bool:
        """Lanes where :meth:`outside` does not know the medium."""
        return medium == UNKNOWN

    def extinction(self, medium: mi.UInt32) -> mi.Color3f:
        """Extinction, by colour channel."""
        return self._colour(medium, 0)

    def sampled(self, medium: mi.UInt32) -> mi.Color3f | mi.Float:
        """Extinction with which walks sample free paths, by colour channel, or as one number; see above."""
        return dr.gather(mi.Float, self._rows, medium * _COLUMNS + 3) if self.is_grey else self._colour(medium, 1)

    def one(self) -> mi.Color3f | mi.Float:
        """1, of the type of :meth:`sampled`."""
        return mi.Float(1.0) if self.is_grey else mi.Color3f(1.0)

    def scattering(self, medium: mi.UInt32) -> mi.Color3f:
        """Scattering coefficient, by colour channel."""
        return self._colour(medium, 2)

    def material(self, medium: mi.UInt32) -> mi.BSDFPtr:
        """The phase function as a material."""
        return dr.reinterpret_array(mi.BSDFPtr, dr.gather(mi.UInt32, self._materials, medium))

    def _colour(self, medium: mi.UInt32, column: int) -> mi.Color3f:
        first = medium * _COLUMNS + 3 * column
        return mi.Color3f(*(dr.gather(mi.Float, self._rows, first + channel) for channel in range(3)))


def number_of(medium: mi.Medium | None) -> int:
    """The number of a medium, 0 for none."""
    return 0 if medium is None else int(dr.reinterpret_array(mi.UInt32, mi.MediumPtr(medium))[0])


def _pointer(bsdf: mi.BSDF) -> int:
    return int(dr.reinterpret_array(mi.UInt32, mi.BSDFPtr(bsdf))[0])


@lru_cache(maxsize=8)
def _phase_material(variant: str) -> Any:
    # A class per variant, as Mitsuba's types exist only once a variant is set.
    class PhaseMaterial(mi.BSDF):
        """A phase function as a material: the points of a medium are scattered at as those of a surface are. Local
        directions are those of any frame, and there is no cosine."""

        plugin_name = "phase function"

        def __init__(self, phase: mi.PhaseFunction) -> None:
            super().__init__(mi.Properties())
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.DiffuseTransmission
            self.m_components = [flags | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide]
            self.m_flags = self.m_components[0]
            self.phase = phase

        def sample(
            self,
            ctx: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            sample1: mi.Float,
            sample2: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.BSDFSample3f, mi.Color3f]:
            """A direction, and value over density."""
            wo, weight, pdf = self.phase.sample(mi.PhaseFunctionContext(None), _in_medium(si), sample1, sample2, active)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf, bs.eta = si.to_local(wo), pdf, mi.Float(1.0)
            bs.sampled_type, bs.sampled_component = mi.UInt32(+mi.BSDFFlags.DiffuseReflection), mi.UInt32(0)
            return bs, mi.Color3f(weight) & active

        def eval(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> mi.Color3f:
            """The phase function."""
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> mi.Float:
            """The density of ``wo``."""
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> tuple[mi.Color3f, mi.Float]:
            """Phase function and density."""
            at, context = _in_medium(si), mi.PhaseFunctionContext(None)
            value, pdf = self.phase.eval_pdf(context, at, si.to_world(wo), active)
            return mi.Color3f(value) & active, dr.select(active, pdf, 0.0)

        def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Color3f:
            """1: what is absorbed is a property of the medium."""
            return mi.Color3f(1.0) & active

        def to_string(self) -> str:
            """A name."""
            return f"PhaseMaterial[{self.phase}]"

    return PhaseMaterial


def is_phase(bsdf: mi.BSDF) -> bool:
    """Whether a material is the phase function of a medium."""
    return isinstance(bsdf, _phase_material(mi.variant()))


def _in_medium(si: mi.SurfaceInteraction3f) -> mi.MediumInteraction3f:
    mei = dr.zeros(mi.MediumInteraction3f)
    mei.p, mei.time, mei.wavelengths = si.p, si.time, si.wavelengths
    mei.wi = si.to_world(si.wi)
    mei.sh_frame = mi.Frame3f(mei.wi)
    return mei
