"""Codecs of files of particles: bytes of a particle, and how fast they pack and unpack. In memory, without a disk."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any

import drjit as dr
import typer

from etendue.core import BackendError
from etendue.particles import RAW_BYTES, Codec, Grid, coder_names, decode, encode

from ..measuring import Record, interleaved, spread, verdict
from ..options import Rounds
from .tracing import Count, Scene, Traced, traced

#: Bars for bounded loss: bytes without and with path numbers; megabytes of raw particles a second, packed and unpacked.
BYTES, BYTES_WITH_PATHS, PACKED, UNPACKED = 12.0, 16.0, 200.0, 500.0
_FAST = ("packed-no-paths", "packed", "raw", "exact")


def measure(
    count: Count = 10_000_000,
    scene: Scene = "caustics",
    rounds: Rounds = 3,
    part: Annotated[
        int, typer.Option(min=0, help="Particles for codecs with another coder, which are slow; 0 for none.")
    ] = 200_000,
) -> Record:
    """Every layout with its own coder, then with every coder that is installed."""
    particles = traced(scene, count, 1)
    few = Traced(particles.surfaces, [particles.passes[0][:part]], particles.paths)
    grid = Grid(particles.surfaces)
    threads = max(int(dr.thread_count()), 1)
    record = Record(
        f"Codecs, {particles.count} particles of {scene}",
        ("codec", "bytes", "bar", "packed MB/s", "unpacked MB/s", "MB a CPU second, packed", "unpacked", "bars"),
    )
    coders = [name for name in coder_names() if _is_installed(name)]
    with ThreadPoolExecutor(threads) as pool:
        for name in _FAST:
            record.add(name, *_row(Codec.parse(name), particles, grid, pool, rounds))
        for name in [f"{layout}+{coder}" for layout in ("packed", "exact", "raw") for coder in coders] if part else []:
            record.add(name, *_row(Codec.parse(name), few, grid, pool, 1))
    record.notes += [
        f"{threads} threads; bytes a particle, with heads; MB: 10^6 bytes of raw particles, {RAW_BYTES} bytes each",
        f"median of {rounds} rounds (min … max); a CPU second: of all threads; sorting is part of packing",
        f"codecs named with a coder: {part} particles, once; the fewer particles are packed at a time, the more bytes "
        "does each take",
    ]
    if missing := [name for name in coder_names() if name not in coders]:
        record.notes.append(f"not installed: {', '.join(missing)}")
    return record


def _is_installed(name: str) -> bool:
    try:
        Codec.parse(f"raw+{name}")
    except BackendError:
        return False
    return True


def _row(codec: Codec, part: Traced, grid: Grid, pool: ThreadPoolExecutor, rounds: int) -> list[str]:
    made: list[Any] = []

    def pack(_: int) -> None:
        made[:] = [list(pool.map(_call, encode(rows, codec, grid))) for rows in part.passes]

    payloads: list[Any] = []

    def join(_: int) -> None:
        payloads[:] = [(chunk.head, b"".join(chunk.strips)) for chunks in made for chunk in chunks]

    def unpack(_: int) -> None:
        for rows in pool.map(lambda known: decode(*known, grid), payloads):
            del rows

    for make in encode(part.passes[0][:1000], codec, grid):  # compiles, or loads what was compiled
        warm = make()
        decode(warm.head, b"".join(warm.strips), grid)
    times = interleaved({"pack": pack, "join": join, "unpack": unpack}, rounds, 0)
    raw = part.count * RAW_BYTES / 1e6
    size = sum(len(data) + len(json.dumps(head)) for head, data in payloads) / part.count
    packing, unpacking = ([raw / clock.wall for clock in times[step]] for step in ("pack", "unpack"))
    cpu = [statistics.median(raw / clock.cpu for clock in times[step]) for step in ("pack", "unpack")]
    bar = {"packed+fast": BYTES_WITH_PATHS, "packed-no-paths+fast": BYTES}.get(str(codec))
    bars = "" if bar is None else f"≥ {PACKED:g}, {UNPACKED:g}: "
    if bars:
        fast = statistics.median(packing) >= PACKED and statistics.median(unpacking) >= UNPACKED
        bars += "reached" if fast else "missed"
    speeds = spread(packing, ".0f"), spread(unpacking, ".0f"), f"{cpu[0]:.0f}", f"{cpu[1]:.0f}"
    return [f"{size:.2f}", verdict(size, bar), *speeds, bars]


def _call(make: Callable[[], Any]) -> Any:
    return make()
