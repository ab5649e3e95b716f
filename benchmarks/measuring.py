"""What every benchmark shares: clocks, the machine, child processes, tables and records."""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parent.parent
PUBLIC_SCENES = ROOT.parent / "shared" / "scenes"

#: The scene for costs, and what a pass of ``bpt`` and ``vcm`` is when its cost is stated: one light path per camera
#: path, one connection and one light point at a camera vertex; for ``vcm`` a radius of 0.003 of half the diagonal of
#: the scene's box, which does not shrink from pass to pass.
COST_SCENE = "cornell-glass"
_PASS = {"max_depth": 10, "samples_per_pass": 1}
_BIDIRECTIONAL = _PASS | {"connections": 1, "next_events": 1, "light_source": "cache", "light_paths": 1.0}
COST_SETTINGS: dict[str, dict[str, Any]] = {
    "auto": _PASS,
    "path": _PASS,
    "guided": _PASS,
    "vegas": _PASS,
    "stratified": _PASS,
    "light": _PASS | {"light_paths": 1.0},
    "pm": _PASS | {"photons": 200_000, "neighbours": 50},
    "ppm": _PASS | {"radius": 0.003, "radius_unit": "scene", "alpha": 1.0},
    "sppm": _PASS | {"radius": 0.003, "radius_unit": "scene", "alpha": 1.0},
    "bpt": _BIDIRECTIONAL,
    "bpm": _BIDIRECTIONAL | {"radius": 0.003, "radius_unit": "scene", "alpha": 1.0},
    "vcm": _BIDIRECTIONAL | {"radius": 0.003, "radius_unit": "scene", "alpha": 1.0},
    "pssmlt": _PASS,
    "mmlt": _PASS,
    "film_metropolis": _PASS,
    "irradiance_cache": _PASS,
    "ambient_path": _PASS,
    "ambient_light": _PASS | {"light_paths": 1.0},
}

console = Console(highlight=False)
if not console.is_terminal:
    console.width = 160  # a log is not wrapped at the 80 columns that are assumed for it


@dataclass(frozen=True)
class Clock:
    """A span of wall time, and of CPU time over all threads of this process."""

    wall: float
    cpu: float


def timed(work: Callable[..., Any], *arguments: Any) -> Clock:
    """Time ``work``, which must not return before the device is done (``dr.sync_thread``, or results on the host)."""
    cpu, wall = time.process_time(), time.perf_counter()
    work(*arguments)
    return Clock(time.perf_counter() - wall, time.process_time() - cpu)


def interleaved(tasks: Mapping[str, Callable[[int], Any]], rounds: int, warm_up: int) -> dict[str, list[Clock]]:
    """Time every task once a round, A B C A B C, so that what else the machine does meets all alike.

    A task is given the number of the round; the ``warm_up`` rounds come first and are not kept.
    """
    times: dict[str, list[Clock]] = {name: [] for name in tasks}
    for number in range(warm_up + rounds):
        for name, task in tasks.items():
            clock = timed(task, number)
            if number >= warm_up:
                times[name].append(clock)
    return times


def spread(values: Sequence[float], form: str = ".2f") -> str:
    """``median (min … max)``."""
    middle, low, high = statistics.median(values), min(values), max(values)
    return f"{middle:{form}} ({low:{form}} … {high:{form}})"


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def verdict(value: float, bar: float | None) -> str:
    """A value's bar, and whether it is reached."""
    if bar is None:
        return ""
    return f"≤ {bar:g}: {'reached' if value <= bar else 'missed'}"


