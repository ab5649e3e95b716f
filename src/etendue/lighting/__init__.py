"""Lighting design and daylight as numbers: photometric files, skies, the sun, weather, glare, units. NumPy only."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .bearings import compass as compass
    from .daylight import AnnualDaylight as AnnualDaylight, DaylightCoefficients as DaylightCoefficients
    from .discomfort import (
        Glare as Glare,
        GlareSource as GlareSource,
        glare as glare,
        position_index as position_index,
    )
    from .errors import LightingError as LightingError
    from .files import read_photometry as read_photometry
    from .meters import QUANTITIES as QUANTITIES, Meters as Meters, Quantity as Quantity
    from .patches import SkyPatches as SkyPatches
    from .skies import (
        GROUND as GROUND,
        SUN_DIAMETER as SUN_DIAMETER,
        Sky as Sky,
        cie_sky as cie_sky,
        perez_sky as perez_sky,
    )
    from .sun import day_of_year as day_of_year, sun_direction as sun_direction
    from .suns import Suns as Suns
    from .tilt import Tilt as Tilt
    from .units import EFFICACY as EFFICACY, photometric as photometric
    from .views import PROJECTIONS as PROJECTIONS, Projection as Projection, View as View
    from .weather import Beam as Beam, Weather as Weather, read_epw as read_epw
    from .web import PhotometricWeb as PhotometricWeb
else:
    __getattr__, __dir__ = on_use(__name__)
