"""Viewer: a scene live in the browser."""

from .opening import Viewer, view
from .panels import Panel
from .refining import is_picture
from .session import Session
from .states import Asked

__all__ = ["Asked", "Panel", "Session", "Viewer", "is_picture", "view"]
