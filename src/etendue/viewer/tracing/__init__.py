"""What the 3-D view shows beside surfaces: traced and solved in a process of its own, so that pictures do not wait."""

from .desk import Arrays as Arrays, Desk as Desk
from .orders import Order as Order, SceneCopy as SceneCopy, View as View
from .process import Reply as Reply, TracingProcess as TracingProcess
