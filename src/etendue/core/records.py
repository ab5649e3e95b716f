"""Records: rows that passes append and that are not summed, such as segments of lines."""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable, Iterator, Mapping
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
    """A file with the rows of some passes, one after the other; never modified after it is written."""

    path: str  #: absolute
    #: CRC-32 of the rows.
    checksum: int
    #: Passes and the number of rows of each, in the order of the file.
    passes: tuple[tuple[PassKey, int], ...]

    def __len__(self) -> int:
        return sum(count for _, count in self.passes)


class Record:
    """Arrays of rows, one for each pass, ordered by replica and iteration.

    All arrays have the same type and the same shape of a row, (k, ...), and are not modified. They are in memory, or in
    :attr:`files` that are mapped into memory, so that a record may be larger than the memory.
    """

    def __init__(self, parts: Mapping[PassKey, Rows] | None = None) -> None:
        self._parts: dict[PassKey, Rows] = dict(parts or {})
        self._order = sorted(self._parts)
        self._rows = sum(map(len, self._parts.values()))
        #: Files that contain some of the rows; other rows are in memory only.
        self.files: list[RecordFile] = []

    @classmethod
    def single(cls, rows: Rows, iteration: int, replica: int = 0) -> Record:
        """The rows of one pass."""
        return cls({(replica, iteration): rows})

    def __len__(self) -> int:
        return self._rows

    def __iter__(self) -> Iterator[Rows]:
        return (self._parts[key] for key in self._order)

    def __getitem__(self, key: PassKey) -> Rows:
        return self._parts[key]

    @property
    def passes(self) -> list[PassKey]:
        """Replica and iteration of each array, in order."""
        return list(self._order)

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
            raise EtendueError(f"records with different types of rows cannot be added: {sorted(map(str, kinds))}")

    def __iadd__(self, other: Record) -> Record:
        self.check(other)
        self._parts |= other._parts
        for key in other._order:
            insort(self._order, key)
        self._rows += other._rows
        self.files += other.files
        return self

    def keep(self, files: Iterable[RecordFile], file: RecordFile, rows: Rows) -> None:
        """Replace rows by the equal ``rows`` of a new ``file``, mapped into memory. The record's files then are
        ``files`` and the new one."""
        ends = np.cumsum([0, *(count for _, count in file.passes)])
        parts = {key: rows[a:b] for (key, _), a, b in zip(file.passes, ends[:-1], ends[1:], strict=True)}
        self._rows += sum(count for key, count in file.passes if key not in self._parts)
        for key in parts.keys() - self._parts.keys():
            insort(self._order, key)
        self._parts |= parts
        self.files = [*files, file]

    def _first(self) -> list[Rows]:
        return [next(iter(self._parts.values()))] if self._parts else []
