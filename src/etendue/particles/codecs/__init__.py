"""Codecs of particles: layouts of a pass as chunks of bytes, and coders of their strips."""

from .codec import LAYOUTS, Codec, decode, encode
from .coders import coder, coder_names
from .grid import Grid

__all__ = ["LAYOUTS", "Codec", "Grid", "coder", "coder_names", "decode", "encode"]
