"""What the passes of ``auto`` cost: the CPU times of its candidates beside its model of them, fitted anew."""

from __future__ import annotations

import gc
import statistics
import time
from dataclasses import astuple

import numpy as np
from scipy.optimize import nnls

from etendue import scene
from etendue.methods.auto import Auto, AutoSettings, Learned, PassWork, describe
from etendue.transport import Candidate

from .choice import scaled_size, sources
from .measuring import Record, console
from .options import Names, Pixels, Rounds

SCENES = (
    "cornell-box,skylight,grey-white-room,veach-bidir,caustics,cornell-glass,stage,ajar,wooden-staircase,street,"
    "water-caustic,flat,shutters"
)
#: The first is path tracing, whose time is the unit.
_COUNTS = (
    Candidate(0.0, 0, False),
    *(Candidate(n, k, False) for n, k in ((0.125, 0), (0.125, 1), (0.125, 2), (0.5, 0), (0.5, 2), (0.5, 8))),
    *(Candidate(n, k, True) for n, k in ((0.125, 0), (0.125, 2), (0.5, 1), (1.0, 0), (2.0, 1))),
)
_CONSTANTS = ("CAMERA_EDGE", "CONNECTING", "CONNECTION", "LIGHT_PATH", "LIGHT_VERTEX", "QUERY", "PHOTON")


def measure(names: Names = SCENES, pixels: Pixels = 65536, rounds: Rounds = 3) -> Record:
    """A row for each scene: the model's costs, relative to path tracing, over the measured ones."""
    record = Record(f"Costs of auto, about {pixels} pixels", ("", *(describe(c) for c in _COUNTS[1:])))
    parts: list[np.ndarray] = []
    ratios: list[float] = []
    for name in names:
        problem = scene.load(sources()[name], size=scaled_size(sources()[name], pixels))
        method = Auto(AutoSettings(max_depth=problem.max_depth))
        method.prepare(problem, 1)
        state = method.start()
        for iteration in range(method.settings.probe_passes):
            state = method.step(iteration, 1, state).state
        work = Learned.of(state["learned"]).mean_work()
        times: dict[Candidate, list[float]] = {counts: [] for counts in _COUNTS}
        for number in range(rounds + 1):
            for counts, taken in times.items():
                begin = time.process_time()
                method.render_with(counts, 1000 + number, 1)
                if number:  # the first has compiled its kernels
                    taken.append(time.process_time() - begin)
        seconds = [statistics.median(taken) for taken in times.values()]
        measured = [work.edges * s / seconds[0] for s in seconds]
        found = [work.cost(c) / m for c, m in zip(_COUNTS, measured, strict=True)][1:]
        parts += [_parts(work, c) / m for c, m in zip(_COUNTS, measured, strict=True)][1:]
        ratios += found
        record.add(name, *(f"{ratio:.2f}" for ratio in found))
        console.print(name, *(f"{ratio:.2f}" for ratio in found), style="dim")
        del method, problem
        gc.collect()
    matrix = np.array(parts)
    fitted, _ = nnls(matrix, np.ones(len(matrix)))
    error = float(np.sqrt(np.mean(np.square(matrix @ fitted - 1.0))))
    record.notes += [
        f"model over CPU time, both relative to path; median of {rounds} rounds in turn; rms of ratio - 1: "
        f"{np.sqrt(np.mean(np.square(np.array(ratios) - 1.0))):.3f}",
        f"fitted to these: {', '.join(f'{n} {x:.2f}' for n, x in zip(_CONSTANTS, fitted, strict=True))}: {error:.3f}",
    ]
    return record


def _parts(work: PassWork, counts: Candidate) -> np.ndarray:
    """What the constants are multiplied with; see :meth:`PassWork.cost`."""
    edges, smooth, photons, vertices = astuple(work)
    n, k = counts.light_paths, counts.connections
    merging = float(counts.merging)
    return np.array([edges, smooth * (k > 0), smooth * k, n, n * vertices, merging * smooth, merging * n * photons])
