"""Vertex connection and merging with sample counts that are chosen while it renders."""

from .efficiency import Learned, Work
from .method import CANDIDATES, FIXED, LEARNER, Auto, AutoSettings, describe

__all__ = ["CANDIDATES", "FIXED", "LEARNER", "Auto", "AutoSettings", "Learned", "Work", "describe"]
