"""Error after equal time of chains and of independent paths. Each run is saved, so that a table can be resumed."""

from __future__ import annotations

import gc
import json
import math
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue import film, methods
from etendue.core import Measurement, Replica
from etendue.scene import bundled, bundled_scene, load

from ..choice import scaled_size
from ..measuring import Record, console
from ..options import Names, Out, ReferenceSeconds, Seconds, Seeds, Size, words
from ..quality import Case, find
from ..tuning import WARM_PASSES

SCENES = "veach-bidir,water-caustic,ajar,stage,gaps,cornell-box,cornell-glass"
#: Method and settings of each entrant.
ENTRANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "path": ("path", {}),
    "bpt": ("bpt", {}),
    "auto": ("auto", {}),
    "pssmlt": ("pssmlt", {}),
    "pssmlt bidirectional": ("pssmlt", {"estimator": "bidirectional"}),
    "mmlt": ("mmlt", {}),
    "mmlt not equalised": ("mmlt", {"equalise": False}),
}
#: Scenes whose pictures have no reference, and the settings of ``bpt`` for a long run that makes one.
REFERENCES: dict[str, dict[str, Any]] = {
    "ajar": {"guide_connections": True},
    "gaps": {"guide_connections": True},
    "stage": {},
    "cornell-glass": {},
    "skylight": {},
}
#: Scenes with light that only merging finds: it is not in their references, and what ``auto`` shows of it is its error.
_MERGED = ("stage",)
#: Bars: scenes on which the best of the chains has a lower error than ``path``; than ``bpt``; and at most twice path's.
BELOW_PATH, BELOW_BPT = ("veach-bidir", "water-caustic", "ajar", "stage", "gaps"), ("gaps",)
Entrants = Annotated[Any, typer.Option("--entrants", parser=words, help="Rows, separated by commas.", metavar="NAMES")]
Cpu = Annotated[
    bool, typer.Option("--cpu", help="Count CPU seconds of all threads, as for a machine that is not idle.")
]


@dataclass(frozen=True)
class _Run:
    """What is measured of one picture."""

    error: float
    own: float  #: relMSE that the run estimates of itself
    mean: float
    samples: int
    seconds: float
    stay: int  #: proposals rejected in a row, at most


def measure(
    scenes: Names = SCENES,
    entrants: Entrants = "path,bpt,auto,pssmlt,pssmlt bidirectional,mmlt",
    size: Size = "512x512",
    seconds: Seconds = 60.0,
    seeds: Seeds = 5,
    cpu: Cpu = False,
    reference_seconds: ReferenceSeconds = 960.0,
    out: Out = Path("metropolis-output"),
) -> Iterator[Record]:
    """One table a scene; the entrants take turns, seed by seed."""
    out.mkdir(parents=True, exist_ok=True)
    clock = time.process_time if cpu else time.perf_counter
    for name in scenes:
        case = _case(name, size, reference_seconds, clock, out)
        if isinstance(case, str):
            console.print(case)
            continue
        runs: dict[str, list[_Run]] = {entrant: [] for entrant in entrants}
        for seed in range(seeds):
            for entrant in entrants:
                runs[entrant].append(_saved(case[0], entrant, seed, seconds, cpu, out))
        yield _record(case[0], case[1], runs, seconds, cpu)


def _saved(case: Case, entrant: str, seed: int, seconds: float, cpu: bool, out: Path) -> _Run:
    """A run, or what an earlier call of the command has saved of it."""
    key = [case.name, entrant, list(case.size), seed, seconds, cpu]
    path = out / "runs.jsonl"
    for line in path.read_text("utf-8").splitlines() if path.exists() else ():
        if (row := json.loads(line))["key"] == key:
            return _Run(**row["run"])
    method, settings = ENTRANTS[entrant]
    measurement, facts = _render(case, method, settings, seed, seconds, time.process_time if cpu else time.perf_counter)
    image = measurement.mean().astype(np.float32)
    run = _Run(
        error=film.relative_mse(image, case.reference),
        own=measurement.relative_error(),
        mean=film.relative_bias(image, case.reference),
        **facts,
    )
    console.print(f"{case.name}, {entrant}, seed {seed}: relMSE {run.error:.4g}", style="dim")
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps({"key": key, "run": vars(run)}) + "\n")
    return run


