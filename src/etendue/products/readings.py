"""Readings of meters, and their files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from etendue import film
from etendue.core import Array, OptionError, Settings, checked_path, logger, warn_of_nonfinite
from etendue.engine import Budget, Job, Product, RunResult, Task, check_period, silent
from etendue.lighting import EFFICACY, Meters
from etendue.scene import Problem

from .files import PathLike, Writing, check_files, listed, rescued
from .pictures import developed

#: Camera paths of each meter, if there is no limit, and passes of a run, whose variance gives the standard error.
_PATHS, _PASSES = 4096, 32
#: Names of what is measured, by quantity: in watts, and in lumens.
_RADIOMETRIC = {"irradiance": ("irradiance", "W/m^2"), "radiance": ("radiance", "W/m^2/sr")}
_PHOTOMETRIC = {"irradiance": ("illuminance", "lx"), "radiance": ("luminance", "cd/m^2")}


@dataclass(repr=False)
class Readings:
    """What meters read.

    Attributes
    ----------
    meters: n meters.
    values: (n, 3), linear RGB: irradiance in W/m^2, or radiance in W/m^2/sr.
    errors: (n, 3), standard errors of ``values``; NaN after a single pass.
    metadata: method, settings, seed, samples, seconds and more, as of a picture.
    """

    meters: Meters
    values: Array
    errors: Array
    metadata: dict[str, Any]

    @property
    def photometric(self) -> Array:
        """(n,) illuminance in lx, or luminance in cd/m^2: 683 lm/W times the luminance of ``values``."""
        result: Array = EFFICACY * self.values @ np.array(film.LUMINANCE)
        return result

    @property
    def photometric_error(self) -> Array:
        """(n,) standard error of :attr:`photometric`; an upper estimate, as the errors of the channels are hardly ever
        independent."""
        result: Array = EFFICACY * self.errors @ np.array(film.LUMINANCE)
        return result

    def save(self, path: PathLike, photometric: bool = False) -> None:
        """Write a table (``.csv``): a row for each meter with its name, point and direction, and what it reads with
        the standard error: red, green and blue, or one ``photometric`` number.

        Raises :class:`OptionError` for another suffix, :class:`OutputError` if the file cannot be written.
        """
        path = check_table(path)
        name, unit = (_PHOTOMETRIC if photometric else _RADIOMETRIC)[self.meters.quantity]
        heads = [f"{name} [{unit}]"] if photometric else [f"{name}_{c} [{unit}]" for c in "rgb"]
        heads += [head.split(" ")[0] + "_error" for head in heads]
        numbers = [self.meters.points, self.meters.directions]
        numbers += [v.reshape(len(self.meters), -1) for v in self._columns(photometric)]
        names = self.meters.names
        with film.replacing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([*(["name"] if names else []), "x", "y", "z", "nx", "ny", "nz", *heads])
            for k, row in enumerate(np.concatenate(numbers, axis=1)):
                writer.writerow([*names[k : k + 1], *(f"{v:.9g}" for v in row)])

    def _columns(self, photometric: bool) -> tuple[Array, Array]:
        return (self.photometric, self.photometric_error) if photometric else (self.values, self.errors)

    def summary(self, photometric: bool = False) -> str:
        """``12 meters: illuminance 108 to 730 lx, mean 412, uniformity 0.26, error 0.4 %``. Uniformity is the least
        reading over the mean, the error the mean relative standard error."""
        name, unit = (_PHOTOMETRIC if photometric else _RADIOMETRIC)[self.meters.quantity]
        weights = 1.0 if photometric else 1.0 / EFFICACY
        read, error = weights * self.photometric, weights * self.photometric_error
        mean, count = float(read.mean()), len(read)
        parts = [f"{name} {read.min():.4g} to {read.max():.4g} {unit}" if count > 1 else f"{name} {mean:.5g} {unit}"]
        if count > 1:
            parts.append(f"mean {mean:.4g}")
        if count > 1 and mean > 0.0 and self.meters.quantity == "irradiance":
            parts.append(f"uniformity {read.min() / mean:.2g}")
        if mean > 0.0 and np.isfinite(error).all():
            parts.append(f"error {100.0 * float(error.mean()) / mean:.2g} %")
        return f"{count} meter{'' if count == 1 else 's'}: {', '.join(parts)}"

    def __repr__(self) -> str:
        return f"<etendue.Readings {self.summary()}>"


@dataclass
class MeterTable(Product[Readings]):
    """Readings and their tables. ``photometric``: tables in lx or cd/m^2."""

    kind: ClassVar[str] = "readings"

    meters: Meters
    tables: tuple[Path, ...] = ()
    photometric: bool = False
    save_every: float | None = None

    @classmethod
    def of(
        cls,
        meters: Meters,
        tables: PathLike | Sequence[PathLike] = (),
        photometric: bool = False,
        save_every: float | None = None,
    ) -> MeterTable:
        """Check and make. Raises :class:`OptionError` for another suffix than ``.csv``, a file that is named twice or a
        time that is not above 0, :class:`OutputError` for a file that cannot be written."""
        check_period(save_every)
        made = cls(meters, tuple(map(check_table, listed(tables))), photometric, save_every)
        check_files(made.files)
        return made

    @property
    def files(self) -> tuple[Path, ...]:
        """The tables."""
        return self.tables

    def default_budget(self, task: Task, problem: Problem) -> Budget:
        """A fixed number of paths."""
        return Budget(samples=_PATHS)

    def settings(self, task: Task, problem: Problem, budget: Budget) -> Settings:
        """Those of the task: the depth of paths in pictures of the scene does not apply. A run with a number of samples
        has passes enough for the standard error."""
        given = dict(task.settings)
        if budget.samples is not None:
            ranges = {field.name: field.metadata for field in fields(task.method.Settings)}
            most = int(ranges["samples_per_pass"]["maximum"])
            given.setdefault("samples_per_pass", min(max(1, int(budget.samples) // _PASSES), most))
        made: Settings = task.method.Settings.from_mapping(given, owner=f"method '{task.method.name}'")
        return made

    def saving(self, job: Job) -> dict[str, Any]:
        """See :class:`Product`."""
        if not self.files:
            return {}
        return {"on_save": lambda run: self._write(job, run), "save_every": self.save_every}

    def keep(self, job: Job, run: RunResult) -> Readings:
        """See :class:`Product`: all tables are written."""
        return self._write(job, run)

    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> Readings:
        """See :class:`Product`."""
        warn_of_nonfinite(run.measurement)
        return self._write(job, run)

    def _write(self, job: Job, run: RunResult) -> Readings:
        values, variance = (
            np.asarray(v, np.float64).reshape(len(self.meters), -1)
            for v in (run.measurement.mean("image"), run.measurement.variance_of_mean("image"))
        )
        result = Readings(self.meters, values, np.sqrt(variance), developed(run, job.problem, job.seed).metadata)
        if run.stopped_by != "running" and len(dark := np.flatnonzero(~values.any(axis=1))):
            first = np.round(self.meters.points[dark[0]], 4).tolist()
            logger.warning(
                "%d of %d meters read 0, as number %d at %s: light does not reach them, or they are inside of solids",
                *(len(dark), len(values), dark[0], first),
            )
        writing = Writing()
        for path in self.tables:
            write = partial(result.save, photometric=self.photometric)

            def rescue(path: Path = path, write: Callable[[Path], None] = write) -> str:
                place = None if run.stopped_by == "running" else rescued(path.name, ("", write))
                return "" if place is None else f"; the table is in '{place}' instead"

            with writing.attempt(f"write '{path}'", rescue):
                write(path)
        writing.finish()
        return result


def check_table(path: PathLike) -> Path:
    """The path of a table. Raises :class:`OptionError` for another suffix than ``.csv``."""
    checked = checked_path(path, "a table")
    if checked.suffix.lower() != ".csv":
        raise OptionError(f"readings are written as .csv, not as '{checked.name}'; change the name")
    return checked
