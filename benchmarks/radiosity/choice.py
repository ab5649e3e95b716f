"""Which method pays: flat A-buffer, flat rays, form factors in a hierarchy (HA) and multipath in boxes (HM), to the
same error on the same furnished rooms in finer and finer patches. Every run is a process of its own, for its memory."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array, EtendueError
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    HierarchicalMultipath,
    HierarchicalMultipathSettings,
    Part,
    PartProblem,
    Patches,
    RadiosityError,
    RayScene,
    grouped,
    shot_at_patches,
    solve,
)

from ..measuring import ROOT, Record
from ..options import Out, whole_numbers
from .boxes import Rooms
from .options import OUT
from .references import mean_squared_error
from .scenes import FURNISHED, LEAST

#: Patches of the rooms with detail 1.
_PATCHES = {"room": 10122, "office": 6790}
#: Bundles of the A-buffer to begin with, rays of its shot for a segment, and seeds.
_BUNDLES, _RAYS, _SEEDS = 2, 1 / 4, 2
#: Budget of a whole pass of multipath.
_WHOLE = 16
#: Address space beside the data: code, and what compilers reserve.
_BESIDE = 6e9

#: Radiosity of patches by a budget 1, 2, 4 and so on, and a seed.
Way = Callable[[Patches, Any, int, int], Array]


def _buffered(patches: Patches, objects: Any, budget: int, seed: int) -> Array:
    """Segments of bundles, and the system."""
    engine = ABuffer(patches, OwenSobol(4, seed=500 + seed))
    segments = engine.cast(_BUNDLES * budget)
    return solve(
        patches, segments, "conjugate-gradient", shot=_shot(patches, engine, budget, seed), tolerance=1e-4
    ).radiosity


def _shot(patches: Patches, engine: ABuffer, budget: int, seed: int) -> Any:
    rays = _RAYS * float(engine.expected(_BUNDLES * budget).sum()) / 2
    return shot_at_patches(RayScene(patches), rays, OwenSobol(4, seed=seed))


def _in_tree(patches: Patches, objects: Any, budget: int, seed: int) -> Array:
    """Form factors by bundles in a hierarchy of spheres, and the system."""
    import etendue

    asked: dict[str, Any] = {"objects": objects, "engine": "bundles", "main_share": 0.0, "seed": seed}
    bundles = _BUNDLES * budget
    factors = etendue.compute_form_factors(patches, "spheres", estimator="pooled", bundles=bundles, **asked).factors
    shot = _shot(patches, ABuffer(patches), budget, seed)
    return solve(patches, factors, "conjugate-gradient", shot=shot, tolerance=1e-4).radiosity


def _multipath(is_boxed: bool, patches: Patches, objects: Any, budget: int, seed: int) -> Array:
    """Multipath by rays with a BVH: a part of the lines that it takes by itself, or several passes of them."""
    least = max(round(LEAST * len(patches) / _PATCHES["room"]), 1)
    problem = PartProblem(grouped(patches, objects, least=least) if is_boxed else Part(patches))
    shares = {} if is_boxed else {"top": 1.0}
    method = HierarchicalMultipath(HierarchicalMultipathSettings(**shares))
    method.prepare(problem, seed)
    if budget < _WHOLE:
        lines = method.samples_per_iteration * budget // _WHOLE
        method = HierarchicalMultipath(HierarchicalMultipathSettings(lines=lines, **shares))
        method.prepare(problem, seed)
    total = method.step(0, seed, {}).measurement
    for k in range(1, budget // _WHOLE):
        total += method.step(k, seed, {}).measurement
    return method.solution(total).on(patches).radiosity


WAYS: dict[str, Way] = {
    "A-buffer and system": _buffered,
    "flat multipath by rays": partial(_multipath, False),
    "form factors in a hierarchy (HA)": _in_tree,
    "multipath in boxes (HM)": partial(_multipath, True),
}


def measure(
    scenes: Rooms = "room",
    patches: Annotated[
        Any, typer.Option("--patches", parser=whole_numbers, help="About how many, by commas.", metavar="N,...")
    ] = "1000,10000,100000",
    error: Annotated[float, typer.Option(min=1e-4, help="The error to come to, of radiosity, relative.")] = 0.01,
    seconds: Annotated[float, typer.Option(min=1, help="CPU seconds that a run may take.")] = 120.0,
    memory: Annotated[float, typer.Option(min=0.1, help="Gigabytes that a run may take.")] = 6.0,
    times: Annotated[int, typer.Option(min=2, help="Lines of the reference, in those of the A-buffer.")] = 100,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene and number of patches: CPU seconds and memory of each method to the same error from the
    same reference, so that boxes keep their bias."""
    limits = {"error": error, "seconds": seconds, "memory": memory * 1e9, "times": times}
    for name in scenes:
        for count in patches:
            yield _measure({"scene": name, "detail": float(np.sqrt(count / _PATCHES[name])), **limits}, out)