def _render(
    case: Case, method: str, settings: Mapping[str, Any], seed: int, seconds: float, clock: Callable[[], float]
) -> tuple[Measurement, dict[str, Any]]:
    """Passes until the time is used up; preparation counts, the compilation in the first pass does not."""
    gc.collect()  # a scene that is still alive makes the next one's kernels larger
    source = bundled_scene(case.source) if case.source in bundled() else case.source
    problem = load(source, size=case.size)
    kind = methods.get(method)
    made = kind(kind.Settings.from_mapping({"max_depth": problem.max_depth} | dict(settings)))
    made.prepare(problem, seed)
    warm = Replica(made, seed)
    for number in range(WARM_PASSES.get(method, 1)):
        warm.step(number)
    begin = clock()
    made = kind(made.settings)
    made.prepare(problem, seed)
    replica, total, passes, taken = Replica(made, seed), None, 0, 0.0
    while total is None or (clock() - begin) * (1.0 + 0.5 / passes) < seconds:
        measured = replica.step(passes)
        total = measured if total is None else total + measured
        passes, taken = passes + 1, clock() - begin
    result = made.develop(total, replica.state).metadata
    facts = {
        "samples": passes * made.samples_per_iteration,
        "seconds": taken,
        "stay": result.get("chains", {}).get("longest_stay", 0),
    }
    return total, facts


def _case(
    name: str, size: tuple[int, int], seconds: float, clock: Callable[[], float], out: Path
) -> tuple[Case, float] | str:
    """A scene with its reference, and the reference's own error."""
    if name not in REFERENCES:
        case = find(name, size)
        return case if isinstance(case, str) else (case, 0.0)
    size = scaled_size(name, size[0] * size[1])
    path = out / f"{name}-{size[0]}x{size[1]}.npz"
    if not path.exists():
        console.print(f"{name}: reference by bpt, {seconds:g} s", style="dim")
        empty = Case(name, name, np.zeros((size[1], size[0], 3), np.float32), "")
        halves = [
            _render(empty, "bpt", REFERENCES[name], 1000 + half, seconds / 2, clock)[0].mean() for half in range(2)
        ]
        np.savez(path, halves=np.stack(halves))
    first, second = np.load(path)["halves"]
    mean = (first + second) / 2
    note = "a longer run of bpt in two halves, whose difference tells its error"
    return Case(name, name, mean.astype(np.float32), note), film.relative_mse(first, mean)


def _record(case: Case, own: float, runs: Mapping[str, list[_Run]], seconds: float, cpu: bool) -> Record:
    kind = "CPU seconds" if cpu else "s"
    record = Record(
        f"Chains, {case.name}, {case.size[0]}x{case.size[1]}, {seconds:g} {kind}",
        ("", "relMSE", "range", "estimated by the run", "brightness", "spp", "longest stay", "to path"),
    )
    middle = {name: statistics.median(run.error for run in found) for name, found in runs.items()}
    for name, found in runs.items():
        errors = [run.error for run in found]
        means = [run.mean for run in found]
        spread = f" ± {statistics.stdev(means) / math.sqrt(len(means)):.2%}" if len(means) > 1 else ""
        record.add(
            name,
            f"{middle[name]:.4g}",
            f"{min(errors):.3g} … {max(errors):.3g}",
            f"{statistics.median(run.own for run in found):.4g}",
            f"{statistics.mean(means):+.2%}{spread}",
            f"{statistics.median(run.samples for run in found):.0f}",
            str(max(run.stay for run in found) or ""),
            f"{middle[name] / middle['path']:.3f}" if "path" in middle else "",
        )
    chains = [name for name in runs if ENTRANTS[name][0] in ("pssmlt", "mmlt")]
    if chains and "path" in middle:
        best = min(chains, key=lambda name: middle[name])
        limit = 1.0 if case.name in BELOW_PATH else 2.0
        reached = [middle[best] < limit * middle["path"]]
        text = f"bar: the best of the chains, {best}, below {limit:g} x path's relMSE"
        if case.name in BELOW_BPT and "bpt" in middle:
            text += ", and below bpt's"
            reached.append(middle[best] < middle["bpt"])
        record.notes.append(f"{text}: {'reached' if all(reached) else 'missed'}")
    if case.name in _MERGED:
        record.notes.append("light that only merging finds is not in the reference; it is the error of auto")
    record.notes += [
        f"reference: {case.note}" + (f"; its own relMSE: {own:.2g}" if own else ""),
        f"median of {len(next(iter(runs.values())))} seeds; entrants in turn in one process; preparation counts, "
        "compilation does not",
        "brightness: mean over the reference's, minus 1, and its standard error over the seeds",
    ]
    return record
