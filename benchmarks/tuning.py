"""``auto`` beside the methods that a user could have chosen: their errors after the same CPU time.

CPU time of all threads, so that other work on the machine counts little. Every outcome is a line of a file in the
folder ``out``, and what is in it is not measured again: a run that was interrupted goes on.
"""

from __future__ import annotations

import contextlib
import gc
import json
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import mitsuba as mi
import numpy as np
import typer

from etendue import methods, scene
from etendue.core import RELATIVE_EPSILON, Measurement, Replica, Result
from etendue.methods.auto import FIXED, Auto, AutoSettings, describe
from etendue.scene import scene_xml
from etendue.transport import Candidate

from .choice import error, scaled_size, sources
from .earlier import Earlier, revision
from .measuring import Record, console, verdict
from .options import Methods, Names, Pixels, Seeds

#: Geometric mean of the errors of ``auto`` over those of ``vcm``, and over those of the best method; the worst one.
BAR, BEST_BAR, WORST_BAR = 0.4, 0.7, 1.1
SCENES = (
    "caustics,cornell-box,cornell-glass,ajar,skylight,stage,veach-bidir,water-caustic,grey-white-room,wooden-staircase"
)
#: Methods of the references; by default ``bpt``.
REFERENCES: dict[str, tuple[str, dict[str, Any]]] = {
    "ajar": ("bpt", {"guide_connections": True}),
    "flat": ("bpt", {"guide_connections": True}),
    "caustics": ("vcm", {"radius": 0.002}),
    "water-caustic": ("vcm", {"radius": 0.002}),
    "stage": ("vcm", {"radius": 0.002}),
    "cornell-glass": ("vcm", {"radius": 0.002}),
    "grey-white-room": ("path", {}),
    "wooden-staircase": ("path", {}),
}
#: Of the methods of the earlier state other than ``vcm`` the one with the least error, as recorded with one seed.
BEST = {
    "stage": "sppm",
    "grey-white-room": "path",
    "wooden-staircase": "bpt",
    "veach-bidir": "bpt",
    "cornell-glass": "bpt",
    "cornell-box": "path",
    "skylight": "path",
    "ajar": "bpt",
    "water-caustic": "bpm",
    "caustics": "bpm",
    "flat": "bpt",
    "street": "path",
    "yard": "path",
}
#: Each half of a reference takes this many times the longest time.
_HALF = 3.0
#: Share of the brightest errors that is left out: one firefly must not decide.
_TRIM = 0.001
#: Seed of the passes that warm up.
_WARM_UP = 1 << 20
#: Ends the names of methods of an earlier state.
_BEFORE = ", before"
#: Passes that warm up: ``auto`` first learns.
WARM_PASSES = {"auto": 4}


def measure(
    names: Names = SCENES,
    entrants: Methods = "auto,vcm,path,guided,bpt,bpm,sppm",
    pixels: Pixels = 65536,
    at: Annotated[str, typer.Option(metavar="S,...", help="CPU seconds, separated by commas.")] = "20,60",
    seeds: Seeds = 3,
    out: Annotated[Path, typer.Option(help="Folder of outcomes and references.")] = Path("tuning"),
    before: Annotated[
        Path | None, typer.Option(help="A checkout of an earlier state, whose methods run in place of today's.")
    ] = None,
    both: Annotated[bool, typer.Option("--both", help="With --before: its auto, too.")] = False,
    best: Annotated[
        bool, typer.Option("--best", help="In place of --methods: auto, vcm, and the method that was best before.")
    ] = False,
) -> list[Record]:
    """A table for each time; the methods take turns pass by pass, the next is always the one with the least time.

    With ``before`` all methods but ``auto`` are those of the earlier state; with ``best`` only ``auto``, ``vcm`` and
    the one of :data:`BEST` run on a scene."""
    marks = sorted(float(word) for word in at.split(","))
    known = sources()
    racing = {name: _entrants(name, entrants, before, both, best) for name in names}
    out.mkdir(parents=True, exist_ok=True)
    for name, own in racing.items():
        size = scaled_size(known[name], pixels)
        for seed in range(seeds):
            done = {(row["method"], row["seed"]) for row in _rows(out, name, size, marks)}
            if wanted := [entrant for entrant in own if (entrant, seed) not in done]:
                _race(name, known[name], size, wanted, seed, marks, out, before)
    tables = [_table(racing, known, pixels, seeds, marks, mark, out) for mark in marks]
    if before is not None:
        for table in tables:
            table.notes.append(f"before: the state of {revision(before)}")
    return tables


