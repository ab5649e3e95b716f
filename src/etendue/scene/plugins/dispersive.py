"""BSDFs ``dispersive`` and ``roughdispersive``: glass whose index of refraction depends on the wavelength.

They are Mitsuba's ``dielectric`` and ``roughdielectric`` [Walter 2007] at each wavelength, under spectral variants.

Parameters: ``int_ior`` (bk7), a name of :data:`.glasses.GLASSES`, or a number: the index at 587.6 nm, to which
``abbe``, the Abbe number, adds dispersion, or ``dispersion``, which is 20 / abbe (KHR_materials_dispersion of glTF;
for OpenPBR, abbe is its Abbe number over its scale). Instead of ``int_ior``, ``cauchy`` (A, B, C) or ``sellmeier``
(B_1, B_2, ..., C_1, C_2, ...), texts of numbers, for wavelengths in micrometres. ``ext_ior`` (air), a name or a number;
``specular_reflectance``, ``specular_transmittance`` (1), colours or textures. The rough one has ``alpha`` (0.1) and
``distribution``, beckmann or ggx.

Light of different wavelengths is refracted in different directions, so that a refracted ray carries one. In étendue it
is the hero of the packet, which rotates from pass to pass [Wilkie 2014]: the path goes on with its wavelength alone,
whose light counts four times. Mitsuba's integrators do not know of this. For them a wavelength is chosen at random at
each refraction, which is right on average but noisier: three of four paths end at the second smooth one.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, UnsupportedError, is_number

from ..both import pdf_of_both, value_of_both
from ..packet import DISPERSES, entry, is_hero_chosen, is_spectral
from .glasses import Index, constant, glass, of_abbe
from .parameters import block, check_range, number


def make_dispersive() -> type:
    """The BSDF class ``dispersive`` for the current variant."""
    return _dispersive("dispersive", is_rough=False)


def make_roughdispersive() -> type:
    """The BSDF class ``roughdispersive`` for the current variant."""
    return _dispersive("roughdispersive", is_rough=True)


def _dispersive(name: str, is_rough: bool) -> type:
    if not is_spectral():
        raise UnsupportedError(
            f"material '{name}' needs wavelengths: render under a spectral variant (--variant llvm_ad_spectral)"
        )

    class Dispersive(mi.BSDF):
        """Glass with dispersion."""

        eval, pdf = value_of_both, pdf_of_both

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = name
            self.reflectance = props.get_texture("specular_reflectance", 1.0)
            self.transmittance = props.get_texture("specular_transmittance", 1.0)
            self._inside, self._outside = _inside(props, name), _index(props, "ext_ior", "air", name)
            self.numbers = [[mi.Float(n) for n in index.numbers] for index in (self._inside, self._outside)]
            dr.make_opaque(self.numbers)
            if is_rough:
                self.alpha = number(props, "alpha", 0.1)
                kind = str(props.get("distribution", "beckmann"))
                if kind not in ("beckmann", "ggx"):
                    raise OptionError(f"'{name}': 'distribution' is beckmann or ggx, not '{kind}'")
                self._kind = mi.MicrofacetType.GGX if kind == "ggx" else mi.MicrofacetType.Beckmann
            self._set_components()

        def _set_components(self) -> None:
            if is_rough:
                check_range(name, "alpha", self.alpha, 0.0, strict=True)
                dr.make_opaque(self.alpha)
            both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            lobes = ("GlossyReflection", "GlossyTransmission") if is_rough else ("DeltaReflection", "DeltaTransmission")
            reflects, transmits = (getattr(mi.BSDFFlags, lobe) | both for lobe in lobes)
            for texture in (self.reflectance, self.transmittance):
                if texture.is_spatially_varying():
                    reflects |= mi.BSDFFlags.SpatiallyVarying
            self.m_components = [reflects, transmits | mi.BSDFFlags.NonSymmetric | DISPERSES]
            self.m_flags = self.m_components[0] | self.m_components[1]

        # ------------------------------------------------------------------ wavelengths

        def _indices(self, si: mi.SurfaceInteraction3f) -> list[mi.Float]:
            """Indices of refraction of the inside relative to the outside, one for each wavelength."""
            inside, outside = self.numbers
            return [self._inside.at(w, inside) / self._outside.at(w, outside) for w in si.wavelengths]

        def _choose(self, si: mi.SurfaceInteraction3f, u: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            """(the wavelength that decides on the direction, a random number)."""
            if is_hero_chosen():
                return mi.UInt32(0), u
            scaled = 4.0 * u
            chosen = dr.minimum(mi.UInt32(scaled), 3)
            return chosen, scaled - mi.Float(chosen)

        def _alone(self, si: mi.SurfaceInteraction3f, chosen: mi.UInt32) -> mi.Spectrum:
            """Factors on what is refracted in the direction of one of the wavelengths: of those that are the same."""
            one = entry(si.wavelengths, chosen)
            same = [dr.select(w == one, mi.Float(1.0), 0.0) for w in si.wavelengths]
            return mi.Spectrum(*same) * (4.0 / sum(same))

        # ------------------------------------------------------------------ smooth and rough

        def sample(
            self,
            ctx: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            sample1: mi.Float,
            sample2: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            """A direction, and value over density."""
            chosen, u = self._choose(si, sample1)
            etas, cos_i = self._indices(si), mi.Frame3f.cos_theta(si.wi)
            m, active = mi.Normal3f(0.0, 0.0, 1.0), active & (cos_i != 0.0)
            if is_rough:
                m, _ = self._facets().sample(dr.mulsign(si.wi, cos_i), sample2)
            fresnel, cos_t, eta_it, eta_ti = mi.fresnel(dr.dot(si.wi, m), entry(etas, chosen))
            may_reflect, may_transmit = (ctx.is_enabled(flag, k) for k, flag in enumerate(self._lobes()))
            share = (fresnel if may_transmit else mi.Float(1.0)) if may_reflect else mi.Float(0.0)
            if not may_reflect and not may_transmit:
                return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0.0)
            reflects = u < share
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = dr.select(reflects, mi.reflect(si.wi, m), mi.refract(si.wi, m, cos_t, eta_ti))
            bs.eta = dr.select(reflects, 1.0, eta_it)
            bs.sampled_component = dr.select(reflects, mi.UInt32(0), mi.UInt32(1))
            bs.sampled_type = dr.select(reflects, *(mi.UInt32(+flag) for flag in self._lobes()))
            if is_rough:
                # What a facet reflects below the surface, or refracts above it, would hit another facet.
                is_above = mi.Frame3f.cos_theta(bs.wo) * cos_i > 0.0
                value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active & (is_above == reflects))
                return bs, dr.select(bs.pdf > 0.0, value / bs.pdf, 0.0)
            bs.pdf = dr.select(active, dr.select(reflects, share, 1.0 - share), 0.0)
            each = mi.Spectrum(*(mi.fresnel(cos_i, eta)[0] for eta in etas))
            scale = dr.square(eta_ti) if ctx.mode == mi.TransportMode.Radiance else mi.Float(1.0)
            refracted = self.transmittance.eval(si, active) * self._alone(si, chosen) * ((1.0 - fresnel) * scale)
            weight = dr.select(reflects, self.reflectance.eval(si, active) * each, refracted)
            return bs, dr.select(bs.pdf > 0.0, weight / bs.pdf, 0.0)

        def eval_pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> tuple[mi.Spectrum, mi.Float]:
            """The BSDF times the cosine, and the density; 0 for smooth glass."""
            if not is_rough:
                return mi.Spectrum(0.0), mi.Float(0.0)
            cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
            active, reflects = active & (cos_i != 0.0) & (cos_o != 0.0), cos_i * cos_o > 0.0
            enabled = [ctx.is_enabled(flag, k) for k, flag in enumerate(self._lobes())]
            active &= dr.select(reflects, enabled[0], enabled[1])
            etas = self._indices(si)
            found = [self._facet(ctx, si.wi, wo, eta, reflects, all(enabled)) for eta in etas]
            value = mi.Spectrum(*(one[0] for one in found))
            pdf = found[0][1] if is_hero_chosen() else sum(one[1] for one in found) * 0.25
            tint = dr.select(reflects, self.reflectance.eval(si, active), self.transmittance.eval(si, active))
            if is_hero_chosen():
                tint = dr.select(reflects, tint, tint * self._alone(si, mi.UInt32(0)))
            return value * tint & active, dr.select(active, pdf, 0.0)

        def _facet(
            self,
            ctx: mi.BSDFContext,
            wi: mi.Vector3f,
            wo: mi.Vector3f,
            index: mi.Float,
            reflects: mi.Bool,
            chooses: bool,
        ) -> tuple[mi.Float, mi.Float]:
            """(value times cosine, density) of rough glass at one wavelength [Walter 2007]. ``chooses``: between
            reflection and refraction."""
            cos_i = mi.Frame3f.cos_theta(wi)
            eta = dr.select(cos_i > 0.0, index, dr.rcp(index))
            m = dr.normalize(wi + wo * dr.select(reflects, 1.0, eta))
            m = dr.mulsign(m, mi.Frame3f.cos_theta(m))
            facets, fresnel = self._facets(), mi.fresnel(dr.dot(wi, m), index)[0]
            dot_i, dot_o = dr.dot(wi, m), dr.dot(wo, m)
            faces = (dot_i * cos_i > 0.0) & (dot_o * mi.Frame3f.cos_theta(wo) > 0.0)
            both = facets.eval(m) * facets.G(wi, wo, m)
            squared = dr.square(dot_i + eta * dot_o)
            scale = 1.0 if ctx.mode == mi.TransportMode.Radiance else dr.square(eta)
            through = dr.abs((1.0 - fresnel) * scale * both * dot_i * dot_o / (cos_i * squared))
            value = dr.select(reflects, fresnel * both / (4.0 * dr.abs(cos_i)), through)
            change = dr.select(reflects, dr.rcp(4.0 * dot_o), dr.square(eta) * dot_o / squared)
            share = dr.select(reflects, fresnel, 1.0 - fresnel) if chooses else mi.Float(1.0)
            pdf = facets.pdf(dr.mulsign(wi, cos_i), m) * share * dr.abs(change)
            return dr.select(faces, value, 0.0), dr.select(faces, pdf, 0.0)

        def _facets(self) -> mi.MicrofacetDistribution:
            return mi.MicrofacetDistribution(self._kind, self.alpha, True)

        def _lobes(self) -> tuple[mi.BSDFFlags, mi.BSDFFlags]:
            """Flags of reflection and of refraction."""
            flags = mi.BSDFFlags
            if is_rough:
                return flags.GlossyReflection, flags.GlossyTransmission
            return flags.DeltaReflection, flags.DeltaTransmission

        # ------------------------------------------------------------------ parameters

        def traverse(self, callback: mi.TraversalCallback) -> None:
            callback.put("specular_reflectance", self.reflectance, mi.ParamFlags.Differentiable)
            callback.put("specular_transmittance", self.transmittance, mi.ParamFlags.Differentiable)
            for side, numbers in zip(("int", "ext"), self.numbers, strict=True):
                for k, value in enumerate(numbers):
                    callback.put(f"{side}_index_{k}", value, mi.ParamFlags.NonDifferentiable)
            if is_rough:
                callback.put("alpha", self.alpha, mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous)

        def parameters_changed(self, keys: list[str]) -> None:
            self._set_components()

        def to_string(self) -> str:
            return block(name, int_ior=self._inside, ext_ior=self._outside)

    Dispersive.__name__ = Dispersive.__qualname__ = f"{name.capitalize()}BSDF"
    return Dispersive


def _inside(props: mi.Properties, owner: str) -> Index:
    """The index of refraction of the inside by the parameters of a material."""
    ways = [key for key in ("int_ior", "cauchy", "sellmeier") if key in props]
    added = [key for key in ("abbe", "dispersion") if key in props]
    if len(ways) > 1 or len(added) > 1:
        first, second = (ways if len(ways) > 1 else added)[:2]
        raise OptionError(f"'{owner}' has either '{first}' or '{second}'; remove one")
    if ways and ways[0] != "int_ior":
        if added:
            raise OptionError(f"'{owner}': '{added[0]}' belongs to a number 'int_ior', not to '{ways[0]}'; remove one")
        return _formula(props, ways[0], owner)
    index = _index(props, "int_ior", "bk7", owner)
    if not added:
        return index
    if not is_number(props.get("int_ior")):
        raise OptionError(f"'{owner}': '{added[0]}' needs the index at 587.6 nm: give 'int_ior' a number")
    value = float(number(props, added[0], 0.0)[0])
    if value < 0.0 or (added[0] == "abbe" and value == 0.0):
        raise OptionError(f"'{owner}': '{added[0]}' is {value:g}; it must be a number above 0")
    number_of = value if added[0] == "abbe" else (20.0 / value if value else float("inf"))
    return of_abbe(index.numbers[0], number_of)


def _index(props: mi.Properties, key: str, default: str, owner: str) -> Index:
    value = props.get(key, default)
    if isinstance(value, str):
        return glass(value)
    if not is_number(value) or not 0.1 <= float(value) <= 10.0:
        raise OptionError(f"'{owner}': '{key}' is a name or a number between 0.1 and 10, not {value!r}")
    return constant(float(value))


def _formula(props: mi.Properties, key: str, owner: str) -> Index:
    """Cauchy's or Sellmeier's formula by a text of numbers."""
    text = str(props.get(key))
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if key == "cauchy" and 1 <= len(values) <= 3:
        index = Index((*values, 0.0, 0.0)[:3])
    elif key == "sellmeier" and len(values) >= 2 and len(values) % 2 == 0:
        half = len(values) // 2
        index = Index(tuple(n for pair in zip(values[:half], values[half:], strict=True) for n in pair), True)
    else:
        form = "A, B, C" if key == "cauchy" else "B_1, B_2, B_3, C_1, C_2, C_3"
        raise OptionError(f"'{owner}': '{key}' is a text of numbers {form}, not '{text}'")
    for wavelength in (mi.MI_CIE_MIN, mi.MI_CIE_MAX):
        found = index.at(wavelength)
        if isinstance(found, complex) or not 0.1 <= found <= 10.0:
            raise OptionError(
                f"'{owner}': '{key}' gives an index of {found:.3g} at {wavelength:g} nm; wavelengths are in micrometres"
            )
    return index
