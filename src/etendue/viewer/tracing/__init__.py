"""What the 3-D view shows beside surfaces: traced and solved in a process of its own, so that pictures do not wait."""

from .desk import Arrays, Desk
from .orders import Order, SceneCopy, View
from .process import Reply, TracingProcess

__all__ = ["Arrays", "Desk", "Order", "Reply", "SceneCopy", "TracingProcess", "View"]
