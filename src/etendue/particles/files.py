"""Files of particles: reading all of them, or those on some surfaces and in a region."""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, InNotebooks, checked_path, in_order, logger, suggest
from etendue.scene import Problem

from . import blocks
from .blocks import Block
from .errors import ParticleError
from .packing.codecs import Codec, decode
from .packing.grid import Grid
from .particles import WORDS, Particles, Rows, columns_of
from .surfaces import Surfaces

PathLike = str | os.PathLike[str]
T = TypeVar("T")


def is_particle_file(path: PathLike) -> bool:
    """Whether a file begins like a file of particles."""
    try:
        with open(path, "rb") as file:
            return file.read(len(blocks.HEADER)) == blocks.HEADER
    except OSError:
        return False


class ParticleFile(InNotebooks):
    """The particles of a file. Heads of blocks are read when the file is opened, particles on request.

    A file that was cut off has the particles of its complete passes. Raises :class:`ParticleError` if there is no file,
    if it is not a file of particles, or if its format has another version.

    Attributes
    ----------
    header: scene, fingerprints, seed, settings, codec and versions.
    surfaces: the shapes of the scene. counters: paths, particles and rays. passes: iterations.
    is_finished: whether the run that wrote the file ended, by its budget or on request. lost: number of complete passes
    behind a damaged place, which cannot be read; a warning reports them.
    """

    def __init__(self, path: PathLike) -> None:
        self.path = checked_path(path, "a file of particles")
        try:
            with open(self.path, "rb") as file:
                self._open(file)
        except FileNotFoundError:
            raise ParticleError(f"there is no file '{path}' of particles; check the name") from None
        except OSError as error:
            raise ParticleError(f"cannot read '{path}': {error.strerror or error}") from None

    def _open(self, file: BinaryIO) -> None:
        size = os.fstat(file.fileno()).st_size
        first = blocks.read_block(file, size)
        if first is None or first.kind != blocks.HEADER:
            raise ParticleError(f"'{self.path}' is not a file of particles, or its beginning is damaged")
        self.header = first.head
        if self.header["format"] != blocks.FORMAT:
            version = self.header.get("versions", {}).get("etendue", "of another version")
            raise ParticleError(
                f"'{self.path}' has format {self.header['format']}, this étendue reads format {blocks.FORMAT}; "
                f"read it by étendue {version}"
            )
        self.codec = Codec.parse(self.header["codec"])
        try:
            frames = np.frombuffer(zlib.decompress(first.payload(file)), np.float32).reshape(-1, 9)
        except (ValueError, zlib.error):
            raise ParticleError(f"the header of '{self.path}' is damaged; trace the particles anew") from None
        self.surfaces = Surfaces.described(self.header["surfaces"], frames)
        self.grid = Grid(self.surfaces)
        found = blocks.read_index(file, size)
        if found is None:
            file.seek(first.end)
            found = list(blocks.scanned(file, size)), {}
        every, self.ending = found
        #: Position in the file where the last complete pass ends.
        self.end = first.end
        #: Chunks of particles, and the ends of passes.
        self.chunks: list[Block] = []
        self.passes: list[Block] = []
        waiting: list[Block] = []
        for block in every:
            if block.kind == blocks.CHUNK:
                waiting.append(block)
            elif block.kind == blocks.PASS:
                self.chunks += waiting
                self.passes.append(block)
                waiting, self.end = [], block.end
        self.is_finished = bool(self.ending.get("stopped_by"))
        self.size = size
        #: Complete passes behind a damaged place, which cannot be read.
        self.lost = 0 if self.ending else blocks.whole_passes(file, self.end, size)
        if self.lost:
            logger.warning(
                "'%s' is damaged behind its first %d passes: %d more are left out; copy it again, or trace anew",
                *(self.path, len(self.passes), self.lost),
            )
        self.counters: dict[str, float] = {}
        for block in self.passes:
            for name, value in block.head["counters"].items():
                self.counters[name] = self.counters.get(name, 0.0) + value

    def __len__(self) -> int:
        return sum(int(block.head["count"]) for block in self.chunks)

    @property
    def paths(self) -> int:
        """Light paths that were emitted."""
        return int(self.counters.get("paths", 0))

    @property
    def bounds(self) -> dict[str, float]:
        """Bounds of the errors of all codecs that have packed the particles, see :attr:`Grid.bounds`; empty if they are
        exact."""
        times = sum(Codec.parse(name).is_bounded for name in (self.header["codec"], *self.header.get("before", [])))
        return {name: times * bound for name, bound in self.grid.bounds.items()} if times else {}

    @property
    def has_paths(self) -> bool:
        """Whether particles have the numbers of their paths, which the codec ``packed-no-paths`` leaves out."""
        names = (self.header["codec"], *self.header.get("before", []))
        return all(Codec.parse(name).layout != "packed-no-paths" for name in names)

    @property
    def counts(self) -> NDArray[np.int64]:
        """Particles on each shape, from the heads of chunks."""
        counts = np.zeros(len(self.surfaces), np.int64)
        for block in self.chunks:
            for shape, count in block.head["shapes"]:
                counts[shape] += count
        return counts

    @property
    def power(self) -> Array:
        """Sum of the power of all particles, (3,) W, from the heads of chunks."""
        total = np.sum([block.head["power"] for block in self.chunks], axis=0) if self.chunks else np.zeros(3)
        return np.asarray(total / max(self.paths, 1))

    def shape(self, name: str | int) -> int:
        """The index of a shape by name or index; of the shape "12", if there is one, for "12". Raises
        :class:`ParticleError` if there is none."""
        names = self.surfaces.names
        if name in names:
            return names.index(str(name))
        if isinstance(name, (int, np.integer)) or str(name).isdecimal():
            if 0 <= int(name) < len(names):
                return int(name)
            raise ParticleError(f"there is no shape {name}: '{self.path}' has shapes 0 to {len(names) - 1}")
        raise ParticleError(f"there is no shape '{name}' in '{self.path}'; {suggest(str(name), names, 'it has')}")

    def read(self, shapes: Sequence[str | int] | None = None, box: ArrayLike | None = None) -> Particles:
        """All particles, or those on ``shapes`` (names or indices) and in ``box`` ((2, 3): lower and upper corner)."""
        return Particles.joined(list(self.parts(shapes, box)))

    def parts(
        self,
        shapes: Sequence[str | int] | None = None,
        box: ArrayLike | None = None,
        passes: Collection[int] | None = None,
    ) -> Iterator[Particles]:
        """As :meth:`read`, in parts of at most 65536 particles; ``passes``: only particles of these iterations. Chunks
        without selected particles are not read.

        Raises :class:`ParticleError` for a damaged chunk, and for shapes that do not exist."""
        return (part for _, part in self.parts_by_pass(shapes, box, passes))

    def parts_by_pass(
        self,
        shapes: Sequence[str | int] | None = None,
        box: ArrayLike | None = None,
        passes: Collection[int] | None = None,
    ) -> Iterator[tuple[int, Particles]]:
        """As :meth:`parts`, each with the number of its pass; pass and ``path`` together identify a light path of the
        file."""
        wanted = None if shapes is None else np.array([self.shape(name) for name in shapes], np.uint32)
        corners = _corners(box)
        scale = 1.0 / max(self.paths, 1)
        chosen = [block for block in self.chunks if _may_have(block.head, wanted, corners)]
        if passes is not None:
            chosen = [block for block in chosen if block.head["pass"] in passes]
        parts = self._unpacked(chosen, lambda rows: Particles.of_rows(_selected(rows, wanted, corners), scale))
        for block, part in zip(chosen, parts, strict=True):
            if len(part):
                yield int(block.head["pass"]), part

    def rows_of_passes(self) -> Iterator[tuple[Block, Rows]]:
        """The end of each pass, and its rows; their power is not divided by the number of paths."""
        begin = 0
        for block in self.passes:
            end = begin
            while end < len(self.chunks) and self.chunks[end].start < block.start:
                end += 1
            rows = list(self._unpacked(self.chunks[begin:end], lambda rows: rows))
            yield block, np.concatenate([np.zeros((0, WORDS), np.uint32), *rows])
            begin = end

    def _unpacked(self, chosen: Iterable[Block], then: Callable[[Rows], T]) -> Iterator[T]:
        with open(self.path, "rb") as file:
            # Chunks are read here, one after the other, and unpacked in threads.
            yield from in_order(partial(self._decoded, block, self._payload(file, block), then) for block in chosen)

    def _payload(self, file: BinaryIO, block: Block) -> bytes:
        try:
            return block.payload(file)
        except (ValueError, OSError):
            raise ParticleError(
                f"'{self.path}' is damaged: {block.head['count']} particles of pass {block.head['pass']} cannot be "
                "read; copy it again, or trace anew"
            ) from None

    def _decoded(self, block: Block, payload: bytes, then: Callable[[Rows], T]) -> T:
        return then(decode(block.head, payload, self.grid))

    def is_of(self, problem: Problem) -> bool:
        """Whether the particles belong to this scene, whatever its sensors."""
        return bool(problem.light_fingerprint == self.header["light_fingerprint"])

    def require_scene(self, problem: Problem) -> None:
        """Raise :class:`ParticleError` unless the particles belong to this scene."""
        if not self.is_of(problem):
            raise ParticleError(
                f"'{self.path}' has particles of another scene ('{self.header['scene']}'), or that has changed since; "
                "trace the particles of this scene"
            )


def _corners(box: ArrayLike | None) -> Array | None:
    if box is None:
        return None
    corners = np.asarray(box, np.float64)
    if corners.shape != (2, 3) or not (corners[0] <= corners[1]).all():
        raise ParticleError("a region is a lower and an upper corner, three numbers each")
    return corners


def _may_have(head: dict[str, Any], wanted: NDArray[np.uint32] | None, corners: Array | None) -> bool:
    """Whether a chunk can contain a selected particle."""
    if wanted is not None and not any(shape in wanted for shape, _ in head["shapes"]):
        return False
    box = np.array(head["box"])
    return corners is None or bool((box[:3] <= corners[1]).all() and (box[3:] >= corners[0]).all())


def _selected(rows: Rows, wanted: NDArray[np.uint32] | None, corners: Array | None) -> Rows:
    keep = np.ones(len(rows), bool)
    if wanted is not None:
        keep &= np.isin(rows[:, columns_of("shape")][:, 0], wanted)
    if corners is not None:
        position = rows[:, columns_of("position")].view(np.float32)
        keep &= ((position >= corners[0]) & (position <= corners[1])).all(1)
    return rows if keep.all() else rows[keep]
