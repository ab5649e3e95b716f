"""Jobs: requests, their execution and their output files, for pictures and for radiosity."""

from importlib import import_module
from typing import TYPE_CHECKING

from .files import (
    PathLike as PathLike,
    Writing as Writing,
    about as about,
    check_files as check_files,
    listed as listed,
)
from .pictures import (
    Image as Image,
    Outputs as Outputs,
    PictureWork as PictureWork,
    Rendering as Rendering,
    Update as Update,
    Writer as Writer,
    check_picture as check_picture,
    save_result as save_result,
)
from .results import (
    DEFAULT_BUNDLES as DEFAULT_BUNDLES,
    DEFAULT_POINTS as DEFAULT_POINTS,
    FormFactorResult as FormFactorResult,
    LinesResult as LinesResult,
    RadiosityResult as RadiosityResult,
)
from .running import Passes as Passes, Watch as Watch, Work as Work, run_work as run_work, start_work as start_work
from .wording import PYTHON as PYTHON, Wording as Wording

if TYPE_CHECKING:
    from .boxes import (
        DEFAULT_PASSES as DEFAULT_PASSES,
        HierarchyRequest as HierarchyRequest,
        HierarchyResult as HierarchyResult,
        HierarchyWork as HierarchyWork,
    )
    from .gathering import PICTURE_FILES as PICTURE_FILES, picture as picture
    from .hierarchies import split_settings as split_settings
    from .lines import LinesJob as LinesJob, LinesTask as LinesTask
    from .linesrequest import LinesRequest as LinesRequest
    from .maps.making import MadeMap as MadeMap, MapOptions as MapOptions, make_map as make_map
    from .maps.sources import FileSource as FileSource
    from .maps.writing import (
        MAP_FILES as MAP_FILES,
        check_map_file as check_map_file,
        map_lightmap as map_lightmap,
        write_map as write_map,
    )
    from .multipath import MultipathWork as MultipathWork
    from .particles import (
        DEFAULT_PATHS as DEFAULT_PATHS,
        TRACINGS as TRACINGS,
        ParticleRequest as ParticleRequest,
        ParticleResult as ParticleResult,
        ParticleWork as ParticleWork,
        repack as repack,
    )
    from .requests import (
        FormFactorRequest as FormFactorRequest,
        RadiosityRequest as RadiosityRequest,
        asked_before as asked_before,
    )
    from .solutions import (
        ERROR_SCALE as ERROR_SCALE,
        SolutionOutputs as SolutionOutputs,
        files_and_lightmap as files_and_lightmap,
        saved_solution as saved_solution,
    )
    from .solving import (
        FormFactorWork as FormFactorWork,
        LinesWork as LinesWork,
        PatchWork as PatchWork,
        RadiosityWork as RadiosityWork,
        RequestedWork as RequestedWork,
        radiosity_work as radiosity_work,
        solve_ambient as solve_ambient,
    )
else:
    #: Modules of radiosity and particles. They are imported when one of their names is used, since rendering does not
    #: need them.
    _LATER = {
        "gathering": ("PICTURE_FILES", "picture"),
        "boxes": ("DEFAULT_PASSES", "HierarchyRequest", "HierarchyResult", "HierarchyWork"),
        "hierarchies": ("split_settings",),
        "lines": ("LinesJob", "LinesTask"),
        "maps.making": ("MadeMap", "MapOptions", "make_map"),
        "maps.sources": ("FileSource",),
        "maps.writing": ("MAP_FILES", "check_map_file", "map_lightmap", "write_map"),
        "multipath": ("MultipathWork",),
        "linesrequest": ("LinesRequest",),
        "particles": ("DEFAULT_PATHS", "TRACINGS", "ParticleRequest", "ParticleResult", "ParticleWork", "repack"),
        "requests": ("FormFactorRequest", "RadiosityRequest", "asked_before"),
        "solutions": ("ERROR_SCALE", "SolutionOutputs", "files_and_lightmap", "saved_solution"),
        "solving": (
            "FormFactorWork",
            "LinesWork",
            "PatchWork",
            "RadiosityWork",
            "RequestedWork",
            "radiosity_work",
            "solve_ambient",
        ),
    }

    def __getattr__(name):
        """See :data:`_LATER`."""
        for module, names in _LATER.items():
            if name in names:
                return getattr(import_module(f"{__name__}.{module}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
