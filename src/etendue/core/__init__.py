"""Shared basics, independent of rendering: settings, measurements, methods, random numbers, errors, backend."""

from .backend import (
    as_array as as_array,
    check_llvm as check_llvm,
    check_variant as check_variant,
    choose_variant as choose_variant,
    copied_to_device as copied_to_device,
    lower_priority as lower_priority,
    on_device as on_device,
    use_variant as use_variant,
    uses_cuda as uses_cuda,
)
from .citations import bibliography as bibliography, bibtex as bibtex
from .errors import (
    BackendError as BackendError,
    CheckpointError as CheckpointError,
    ClusterError as ClusterError,
    EtendueError as EtendueError,
    OptionError as OptionError,
    OutputError as OutputError,
    SceneError as SceneError,
    UnsupportedError as UnsupportedError,
    describe as describe,
    suggest as suggest,
)
from .extras import library as library, sparse as sparse
from .frozen import Frozen as Frozen
from .ingredients import Ingredients as Ingredients, numbers_for_json as numbers_for_json
from .kernels import (
    kernel_target as kernel_target,
    optimise_kernels as optimise_kernels,
    own_kernels as own_kernels,
)
from .lazy import on_use as on_use
from .log import logger as logger
from .measurement import (
    CONTRAST as CONTRAST,
    RELATIVE_EPSILON as RELATIVE_EPSILON,
    Array as Array,
    Iterations as Iterations,
    Measurement as Measurement,
    SquaresOf as SquaresOf,
    Weight as Weight,
    warn_of_nonfinite as warn_of_nonfinite,
)
from .memory import free_memory as free_memory
from .method import (
    Carrying as Carrying,
    Method as Method,
    Pass as Pass,
    Replica as Replica,
    Result as Result,
    State as State,
    on_host as on_host,
    prepared as prepared,
)
from .notebooks import InNotebooks as InNotebooks
from .progress import (
    Progress as Progress,
    format_count as format_count,
    format_number as format_number,
    format_rate as format_rate,
    format_seconds as format_seconds,
)
from .records import PassKey as PassKey, Record as Record, RecordFile as RecordFile
from .reprs import short_repr as short_repr
from .samples import (
    COMPONENTS_PER_VERTEX as COMPONENTS_PER_VERTEX,
    IndependentSource as IndependentSource,
    SampleSource as SampleSource,
    hash_mix as hash_mix,
    in_steps as in_steps,
    keyed_bits as keyed_bits,
    seed_key as seed_key,
    to_unit_float as to_unit_float,
)
from .settings import (
    Settings as Settings,
    checked_path as checked_path,
    is_number as is_number,
    is_whole as is_whole,
    setting as setting,
)
from .threads import (
    in_order as in_order,
    set_threads as set_threads,
    threads as threads,
    threads_for_files as threads_for_files,
)
from .version import VERSION as VERSION
