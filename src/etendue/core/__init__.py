"""Shared basics, independent of rendering: settings, measurements, methods, random numbers, errors, backend."""

from .backend import (
    check_llvm,
    check_variant,
    choose_variant,
    copied_to_device,
    lower_priority,
    on_device,
    set_threads,
    use_variant,
)
from .citations import bibliography, bibtex
from .errors import (
    BackendError,
    CheckpointError,
    ClusterError,
    EtendueError,
    OptionError,
    OutputError,
    SceneError,
    UnsupportedError,
    describe,
    suggest,
)
from .extras import library, sparse
from .frozen import Frozen
from .log import logger
from .measurement import CONTRAST, RELATIVE_EPSILON, Array, Iterations, Measurement, warn_of_nonfinite
from .memory import free_memory
from .method import Carrying, Method, Pass, Replica, Result, State, on_host, prepared
from .notebooks import InNotebooks
from .progress import Progress, format_count, format_number, format_rate, format_seconds, format_shares
from .records import PassKey, Record, RecordFile
from .samples import (
    COMPONENTS_PER_VERTEX,
    IndependentSource,
    SampleSource,
    hash_mix,
    keyed_bits,
    seed_key,
    to_unit_float,
)
from .settings import Settings, checked_path, is_number, is_whole, setting

__all__ = [
    "COMPONENTS_PER_VERTEX",
    "CONTRAST",
    "RELATIVE_EPSILON",
    "Array",
    "BackendError",
    "Carrying",
    "CheckpointError",
    "ClusterError",
    "EtendueError",
    "Frozen",
    "InNotebooks",
    "IndependentSource",
    "Iterations",
    "Measurement",
    "Method",
    "OptionError",
    "OutputError",
    "Pass",
    "PassKey",
    "Progress",
    "Record",
    "RecordFile",
    "Replica",
    "Result",
    "SampleSource",
    "SceneError",
    "Settings",
    "State",
    "UnsupportedError",
    "bibliography",
    "bibtex",
    "check_llvm",
    "check_variant",
    "checked_path",
    "choose_variant",
    "copied_to_device",
    "describe",
    "format_count",
    "format_number",
    "format_rate",
    "format_seconds",
    "format_shares",
    "free_memory",
    "hash_mix",
    "is_number",
    "is_whole",
    "keyed_bits",
    "library",
    "logger",
    "lower_priority",
    "on_device",
    "on_host",
    "prepared",
    "seed_key",
    "set_threads",
    "setting",
    "sparse",
    "suggest",
    "to_unit_float",
    "use_variant",
    "warn_of_nonfinite",
]
