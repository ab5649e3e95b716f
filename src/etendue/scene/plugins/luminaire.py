r"""Emitter ``luminaire``: a point that shines as a photometric file says, IES LM-63 or EULUMDAT.

    I(w) = dimming tilt flux / 683 lm/W  p(w) color   p: intensity of the file over its flux, per solid angle

in watts per steradian, so that white light has the file's candelas over :data:`~etendue.lighting.EFFICACY`.

Parameters: ``filename``; ``to_world``, position and rotation: the file's nadir is -z, its plane C = 0 is +x and C = 90
is +y; ``flux``, in lm, by default that of the file, the integral of its intensity; ``dimming`` (1), a factor of at
least 0; ``color`` (white, D65), a constant colour or spectrum, divided by its luminance; ``sampling_weight``.
``lamp_set``: of an EULUMDAT file with several, 0 for all together. ``up``: the vertical of the scene, for files with
tilt factors, of which ``tilt`` is the one for the luminaire's position.

Rays have the density p exactly, so that all carry the same power.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError
from etendue.lighting import EFFICACY, Tilt, read_photometry

from ..packet import is_rgb, is_spectral
from .parameters import block, check_range, make_opaque, number
from .webs import WebTable


def make_luminaire() -> type:
    """The emitter class for the current variant."""

    class Luminaire(mi.Emitter):
        """A point light with the intensity of a photometric file."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "luminaire"
            name = props.get("filename", "")
            if not isinstance(name, str) or not name:
                raise OptionError("'luminaire' needs a 'filename', a photometric file (.ies or .ldt)")
            #: The web of the file, on the host.
            lamps = props.get("lamp_set", None)
            self.photometry = read_photometry(str(mi.file_resolver().resolve(name)), lamps)
            self.up = _up(props, self.photometry.tilt, name)
            self.table = WebTable(self.photometry)
            self.to_world = mi.Transform4f(super().world_transform())
            self.flux = number(props, "flux", self.photometry.flux)
            self.dimming = number(props, "dimming", 1.0)
            self.color = props.get_emissive_texture("color", 1.0)
            self._web = self.table.arrays()
            self._check()
            self.m_flags = +mi.EmitterFlags.DeltaPosition

        def _check(self) -> None:
            check_range("luminaire", "flux", self.flux, 0.0, strict=True)
            check_range("luminaire", "dimming", self.dimming, 0.0)
            if self.color.is_spatially_varying():
                raise OptionError("'luminaire': 'color' is a texture that varies; give one colour or spectrum")
            luminance = _luminance(self.color)
            if not 0.0 < luminance < np.inf:
                raise OptionError(f"'luminaire': 'color' has a luminance of {luminance:g}; dim it by 'dimming'")
            self._per_lumen = mi.Float(1.0 / (EFFICACY * luminance))
            self._tilt = mi.Float(self._tilt_factor())
            make_opaque(self.flux, self.dimming, self._per_lumen, self._tilt, self.to_world)

        def _power(self) -> mi.Float:
            """Radiant flux for each unit of ``color``."""
            return self.flux * self.dimming * self._tilt * self._per_lumen

        def _tilt_factor(self) -> float:
            """The factor for how the luminaire is tilted."""
            if self.up is None or self.photometry.tilt is None:
                return 1.0
            turn = np.asarray(self.to_world.matrix, np.float64).reshape(4, 4)[:3, :3]
            return self.photometry.tilt.factor(self.up @ turn)

        def ray_pdf(self, d: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Float:
            """Density per solid angle with which :meth:`sample_ray` samples the direction ``d`` of the world."""
            return self.table.pdf(self.to_world.inverse() @ d, active)

        def world_transform(self) -> mi.Transform4f:
            return self.to_world

        def _position(self) -> mi.Point3f:
            return mi.Point3f(self.to_world.translation())

        def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Spectrum:
            return mi.Spectrum(0.0)

        def sample_position(
            self, time: mi.Float, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.PositionSample3f, mi.Float]:
            ps = dr.zeros(mi.PositionSample3f)
            ps.p, ps.time, ps.pdf, ps.delta = self._position(), time, mi.Float(1.0), mi.Bool(True)
            return ps, mi.Float(1.0)

        def sample_ray(
            self,
            time: mi.Float,
            sample1: mi.Float,
            sample2: mi.Point2f,
            sample3: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            wavelengths, spectrum = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            d = dr.normalize(self.to_world @ self.table.sample(sample3, active))
            # Rounding may turn a direction out of the web, where no other technique finds light.
            inside = self.ray_pdf(d, active) > 0.0
            return mi.Ray3f(self._position(), d, time, wavelengths), spectrum * dr.select(inside, self._power(), 0.0)

        def sample_direction(
            self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p, ds.time, ds.pdf, ds.delta = self._position(), it.time, mi.Float(1.0), mi.Bool(True)
            ds.emitter = mi.EmitterPtr(self)
            ds.d = ds.p - it.p
            ds.dist = dr.norm(ds.d)
            ds.d /= ds.dist
            return ds, self.eval_direction(it, ds, active)

        def pdf_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Float:
            return mi.Float(0.0)

        def eval_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Spectrum:
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wavelengths = it.wavelengths
            return self.color.eval(si, active) * (self._power() * self.ray_pdf(-ds.d, active) / dr.square(ds.dist))

        def sample_wavelengths(
            self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool | bool = True
        ) -> tuple[mi.Color0f, mi.Spectrum]:
            if is_spectral():
                return self.color.sample_spectrum(si, mi.sample_shifted(sample), active)
            return dr.zeros(mi.Color0f), self.color.eval(si, active)

        def bbox(self) -> mi.ScalarBoundingBox3f:
            at = mi.ScalarPoint3f(np.asarray(self._position()).ravel().tolist())
            return mi.ScalarBoundingBox3f(at, at)

        def traverse(self, callback: mi.TraversalCallback) -> None:
            super().traverse(callback)
            callback.put("to_world", self.to_world, mi.ParamFlags.NonDifferentiable)
            callback.put("flux", self.flux, mi.ParamFlags.Differentiable)
            callback.put("dimming", self.dimming, mi.ParamFlags.Differentiable)
            callback.put("color", self.color, mi.ParamFlags.Differentiable)
            callback.put("web", self._web, mi.ParamFlags.NonDifferentiable)
            if self.up is not None:
                callback.put("tilt", self._tilt, mi.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            if "web" in keys or "tilt" in keys:
                raise OptionError("web and tilt factor of a 'luminaire' are those of its file; load another one")
            self._check()
            super().parameters_changed(keys)

        def to_string(self) -> str:
            return block(
                "luminaire",
                to_world=self.to_world,
                flux=self.flux,
                dimming=self.dimming,
                color=self.color,
                web=f"{self.photometry.candela.shape[0]} planes, {self.photometry.candela.shape[1]} angles",
            )

    return Luminaire


def _up(props: mi.Properties, tilt: Tilt | None, name: str) -> NDArray[np.float64] | None:
    """The unit vector ``up`` of the scene; None if the file has no tilt factors. Raises :class:`OptionError`."""
    given = props.get("up", None)
    if given is None and tilt is not None:
        raise OptionError(
            f"'luminaire': {name} has factors for a tilted luminaire; give 'up', the vertical of the scene, as 0, 0, 1"
        )
    if given is None or tilt is None:
        return None
    up = np.asarray(given, np.float64).ravel() if not isinstance(given, str) else np.zeros(0)
    length = float(np.linalg.norm(up))
    if up.shape != (3,) or not 0.0 < length < np.inf:
        raise OptionError(f"'luminaire': 'up' is a vector of three numbers, not {given!r}")
    return up / length


def _luminance(color: mi.Texture) -> float:
    """Luminance of a constant emissive texture; 1 for white, D65."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    if not is_spectral():
        value = color.eval(si)
        return float(np.asarray(mi.luminance(value) if is_rgb() else value[0]).ravel()[0])
    nanometres = dr.arange(mi.Float, int(mi.MI_CIE_MAX - mi.MI_CIE_MIN)) + (mi.MI_CIE_MIN + 0.5)
    si.wavelengths = mi.Spectrum(nanometres)
    total = dr.sum(color.eval(si)[0] * mi.cie1931_y(nanometres))
    return float(np.asarray(total).ravel()[0]) * mi.MI_CIE_Y_NORMALIZATION
