"""The experiments of the three theses, small: each statement, the command that tries it, its figures, and whether it
holds here. One run with few seeds: what is known with errors stands in ``docs/findings.md``."""

from __future__ import annotations

import gc
import re
import shlex
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import typer
from typer.main import get_command

from etendue.core import OptionError

from .measuring import Record, console, published

VCM, FRAMEWORK, LINES = "vertex connection and merging", "Monte Carlo framework", "global lines"
THESES = (VCM, FRAMEWORK, LINES)


@dataclass(frozen=True)
class Figure:
    """A figure of a table: what it is, its value, and the range in which the statement holds."""

    what: str
    value: float
    least: float = -float("inf")
    most: float = float("inf")

    @property
    def holds(self) -> bool:
        """Whether the value is in the range."""
        return self.least <= self.value <= self.most

    def __str__(self) -> str:
        return f"{self.what} {self.value:.3g}"


class Tables:
    """The tables of a command."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = list(records)

    def __call__(self, row: str, column: str, title: str = "") -> float:
        """The first number of a cell: in the first table whose title contains ``title``, of the first row that begins
        with ``row`` (cells joined by " | "), in the last column that begins with ``column``."""
        for record in self.records:
            columns = [k for k, name in enumerate(record.columns) if name.startswith(column)]
            if title not in record.title or not columns:
                continue
            for cells in record.rows:
                if " | ".join(cells).startswith(row) and (number := _number(cells[columns[-1]])) is not None:
                    return number
        raise LookupError(f"no number in row '{row}', column '{column}' of {[record.title for record in self.records]}")


def _number(cell: str) -> float | None:
    found = re.search(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?", cell)
    return None if found is None else float(found.group())


@dataclass(frozen=True)
class Experiment:
    """A statement of a thesis, and how it is tried. ``judge``: the figures of the tables that the commands make."""

    thesis: str
    place: str
    statement: str
    commands: tuple[str, ...]
    judge: Callable[[Tables], list[Figure]]


def _vcm(commands: str, *more: str) -> tuple[str, ...]:
    return tuple(f"vcm_thesis {command}" for command in (commands, *more))


_RACE = "--time 8 --seeds 2 --reference-time 40 --reference-radius 2 --size 160x120"

EXPERIMENTS = (
    # ------------------------------------------------------------------ vertex connection and merging
    Experiment(
        *(VCM, "table 5.1", "VCM and PT differ by noise only on a diffuse scene"),
        _vcm("correctness --passes 32 --seeds 3 --size 160x120 --radius 12"),
        lambda t: [
            Figure("slope of the difference", t("slope", "vcm, 12 mm"), -0.55, -0.45),
            Figure("mean of z² of blocks, bpt", t("bpt - path", "mean of z"), 0.7, 1.4),
            Figure("vcm", t("vcm, 12 mm - path", "mean of z"), 0.7, 1.4),
        ],
    ),
    Experiment(
        *(VCM, "tables 5.3, 5.4", "merging takes 14 to 25 % of a pass; paths of 4 to 8 surfaces"),
        _vcm("profile --rounds 3 --size 160x120"),
        lambda t: [
            Figure(
                "merging / pass, mirror balls", t("mirror-balls", "merging s") / t("mirror-balls", "pass s"), 0.1, 0.3
            ),
            Figure("surfaces of a camera path", t("mirror-balls", "camera path"), 4.0),
        ],
    ),
    Experiment(
        *(VCM, "table 5.5", "merging finds reflected caustics, and less as its radius falls"),
        _vcm("parts --passes 60 --size 160x120 --scene mirror-balls"),
        lambda t: [
            Figure(
                "share of merging, late / early",
                t("mirror-balls | 60", "merging") / t("mirror-balls | 1", "merging"),
                0,
                0.99,
            ),
            Figure("in the pixels it lights most, late", t("mirror-balls | 60", "in the 1 %"), 0.1),
        ],
    ),
    Experiment(
        *(VCM, "tables 5.6 to 5.8", "VCM ends best where caustics are reflected; PT misses them"),
        _vcm(f"convergence --scene mirror-balls,bathroom {_RACE}"),
        lambda t: [
            Figure(f"vcm / {other}, {scene}", t("vcm", "RMS at 8", scene) / t(other, "RMS at 8", scene), 0, 1)
            for scene in ("mirror-balls", "bathroom")
            for other in ("bpt", "bpm", "path")
        ],
    ),
    Experiment(
        *(VCM, "section 5.2", "on a diffuse scene PT converges faster than VCM"),
        _vcm(f"convergence --scene diffuse {_RACE}"),
        lambda t: [Figure("path / vcm", t("path", "RMS at 8") / t("vcm", "RMS at 8"), 0, 1)],
    ),
    Experiment(
        *(VCM, "table 5.9", "four times the light paths beat both the same and twice the radius"),
        _vcm(f"photons {_RACE}"),
        lambda t: [
            Figure("4 n / 2 r", t("b:", "RMS at 8") / t("c:", "RMS at 8"), 0, 1),
            Figure("4 n / n", t("b:", "RMS at 8") / t("a:", "RMS at 8"), 0, 1),
        ],
    ),
    Experiment(
        *(
            VCM,
            "tables 5.10, 5.11",
            "a large radius is smooth early and blurred late; merging at the first vertex costs 1 to 4 %",
        ),
        _vcm(f"radius {_RACE}"),
        lambda t: [
            Figure("25 mm / 5 mm, early", t("0.25", "25 mm, off", "RMS") / t("0.25", "5 mm, off", "RMS"), 0, 1),
            Figure("25 mm / 5 mm, late", t("8", "25 mm, off", "RMS") / t("8", "5 mm, off", "RMS"), 1),
            Figure("passes on / off", t("8", "12 mm, on", "passes") / t("8", "12 mm, off", "passes"), 0.96, 0.99),
        ],
    ),
    Experiment(
        *(VCM, "section 5.5", "several radii at once cost less than 0.3 % of the time"),
        _vcm("radii --rounds 5 --scene living-room --size 160x120"),
        lambda t: [Figure("two / one", t("living-room", "two / one"), 0, 1.003)],
    ),
    Experiment(
        *(VCM, "section 6.1", "pictures of several radii should be combined (proposed)"),
        _vcm("combined --passes 32 --seeds 2 --scene living-room --reference-time 40 --size 160x120"),
        lambda t: [
            Figure("mean / best alone", t("mean", "to the best"), 0, 0.95),
            Figure("extrapolated", t("extrapolated", "to the best"), 0, 0.95),
            Figure("bound of any weights", t("best (", "to the best"), 0, 0.95),
        ],
    ),
    # ------------------------------------------------------------------ Monte Carlo framework
    Experiment(
        *(FRAMEWORK, "chapter 4, VEGAS", "smoothing and damping together are best with few samples"),
        ("adaptive sine",),
        lambda t: [
            Figure(
                f"both / {other}, N = 100",
                t("both |", "N = 100", "importance") / t(other, "N = 100", "importance"),
                0,
                1,
            )
            for other in ("raw", "smoothed", "damped")
        ],
    ),
    Experiment(
        *(
            FRAMEWORK,
            "E1, figures 6.6 to 6.9",
            "adaptive methods and film Metropolis have less error than random in the specular box",
        ),
        ("adaptive convergence --scene cornell-specular --size 48x48 --samples 256 --seeds 2 --reference-time 40",),
        lambda t: [
            Figure(name, t(name, "all pixels to random"), 0, 1) for name in ("vegas", "stratified", "film Metropolis")
        ],
    ),
    Experiment(
        *(FRAMEWORK, "E1, diffuse box", "the same in the diffuse box"),
        ("adaptive convergence --scene cornell --size 48x48 --samples 256 --seeds 2 --reference-time 40",),
        lambda t: [Figure(name, t(name, "to random"), 0, 1) for name in ("vegas", "stratified", "film Metropolis")],
    ),
    Experiment(
        *(
            FRAMEWORK,
            "section 5.7",
            "Metropolis particles beat random ones where materials are not sampled, and lose elsewhere",
        ),
        ("light_chains against --scene glossy-office,cornell --millions 0.25 --reference-millions 8 --seeds 3",),
        lambda t: [
            Figure("glossy office", t("Metropolis, steps", "to standard", "glossy-office,"), 0, 1),
            Figure("diffuse box", t("Metropolis, steps", "to standard", "particles, cornell,"), 1),
        ],
    ),
    Experiment(
        *(FRAMEWORK, "E3, section 6.3", "work on demand and stealing beat a static share with one slow processor"),
        ("cluster schedules",),
        lambda t: [
            Figure(f"{kind} / static", t(kind, "speed-up 5", "view") / t("static", "speed-up 5", "view"), 1.2)
            for kind in ("demand", "stealing")
        ],
    ),
    Experiment(
        *(FRAMEWORK, "figures 5.37 to 5.42", "paths in strata visit fewer different boxes in a row"),
        ("cluster coherence --paths 30000",),
        lambda t: [Figure("first hits, / random", t("cornell-box | in strata", "first hits"), 0, 0.5)],
    ),
    Experiment(
        *(
            FRAMEWORK,
            "eq. 5.25, figure 5.46",
            "directions by occupied voxels give the same irradiance, and are more coherent than strata",
        ),
        ("cluster voxels --points 128 --rays 8 --seeds 4",),
        lambda t: [
            Figure("z", abs(t("by far voxels", "z", "curved")), 0, 4),
            Figure(
                "by voxels / in strata",
                t("by voxels", "different / random", "curved") / t("in strata", "different / random", "curved"),
                0,
                1,
            ),
        ],
    ),
    Experiment(
        *(FRAMEWORK, "E4, section 6.4", "strips pack better than rows; runs of equal bytes do not pay"),
        ("particles thesis --count 100000",),
        lambda t: [
            Figure(
                "zlib, strip / row",
                t("independent | diffuse uv", "zlib, strip") / t("independent | diffuse uv", "zlib, row"),
                0,
                1,
            ),
            Figure("runs", t("independent | diffuse uv", "rle, strip"), 1),
        ],
    ),
    Experiment(
        *(FRAMEWORK, "E5, figure 6.23", "the step size of film Metropolis matters much"),
        ("metropolis steps --paths bidirectional --size 32x24 --steps 64 --seeds 3 --reference-time 20",),
        lambda t: [
            Figure(
                "0.005 / 0.1", t("uniform, 2 % large | 0.005", "relMSE") / t("uniform, 2 % large | 0.1", "relMSE"), 1.5
            )
        ],
    ),
    Experiment(
        *(FRAMEWORK, "section 3.5", "kernels of variable width beat fixed ones in the dark"),
        ("maps errors --particles 20000 --cells 4000 --seeds 2 --scenes cornell-box",),
        lambda t: [
            Figure("variable / kernel", t("variable", "dark") / t("kernel, cross", "dark"), 0, 1),
            Figure("kernel / histogram", t("kernel, cross", "dark") / t("histogram, 4000", "dark"), 0, 1),
        ],
    ),
    # ------------------------------------------------------------------ global lines
    Experiment(
        *(LINES, "section 3.3, table 3.1", "Halton's and Sobol's points halve the error of Multipath"),
        ("radiosity sequences --scene six-cubes --lines 524288 --seeds 3",),
        lambda t: [Figure(name, t(name, "to independent at 524288"), 0, 0.6) for name in ("halton", "sobol")],
    ),
    Experiment(
        *(LINES, "section 3.4", "pairs of points on a sphere are the best generator of lines"),
        ("radiosity generators --seeds 3 --lines 65536",),
        lambda t: [Figure("sphere pairs with Halton", t("sphere-pairs | halton", "to independent"), 0, 0.75)],
    ),
    Experiment(
        *(LINES, "section 3.5", "sequences reduce direct light's error by 50 to 60 %, that of all light by 40 to 50 %"),
        ("radiosity direct --lines 65536 --seeds 6",),
        lambda t: [
            Figure("direct, %", t("halton | direct", "last"), 45, 65),
            Figure("whole, %", t("halton | whole", "last"), 30, 55),
        ],
    ),
    Experiment(
        *(LINES, "section 4.2", "the estimator F4 has the least error of four"),
        ("radiosity estimators --scene test-one --seeds 4",),
        lambda t: [Figure(f"F4 / {name}", t("F4", "FFE") / t(name, "FFE"), 0, 1) for name in ("F1", "F2", "F3")],
    ),
    Experiment(
        *(LINES, "chapter 4, E5 to E7", "form factors in a hierarchy of spheres are 1.8 to 3.6 times as efficient"),
        ("radiosity hierarchy --scene nine-cubes-factors --lines 100000,500000 --seeds 3 --bundles 64",),
        lambda t: [Figure("RelEff, 500,000 lines", t("500000", "RelEff", "whole scene"), 1.8)],
    ),
    Experiment(
        *(LINES, "tables 5.2 to 5.7", "Multipath in boxes takes half of the time, with Halton's points 0.3"),
        ("radiosity box-errors --scene room --lines 131072,524288 --seeds 2",),
        lambda t: [
            Figure("boxes", t("boxes | independent", "MSE x time to classic"), 0, 0.6),
            Figure("boxes, Halton", t("boxes | halton", "MSE x time to classic"), 0, 0.36),
        ],
    ),
    Experiment(
        *(LINES, "figures 5.5, 5.6", "casting takes 75 % less time, the first shot 40 % less"),
        ("radiosity box-tests --scene room",),
        lambda t: [
            Figure("tests of lines", t("lines of the top", "to every polygon"), 0, 0.25),
            Figure("of the shot", t("first shot, conservative", "to every polygon"), 0, 0.6),
        ],
    ),
    Experiment(
        *(LINES, "figure 5.8", "the bias of boxes is at most 2 % away from them"),
        ("radiosity box-bias --scene room",),
        lambda t: [
            Figure(zone, t(f"4x4, 4, 2 | {zone}", "rms, each"), -2, 2) for zone in ("0.25 to 0.75 m", "farther")
        ],
    ),
    Experiment(
        *(LINES, "section 5.5, E12", "the lists of 7 million lines take 170 MB"),
        ("radiosity box-memory --scene room",),
        lambda t: [Figure("MB", t("room", "MB"), 0, 180)],
    ),
    Experiment(
        *(LINES, "chapter 6", "ambient terms replace the rest of a solver that stops early, at no cost"),
        ("radiosity finishing --scene six-cubes",),
        lambda t: [Figure("error left out / fuzzy, 2 bounces", t("jacobi | 2", "left out, to"), 2)],
    ),
    Experiment(
        *(LINES, "figures 6.4 to 6.8", "classes of orientations are better than one ambient term"),
        ("radiosity ambient",),
        lambda t: [
            Figure(
                "interior: fuzzy / classic",
                t("interior | 1110 | fuzzy", "all light") / t("interior | 1110 | classic", "all light"),
                0,
                1,
            ),
        ],
    ),
)


def measure(
    theses: Annotated[
        str | None, typer.Option("--thesis", help="Only those whose name contains this.", metavar="TEXT")
    ] = None,
    only: Annotated[str | None, typer.Option(help="Only commands that contain this.", metavar="TEXT")] = None,
) -> Iterator[Record]:
    """A table of each thesis. Raises :class:`OptionError` if no experiment is left."""
    chosen = [
        one
        for one in EXPERIMENTS
        if (theses or "") in one.thesis and any((only or "") in command for command in one.commands)
    ]
    if not chosen:
        raise OptionError(f"no experiment is left; the theses are {', '.join(THESES)}")
    for thesis in THESES:
        mine = [one for one in chosen if one.thesis == thesis]
        if not mine:
            continue
        record = Record(
            f"Experiments of the thesis on {thesis}", ("", "the thesis found", "here", "holds", "command", "minutes")
        )
        for one in mine:
            begin = time.monotonic()
            figures, verdict = _tried(one)
            record.add(
                *(one.place, one.statement, figures, verdict),
                *("; ".join(f"python -m benchmarks.{command}" for command in one.commands),),
                f"{(time.monotonic() - begin) / 60:.1f}",
            )
            gc.collect()
        record.notes.append(
            "holds: all figures are in the range of the statement, in part: some of them; one small run. Results with "
            "errors, conditions and causes stand in docs/findings.md"
        )
        yield record


def _tried(one: Experiment) -> tuple[str, str]:
    """The figures of an experiment, and whether its statement holds."""
    from .registry import PROGRAMS, command_line

    records: list[Record] = []
    for command in one.commands:
        package, *words = shlex.split(command)
        console.print(f"python -m benchmarks.{command}", style="bold")
        with published() as tables:
            get_command(command_line(PROGRAMS[f"benchmarks.{package}"])).main(words, standalone_mode=False)
        records += tables
    try:
        figures = one.judge(Tables(records))
    except LookupError as error:
        return str(error), "not known"
    good = [figure.holds for figure in figures]
    return "; ".join(map(str, figures)), "yes" if all(good) else "in part" if any(good) else "no"
