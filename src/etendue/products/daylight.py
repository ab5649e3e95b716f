"""Daylight coefficients, the daylight of a year, and their files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from etendue import film
from etendue.core import OptionError, checked_path, format_count
from etendue.engine import Budget, Job, Product, RunResult, Task, silent
from etendue.lighting import AnnualDaylight, DaylightCoefficients, Meters, Weather
from etendue.methods import SkyTracing
from etendue.scene import Problem

from .files import PathLike, Writing, check_files, listed, rescued
from .pictures import developed
from .readings import warn_of_dark

#: Paths of each meter, if there is no limit.
_PATHS = 1 << 16
_SUFFIXES = (".mtx", ".npz", ".csv")


@dataclass(repr=False)
class DaylightResult:
    """Daylight coefficients, and with weather the daylight of a year."""

    coefficients: DaylightCoefficients
    annual: AnnualDaylight | None = None

    def save(self, path: PathLike) -> None:
        """Write the coefficients as a matrix for Radiance's ``dctimestep`` (``.mtx``), coefficients and the
        illuminance of all hours as arrays (``.npz``), or a table of meters with the metrics of the year (``.csv``).

        Raises :class:`OptionError` for another suffix, or a table without weather; :class:`OutputError` if the file
        cannot be written.
        """
        path = check_daylight_file(path, self.annual is not None)
        with film.replacing(path) as part:
            if path.suffix.lower() == ".mtx":
                self.coefficients.write_matrix(part)
            elif path.suffix.lower() == ".npz":
                with part.open("wb") as file:
                    np.savez_compressed(file, **self._arrays())
            else:
                self._write_table(part)

    def _arrays(self) -> dict[str, Any]:
        c = self.coefficients
        arrays: dict[str, Any] = {"coefficients": c.values, "errors": c.errors, "points": c.meters.points}
        arrays |= {"normals": c.meters.directions, "sky_directions": c.patches.directions}
        if self.annual is not None:
            arrays |= {"illuminance": self.annual.illuminance.astype(np.float32), "times": self.annual.weather.times}
        return arrays

    def _write_table(self, path: Path) -> None:
        assert self.annual is not None
        heads, rows = self.annual.table()
        names = self.coefficients.meters.names
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([*(["name"] if names else []), *heads])
            for k, row in enumerate(rows):
                writer.writerow([*names[k : k + 1], *(f"{v:.9g}" for v in row)])

    def summary(self) -> str:
        """The number of coefficients, and the metrics of the year."""
        n, p, _ = self.coefficients.values.shape
        text = f"{format_count(n, 'meter')}, {p} patches of the sky"
        if self.annual is not None:
            year = self.annual
            text += (
                f"; sDA 300/50 {100 * year.spatial_autonomy():.3g} %, UDI 100-3000 "
                f"{100 * float(year.useful().mean()):.3g} %, EN 17037: {year.en17037()}"
            )
        return text

    def __repr__(self) -> str:
        return f"<etendue.DaylightResult {self.summary()}>"


@dataclass
class Daylight(Product[DaylightResult]):
    """Daylight coefficients and their files."""

    kind: ClassVar[str] = "daylight"

    meters: Meters
    weather: Weather | None = None
    outputs: tuple[Path, ...] = ()

    @classmethod
    def of(cls, meters: Meters, weather: Weather | None, outputs: PathLike | Sequence[PathLike] = ()) -> Daylight:
        """Check and make. Raises :class:`OptionError` for files that cannot be made, :class:`OutputError` for those
        that cannot be written, :class:`LightingError` for weather with gaps."""
        if weather is not None:
            weather.check()
        paths = tuple(check_daylight_file(path, weather is not None) for path in listed(outputs))
        check_files(paths)
        return cls(meters, weather, paths)

    @property
    def files(self) -> tuple[Path, ...]:
        """See :class:`Product`."""
        return self.outputs

    def default_budget(self, task: Task, problem: Problem) -> Budget:
        """A fixed number of paths."""
        return Budget(samples=_PATHS)

    def keep(self, job: Job, run: RunResult) -> DaylightResult:
        """See :class:`Product`."""
        return self.finish(job, run)

    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> DaylightResult:
        """See :class:`Product`."""
        method = job.method
        assert isinstance(method, SkyTracing)
        values, errors = method.coefficients(run.measurement)
        warn_of_dark(values.sum(axis=1), self.meters, "see nothing of the sky")
        about = developed(run, job.problem, job.seed).metadata
        coefficients = DaylightCoefficients(self.meters, method.patches, values, errors, about)
        tell("the hours of the year")
        result = DaylightResult(coefficients, None if self.weather is None else coefficients.annual(self.weather))
        writing = Writing()
        for path in self.outputs:

            def rescue(path: Path = path) -> str:
                place = rescued(path.name, ("", result.save))
                return "" if place is None else f"; it is in '{place}' instead"

            with writing.attempt(f"write '{path}'", rescue):
                result.save(path)
        writing.finish()
        return result


def check_daylight_file(path: PathLike, has_weather: bool) -> Path:
    """The path of a file of daylight. Raises :class:`OptionError`."""
    checked = checked_path(path, "a file of daylight")
    if checked.suffix.lower() not in _SUFFIXES:
        raise OptionError(f"daylight is written as {', '.join(_SUFFIXES)}, not as '{checked.name}'; change the name")
    if checked.suffix.lower() == ".csv" and not has_weather:
        raise OptionError(f"'{checked.name}' has the metrics of a year: give the weather, or write .mtx or .npz")
    return checked
