"""Products: what leaves a run, and its files: pictures, form factors, solutions, particles and maps of them."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .daylight import (
        Daylight as Daylight,
        DaylightResult as DaylightResult,
        check_daylight_file as check_daylight_file,
    )
    from .files import (
        PathLike as PathLike,
        Writing as Writing,
        about as about,
        check_files as check_files,
        listed as listed,
    )
    from .heat import HeatResult as HeatResult, heat_files as heat_files, warn_of_cold_sky as warn_of_cold_sky
    from .patchpictures import patch_picture as patch_picture
    from .pictures import (
        Image as Image,
        Picture as Picture,
        Rendering as Rendering,
        check_picture as check_picture,
        developed as developed,
        picture_task as picture_task,
        save_result as save_result,
        scene_settings as scene_settings,
    )
    from .readings import MeterTable as MeterTable, Readings as Readings
    from .registry import (
        DEFAULT as DEFAULT,
        FACTORS as FACTORS,
        PARTICLES as PARTICLES,
        SOLUTIONS as SOLUTIONS,
        budget_of as budget_of,
        choose_method as choose_method,
        chosen as chosen,
        current as current,
        find as find,
        limits_of as limits_of,
        table as table,
    )
    from .results import FormFactorResult as FormFactorResult, RadiosityResult as RadiosityResult
    from .resuming import saved_task as saved_task
    from .running import Callback as Callback, Update as Update, run_job as run_job, start_job as start_job
else:
    __getattr__, __dir__ = on_use(__name__)
