"""Ground floor: what every room shares and that knows nothing of rendering."""

from .backend import check_imports, check_llvm, check_variant, choose_variant, ensure_llvm, set_threads, use_variant
from .errors import (
    BackendError,
    CheckpointError,
    EtendueError,
    OptionError,
    OutputError,
    SceneError,
    UnsupportedError,
)
from .log import logger
from .measurement import RELATIVE_EPSILON, Iterations, Measurement
from .method import Method, Result
from .settings import Settings, setting

__all__ = [
    "RELATIVE_EPSILON",
    "BackendError",
    "CheckpointError",
    "EtendueError",
    "Iterations",
    "Measurement",
    "Method",
    "OptionError",
    "OutputError",
    "Result",
    "SceneError",
    "Settings",
    "UnsupportedError",
    "check_imports",
    "check_llvm",
    "check_variant",
    "choose_variant",
    "ensure_llvm",
    "logger",
    "set_threads",
    "setting",
    "use_variant",
]