def _measure(task: dict[str, Any], out: Path) -> Record:
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"choice-{task['scene']}-{task['detail']:.3f}.npy"
    task = task | {"reference": str(file.absolute())}
    made = _kept(task | {"way": "reference"}, out)
    title = f"{task['scene']}, {made.get('patches', '?')} patches"
    record = Record(
        f"To an error of {task['error']:.1%}, {title}", ("", "CPU s", "peak memory", "budget", "error", "of the first")
    )
    if "said" in made:
        record.notes.append(f"no reference: {made['said']}")
        return record
    first = None
    for way in WAYS:
        found = _kept(task | {"way": way, "own": made["error"]}, out)
        if "said" in found:
            record.add(way, "", "", "", "", found["said"])
            continue
        first = first or found["cpu"]
        is_there = found["error"] <= task["error"]
        record.add(
            *(way, f"{found['cpu']:.3g}" if is_there else f"more than {found['spent']:.3g}"),
            *(f"{found['memory'] / 1e9:.2f} GB", f"{found['budget']:.1f}", f"{found['error']:.2%}"),
            f"{found['cpu'] / first:.1f}" if is_there else f"not by {found['spent']:.3g} CPU s",
        )
    record.notes += [
        f"budget: {_BUNDLES} bundles with a ray of the shot for {1 / _RAYS:.0f} segments, or 1 / {_WHOLE} of a pass of "
        "multipath; doubled until the error is reached, seconds in between by the power of the last two",
        f"reference: mean of A-buffer solutions of {task['times']} times the lines that reach the error, "
        f"{made['spent']:.0f} CPU s; its own error, {made['error']:.2%}, is taken off",
        f"limits of a run: {task['seconds']:.0f} CPU s, {task['memory'] / 1e9:.0f} GB",
    ]
    return record


def _kept(task: dict[str, Any], out: Path) -> dict[str, Any]:
    """A task, or what an earlier call of the command has kept of it."""
    file, key = out / "choice.jsonl", json.dumps(task)
    for line in file.read_text("utf-8").splitlines() if file.exists() else ():
        if (row := json.loads(line))["task"] == key and Path(task["reference"]).exists():
            return dict(row["found"])
    found = _run(task)
    with file.open("a", encoding="utf-8") as rows:
        rows.write(json.dumps({"task": key, "found": found}) + "\n")
    return found


def _run(task: dict[str, Any]) -> dict[str, Any]:
    """A task in a process of its own."""
    words = [sys.executable, "-m", __name__, json.dumps(task)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    for line in reversed(done.stdout.splitlines()):
        if line.startswith("{"):
            found: dict[str, Any] = json.loads(line)
            return found
    reason = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
    return {"said": reason[0][:100]}


def _child(task: dict[str, Any]) -> dict[str, Any]:
    """What :func:`_run` is told."""
    warm, of = FURNISHED[task["scene"]](0.2)
    name = task["way"]
    way = WAYS.get(name, _buffered)
    way(warm, of, 1, 0)  # compiles
    patches, objects = FURNISHED[task["scene"]](task["detail"])
    limit = int(task["memory"] + _BESIDE)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        if name == "reference":
            return _reference(patches, objects, task)
        return _to_the_error(patches, objects, way, task, np.load(task["reference"]))
    except MemoryError:
        return {"said": f"does not fit into {task['memory'] / 1e9:.0f} GB", "patches": len(patches)}
    except EtendueError as error:
        return {"said": str(error), "patches": len(patches)}


def _relative(patches: Patches, found: Array, exact: Array) -> float:
    scale = (patches.areas[:, None] * exact**2).sum() / patches.areas.sum() / exact.shape[1]
    return float(np.sqrt(mean_squared_error(patches, found, exact) / scale))


def _reference(patches: Patches, objects: Any, task: dict[str, Any]) -> dict[str, Any]:
    """The mean of independent solutions, once it is known how many lines bring two of them within the error."""
    begin, budget = time.process_time(), 1
    while True:
        pair = [_buffered(patches, objects, budget, 2000 + k) for k in range(2)]
        if _relative(patches, *pair) / np.sqrt(2) <= task["error"]:
            break
        budget *= 2
    total = np.zeros_like(pair[0])
    for k in range(task["times"]):
        total += _buffered(patches, objects, budget, 3000 + k)
    np.save(task["reference"], total / task["times"])
    own = _relative(patches, *pair) / np.sqrt(2 * task["times"])
    return {"patches": len(patches), "error": own, "spent": time.process_time() - begin}


def _to_the_error(patches: Patches, objects: Any, way: Way, task: dict[str, Any], exact: Array) -> dict[str, Any]:
    budget, spent = 1, 0.0
    before: tuple[float, float, float] | None = None
    while True:
        errors, seconds = np.empty((2, _SEEDS))
        for seed in range(_SEEDS):
            begin = time.process_time()
            try:
                errors[seed] = _relative(patches, way(patches, objects, budget, 10 + seed), exact) ** 2
            except RadiosityError:
                if budget >= _WHOLE:
                    raise
                errors[seed] = np.inf  # too few lines to cross each box
            seconds[seed] = time.process_time() - begin
        error = float(np.sqrt(max(errors.mean() - task["own"] ** 2, 0)))  # that of the reference is independent
        spent = float(seconds.mean())
        found = {"error": error, "cpu": spent, "budget": float(budget), "spent": spent}
        if error <= task["error"] or 2 * spent > task["seconds"]:
            break
        before, budget = (error, spent, float(budget)) if np.isfinite(error) else None, 2 * budget
    if before is not None and error <= task["error"]:
        share = np.log(before[0] / task["error"]) / np.log(before[0] / error)
        found |= {"cpu": float(before[1] ** (1 - share) * spent**share), "budget": before[2] * 2**share}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return found | {"memory": float(peak), "patches": len(patches)}


if __name__ == "__main__":
    print(json.dumps(_child(json.loads(sys.argv[1]))), flush=True)
