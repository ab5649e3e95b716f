"""Particles on surfaces: records of light paths, their files and codecs."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .boxes import BoxGrid as BoxGrid, BoxWalk as BoxWalk
    from .errors import ParticleError as ParticleError
    from .files import ParticleFile as ParticleFile, is_particle_file as is_particle_file
    from .layouts import (
        RECORDS as RECORDS,
        merged as merged,
        of_strips as of_strips,
        records as records,
        strips as strips,
    )
    from .packing.codecs import Codec as Codec, decode as decode, encode as encode
    from .packing.coders import coder as coder, coder_names as coder_names
    from .packing.grid import Grid as Grid
    from .particles import (
        LAYOUT as LAYOUT,
        RAW_BYTES as RAW_BYTES,
        WORDS as WORDS,
        Particles as Particles,
        Rows as Rows,
        columns_of as columns_of,
    )
    from .surfaces import Surfaces as Surfaces, SurfaceTable as SurfaceTable
    from .walk import (
        Keep as Keep,
        ParticleStore as ParticleStore,
        ParticleWalk as ParticleWalk,
        in_path_order as in_path_order,
    )
    from .writer import ParticleWriter as ParticleWriter
else:
    __getattr__, __dir__ = on_use(__name__)
