"""Particles, their files, and maps of irradiance made from them."""

from .mapfiles import (
    check_map_file as check_map_file,
    write_map as write_map,
)
from .maps import MadeMap as MadeMap, MapOptions as MapOptions, make_map as make_map
from .sources import FileSource as FileSource
from .tracing import (
    ParticleProduct as ParticleProduct,
    ParticleResult as ParticleResult,
    repack as repack,
)
