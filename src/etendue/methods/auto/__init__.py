"""Vertex connection and merging with sample counts that are chosen while it renders."""

from .efficiency import Learned as Learned, PassWork as PassWork
from .method import (
    CANDIDATES as CANDIDATES,
    FIXED as FIXED,
    LEARNER as LEARNER,
    Auto as Auto,
    AutoSettings as AutoSettings,
    describe as describe,
)
