"""The thesis's experiment on compression: records of 11 and 17 bytes as rows or as strips, by zlib, bzip2 and runs.

A buffer of 2 MB of records is coded as it is, or each of its attributes by itself. Independent particles are those of
light paths. The others are of a toy: a walk on the unit square with uniform steps up to the step size, reflected at the
border, that stays where it is with probability 0.3, as a Metropolis chain does where it refuses; real chains are in
:mod:`.chains`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from etendue.core import Array
from etendue.particles import RAW_BYTES, Codec, Grid, Particles, coder, decode, encode, merged, records, strips

from ..measuring import Record
from .tracing import Count, Scene, Traced, traced

BUFFER = 2 << 20
CODERS = ("zlib", "bz2", "rle")
_STEPS = (0.1, 0.01, 0.001)
_STAYS = 0.3
CHANNELS = 3


def measure(count: Count = 2_000_000, scene: Scene = "caustics") -> Iterator[Record]:
    """Ratios of packed to unpacked bytes, then the time of saving and loading."""
    particles = traced(scene, count, 1)
    yield ratios(particles, scene)
    yield saving(particles, scene)


def ratios(known: Traced, scene: str) -> Record:
    """Row and strip for each coder, and where repetitions are counted."""
    particles = Particles.of_rows(np.concatenate(known.passes))
    record = Record(
        f"Records of a thesis, {len(particles)} particles of {scene}: packed / unpacked bytes",
        ("particles", "record", "bytes", *(f"{name}, {form}" for name in CODERS for form in ("row", "strip"))),
    )
    chains = {f"walk, step {step:g}": _walk(particles, step) for step in _STEPS}
    for label, those in {"independent": particles, **chains}.items():
        few, counts = merged(those)
        for kind in ("diffuse uv", "glossy xyz"):
            made = records(few, kind, counts, few.path % CHANNELS)
            rows = [made.tobytes()[at : at + BUFFER] for at in range(0, made.nbytes, BUFFER)]
            columns = list(strips(made, BUFFER))
            cells = []
            for name in CODERS:
                encode = coder(name).encode
                for buffers in (rows, columns):
                    cells.append(f"{sum(len(encode(data)) for data in buffers) / made.nbytes:.3f}")
            record.add(label, kind, str(made.itemsize), *cells)
    record.notes += [
        "buffers of 2 MB; a strip is one attribute of the records of a buffer; the channel is constant on a path",
        "the thesis gives ratios in figures only; for its records of 11 bytes, recomputed with a toy chain, row and "
        "strip: independent zlib .79 .71, bz2 .74 .70; step .01 zlib .73 .65, bz2 .73 .66; step .001 zlib .64 .56, bz2 "
        ".62 .55",
    ]
    return record


def saving(known: Traced, scene: str) -> Record:
    """Seconds of packing beside those of tracing, and the disk below whose speed a packed file is loaded faster."""
    record = Record(
        f"Saving and loading, {known.count} particles of {scene}",
        ("codec", "bytes a particle", "packing / tracing", "unpacking ns", "loads faster than raw below"),
    )
    begin = time.process_time()
    again = traced(scene, known.count, 2)
    tracing = (time.process_time() - begin) / again.count
    grid = Grid(known.surfaces)
    for name in ("packed", "packed-no-paths", "exact"):
        for make in encode(known.passes[0][:1000], Codec.parse(name), grid):  # compiles, or loads what was compiled
            warm = make()
            decode(warm.head, b"".join(warm.strips), grid)
        begin, size, packed = time.process_time(), 0, []
        for rows in known.passes:
            for make in encode(rows, Codec.parse(name), grid):
                chunk = make()
                packed.append((chunk.head, b"".join(chunk.strips)))
                size += len(packed[-1][1])
        packing = (time.process_time() - begin) / known.count
        begin = time.process_time()
        for head, data in packed:
            decode(head, data, grid)
        unpacking = (time.process_time() - begin) / known.count
        each = size / known.count
        limit = (RAW_BYTES - each) / unpacking / 1e6
        record.add(name, f"{each:.2f}", f"{packing / tracing:.2f}", f"{1e9 * unpacking:.0f}", f"{limit:.0f} MB/s")
    record.notes += [
        "times of the CPU, one thread; tracing with preparation and compilation",
        "loads faster: from a disk below that speed, reading and unpacking the packed file take less time than reading "
        "the raw one",
    ]
    return record


def _walk(like: Particles, step: float) -> Particles:
    """A walk on the square, with the fields of independent particles at its places."""
    rng, n = np.random.default_rng(8), len(like)
    moves = rng.uniform(-step, step, (n, 4)) * (rng.random(n) >= _STAYS)[:, None]
    at = np.cumsum(moves, axis=0) + 0.3
    at = np.abs((at + 1) % 2 - 1)  # reflected at 0 and 1
    z, turn = 2 * at[:, 2] - 1, 2 * np.pi * at[:, 3]
    flat = np.sqrt(1 - z**2)
    ones: Array = np.ones(n)
    return Particles(
        np.stack([at[:, 0], at[:, 1], 0 * ones], 1).astype("f4"),
        np.stack([flat * np.cos(turn), flat * np.sin(turn), z], 1).astype("f4"),
        np.ones((n, 3), "f4"),
        np.zeros(n, "u4"),
        np.zeros(n, "u4"),
        at[:, :2].astype("f4"),
        np.zeros(n, "u4"),
        np.ones(n, "u4"),
    )
