"""The command ``cie171``: every case, compared meter by meter."""

from __future__ import annotations

import json
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue import measure as read
from etendue.lighting import Meters

from ..measuring import Record, console
from ..options import Out, named
from .cases import NUMBERS, Case, cases as cases_of
from .patches import solved
from .rooms import Array

#: A reading is right within this share of the reference, or this many standard errors where that is more; the standard
#: error itself is this share of the reference at most.
BAR, ERRORS, NOISE = 0.005, 3.0, 0.01
#: Where the reference is 0: share of the largest reference of the case.
_DARK = 1e-4
#: A reading that is noisier, or not within the share, is taken again, so often at most, with so many times the paths
#: and other random numbers; the last one counts. Among some thousand readings some are beyond three standard errors by
#: chance, and noise would hide a deviation.
_AGAIN, _MORE = 2, 8
_QUICK = (1, 5, 12)
_ALL = ",".join(NUMBERS)

Cases = Annotated[
    Any, typer.Option("--cases", parser=named(NUMBERS, "case"), help="Numbers, separated by commas.", metavar="N,...")
]
Quick = Annotated[bool, typer.Option("--quick", help=f"Skies {', '.join(map(str, _QUICK))} instead of all 15.")]


@dataclass(frozen=True)
class Reading:
    """What a meter or a patch reads, beside its reference. ``looks``: how often it was measured."""

    number: str
    row: str
    what: str
    method: str
    name: str
    value: float
    error: float
    expected: float
    passed: bool
    looks: int = 1

    @property
    def is_settled(self) -> bool:
        """Whether it is right without the allowance for noise."""
        return self.passed and not abs(self.deviation) > BAR

    @property
    def deviation(self) -> float:
        """Relative to the reference; NaN where that is 0."""
        return self.value / self.expected - 1.0 if self.expected else float("nan")


def measure(cases: Cases = _ALL, quick: Quick = False, out: Out = Path("cie171-output")) -> Record:
    """All cases by every method that is asked to; the readings are written to ``readings.json``."""
    readings: list[Reading] = []
    with tempfile.TemporaryDirectory() as folder:
        for number in cases:
            for found in readings_of(number, _QUICK if quick else range(1, 16), Path(folder)):
                readings += found
                first = found[0]
                for reading in found:
                    if not reading.passed:
                        console.print(f"beyond: {reading}", style="dim", markup=False)
                console.print(f"{number} {first.row}, {first.what}, {first.method}", style="dim", markup=False)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps([asdict(reading) for reading in readings], indent=1)
    (out / "readings.json").write_text(text + "\n", "utf-8")
    return table(readings, "skies " + ", ".join(map(str, _QUICK)) if quick else "all skies")


def readings_of(number: str, kinds: Sequence[int], folder: Path) -> Iterator[list[Reading]]:
    """The readings of a case by each method: by pictures' methods at points, by radiosity as means of patches."""
    for case in cases_of([number], kinds, folder):
        for method in case.methods:
            yield take(case, method)
    for found in solved(number, folder):
        names = [f"patch {k}" for k in range(len(found.values))] if len(found.values) > 1 else ["mean"]
        about = (found.number, found.row, found.what, "radiosity")
        yield _judged(about, names, found.values, found.errors, found.expected)


def take(case: Case, method: str) -> list[Reading]:
    """The readings of a case by a method, taken again where they are noisy or beyond the bar."""
    about = (case.number, case.row, case.what, method)
    values, errors = _read(case, method, np.arange(len(case.points)), 1, 0)
    readings = _judged(about, case.names, values, errors, case.expected)
    for look in range(1, _AGAIN + 1):
        wrong = np.flatnonzero([not reading.is_settled for reading in readings])
        if not len(wrong):
            break
        chosen = wrong if case.weights is None else np.arange(len(case.points))
        values[wrong], errors[wrong] = _read(case, method, chosen, _MORE**look, look)
        judged = _judged(about, case.names, values, errors, case.expected)
        readings = [
            replace(new, looks=look + 1) if k in wrong else old
            for k, (old, new) in enumerate(zip(readings, judged, strict=True))
        ]
    return readings


def _read(case: Case, method: str, chosen: Array, copies: int, look: int) -> tuple[Array, Array]:
    """Values and standard errors of some meters, each the mean of copies in its place, or of their weighted sum."""
    points, directions = (np.repeat(v[chosen], copies, axis=0) for v in (case.points, case.directions))
    meters = Meters(points, directions, case.quantity)
    # Each case has random numbers of its own: deviations under different skies are independent.
    seed = zlib.crc32(f"{case.number} {case.row} {case.what} {look}".encode()) % (1 << 31)
    found = read(case.scene, meters, method=method, spp=case.spp, max_depth=case.max_depth, seed=seed)
    values = found.photometric.reshape(-1, copies).mean(axis=1)
    errors = np.linalg.norm(found.photometric_error.reshape(-1, copies), axis=1) / copies
    if case.weights is None:
        return values, errors
    return np.array([case.weights @ values]), np.array([np.linalg.norm(case.weights * errors)])


def _judged(
    about: tuple[str, str, str, str], names: Sequence[str], values: Array, errors: Array, expected: Array
) -> list[Reading]:
    least = np.where(expected > 0.0, BAR * expected, _DARK * expected.max())
    quiet = (errors <= NOISE * expected) | (expected == 0.0)
    passed = quiet & (np.abs(values - expected) <= np.maximum(least, ERRORS * errors))
    rows = zip(names, values.tolist(), errors.tolist(), expected.tolist(), passed.tolist(), strict=True)
    return [Reading(*about, *row) for row in rows]


def table(readings: Iterable[Reading], skies: str) -> Record:
    """A row for each case and method."""
    record = Record(
        f"CIE 171:2006, {skies}",
        ("case", "", "by", "readings", "largest deviation", "mean", "largest standard error", "again", "passed"),
    )
    groups: dict[tuple[str, str, str], list[Reading]] = {}
    for reading in readings:
        groups.setdefault((reading.number, reading.row, reading.method), []).append(reading)
    for (number, row, method), found in groups.items():
        lit = [r for r in found if r.expected]
        deviations = np.abs([r.deviation for r in lit])
        record.add(
            *(number, row, method, f"{len(found)}", f"{deviations.max():.2%}", f"{deviations.mean():.3%}"),
            f"{max(r.error / r.expected for r in lit):.2%}",
            f"{sum(r.looks > 1 for r in found)}",
            f"{sum(r.passed for r in found)} of {len(found)}",
        )
    record.notes += [
        f"passed: within {BAR:.1%} of the reference, or {ERRORS:g} standard errors where that is more, which are at "
        f"most {NOISE:.0%}; where the reference is 0, within {_DARK:g} of the largest of the case",
        f"again: readings that were noisier, or not within {BAR:.1%}, and were taken again, with {_MORE} times the "
        f"paths, up to {_AGAIN} times, and other random numbers; the last one counts",
        "references: closed forms, and integrals over the visible part of the opening",
    ]
    return record
