"""Viewer: a scene live in the browser."""

from .opening import Viewer as Viewer
from .panels import Panel as Panel
from .refining import is_picture as is_picture
from .session import ViewerSession as ViewerSession
from .states import Asked as Asked
