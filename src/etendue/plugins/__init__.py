"""Registration of étendue's methods and plugins with Mitsuba, under every variant that is set, now or later."""

from .registration import register

__all__ = ["register"]