def _entrants(name: str, entrants: Sequence[str], before: Path | None, both: bool, best: bool) -> list[str]:
    """Who runs on a scene."""
    if name not in sources():
        raise SystemExit(f"no test scene '{name}'; there are {', '.join(sources())}")
    if best and name not in BEST:
        raise SystemExit(f"--best: which method is best on '{name}' is not known; it is for {', '.join(BEST)}")
    own = list(dict.fromkeys(["auto", "vcm", BEST[name]])) if best else list(entrants)
    if before is not None:
        own = [one if one == "auto" else one + _BEFORE for one in own] + ["auto" + _BEFORE] * both
    return own


def _file(out: Path) -> Path:
    return out / "tuning.jsonl"


def _rows(out: Path, name: str, size: Sequence[int], marks: Sequence[float]) -> list[dict[str, Any]]:
    """What was measured of a scene."""
    if not _file(out).is_file():
        return []
    rows = [json.loads(line) for line in _file(out).read_text().splitlines()]
    return [row for row in rows if (row["scene"], row["size"], row["marks"]) == (name, list(size), list(marks))]


class Passes:
    """Passes of a method: their sum, their number, and the CPU seconds of all threads, preparation included."""

    def __init__(self, problem: Any, name: str, seed: int, **settings: Any) -> None:
        start = time.process_time()
        method = methods.get(name)
        estimator = method(method.Settings(max_depth=problem.max_depth, **settings))
        estimator.prepare(problem, seed)
        self._replica, self.count = Replica(estimator, seed), 0
        self._total: Measurement | None = None
        self.seconds = time.process_time() - start

    @classmethod
    def warm(cls, problem: Any, name: str, seed: int, **settings: Any) -> Passes:
        """No passes yet, of a method whose kernels are compiled."""
        before = cls(problem, name, seed + _WARM_UP, **settings)
        for _ in range(WARM_PASSES.get(name, 1)):
            before.add()
        return cls(problem, name, seed, **settings)

    def add(self) -> float:
        """One more; returns its CPU seconds."""
        start = time.process_time()
        made = self._replica.step(self.count)
        self._total = made if self._total is None else self._total + made
        self.count += 1
        spent = time.process_time() - start
        self.seconds += spent
        return spent

    def until(self, seconds: float) -> Passes:
        """As many as so many CPU seconds need."""
        while self.seconds < seconds:
            self.add()
        return self

    def mean(self) -> np.ndarray:
        """The picture without re-weighting, which only some methods have on."""
        assert self._total is not None
        return self._total.mean().astype(np.float32)

    def result(self) -> Result:
        """What a user would get."""
        assert self._total is not None
        return self._replica.develop(self._total)


class _Run:
    """A method under way."""

    def __init__(self, problem: Any, name: str, seed: int) -> None:
        self.name, self._made = name, Passes.warm(problem, name, seed)
        self.seconds, self._passes = self._made.seconds, 0
        self.found: list[dict[str, Any]] = []

    def go_on(self, marks: Sequence[float], halves: Sequence[np.ndarray]) -> None:
        """A pass, and the errors at the marks that it reaches."""
        self.seconds += self._pass()
        self._passes += 1
        for mark in [mark for mark in marks[len(self.found) :] if mark <= self.seconds]:
            image, chosen = self._picture()
            # The error of the last pass's picture, brought to the time of the mark.
            reached = max(error(image, halves), 1e-9) * self.seconds / mark
            self.found.append({"error": reached, "seconds": self.seconds, "passes": self._passes, "chosen": chosen})

    def _pass(self) -> float:
        """A pass; returns its CPU seconds."""
        return self._made.add()

    def _picture(self) -> tuple[np.ndarray, str]:
        """(mean of the passes so far; what was chosen)."""
        return self._made.mean(), self._made.result().metadata.get("chosen", self.name)


class _RunBefore(_Run):
    """A method of an earlier state under way, in its own process."""

    def __init__(self, earlier: Earlier, name: str, seed: int) -> None:
        self.name, self._earlier, self._passes = name, earlier, 0
        self._method = name.removesuffix(_BEFORE)
        self.seconds = earlier.ask("begin", self._method, seed, seed + _WARM_UP)
        self.found = []

    def _pass(self) -> float:
        return self._earlier.ask("pass", self._method)

    def _picture(self) -> tuple[np.ndarray, str]:
        with tempfile.TemporaryDirectory() as folder:
            self._earlier.ask("picture", self._method, f"{folder}/picture.npy")
            return np.load(f"{folder}/picture.npy"), self._method


