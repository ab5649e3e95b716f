"""Form factors and solutions: what is made from lines through patches, and its files."""

from .base import PatchProduct as PatchProduct
from .daylight import DaylightRun as DaylightRun, PatchDaylight as PatchDaylight, daylight_run as daylight_run
from .factors import FormFactorProduct as FormFactorProduct
from .gathering import picture as picture
from .illuminance import illuminance_text as illuminance_text
from .saved import write_saved as write_saved
from .solution_files import (
    ERROR_SCALE as ERROR_SCALE,
    SolutionFiles as SolutionFiles,
    files_and_lightmap as files_and_lightmap,
)
from .solutions import SolutionProduct as SolutionProduct
from .sunshine import make_sunlight as make_sunlight
from .tasks import (
    AtOnce as AtOnce,
    FactorRun as FactorRun,
    SolutionRun as SolutionRun,
    without_hierarchy as without_hierarchy,
)
