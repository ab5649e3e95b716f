"""Photometric units."""

from __future__ import annotations

#: Luminous efficacy of light whose RGB values are radiometric, in lm/W: luminance in cd/m^2 is this times the luminance
#: of the picture, illuminance in lux this times the luminance of irradiance. It is that of monochromatic light at 540
#: THz; programs with another convention (Radiance: 179) differ by a factor in their files, not in their results.
EFFICACY = 683.0