def _race(
    name: str,
    source: Any,
    size: tuple[int, int],
    wanted: Sequence[str],
    seed: int,
    marks: Sequence[float],
    out: Path,
    before: Path | None,
) -> None:
    halves = _halves(name, source, size, _HALF * marks[-1], out)
    # One copy for all: kernels contain the materials of every scene in memory, so that those of a method that has
    # warmed up would not serve once the next one has loaded a scene.
    problem = scene.load(source, size=size)
    runs: list[_Run] = []
    with contextlib.ExitStack() as stack:
        if before is not None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            earlier = Earlier(before, mi.variant(), _file_of(source, folder), size)
            stack.callback(earlier.close)
        for method in wanted:
            runs.append(_RunBefore(earlier, method, seed) if method.endswith(_BEFORE) else _Run(problem, method, seed))
            gc.collect()
        while going := [run for run in runs if len(run.found) < len(marks)]:
            min(going, key=lambda run: run.seconds).go_on(marks, halves)
    with _file(out).open("a") as lines:
        for run in runs:
            row = {"scene": name, "size": list(size), "marks": list(marks), "method": run.name, "seed": seed}
            lines.write(json.dumps(row | {"found": run.found}) + "\n")
            texts = [f"{found['error']:.3g} ({found['passes']})" for found in run.found]
            console.print(
                f"{name}, seed {seed}, {run.name}: {', '.join(texts)}; {run.found[-1]['chosen']}", style="dim"
            )


def _file_of(source: Any, folder: Path) -> Path:
    """A scene as a file: an earlier state does not know all bundled ones."""
    if isinstance(source, Path):
        return source
    path = folder / f"{source}.xml"
    path.write_text(scene_xml(source, folder=folder / "meshes"), encoding="utf-8")
    return path


def _halves(name: str, source: Any, size: tuple[int, int], seconds: float, out: Path) -> list[np.ndarray]:
    """The reference in two halves of so many CPU seconds, from its file if there is one."""
    path = out / f"{name.replace(' ', '-')}-{size[0]}x{size[1]}.npz"
    if not path.is_file():
        method, settings = REFERENCES.get(name, ("bpt", {}))
        console.print(f"reference of {name} by {method}, {2 * seconds:g} s", style="dim")
        pictures = []
        for half in range(2):
            passes = Passes(scene.load(source, size=size), method, 1000 + half, **settings)
            pictures.append(passes.until(seconds).result().image)
        np.savez(path, *pictures)
    with np.load(path) as found:
        return [found[key] for key in found.files]


