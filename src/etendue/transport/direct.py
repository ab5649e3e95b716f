r"""Weights of the two techniques of path tracing: a ray that hits a light, and a point sampled on a light.

.. math:: w^e = \frac{p_s^\beta}{p_s^\beta + p_d^\beta}, \qquad w^d = \frac{p_d^\beta}{p_s^\beta + p_d^\beta}

with the solid-angle densities p_s of the scattered direction and p_d of the light point [Veach 1997, sec. 9.2].
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .emission import DirectSample


@dataclass(frozen=True)
class DirectWeights:
    """Weights of hits and of light points.

    ``mode``: ``naive`` counts hits only; ``next_event`` counts light points wherever one can be sampled, and hits
    elsewhere; ``mis`` weighs both by the ``heuristic``, ``balance`` (beta = 1) or ``power`` (beta = 2).
    """

    mode: str = "mis"
    heuristic: str = "balance"

    @property
    def next_event(self) -> bool:
        """Whether light points are sampled."""
        return self.mode != "naive"

    def hit(self, pdf: mi.Float, direct_pdf: mi.Float) -> mi.Float:
        """w^e of a hit. ``pdf``: p_s, or 0 where only a hit can find the light: on the first edge and after a delta
        scattering; ``direct_pdf``: p_d."""
        if self.mode == "naive":
            return mi.Float(1.0)
        if self.mode == "next_event":
            return dr.select(pdf == 0.0, mi.Float(1.0), 0.0)
        return dr.select(pdf == 0.0, 1.0, dr.rcp(1.0 + self._power(direct_pdf / pdf)))

    def light_point(self, light: DirectSample, pdf: mi.Float) -> mi.Float:
        """w^d of a light point. ``pdf``: p_s; a delta light has w^d = 1, as no ray hits it."""
        if self.mode == "next_event":
            return mi.Float(1.0)
        return dr.select(light.is_delta, 1.0, dr.rcp(1.0 + self._power(pdf / light.pdf)))

    def together(self, pdf: mi.Float, direct_pdf: mi.Float) -> mi.Float:
        """Density q of both techniques, such that a contribution f times its weight over its density is f / q; with
        the power heuristic nearly so."""
        if self.mode == "naive":
            return pdf
        return direct_pdf if self.mode == "next_event" else pdf + direct_pdf

    def _power(self, ratio: mi.Float) -> mi.Float:
        return ratio * ratio if self.heuristic == "power" else ratio
