"""Coders of strips: lossless compression of bytes. Optional libraries are imported at first use."""

from __future__ import annotations

import bz2
import lzma
import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import library, suggest

from ..errors import ParticleError
from ..particles import RAW_BYTES

#: The coder ``fast`` leaves strips as they are whose entropy is above this share of eight bits a byte.
_WORTH = 0.85
#: For strips of at least ``_LONG`` bytes the entropy is that of every ``_EVERY``-th byte.
_LONG, _EVERY = 1 << 14, 4


@dataclass(frozen=True)
class Coder:
    """A lossless code of byte strings; ``decode`` gets the length of its result."""

    about: str
    encode: Callable[[bytes], bytes]
    decode: Callable[[bytes, int], bytes]


def _fast(data: bytes) -> bytes:
    """Huffman's code with runs, by zlib: two to five times as fast as its search for repetitions."""
    packer = zlib.compressobj(1, zlib.DEFLATED, -15, 9, zlib.Z_RLE)
    return packer.compress(data) + packer.flush()


def _inflate(data: bytes, length: int) -> bytes:
    return zlib.decompress(data, -15, length)


def run_lengths(data: bytes) -> bytes:
    """Runs as pairs of bytes, count and value [Leeson 2001, sec. 5.7.10]."""
    array = np.frombuffer(data, np.uint8)
    if len(array) == 0:
        return b""
    begins = np.concatenate([[0], np.flatnonzero(np.diff(array)) + 1])
    lengths = np.diff(np.append(begins, len(array)))
    pieces = -(-lengths // 255)
    values = np.repeat(array[begins], pieces)
    counts = np.full(len(values), 255)
    counts[np.cumsum(pieces) - 1] = lengths - 255 * (pieces - 1)
    return np.stack([counts, values], axis=1).astype(np.uint8).tobytes()


def of_run_lengths(data: bytes, length: int) -> bytes:
    """Inverse of :func:`run_lengths`."""
    pairs = np.frombuffer(data, np.uint8).reshape(-1, 2)
    return np.repeat(pairs[:, 1], pairs[:, 0]).tobytes()


def _zstandard() -> Coder:
    module = library("zstandard", "the coder 'zstd'", "particles")
    # Objects of this library must not be shared by threads.
    return Coder(
        "",
        lambda data: module.ZstdCompressor(level=3).compress(data),
        lambda data, n: module.ZstdDecompressor().decompress(data, n),
    )


def _lz4() -> Coder:
    module = library("lz4.block", "the coder 'lz4'", "particles")
    return Coder(
        "",
        lambda data: module.compress(data, store_size=False),
        lambda data, n: module.decompress(data, uncompressed_size=n),
    )


def _blosc() -> Coder:
    module = library("blosc2", "the coder 'blosc2'", "particles")

    def encode(data: bytes) -> bytes:
        # The bytes of rows are shuffled to planes; other strips are planes already.
        size = RAW_BYTES if len(data) % RAW_BYTES == 0 else 1
        packed: bytes = module.compress(data, size, 5, module.Filter.SHUFFLE, module.Codec.ZSTD)
        return packed

    return Coder("", encode, lambda data, n: module.decompress(data))


CODERS: dict[str, Coder] = {
    "none": Coder("no code", lambda data: data, lambda data, n: data),
    "fast": Coder("Huffman's code with runs, by zlib", _fast, _inflate),
    "zlib": Coder("zlib, level 6", lambda data: zlib.compress(data, 6), lambda data, n: zlib.decompress(data)),
    "bz2": Coder("bzip2, level 9", lambda data: bz2.compress(data, 9), lambda data, n: bz2.decompress(data)),
    "lzma": Coder(
        "LZMA, level 6",
        lambda data: lzma.compress(data, lzma.FORMAT_ALONE, preset=6),
        lambda data, n: lzma.decompress(data, lzma.FORMAT_ALONE),
    ),
    "rle": Coder("runs as count and value", run_lengths, of_run_lengths),
}
#: Coders of optional libraries.
_LATER: dict[str, tuple[str, Callable[[], Coder]]] = {
    "zstd": ("Zstandard, level 3 (library zstandard)", _zstandard),
    "lz4": ("LZ4 (library lz4)", _lz4),
    "blosc2": ("Blosc2 with shuffle (library blosc2)", _blosc),
}


def coder(name: str) -> Coder:
    """A coder by name. Raises :class:`ParticleError` for an unknown one, :class:`etendue.core.BackendError` if its
    library is not installed."""
    if name in _LATER and name not in CODERS:
        CODERS[name] = _LATER[name][1]()
    if name not in CODERS:
        raise ParticleError(f"there is no coder '{name}'; {suggest(name, (*CODERS, *_LATER))}")
    return CODERS[name]


def coder_names() -> dict[str, str]:
    """Names and descriptions of all coders."""
    return {name: known.about for name, known in CODERS.items() if known.about} | {
        name: about for name, (about, _) in _LATER.items()
    }


def coded(data: bytes | NDArray[np.uint8], name: str) -> tuple[str, bytes]:
    """(coder that was used, code) of a strip; the coder is ``none`` if ``name`` does not make the strip shorter."""
    array = np.frombuffer(data, np.uint8)
    plain = array.tobytes()
    if name == "none" or not plain or (name == "fast" and _entropy(array) > _WORTH * 8):
        return "none", plain
    made = coder(name).encode(plain)
    return (name, made) if len(made) < len(plain) else ("none", plain)


def _entropy(array: NDArray[np.uint8]) -> float:
    """Entropy in bits a byte, from the frequencies of values."""
    from . import kernels

    counts = np.empty(256, np.int64)
    kernels.entropy_counts(array, counts, _EVERY if len(array) >= _LONG else 1)
    shares = counts[counts > 0] / counts.sum()
    return float(-(shares * np.log2(shares)).sum())