def _table(
    racing: Mapping[str, Sequence[str]],
    known: Mapping[str, Any],
    pixels: int,
    seeds: int,
    marks: Sequence[float],
    mark: float,
    out: Path,
) -> Record:
    """Median errors at a mark, and the ratios of ``auto``; ``racing``: the entrants of each scene."""
    entrants = list(dict.fromkeys(entrant for each in racing.values() for entrant in each))
    record = Record(
        f"Tuning, about {pixels} pixels, {mark:g} s of CPU",
        ("", *entrants, "auto / vcm", "auto / best other", "of the seeds", "bar", "chosen"),
    )
    over_vcm, over_best = [], []
    for name, own in racing.items():
        rows = [row for row in _rows(out, name, scaled_size(known[name], pixels), marks) if row["seed"] < seeds]
        index = list(marks).index(mark)
        found = {entrant: [row["found"][index] for row in rows if row["method"] == entrant] for entrant in own}
        middle = {entrant: statistics.median(one["error"] for one in each) for entrant, each in found.items() if each}
        others = {entrant: error for entrant, error in middle.items() if entrant != "auto"}
        ratios = ["", "", "", "", ""]
        if "auto" in middle and others:
            rival = min(others, key=lambda entrant: others[entrant])
            best = middle["auto"] / others[rival]
            over_best.append(best)
            pairs = [one["error"] / other["error"] for one, other in zip(found["auto"], found[rival], strict=False)]
            by_vcm = ""
            if vcm := others.get("vcm", others.get("vcm" + _BEFORE)):
                over_vcm.append(middle["auto"] / vcm)
                by_vcm = f"{over_vcm[-1]:.2f}"
            chosen = ", ".join(dict.fromkeys(one["chosen"] for one in found["auto"]))
            ratios = [by_vcm, f"{best:.2f}", f"{min(pairs):.2f} to {max(pairs):.2f}", verdict(best, WORST_BAR), chosen]
        record.add(name, *(f"{middle[entrant]:.3g}" if entrant in middle else "" for entrant in entrants), *ratios)
    if over_vcm:
        mean = statistics.geometric_mean(over_vcm)
        record.notes.append(f"geometric mean of auto / vcm: {mean:.2f}, {verdict(mean, BAR)}")
    if over_best:
        mean = statistics.geometric_mean(over_best)
        record.notes.append(
            f"auto / best other: worst {max(over_best):.2f}, geometric mean {mean:.2f}, {verdict(mean, BEST_BAR)}"
        )
    record.notes += [
        f"error: mean of (x - ref)² / (ref² + {RELATIVE_EPSILON:g}) without the worst 0.1 % of pixels, less that of "
        "the reference, times the CPU seconds of the pass that reached the time over the time",
        f"median of {seeds} seed{'s' if seeds > 1 else ''}; kernels are compiled before; preparation counts; "
        "of the seeds: the least and the greatest ratio to the best other method with the same seed",
        "references: " + ", ".join(f"{name} by {method[0]}" for name, method in REFERENCES.items()) + ", others by bpt",
    ]
    return record


def choices(names: Names = SCENES, pixels: Pixels = 16384, passes: Annotated[int, typer.Option(min=3)] = 6) -> Record:
    """A row a scene: what ``auto`` chooses after its first passes, and the variance of passes times their CPU time, by
    its counts and those of ``path`` and ``bpt``, over that of ``vcm``; passes of all four in turn."""
    record = Record(
        f"Choice after the first passes, about {pixels} pixels",
        ("", "chosen", "path", "bpt", "chosen", "seconds of a pass, learning", "vcm"),
    )
    known = sources()
    for name in names:
        problem = scene.load(known[name], size=scaled_size(known[name], pixels))
        method = Auto(AutoSettings(max_depth=problem.max_depth))
        method.prepare(problem, 1)
        state, seconds = method.start(), []
        for iteration in range(method.settings.probe_passes):
            start = time.process_time()
            state = method.step(iteration, 1, state).state
            seconds.append(time.process_time() - start)
        chosen = Candidate(*state["counts"])
        counts = list(dict.fromkeys([FIXED["path"], FIXED["bpt"], FIXED["vcm"], chosen]))
        pictures: dict[Candidate, list[np.ndarray]] = {one: [] for one in counts}
        times: dict[Candidate, list[float]] = {one: [] for one in counts}
        for iteration in range(passes + 1):
            for one in counts:
                start = time.process_time()
                picture = method.render_with(one, 1000 + iteration, 1)
                if iteration:  # the first has compiled its kernels
                    times[one].append(time.process_time() - start)
                    pictures[one].append(picture)
        level = np.median([np.mean(each, axis=0) for each in pictures.values()], axis=0)
        product = {}
        for one, each in pictures.items():
            scatter = np.sort((np.var(each, axis=0, ddof=1) / (np.square(level) + RELATIVE_EPSILON)).ravel())
            kept = scatter[: int((1.0 - _TRIM) * scatter.size)]
            product[one] = float(kept.mean()) * statistics.median(times[one])
        vcm = FIXED["vcm"]
        ratios = [
            f"{product[one] / product[vcm]:.2f} ({method.foreseen(one) / method.foreseen(vcm):.2f})"
            for one in (FIXED["path"], FIXED["bpt"], chosen)
        ]
        spent = f"{seconds[-1]:.2f}", f"{statistics.median(times[vcm]):.2f}"
        record.add(name, describe(chosen), *ratios, *spent)
        console.print(name, describe(chosen), *ratios, style="dim")
        gc.collect()
    record.notes.append(
        f"products of variance between {passes} passes, relative to the picture, without the worst 0.1 % of pixels, "
        "and CPU seconds of a pass, over that of vcm; in brackets: foreseen by moments and costs. The variance of "
        "so few passes does not show light that a method rarely finds"
    )
    return record
