"""Lighting design and daylight as numbers: photometric files, skies, the sun, weather, units. NumPy only."""

from .errors import LightingError as LightingError
from .meters import QUANTITIES as QUANTITIES, Meters as Meters, Quantity as Quantity
from .units import EFFICACY as EFFICACY, photometric as photometric
