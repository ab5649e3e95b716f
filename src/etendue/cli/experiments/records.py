"""The records of a run file: pictures at given times, a log, a table of the error over time, and a page."""

from __future__ import annotations

import csv
import logging
import shlex
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TextIO

import numpy as np
from numpy.typing import NDArray

from etendue import display, film, methods
from etendue.core import CheckpointError, OutputError, describe, logger
from etendue.engine import Checkpoint, Job, RunResult, versions
from etendue.products import Picture, Rendering, Update, Writing
from etendue.scene import Problem, require_colours

from ..running import check_reference, make_folder
from .history import History
from .repeating import defaults_of, picture_command
from .run_file import RunFile

#: Checkpoint key for the path of the run file.
_RUN_FILE = "run_file"
#: Columns of the table: times, work done, errors. Numbers only; empty if unknown.
COLUMNS = (
    "seconds",
    "rendering_seconds",
    "autosave",
    "passes",
    "samples",
    "rays",
    "error",
    "relmse",
    "relmse_trimmed",
    "luminance_rmse",
)


def run_of(saved: Checkpoint, path: Path) -> RunFile | None:
    """The run file whose records continue with the checkpoint ``saved`` at ``path``, ``None`` if it has none.

    Warns if it no longer exists, or has its checkpoint elsewhere. Errors as :meth:`RunFile.read`, and
    :class:`CheckpointError` if it now has another method, other settings or another seed.
    """
    if _RUN_FILE not in saved.notes:
        return None
    place = Path(saved.notes[_RUN_FILE])
    run = RunFile.read(place) if place.is_file() else None
    if run is None or run.checkpoint_path.resolve() != path.resolve():
        why = "is gone" if run is None else "keeps its checkpoint elsewhere"
        logger.warning("only the picture continues, without log, table and saves: the run file '%s' %s", place, why)
        return None
    try:
        saved.settings_of(methods.get(saved.method if run.method is None else run.method), run.settings, run.seed)
    except CheckpointError as error:
        raise CheckpointError(f"{place} has changed: {error}") from error
    return run


