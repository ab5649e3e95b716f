"""Blocks of a file of particles, and their recovery from a file that was cut off.

A file is a sequence of blocks. A block has 20 bytes, its head and its payload:

=======  ==========================================================================
4 bytes  kind: ``ETPF`` header, ``CHNK`` particles, ``PASS`` end of a pass, ``INDX`` index
4 bytes  length of the head
8 bytes  length of the payload
4 bytes  CRC-32 of the head, which contains that of the payload
head     JSON
payload  bytes
=======  ==========================================================================

All numbers are little-endian. The first block is the header; its payload has the frames of primitives. The particles of
a pass are chunks, followed by the block ``PASS``, which makes them valid. The index has the heads of all blocks; the
last 16 bytes of a finished file are the position of the index and ``ETPFINDX``. A file without them is read block by
block.
"""

from __future__ import annotations

import json
import mmap
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

#: Version of the layout of the file.
FORMAT = 2
HEADER, CHUNK, PASS, INDEX = b"ETPF", b"CHNK", b"PASS", b"INDX"
_PREFIX = struct.Struct("<4sIQI")
_END = struct.Struct("<Q8s")
_MAGIC = b"ETPFINDX"
#: Longest head that is read from a file that may be damaged.
_MOST = 1 << 30


@dataclass(frozen=True)
class Block:
    """A block in a file; ``start`` and ``end``: positions of its payload."""

    kind: bytes
    head: dict[str, Any]
    start: int
    end: int

    def payload(self, file: BinaryIO) -> bytes:
        """Read the payload. Raises ``ValueError`` if it is damaged."""
        file.seek(self.start)
        data = file.read(self.end - self.start)
        if len(data) != self.end - self.start or zlib.crc32(data) != self.head["crc"]:
            raise ValueError("wrong checksum")
        return data


def _write(file: BinaryIO, data: bytes) -> None:
    """Write all bytes to an unbuffered file, whose ``write`` may take only some of them."""
    view = memoryview(data)
    while len(view):
        view = view[file.write(view) :]


def write_block(file: BinaryIO, kind: bytes, head: dict[str, Any], payload: Sequence[bytes] = ()) -> Block:
    """Append a block at the current position of an unbuffered file."""
    checksum = 0
    for part in payload:
        checksum = zlib.crc32(part, checksum)
    head = head | {"crc": checksum}
    text = json.dumps(head, separators=(",", ":")).encode()
    length = sum(map(len, payload))
    start = file.tell() + _PREFIX.size + len(text)
    _write(file, b"".join([_PREFIX.pack(kind, len(text), length, zlib.crc32(text)), text, *payload]))
    return Block(kind, head, start, start + length)


def read_block(file: BinaryIO, size: int) -> Block | None:
    """The block at the current position of a file of ``size`` bytes, without its payload; then the file is behind it.
    ``None`` if it is incomplete or damaged."""
    prefix = file.read(_PREFIX.size)
    if len(prefix) < _PREFIX.size:
        return None
    kind, head_length, length, checksum = _PREFIX.unpack(prefix)
    if kind not in (HEADER, CHUNK, PASS, INDEX) or head_length > _MOST:
        return None
    text = file.read(head_length)
    start = file.tell()
    if len(text) < head_length or zlib.crc32(text) != checksum or start + length > size:
        return None
    file.seek(start + length)
    return Block(kind, json.loads(text), start, start + length)


def scanned(file: BinaryIO, size: int) -> Iterator[Block]:
    """Complete blocks from the current position on, up to the index or the first damaged or incomplete block."""
    while (block := read_block(file, size)) is not None and block.kind != INDEX:
        yield block


def whole_passes(file: BinaryIO, start: int, size: int) -> int:
    """Number of ``PASS`` blocks anywhere behind ``start``, the end of the last readable pass. A file that was cut off
    has none there; a damaged file has those of the passes behind the damage."""
    found = 0
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place = data.find(PASS, start)
        while place >= 0:
            file.seek(place)
            found += read_block(file, size) is not None
            place = data.find(PASS, place + 1)
    return found


def write_index(file: BinaryIO, blocks: Sequence[Block], head: dict[str, Any]) -> None:
    """Append the index of ``blocks``, and the end of the file."""
    rows = [[block.kind.decode(), block.head, block.start, block.end] for block in blocks]
    place = file.tell()
    write_block(file, INDEX, head, [zlib.compress(json.dumps(rows, separators=(",", ":")).encode(), 1)])
    _write(file, _END.pack(place, _MAGIC))


def read_index(file: BinaryIO, size: int) -> tuple[list[Block], dict[str, Any]] | None:
    """(blocks, head of the index) of a finished file; ``None`` for another file."""
    if size < _END.size:
        return None
    file.seek(size - _END.size)
    place, magic = _END.unpack(file.read(_END.size))
    if magic != _MAGIC or place > size:
        return None
    file.seek(place)
    block = read_block(file, size)
    if block is None or block.kind != INDEX:
        return None
    try:
        rows = json.loads(zlib.decompress(block.payload(file)))
    except (ValueError, zlib.error):
        return None
    return [Block(kind.encode(), head, start, end) for kind, head, start, end in rows], block.head
