"""The thesis's experiment on compression (E4, section 6.4) with particles of real chains: records as rows and as
strips, what saving them costs beside tracing, and loading them beside loading what is not compressed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Replica
from etendue.methods import MetropolisParticles
from etendue.particles import Particles, coder, of_strips, records, strips
from etendue.scene import load

from ..measuring import Record
from ..options import Names, Seeds
from .thesis import BUFFER, CHANNELS, CODERS
from .tracing import Count, traced

SIZES = (0.1, 0.01, 0.001)
#: Chains, as few as keep the device busy: the states of each follow each other in the records.
_CHAINS, _STEPS = 512, 256
_KIND, _CODER = "diffuse uv", "zlib"
#: Cells along a side of the histogram of each shape, as the maps of the thesis.
_SIDE = 50


def measure(scenes: Names = "cornell-box,sitting-room", count: Count = 1_000_000, seeds: Seeds = 3) -> Iterator[Record]:
    """A table of each scene, means over the seeds."""
    for name in scenes:
        record = Record(
            f"Compression of particles of chains, {name}, {count} particles or steps",
            (
                "particles",
                "stored",
                *(f"{coding}, {form}" for coding in CODERS for form in ("row", "strip")),
                "packing / tracing",
                "loading / plain",
                "faster below",
            ),
        )
        rows: dict[str, list[list[float]]] = {}
        for seed in range(1, seeds + 1):
            begin = time.process_time()
            known = traced(name, count, seed)
            spent = time.process_time() - begin
            those = Particles.of_rows(np.concatenate(known.passes))
            found = {"independent": (records(those, _KIND, 1, those.path % CHANNELS), spent)}
            found |= {f"chains, steps of {size:g}": _chains(name, count, size, seed) for size in SIZES}
            for label, (made, tracing) in found.items():
                rows.setdefault(label, []).append(_numbers(made, tracing))
        for label, each in rows.items():
            stored, *packed, packing, loading, limit = np.mean(each, axis=0)
            cells = [f"{stored:.0f}", *(f"{share:.3f}" for share in packed), f"{packing:.3f}", f"{loading:.2f}"]
            record.add(label, *cells, f"{limit:.0f} MB/s")
        scatter = max(np.ptp(np.array(each)[:, 1 : 1 + 2 * len(CODERS)], axis=0).max() for each in rows.values())
        record.notes += [
            f"{_KIND} records of 11 bytes in buffers of 2 MB: bytes packed over unpacked; of {_CHAINS} chains, one "
            "after the other, with the number of steps that a chain stays",
            f"means of {seeds} seeds, between which these ratios differ by at most {scatter:.3f}",
            f"by strips and {_CODER}, CPU time: packing over tracing, preparation and compilation included; loading, "
            f"unpacking and a histogram of {_SIDE} x {_SIDE} cells a shape over the same of plain records in memory; "
            "the packed file is loaded faster from a disk below the last speed",
        ]
        yield record


def _chains(name: str, count: int, size: float, seed: int) -> tuple[NDArray[Any], float]:
    """(records of all chains, CPU seconds of tracing)."""
    begin = time.process_time()
    settings = {"chains": _CHAINS, "steps": min(_STEPS, max(8, count // _CHAINS)), "step_size": size, "anew": 0.0}
    method = MetropolisParticles(MetropolisParticles.Settings.from_mapping(settings))
    method.prepare(load(name), seed)
    replica = Replica(method, seed)
    total = replica.step(0)
    for number in range(1, max(1, count // method.samples_per_iteration)):
        total = total + replica.step(number)
    those, repeats = method.particles(total), method.repeats(total)
    spent = time.process_time() - begin
    order = np.argsort(those.path, kind="stable")
    those, repeats = those[order], repeats[order]
    # A path keeps its wavelength until its first edge moves, as in the thesis.
    path = np.cumsum((those.bounce == 1) | np.append(True, np.diff(those.path) != 0))
    channels = np.random.default_rng(8).integers(0, CHANNELS, path[-1] + 1)[path]
    return records(those, _KIND, np.minimum(repeats, 255), channels), spent


def _numbers(made: NDArray[Any], tracing: float) -> list[float]:
    """Those of a row of the table."""
    rows = [made.tobytes()[at : at + BUFFER] for at in range(0, made.nbytes, BUFFER)]
    cells, columns = [float(len(made))], list(strips(made, BUFFER))
    for name in CODERS:
        for buffers in (rows, columns):
            cells.append(sum(len(coder(name).encode(data)) for data in buffers) / made.nbytes)
    coding = coder(_CODER)
    begin = time.process_time()
    packed = [(coding.encode(data), len(data)) for data in strips(made, BUFFER)]
    packing = time.process_time() - begin
    begin = time.process_time()
    _histogram(of_strips((coding.decode(data, size) for data, size in packed), _KIND))
    loading = time.process_time() - begin
    begin = time.process_time()
    _histogram(np.frombuffer(made.tobytes(), made.dtype))
    plain = time.process_time() - begin
    saved = made.nbytes - sum(len(data) for data, _ in packed)
    limit = 1e-6 * saved / max(loading - plain, 1e-9)
    return [*cells, packing / tracing, loading / plain, limit]


def _histogram(made: NDArray[Any]) -> NDArray[Any]:
    """Particles in cells of each shape."""
    u, v = (np.clip((made[name] * _SIDE).astype(np.int64), 0, _SIDE - 1) for name in ("u", "v"))
    return np.bincount((made["tag"].astype(np.int64) * _SIDE + v) * _SIDE + u, made["count"])
