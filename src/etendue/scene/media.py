"""Participating media of a scene: extinction and scattering by the pointer of a medium; phase functions as materials.

A medium is given by its number in Dr.Jit's registry, which is the value of a pointer to it; 0 is no medium.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, TypeGuard

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, UnsupportedError, as_array, on_device

from .both import pdf_of_both, value_of_both
from .graph import contents, describe, plugin_name, shapes
from .members import Members, bsdfs
from .packet import is_spectral, spread_wavelengths

#: In place of the number of a medium that is not known.
UNKNOWN = (1 << 32) - 1
#: Packets of wavelengths at which it is tested whether a medium is grey.
_WAVELENGTHS = 16


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


def coefficients(medium: mi.Medium, wavelengths: mi.Spectrum) -> tuple[Array, Array]:
    """(extinction, scattering) of a medium by colour channel, per unit of length, on the host, at the origin;
    ``wavelengths``: of the channels, under a spectral variant."""
    at = dr.zeros(mi.MediumInteraction3f)
    at.wavelengths = wavelengths
    scattering, _, extinction = medium.get_scattering_coefficients(at)
    return np.array(extinction, np.float64).ravel(), np.array(scattering, np.float64).ravel()


def majorant(medium: mi.Medium) -> float:
    """The largest extinction of a medium, per unit of length, on the host."""
    return float(np.max(np.array(medium.get_majorant(dr.zeros(mi.MediumInteraction3f)))))


def volume_of(medium: mi.Medium, name: str) -> mi.Volume | None:
    """The volume of a medium by the name of its parameter, ``sigma_t`` or ``albedo``."""
    return dict(contents(medium).objects).get(name)


def is_constant(volume: mi.Volume | None) -> TypeGuard[mi.Volume]:
    """Whether a volume has the same value everywhere."""
    return volume is not None and plugin_name(volume) == "constvolume"


def scatters(medium: mi.Medium) -> bool:
    """Whether a medium scatters light, in any colour."""
    albedo = volume_of(medium, "albedo")
    if is_constant(albedo):
        return majorant(medium) > 0.0 and bool(_at_origin(albedo).any())
    return majorant(medium) > 0.0 and (albedo is None or albedo.max() > 0.0)


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
    transmittance. Along rays in heterogeneous media all extinctions are 0 here: their transmittance and their
    collisions are found by null collisions (:meth:`span`, :meth:`at`).

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
        self._numbers = numbers = [number_of(medium) for medium in found]
        materials = np.zeros(max(numbers) + 1, np.uint32)
        kept, ids = [], []
        varying: list[int] = []
        #: Whether a medium is heterogeneous.
        self.heterogeneous = False
        #: Whether the sampled extinctions do not depend on the colour; they are numbers then.
        self.is_grey = True
        #: The largest extinction of a medium that scatters, of a grid at the collisions in the mean, on the host.
        self.densest = 0.0
        for number, medium in zip(numbers, found, strict=True):
            if not medium.is_homogeneous():
                varying.append(number)
                self.heterogeneous = True
            elif not is_constant(volume_of(medium, "albedo")):
                varying.append(number)
            if scatters(medium):
                kept.append(_phase_material(mi.variant())(medium.phase_function()))
                materials[number] = _pointer(kept[-1])
                ids.append(int(materials[number]))
                self.is_grey &= _is_grey(volume_of(medium, "sigma_t"))
                self.densest = max(self.densest, _met(medium))
        #: Whether a medium scatters light.
        self.scatters = bool(kept)
        self._materials = on_device(mi.UInt32, materials)
        self._scattering = [bool(materials[number]) for number in numbers]
        self.take(spread_wavelengths())
        #: Media whose coefficients depend on the position.
        self._varying = Members(mi.MediumPtr, varying, varying) if varying else None
        #: The medium that camera paths start in.
        self.of_sensor = dr.opaque(mi.UInt32, number_of(sensor.get_medium()) if sensor is not None else 0)
        #: Whether a lamp is in several media.
        self.divides_lamps = UNKNOWN in outside
        self._of_light = on_device(mi.UInt32, list(outside) or [0])
        #: The materials of the scene, and the phase functions as such.
        self.bsdfs = bsdfs(scene, sensor)
        if kept:
            ids = [*self.bsdfs.ids, *ids]
            self.bsdfs = Members(mi.BSDFPtr, ids, ids, kept)

    def take(self, wavelengths: mi.Spectrum) -> None:
        """Take the coefficients at the wavelengths of a pass."""
        self._wavelengths = wavelengths
        channels = dr.size_v(mi.Spectrum)
        rows = np.zeros((max(self._numbers) + 1, 3, channels))
        for number, scatters in zip(self._numbers, self._scattering, strict=True):
            medium = dr.reinterpret_array(mi.MediumPtr, mi.UInt32(number))[0]
            if not medium.is_homogeneous():
                continue
            extinction, scattering = coefficients(medium, wavelengths)
            rows[number, 0] = extinction
            if scatters:
                rows[number, 1] = extinction
                rows[number, 2] = scattering if is_constant(volume_of(medium, "albedo")) else 0.0
        self._rows, self._columns = on_device(mi.Float, rows), 3 * channels

    def outside(self, light: mi.UInt32) -> mi.UInt32:
        """The medium that rays from the light with a number start in, or UNKNOWN."""
        return dr.gather(mi.UInt32, self._of_light, light)

    def is_unknown(self, medium: mi.UInt32) -> mi.Bool:
        """Lanes where :meth:`outside` does not know the medium."""
        return medium == UNKNOWN

    def extinction(self, medium: mi.UInt32) -> mi.Spectrum:
        """Extinction of a homogeneous medium, by colour channel; 0 for others."""
        return self._colour(medium, 0)

    def sampled(self, medium: mi.UInt32) -> mi.Spectrum | mi.Float:
        """Extinction with which walks sample free paths, by colour channel, or as one number; see above."""
        if self.is_grey:
            return dr.gather(mi.Float, self._rows, medium * self._columns + self._columns // 3)
        return self._colour(medium, 1)

    def one(self) -> mi.Spectrum | mi.Float:
        """1, of the type of :meth:`sampled`."""
        return mi.Float(1.0) if self.is_grey else mi.Spectrum(1.0)

    def of_type(self, colour: mi.Spectrum) -> mi.Spectrum | mi.Float:
        """A colour as the type of :meth:`sampled`."""
        return colour[0] if self.is_grey else colour

    def at(
        self, medium: mi.UInt32, position: mi.Point3f, active: mi.Bool
    ) -> tuple[mi.Spectrum | mi.Float, mi.Spectrum]:
        """(extinction as :meth:`sampled`, scattering coefficient by colour channel) at a point of a medium that
        scatters."""
        extinction, scattering = self.sampled(medium), self._colour(medium, 2)
        if self._varying is None:
            return extinction, scattering
        more = self._varying.call(medium, _at, position, self._wavelengths, active=active)
        return extinction + self.of_type(more[0]), scattering + more[1]

    def span(self, medium: mi.UInt32, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Float]:
        """(majorant of the extinction, first and last distance) of a ray's part in a heterogeneous medium; the majorant
        is 0 if the medium is another one, or not met."""
        assert self._varying is not None
        return self._varying.call(medium, _span, ray, active=active)

    def varying_extinction(self, medium: mi.UInt32, position: mi.Point3f, active: mi.Bool) -> mi.Spectrum:
        """Extinction at a point of a heterogeneous medium, by colour channel; 0 for others."""
        assert self._varying is not None
        return self._varying.call(medium, _at, position, self._wavelengths, active=active)[0]

    def is_collided_with(self, medium: mi.UInt32) -> mi.Bool:
        """Whether a medium scatters, so that walks collide with it."""
        return dr.gather(mi.UInt32, self._materials, medium) != 0

    def material(self, medium: mi.UInt32) -> mi.BSDFPtr:
        """The phase function as a material."""
        return dr.reinterpret_array(mi.BSDFPtr, dr.gather(mi.UInt32, self._materials, medium))

    def _colour(self, medium: mi.UInt32, column: int) -> mi.Spectrum:
        first = medium * self._columns + column * (self._columns // 3)
        return mi.Spectrum(*(dr.gather(mi.Float, self._rows, first + k) for k in range(dr.size_v(mi.Spectrum))))


# Functions that are dispatched get the medium as an object, not as a pointer.


def _at(
    medium: mi.Medium, position: mi.Point3f, wavelengths: mi.Spectrum, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Spectrum]:
    """(extinction if the medium is heterogeneous, else 0; scattering coefficient)."""
    at = dr.zeros(mi.MediumInteraction3f)
    at.p, at.wavelengths = position, wavelengths
    scattering, _, extinction = medium.get_scattering_coefficients(at, active)
    return mi.Spectrum(0.0 if medium.is_homogeneous() else extinction), mi.Spectrum(scattering)


def _span(medium: mi.Medium, ray: mi.Ray3f, active: mi.Bool) -> tuple[mi.Float, mi.Float, mi.Float]:
    if medium.is_homogeneous():
        return mi.Float(0.0), mi.Float(0.0), mi.Float(0.0)
    met, first, last = medium.intersect_aabb(ray)
    most = dr.max(medium.get_majorant(dr.zeros(mi.MediumInteraction3f), active))
    return dr.select(met & active, most, 0.0), dr.maximum(first, 0.0), mi.Float(last)


def _met(medium: mi.Medium) -> float:
    """The extinction of a medium; the mean over collisions under even light if it is a grid."""
    volume = volume_of(medium, "sigma_t")
    if volume is None or is_constant(volume):
        return majorant(medium)
    values = np.abs(values_of(volume))
    return majorant(medium) * float((values**2).sum() / values.sum() / values.max())


def _is_grey(volume: mi.Volume | None) -> bool:
    """Whether a volume is known to have the same value in all colour channels."""
    if is_constant(volume):
        value = _at_origin(volume)
        return bool((value == value[0]).all())
    return volume is not None and volume.channel_count() == 1


def values_of(volume: mi.Volume) -> Array:
    """All values of a volume; of a grid of spectra, which has their coefficients, the factors on them."""
    data = dict(contents(volume).values).get("data")
    if data is None:
        return _at_origin(volume)
    grid = as_array(data).astype(np.float64)
    return grid[..., 3:] if is_spectral() and grid.shape[-1] == 4 else grid


def _at_origin(volume: mi.Volume) -> Array:
    """Values of a volume at the origin."""
    at = dr.zeros(mi.MediumInteraction3f)
    at.wavelengths = spread_wavelengths(_WAVELENGTHS)
    return np.array(volume.eval(at), np.float64).ravel()


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

        eval, pdf = value_of_both, pdf_of_both

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
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            """A direction, and value over density."""
            wo, weight, pdf = self.phase.sample(mi.PhaseFunctionContext(None), _in_medium(si), sample1, sample2, active)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.pdf, bs.eta = si.to_local(wo), pdf, mi.Float(1.0)
            bs.sampled_type, bs.sampled_component = mi.UInt32(+mi.BSDFFlags.DiffuseReflection), mi.UInt32(0)
            return bs, mi.Spectrum(weight) & active

        def eval_pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> tuple[mi.Spectrum, mi.Float]:
            """Phase function and density."""
            at, context = _in_medium(si), mi.PhaseFunctionContext(None)
            value, pdf = self.phase.eval_pdf(context, at, si.to_world(wo), active)
            return mi.Spectrum(value) & active, dr.select(active, pdf, 0.0)

        def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Spectrum:
            """1: what is absorbed is a property of the medium."""
            return mi.Spectrum(1.0) & active

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
