"""Viewer: a scene live in the browser."""

from .opening import Viewer, view
from .panels import Panel
from .session import Asked, Session

__all__ = ["Asked", "Panel", "Session", "Viewer", "view"]
