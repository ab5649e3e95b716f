"""Bidirectional path tracing, bidirectional photon mapping, and vertex connection and merging."""

from .method import Bidirectional
from .settings import BidirectionalSettings
from .variants import Bpm, Bpt, Vcm

__all__ = ["Bidirectional", "BidirectionalSettings", "Bpm", "Bpt", "Vcm"]
