"""Registration of étendue's methods and plugins with Mitsuba, under every variant that is set, now or later."""

from .registration import register, register_method

__all__ = ["register", "register_method"]
