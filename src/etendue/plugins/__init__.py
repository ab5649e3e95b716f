"""Registration of étendue's methods and plugins with Mitsuba, under the current and all later variants."""

from .registration import register, register_method

__all__ = ["register", "register_method"]
