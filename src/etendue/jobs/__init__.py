"""Jobs: requests, their execution and their output files, for pictures and for radiosity."""

from importlib import import_module
from typing import TYPE_CHECKING

from .files import PathLike, Writing, about, check_files, listed
from .pictures import Image, Outputs, PictureWork, Rendering, Update, Writer, check_picture, save_result
from .results import DEFAULT_BUNDLES, DEFAULT_POINTS, FormFactorResult, LinesResult, RadiosityResult
from .running import Passes, Watch, Work, run_work, start_work
from .wording import PYTHON, Wording

if TYPE_CHECKING:
    from .boxes import DEFAULT_PASSES, HierarchyRequest, HierarchyResult, HierarchyWork
    from .gathering import PICTURE_FILES, picture
    from .hierarchies import split_settings
    from .lines import LinesJob, LinesTask
    from .linesrequest import LinesRequest
    from .maps.making import MadeMap, MapOptions, make_map
    from .maps.sources import FileSource
    from .maps.writing import MAP_FILES, check_map_file, map_lightmap, write_map
    from .multipath import MultipathWork
    from .particles import DEFAULT_PATHS, TRACINGS, ParticleRequest, ParticleResult, ParticleWork, repack
    from .requests import FormFactorRequest, RadiosityRequest, asked_before
    from .solutions import ERROR_SCALE, SolutionOutputs, files_and_lightmap, saved_solution
    from .solving import (
        FormFactorWork,
        LinesWork,
        PatchWork,
        RadiosityWork,
        RequestedWork,
        radiosity_work,
        solve_ambient,
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


__all__ = [
    "DEFAULT_BUNDLES",
    "DEFAULT_PASSES",
    "DEFAULT_PATHS",
    "DEFAULT_POINTS",
    "ERROR_SCALE",
    "MAP_FILES",
    "PICTURE_FILES",
    "PYTHON",
    "TRACINGS",
    "FileSource",
    "FormFactorRequest",
    "FormFactorResult",
    "FormFactorWork",
    "HierarchyRequest",
    "HierarchyResult",
    "HierarchyWork",
    "Image",
    "LinesJob",
    "LinesRequest",
    "LinesResult",
    "LinesTask",
    "LinesWork",
    "MadeMap",
    "MapOptions",
    "MultipathWork",
    "Outputs",
    "ParticleRequest",
    "ParticleResult",
    "ParticleWork",
    "Passes",
    "PatchWork",
    "PathLike",
    "PictureWork",
    "RadiosityRequest",
    "RadiosityResult",
    "RadiosityWork",
    "Rendering",
    "RequestedWork",
    "SolutionOutputs",
    "Update",
    "Watch",
    "Wording",
    "Work",
    "Writer",
    "Writing",
    "about",
    "asked_before",
    "check_files",
    "check_map_file",
    "check_picture",
    "files_and_lightmap",
    "listed",
    "make_map",
    "map_lightmap",
    "picture",
    "radiosity_work",
    "repack",
    "run_work",
    "save_result",
    "saved_solution",
    "solve_ambient",
    "split_settings",
    "start_work",
    "write_map",
]