class Recorder(Picture):
    """The picture of a run file, with its records. As a context it creates the folder and logs warnings.

    A save at a given time has its own files, other saves replace ``name.exr``. ``tell`` receives the log line of every
    save except periodic ones. The seconds of a run include the time of saves. If a run is resumed, log and table
    continue, and times count from its first start.
    """

    def __init__(self, run: RunFile, tell: Callable[[str], object]) -> None:
        super().__init__()
        self._run = run
        self._tell = tell
        self._reference: NDArray[np.float32] | None = film.read_image(run.reference) if run.reference else None
        self._log: TextIO | None = None
        self._table: TextIO | None = None
        self._handler: logging.Handler | None = None
        self._history = History(self._reference)
        self._earlier = 0.0  # seconds of the run before it was resumed
        self._save_at: dict[float, float] = {}  # remaining save times: runner's time to requested time
        self._written: dict[Path, None] = {}  # in the order of first writing

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that were written."""
        return tuple(self._written)

    def check(self, problem: Problem) -> None:
        """Raise :class:`OptionError` if the picture cannot be compared with the reference, :class:`UnsupportedError` if
        it has no colours."""
        require_colours(problem.sensor.film(), "a run file")
        check_reference(self._reference, problem.size, "size = [{}, {}] in [scene]")

    def __enter__(self) -> Self:
        make_folder(self._run.folder)
        self._outputs(self._run.name)  # checks that it can be written
        if self._run.page:
            film.check_writable(self._run.page_path)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and self._log is not None:
            self._line(self._log, f"error: {describe(error)}")
        if self._handler is not None:
            logger.removeHandler(self._handler)
        for file in (self._log, self._table):
            if file is not None:
                file.close()

    def watch(self, update: Update) -> None:
        """A callback of the run: notes errors for the page."""
        if self._run.page:
            self._history.record(update)

    def saving(self, job: Job) -> dict[str, Any]:
        """See ``Product``. Starts or continues log and table."""
        self._earlier = job.earlier
        self._save_at = {time - job.earlier: time for time in self._run.save_at if time > job.earlier}
        self._begin(job)
        return {
            "on_save": lambda run: self._save(job, run),
            "save_every": self._run.save_every,
            "save_at": list(self._save_at),
        }

    def write(self, job: Job, run: RunResult) -> Rendering:
        """At the end of a run: the autosaves that it completes, then the pictures without a time in their name, also if
        an autosave fails."""
        writing = Writing()
        if run.save_times:
            with writing.attempt("write the autosaves"):
                self._save(job, run)
        rendering = self._keep(job, run, self._outputs(self._run.name), None, f"end ({run.stopped_by})")
        if ahead := [time for reached, time in self._save_at.items() if reached not in run.save_times]:
            self._line(self._log, f"the run ended before its autosave at {_times(ahead)} s")
        if self._run.page:
            self._write_page(job, rendering)
        writing.finish()
        return rendering

    def _write_page(self, job: Job, made: Rendering) -> None:
        run, known = self._run, made.metadata
        height, width = made.image.shape[:2]
        name = known["method"]
        entry = display.Entry(
            name,
            made.image,
            known,
            self._history.errors(made.image, self._earlier_errors(), self._earlier),
            {k: v for k, v in made.layers.items() if k != "image"},
            defaults_of(methods.get(name)),
            picture_command(job.task, known["settings"], known["samples"], (width, height)),
        )
        display.write_report(
            run.page_path,
            [entry],
            self._reference,
            title=f"{run.name}: {name} on {run.scene}",
            reference_note=str(run.reference or ""),
            error_name=self._history.error_name,
            repeat=[
                display.Command(shlex.join(["etendue", "run", str(run.path)]), f"This page, from {Path.cwd()}"),
                display.Command(run.path.read_text("utf-8", "replace"), f"The run file {run.path}"),
            ],
        )
        self._written[run.page_path] = None

    def _earlier_errors(self) -> list[tuple[float, float]]:
        """Rows of the table from before the run was resumed."""
        if not self._earlier:
            return []
        column = "error" if self._reference is None else "relmse"
        with open(self._run.folder / f"{self._run.name}.csv", encoding="utf-8") as file:
            rows = [(float(row["seconds"]), row[column]) for row in csv.DictReader(file)]
        return [(seconds, float(error)) for seconds, error in rows if error and seconds <= self._earlier]

    def _save(self, job: Job, run: RunResult) -> None:
        for reached in run.save_times:
            if (time := self._save_at.get(reached)) is not None:  # not written before another autosave failed
                self._keep(job, run, self._outputs(f"{self._run.name}-{_seconds(time)}s"), time, f"autosave {time:g} s")
                del self._save_at[reached]
        if not run.save_times:
            self._keep(job, run, self._outputs(self._run.name), None, "save")

    def _outputs(self, name: str) -> Picture:
        """Pictures with that name, and the checkpoint."""
        run = self._run
        suffixes = ("exr", "png") if run.png else ("exr",)
        checkpoint = run.checkpoint_path if run.checkpoint else None
        pictures = [run.folder / f"{name}.{suffix}" for suffix in suffixes]
        return Picture.of(pictures, checkpoint, separate=run.layers == "separate")

    def _keep(self, job: Job, run: RunResult, outputs: Picture, time: float | None, what: str) -> Rendering:
        """Write ``outputs``, a log line and a row of the table."""
        rendering = outputs.write(job, run)
        for path in outputs.files:
            layers = rendering.layers if outputs.separate and path.suffix == ".exr" else ("image",)
            self._written.update(dict.fromkeys(film.layer_path(path, layer) for layer in layers))
        row = self._row(run, rendering, time)
        self._line(self._table, ",".join("" if row[name] is None else f"{row[name]:.10g}" for name in COLUMNS))
        line = f"{what}: {_words(row, self._run.trim)} -> {outputs.pictures[0].name}"
        self._line(self._log, f"{row['seconds']:.2f} s  {line}")
        if what != "save":
            self._tell(line)
        return rendering

    def _row(self, run: RunResult, rendering: Rendering, time: float | None) -> dict[str, Any]:
        m, image = rendering.metadata, rendering.image
        row: dict[str, Any] = dict.fromkeys(COLUMNS)
        row |= {
            "seconds": round(self._earlier + run.elapsed, 3),
            "rendering_seconds": m["seconds"],
            "autosave": time,
            "passes": m["passes"],
            "samples": m["samples"],
            "rays": int(m["rays"]),
            "error": m["error"],
        }
        if self._reference is not None:
            row |= {
                "relmse": film.relative_mse(image, self._reference),
                "relmse_trimmed": film.relative_mse(image, self._reference, self._run.trim),
                "luminance_rmse": film.luminance_rmse(image, self._reference),
            }
        return row

    def _begin(self, job: Job) -> None:
        made, date = versions(), datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S %z")
        head = [
            f"étendue {made['etendue']}, Mitsuba {made['mitsuba']}, Dr.Jit {made['drjit']}, {made['variant']}; {date}",
            f"{self._run.path.absolute()}: {self._run.describe(job)}",
            f"seed {job.seed}, settings {job.method.settings.to_json()}, fingerprint {job.problem.fingerprint}",
        ]
        if job.earlier > 0.0:
            head.insert(0, f"resumed after {job.earlier:.2f} s")
        job.notes[_RUN_FILE] = str(self._run.path.absolute())
        self._log, self._table = (self._open(suffix, "a" if job.earlier > 0.0 else "w") for suffix in ("log", "csv"))
        for line in head:
            self._line(self._log, line)
        if self._table.tell() == 0:
            self._line(self._table, ",".join(COLUMNS))
        self._handler = logging.StreamHandler(self._log)
        self._handler.setLevel(logging.WARNING)
        self._handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
        logger.addHandler(self._handler)

    def _open(self, suffix: str, mode: Literal["w", "a"]) -> TextIO:
        path = self._run.folder / f"{self._run.name}.{suffix}"
        try:
            file = open(path, mode, encoding="utf-8")  # noqa: SIM115 (closed at the end of the run)
        except OSError as error:
            raise OutputError(f"cannot write '{path}': {error.strerror}; choose another folder") from error
        self._written[path] = None
        return file

    @staticmethod
    def _line(file: TextIO | None, text: str) -> None:
        """Write and flush a line, so that it survives a killed process."""
        assert file is not None
        try:
            file.write(f"{text}\n")
            file.flush()
        except OSError as error:
            raise OutputError(f"cannot write '{file.name}': {error.strerror}; make room there") from error


def _words(row: dict[str, Any], trim: float) -> str:
    """A row of the table as text."""
    passes = f"{row['passes']} pass{'' if row['passes'] == 1 else 'es'}"
    parts = [passes, f"{row['samples']} spp", f"{row['rays']:.3g} rays"]
    if row["error"] is not None:
        parts.append(f"error {row['error']:.3g}")
    if row["relmse"] is not None:
        parts.append(f"relMSE {row['relmse']:.4g} ({row['relmse_trimmed']:.4g} without the worst {100 * trim:g} %)")
        parts.append(f"RMS of luminance {row['luminance_rmse']:.4g}")
    return ", ".join(parts)


def _seconds(time: float) -> str:
    """Seconds for file names: as few digits as possible, without exponent."""
    return f"{time:.6f}".rstrip("0").rstrip(".")


def _times(times: Sequence[float]) -> str:
    return " ".join(f"{t:g}" for t in times)
