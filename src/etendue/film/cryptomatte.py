"""Cryptomatte [Friedman 2015]: the objects that a pixel shows and the share of the pixel that each covers.

The layers ``CryptoObject00``, ``CryptoObject01``, ... hold two ranks each: R and B are hashes of names as floats, G and
A the coverage, the largest first. Attributes of the file map names to hashes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

#: Name of the matte, with which the names of its layers begin, and prefix of its attributes.
MATTE: Final = "CryptoObject"
ATTRIBUTES: Final = "cryptomatte/"


def name_hash(name: str) -> int:
    """The hash of a name, 32 bits: MurmurHash3 for x86 with the seed 0, of UTF-8."""
    data, h = name.encode(), 0
    for first in range(0, len(data), 4):
        k = int.from_bytes(data[first : first + 4], "little") * 0xCC9E2D51 & 0xFFFFFFFF
        h ^= _turned(k, 15) * 0x1B873593 & 0xFFFFFFFF
        if first + 4 <= len(data):
            h = (_turned(h, 13) * 5 + 0xE6546B64) & 0xFFFFFFFF
    h ^= len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        h = (h ^ (h >> shift)) * factor & 0xFFFFFFFF
    return h ^ (h >> 16)


def id_bits(name: str) -> int:
    """The bits of the float that stands for a name: its hash, but no denormal, infinite number or NaN."""
    bits = name_hash(name)
    return bits ^ (1 << 23) if (bits >> 23 & 255) in (0, 255) else bits


def matte_layers(
    numbers: NDArray[np.uint32], coverage: NDArray[np.float32], names: Sequence[str]
) -> dict[str, NDArray[np.float32]]:
    """The layers of a matte, (height, width, 4) each. ``numbers``: which of the ``names`` a pixel shows, from 1, or 0
    for none; ``coverage``: of each. Both are (height, width, ranks), with an even number of ranks."""
    order = np.argsort(-coverage, axis=2, kind="stable")
    ranks = np.take_along_axis(coverage, order, axis=2)
    bits = np.array([0, *(id_bits(name) for name in names)], np.uint32)
    ids = bits[np.take_along_axis(numbers, order, axis=2)].view(np.float32)
    pairs = np.stack([np.where(ranks > 0.0, ids, np.float32(0.0)), ranks], axis=3)
    flat = pairs.reshape(*numbers.shape[:2], -1)
    return {f"{MATTE}{k:02d}": np.ascontiguousarray(flat[:, :, 4 * k : 4 * k + 4]) for k in range(flat.shape[2] // 4)}


def matte_attributes(names: Sequence[str]) -> dict[str, str]:
    """Attributes of a file with a matte of these names."""
    key = f"{ATTRIBUTES}{name_hash(MATTE):08x}"[: len(ATTRIBUTES) + 7]
    about = {
        "name": MATTE,
        "hash": "MurmurHash3_32",
        "conversion": "uint32_to_float32",
        "manifest": json.dumps({name: f"{id_bits(name):08x}" for name in names}, ensure_ascii=False),
    }
    return {f"{key}/{field}": text for field, text in about.items()}


def _turned(word: int, by: int) -> int:
    """A word of 32 bits, rotated to the left."""
    return (word << by | word >> (32 - by)) & 0xFFFFFFFF


def is_matte(layer: str) -> bool:
    """Whether a layer is one of a matte."""
    return layer.startswith(MATTE)
