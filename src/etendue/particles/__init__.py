"""Particles on surfaces: records of light paths, their files and codecs."""

from .boxes import RECORD_WORDS, BoxGrid, BoxWalk
from .errors import ParticleError
from .files import ParticleFile, is_particle_file
from .layouts import RECORDS, merged, of_strips, records, strips
from .packing.codecs import LAYOUTS, Codec, decode, encode
from .packing.coders import coder, coder_names
from .packing.grid import Grid
from .particles import LAYOUT, RAW_BYTES, WORDS, Particles, Rows, columns_of
from .surfaces import Surfaces, SurfaceTable
from .walk import Keep, ParticleStore, ParticleWalk, in_path_order
from .writer import ParticleWriter

__all__ = [
    "LAYOUT",
    "LAYOUTS",
    "RAW_BYTES",
    "RECORDS",
    "RECORD_WORDS",
    "WORDS",
    "BoxGrid",
    "BoxWalk",
    "Codec",
    "Grid",
    "Keep",
    "ParticleError",
    "ParticleFile",
    "ParticleStore",
    "ParticleWalk",
    "ParticleWriter",
    "Particles",
    "Rows",
    "SurfaceTable",
    "Surfaces",
    "coder",
    "coder_names",
    "columns_of",
    "decode",
    "encode",
    "in_path_order",
    "is_particle_file",
    "merged",
    "of_strips",
    "records",
    "strips",
]
