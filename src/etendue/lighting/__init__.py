"""Lighting design and daylight as numbers: photometric files, skies, the sun, weather, units. NumPy only."""

from .errors import LightingError as LightingError
from .files import read_photometry as read_photometry
from .units import EFFICACY as EFFICACY
from .web import PhotometricWeb as PhotometricWeb
