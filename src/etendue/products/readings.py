"""Readings of meters, and their files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue import film
from etendue.core import Array, Method, OptionError, Settings, checked_path, logger, warn_of_nonfinite
from etendue.engine import Budget, Job, Product, RunResult, Task, check_period, fitting_samples, silent
from etendue.lighting import EFFICACY, Meters, photometric
from etendue.scene import Problem

from .files import PathLike, Writing, check_files, listed, rescued
from .pictures import developed

#: Camera paths of each meter, if there is no limit, and passes of a run, whose variance gives the standard error.
_PATHS, _PASSES = 4096, 32
#: Paths of a pass that takes a fraction of a second; most of a meter if nothing tells how many there will be, and at
#: all (``samples_per_pass``).
_SHORT, _MOST, _LARGEST = 1 << 17, 64, 4096
#: Names of what is measured, by quantity: in watts, and in lumens.
_RADIOMETRIC = {
    "irradiance": ("irradiance", "W/m^2"),
    "radiance": ("radiance", "W/m^2/sr"),
    "cylindrical": ("cylindrical_irradiance", "W/m^2"),
    "spherical": ("spherical_irradiance", "W/m^2"),
}
_PHOTOMETRIC = {
    "irradiance": ("illuminance", "lx"),
    "radiance": ("luminance", "cd/m^2"),
    "cylindrical": ("cylindrical_illuminance", "lx"),
    "spherical": ("spherical_illuminance", "lx"),
}
#: What is wrong with a picture of meters at any points.
_NO_GRID = "a picture of readings needs a grid of meters; give a grid, or write a table, .csv"


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
        return photometric(self.values)

    @property
    def photometric_error(self) -> Array:
        """(n,) standard error of :attr:`photometric`; an upper estimate, as the errors of the channels are hardly ever
        independent."""
        return photometric(self.errors)

    def save(
        self, path: PathLike, photometric: bool = False, low: float | None = None, high: float | None = None
    ) -> None:
        """Write a table (``.csv``): a row for each meter with its name, point and direction, and what it reads with
        the standard error: red, green and blue, or one ``photometric`` number. Or write a picture (``.png``) of a grid:
        see :meth:`picture`.

        Raises :class:`OptionError` for another suffix and a picture of meters that are no grid, :class:`OutputError` if
        the file cannot be written.
        """
        path = check_readings_file(path, self.meters)
        if path.suffix.lower() == ".png":
            from etendue.display import write_png  # imported late: most of it is for pages and plots

            write_png(path, self.picture(photometric, low, high))
            return
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

    def picture(
        self, photometric: bool = False, low: float | None = None, high: float | None = None
    ) -> NDArray[np.uint8]:
        """The readings of a grid in false colours with isolines and a legend, (height, width, 3) sRGB bytes: in lx or
        cd/m^2 if ``photometric``, otherwise their luminance in W/m^2 or W/m^2/sr.

        It shows the grid from the side that the meters face, the first edge to the right, the second upwards. ``low``,
        ``high``: the ends of the scale, see :func:`etendue.display.false_colour_picture`. Raises :class:`OptionError`
        for meters that are no grid.
        """
        from etendue.display import false_colour_picture

        if self.meters.cells is None:
            raise OptionError(_NO_GRID)
        _, unit = (_PHOTOMETRIC if photometric else _RADIOMETRIC)[self.meters.quantity]
        columns, rows = self.meters.cells
        points = self.meters.points.reshape(rows, columns, 3)
        # Distances of neighbours; along an edge with one meter it is not known.
        steps = [np.linalg.norm(line[1] - line[0]) if len(line) > 1 else None for line in (points[0], points[:, 0])]
        known = [float(step) for step in steps if step is not None] or [1.0]
        pixel = (known[0], known[-1])
        values = self.photometric * (1.0 if photometric else 1.0 / EFFICACY)
        return false_colour_picture(values.reshape(rows, columns)[::-1], unit, low, high, lines=True, pixel=pixel)

    def _columns(self, photometric: bool) -> tuple[Array, Array]:
        return (self.photometric, self.photometric_error) if photometric else (self.values, self.errors)

    def summary(self, photometric: bool = False) -> str:
        """``12 meters: illuminance 108 to 730 lx, mean 412, uniformity 0.26, error 0.4 %``. Uniformity is the least
        reading over the mean, the error the mean relative standard error."""
        name, unit = (_PHOTOMETRIC if photometric else _RADIOMETRIC)[self.meters.quantity]
        weights = 1.0 if photometric else 1.0 / EFFICACY
        read, error = weights * self.photometric, weights * self.photometric_error
        mean, count = float(read.mean()), len(read)
        name = name.replace("_", " ")
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
    """Readings and their files: tables, pictures of grids, and a checkpoint. ``photometric``: in lx or cd/m^2.
    ``scale``: the ends of the scale of pictures."""

    kind: ClassVar[str] = "readings"
    least_passes: ClassVar[int] = 2  #: for the standard errors

    meters: Meters
    tables: tuple[Path, ...] = ()
    photometric: bool = False
    save_every: float | None = None
    scale: tuple[float | None, float | None] = (None, None)
    checkpoint: Path | None = None

    @classmethod
    def of(
        cls,
        meters: Meters,
        tables: PathLike | Sequence[PathLike] = (),
        photometric: bool = False,
        save_every: float | None = None,
        scale: tuple[float | None, float | None] = (None, None),
        checkpoint: PathLike | None = None,
    ) -> MeterTable:
        """Check and make. Raises :class:`OptionError` for another suffix than ``.csv`` and ``.png``, a picture of
        meters that are no grid, a scale that does not rise or has no picture, a file that is named twice or a time that
        is not above 0, :class:`OutputError` for a file that cannot be written."""
        check_period(save_every)
        files = tuple(check_readings_file(path, meters) for path in listed(tables))
        kept = None if checkpoint is None else checked_path(checkpoint, "a checkpoint")
        made = cls(meters, files, photometric, save_every, scale, kept)
        if scale != cls.scale:
            from etendue.display import check_range

            check_range(*scale)
            if not any(path.suffix.lower() == ".png" for path in files):
                raise OptionError("a range is that of the colours of a picture; write a .png, too")
        check_files(made.files)
        return made

    @property
    def files(self) -> tuple[Path, ...]:
        """The tables and pictures, then the checkpoint."""
        return self.tables if self.checkpoint is None else (*self.tables, self.checkpoint)

    def notes(self) -> dict[str, Any]:
        """See :class:`Product` and :meth:`noted`."""
        tables = [str(path) for path in self.tables]
        known = {"kind": self.kind, "tables": tables, "photometric": self.photometric, "scale": list(self.scale)}
        return {"product": known}

    @classmethod
    def noted(cls, known: Mapping[str, Any], meters: Meters, tables: Sequence[PathLike], **options: Any) -> MeterTable:
        """The product of the notes of a checkpoint, ``known``, with other ``tables`` if there are any. Raises as
        :meth:`of`."""
        files = tables or [Path(name) for name in known["tables"]]
        has_picture = any(Path(path).suffix.lower() == ".png" for path in files)
        scale = tuple(known["scale"]) if has_picture else cls.scale
        return cls.of(meters, files, known["photometric"], scale=scale, **options)

    def default_budget(self, task: Task, problem: Problem) -> Budget:
        """A fixed number of paths."""
        return Budget(samples=_PATHS)

    def settings(self, task: Task, problem: Problem, budget: Budget) -> Settings:
        """Those of the task: the depth of paths in pictures of the scene does not apply. Without a number of samples,
        passes are short, so that there are several for the standard error. With one, those of few meters are longer
        than those of pictures, which have more pixels."""
        given, most = dict(task.settings), _SHORT // len(self.meters)
        if budget.samples is None:
            given.setdefault("samples_per_pass", min(max(1, most), _MOST))
        elif (enough := min(most, budget.samples // _PASSES, _LARGEST)) > _MOST:
            given.setdefault("samples_per_pass", fitting_samples(budget.samples, enough))
        made: Settings = task.method.Settings.from_mapping(given, owner=f"method '{task.method.name}'")
        return made

    def make_method(self, task: Task, settings: Settings, problem: Problem, budget: Budget) -> Method:
        """See :class:`Product`. A number of samples is divided into passes enough for the standard error."""
        made = super().make_method(task, settings, problem, budget)
        made.least_passes = max(made.least_passes, _PASSES)
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
        if run.stopped_by != "running":
            warn_of_dark(values, self.meters, "read 0")
            if np.isnan(result.errors).all():
                logger.warning("the standard errors are not known after a single pass; give more time or more paths")
        writing = Writing()
        if self.checkpoint is not None:
            with writing.attempt(f"write '{self.checkpoint}'"):
                job.checkpoint(run).write(self.checkpoint)
        for path in self.tables:
            low, high = self.scale
            write = partial(result.save, photometric=self.photometric, low=low, high=high)

            def rescue(path: Path = path, write: Callable[[Path], None] = write) -> str:
                place = None if run.stopped_by == "running" else rescued(path.name, ("", write))
                return "" if place is None else f"; it is in '{place}' instead"

            with writing.attempt(f"write '{path}'", rescue):
                write(path)
        writing.finish()
        return result


def warn_of_dark(values: Array, meters: Meters, what: str) -> None:
    """Warn of meters of which all ``values`` (n, k) are 0. ``what`` they do: ``read 0``."""
    if len(dark := np.flatnonzero(~values.any(axis=1))):
        logger.warning(
            "%d of %d meters %s, as number %d at %s: light does not reach them, or they are inside of solids",
            *(len(dark), len(values), what, dark[0], np.round(meters.points[dark[0]], 4).tolist()),
        )


def check_readings_file(path: PathLike, meters: Meters) -> Path:
    """The path of a file of readings. Raises :class:`OptionError` for another suffix than ``.csv`` and ``.png``, and
    for a picture of meters that are no grid."""
    checked = checked_path(path, "a table")
    suffix = checked.suffix.lower()
    if suffix not in (".csv", ".png"):
        raise OptionError(f"readings are written as .csv or .png, not as '{checked.name}'; change the name")
    if suffix == ".png" and meters.cells is None:
        raise OptionError(_NO_GRID)
    return checked
