"""Particles, their files, and maps of irradiance made from them."""

from .mapfiles import (
    MAP_FILES as MAP_FILES,
    check_map_file as check_map_file,
    map_lightmap as map_lightmap,
    write_map as write_map,
)
from .maps import MadeMap as MadeMap, MapOptions as MapOptions, make_map as make_map
from .sources import FileSource as FileSource
from .tracing import (
    DEFAULT_PATHS as DEFAULT_PATHS,
    ParticleProduct as ParticleProduct,
    ParticleResult as ParticleResult,
    repack as repack,
)
