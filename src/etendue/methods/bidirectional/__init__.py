"""Bidirectional path tracing, bidirectional photon mapping, and vertex connection and merging."""

from .method import Bidirectional as Bidirectional
from .settings import BidirectionalSettings as BidirectionalSettings
from .variants import Bpm as Bpm, Bpt as Bpt, Vcm as Vcm
