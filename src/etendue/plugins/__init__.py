"""Registration of étendue's methods and plugins with Mitsuba, under the current and all later variants."""

from .registration import register as register, register_method as register_method