def child(command: str, options: Mapping[str, Any], environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run ``benchmarks.child`` in a fresh process; the JSON object that it prints last.

    If the process fails, what it wrote is printed and the object is empty: the other rows of a table are still made.
    """
    arguments = [sys.executable, "-m", "benchmarks.child", command, json.dumps(dict(options))]
    run = subprocess.run(
        arguments, cwd=ROOT, env=os.environ | dict(environment or {}), capture_output=True, text=True, check=False
    )
    if run.returncode:
        console.print(f"{shlex.join(arguments)} failed ({run.returncode}):\n{run.stderr}", markup=False)
        return {}
    outcome: dict[str, Any] = json.loads(run.stdout.strip().splitlines()[-1])
    return outcome


def gpu() -> str:
    """Name of the first GPU, as its driver says it."""
    command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
    try:
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
    except (OSError, subprocess.SubprocessError):
        return "a GPU"
    return said.partition("\n")[0].strip()


def machine() -> str:
    """Processor, cores that this process may use, memory, system."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(), re.MULTILINE)
        model = found[1] if found else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    parts = [model, f"{cores} cores", platform.system()]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        parts.insert(2, f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.0f} GB")
    return ", ".join(parts)


def software(variant: str) -> str:
    """Versions that a figure depends on."""
    import drjit as dr

    from etendue.core import kernel_target

    names = [f"{name} {metadata.version(name)}" for name in ("etendue", "mitsuba", "drjit")]
    if variant.startswith("cuda"):
        names.insert(0, gpu())
    elif variant.startswith("llvm"):
        names.append(f"LLVM {'.'.join(str(v) for v in dr.detail.llvm_version())} for {kernel_target()}")
    names.append(f"Python {platform.python_version()}")
    return ", ".join([variant, *names])


def _without_out(words: Sequence[str]) -> list[str]:
    """Options of a command without ``--out``: a folder of this machine, which says nothing of the measurement."""
    kept = [word for before, word in zip(["", *words], words, strict=False) if before != "--out"]
    return [word for word in kept if word.split("=")[0] != "--out"]


def _program(script: Path) -> str:
    """What stands behind ``python -m`` for a script of ours, else the script."""
    folder = script.resolve().parent
    inside = script.name == "__main__.py" and folder.is_relative_to(ROOT)
    return ".".join(folder.relative_to(ROOT).parts) if inside else str(script)


#: Lists that published tables are added to.
_KEPT: list[list[Record]] = []


@contextmanager
def published() -> Iterator[list[Record]]:
    """The tables that are published in the block."""
    kept: list[Record] = []
    _KEPT.append(kept)
    try:
        yield kept
    finally:
        _KEPT.remove(kept)


@dataclass
class Record:
    """A table with what must be known to read it; printed, and on request appended to a file."""

    title: str
    columns: Sequence[str]
    rows: list[Sequence[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *cells: str) -> None:
        """Add a row."""
        self.rows.append(cells)

    def publish(self, variant: str, results: Path | None = None) -> None:
        """Print the table, and put it at the end of the file ``results``, if one is given, in place of an older one of
        the same title. Titles of tables made on a GPU say so, so that they stand beside those of a CPU."""
        title = f"{self.title}, on a GPU" if variant.startswith("cuda") else self.title
        for kept in _KEPT:
            kept.append(self)
        console.print(title, style="italic")
        table = Table(box=None, pad_edge=False)
        for column in self.columns:
            table.add_column(column)
        for row in self.rows:
            table.add_row(*row)
        console.print(table)
        for note in self.notes:
            console.print(f"- {note}")
        console.print()
        if results is not None:
            before = results.read_text("utf-8") if results.exists() else ""
            older = re.compile(rf"^## {re.escape(title)}, \d{{4}}-\d\d-\d\d.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)
            results.write_text(older.sub("", before).rstrip("\n") + "\n" + self._markdown(title, variant), "utf-8")

    def _markdown(self, title: str, variant: str) -> str:
        def line(cells: Sequence[str]) -> str:
            return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

        words = [_program(Path(sys.argv[0])), *_without_out(sys.argv[1:])]
        load = f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"
        lines = [
            f"\n## {title}, {datetime.now():%Y-%m-%d %H:%M}\n",
            f"`python -m {shlex.join(words)}`; {machine()}, load {load} at the end; {software(variant)}.\n",
            line(self.columns),
            line(["---"] * len(self.columns)),
            *(line(row) for row in self.rows),
            "",
            *(f"- {note}" for note in self.notes),
        ]
        return "\n".join(lines).rstrip() + "\n"
