"""Records: rows that passes append and nobody adds up, such as segments of lines, particles or samples of the film."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import EtendueError

#: Replica and iteration of a pass.
PassKey = tuple[int, int]
Rows = NDArray[Any]


@dataclass(frozen=True)
class RecordFile:
    """A file, never changed once it is written, that holds the rows of some passes one after the other."""

    path: str
    #: CRC-32 of the rows.
    checksum: int
    #: Passes and the number of rows of each, in the order of the file.
    passes: tuple[tuple[PassKey, int], ...]


class Record:
    """Arrays of rows, one for each pass, ordered by replica and iteration.

    All arrays have one type and one shape of a row, (k, ...), and are not changed. They may lie in memory or in
    :attr:`files`, mapped into it: a record may be larger than the memory.
    """

    def __init__(self, parts: Mapping[PassKey, Rows] | None = None) -> None:
        self._parts: dict[PassKey, Rows] = dict(parts or {})
        #: Those that hold a part of the rows; the others are in memory alone.
        self.files: list[RecordFile] = []

    @classmethod
    def single(cls, rows: Rows, iteration: int, replica: int = 0) -> Record:
        """The rows of one pass."""
        return cls({(replica, iteration): rows})

    def __len__(self) -> int:
        return sum(map(len, self._parts.values()))

    def __iter__(self) -> Iterator[Rows]:
        return (self._parts[key] for key in self.passes)

    def __getitem__(self, key: PassKey) -> Rows:
        return self._parts[key]

    @property
    def passes(self) -> list[PassKey]:
        """Replica and iteration of each array, in order."""
        return sorted(self._parts)

    @property
    def nbytes(self) -> int:
        """Size of all rows, in memory and in files."""
        return sum(rows.nbytes for rows in self._parts.values())

    def copy(self) -> Record:
        """A record of the same arrays."""
        result = Record(self._parts)
        result.files = list(self.files)
        return result

    def check(self, other: Record) -> None:
        """Raise :class:`EtendueError` unless ``other`` can be appended: rows of the same kind, of other passes."""
        if both := self._parts.keys() & other._parts.keys():
            replica, iteration = min(both)
            raise EtendueError(f"rows of iteration {iteration} of replica {replica} are in both records")
        kinds = {(rows.dtype, rows.shape[1:]) for record in (self, other) for rows in record._first()}
        if len(kinds) > 1:
            raise EtendueError(f"records of different rows cannot be put together: {sorted(map(str, kinds))}")

    def __iadd__(self, other: Record) -> Record:
        self.check(other)
        self._parts |= other._parts
        self.files += other.files
        return self

    def keep(self, file: RecordFile, rows: Rows) -> None:
        """Take the ``rows`` of a file in place of those in memory, which they equal."""
        ends = np.cumsum([0, *(count for _, count in file.passes)])
        for (key, _), start, end in zip(file.passes, ends[:-1], ends[1:], strict=True):
            self._parts[key] = rows[start:end]
        self.files.append(file)

    def unkept(self, folder: str | os.PathLike[str]) -> list[PassKey]:
        """Passes whose rows no file in ``folder`` holds, in order."""
        here = os.path.realpath(folder)
        kept = {
            key for file in self.files if os.path.dirname(os.path.realpath(file.path)) == here for key, _ in file.passes
        }
        return [key for key in self.passes if key not in kept]

    def _first(self) -> list[Rows]:
        return [next(iter(self._parts.values()))] if self._parts else []
