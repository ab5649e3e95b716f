"""Options of the commands: parsing of values, and option types with their help."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from etendue.core import OptionError

if TYPE_CHECKING:
    from etendue.distributed import Cluster as OpenedCluster

_TIME = re.compile(r"^(?:(?P<h>[\d.]+)h)?(?:(?P<m>[\d.]+)m(?:in)?)?(?:(?P<s>-?[\d.]+(?:e[+-]?\d+)?)s?)?$")
_MEMORY = re.compile(r"^(?P<number>[\d.]+)\s*(?P<unit>[kmgt]?)i?b?$", re.IGNORECASE)


class Size(NamedTuple):
    """Size of a picture in pixels. A separate class, since typer reads a plain tuple from two words."""

    width: int
    height: int


class Range(NamedTuple):
    """The ends of a scale; ``None`` is automatic."""

    low: float | None = None
    high: float | None = None


class Lengths(NamedTuple):
    """Lengths along x and y."""

    x: float
    y: float


@dataclass(frozen=True)
class Device:
    """Where passes are made: the Mitsuba variant and threads, and a cluster or local worker processes."""

    variant: str | None
    threads: int | None
    cluster: str | None = None
    workers: int | None = None

    def choose(self) -> None:
        """Set the variant and the number of threads of this process."""
        from .running import choose_device

        choose_device(self.variant, self.threads)

    def opened(self) -> AbstractContextManager[OpenedCluster | None]:
        """The cluster, if one is asked for; local workers end with the block."""
        if self.is_alone:
            return nullcontext()
        from etendue.distributed import opened_cluster

        return opened_cluster(self.cluster, self.workers, self.threads)

    @property
    def is_alone(self) -> bool:
        """Whether no workers are asked for."""
        return (self.cluster, self.workers) == (None, None)


def parse_time(text: str | float, option: str = "--time") -> float:
    """Seconds from ``90``, ``1.5m``, ``1h30m``. Raises :class:`OptionError`."""
    text = str(text).strip()  # typer passes defaults through here, too
    match = _TIME.match(text.lower())
    try:
        if match is None or not text:
            raise ValueError
        hours, minutes, seconds = (float(match[unit] or 0) for unit in "hms")
    except ValueError:
        raise OptionError(f"{option} needs a time such as 60, 90s, 5m or 1h30m, not '{text}'") from None
    return 3600 * hours + 60 * minutes + seconds


def parse_period(text: str | float) -> float | None:
    """As :func:`parse_time`; ``None`` from ``0``."""
    seconds = parse_time(text, "--save-every")
    if seconds < 0:
        raise OptionError(f"--save-every needs a time of at least 0, not '{text}'")
    return seconds or None


def parse_size(text: str) -> Size:
    """Width and height from ``640x480``. Raises :class:`OptionError`."""
    match = re.match(r"^\s*(\d+)\s*[x×,]\s*(\d+)\s*$", text.lower())
    if match is None or "0" in (match[1].lstrip("0") or "0", match[2].lstrip("0") or "0"):
        raise OptionError(f"--size needs WIDTHxHEIGHT in pixels, such as 640x480, not '{text}'")
    return Size(int(match[1]), int(match[2]))


def only_one(outputs: list[Path]) -> Path:
    """The file or folder of a command that writes one. Raises :class:`OptionError` for several."""
    if len(outputs) > 1:
        raise OptionError(f"-o names one file or folder here, not {len(outputs)}: {', '.join(map(str, outputs))}")
    return outputs[0]


def limits(time: float | None = None, error: float | None = None, **counts: float | None) -> dict[str, Any]:
    """The limits that are given, by their names in :func:`etendue.products.budget_of`. Raises :class:`OptionError` for
    values that are not above 0."""
    named = {"--time": time, "--error": error} | {f"--{name}": value for name, value in counts.items()}
    for option, value in named.items():
        if value is not None and not 0 < value < math.inf:
            raise OptionError(f"{option} must be above 0, not {value:g}")
    given = {"seconds": time, "error": error, **counts}
    return {name: value for name, value in given.items() if value is not None}


def checkpoint_beside(output: Path, checkpoint: Path | None, no_checkpoint: bool) -> Path | None:
    """The checkpoint beside an output, ``None`` if another one is named, or none is wanted. Raises
    :class:`OptionError` if both are asked for."""
    if no_checkpoint and checkpoint is not None:
        raise OptionError("--checkpoint and --no-checkpoint exclude each other; give one of them")
    return None if no_checkpoint or checkpoint is not None else output.parent / f"{output.stem}.checkpoint"


def parse_exposure(text: str | float) -> float | str:
    """Stops, or ``auto``. Raises :class:`OptionError`."""
    text = str(text).strip()
    try:
        return text if text == "auto" else float(text)
    except ValueError:
        raise OptionError(f"--exposure needs a number of stops or 'auto', not '{text}'") from None


def parse_range(text: str) -> Range:
    """Both ends from ``10:500``, one of which may be missing. Raises :class:`OptionError`."""
    low, colon, high = text.partition(":")
    try:
        if not colon:
            raise ValueError
        return Range(*(float(end) if end.strip() else None for end in (low, high)))
    except ValueError:
        raise OptionError(f"--range needs LOW:HIGH, such as 0:500, not '{text}'") from None


def parse_lengths(text: str) -> Lengths:
    """Two lengths from ``96,64``. Raises :class:`OptionError`."""
    words = text.split(",")
    try:
        if len(words) != 2:
            raise ValueError
        return Lengths(*map(float, words))
    except ValueError:
        raise OptionError(f"--periodic needs LX,LY, such as 96,64, or 96,0 for x only, not '{text}'") from None


def parse_memory(text: str) -> int:
    """Bytes from ``2G`` (2³⁰ each), ``512M``, ``100000000``. Raises :class:`OptionError`."""
    match = _MEMORY.match(text.strip())
    try:
        if match is None:
            raise ValueError
        size = int(float(match["number"]) * 1024 ** " kmgt".index(match["unit"].lower() or " "))
        if size < 1:
            raise ValueError
    except ValueError:
        raise OptionError(f"--memory needs a size above 0 such as 512M or 2G, not '{text}'") from None
    return size


def parse_pairs(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Names and values from ``name=value``. Raises :class:`OptionError` for another form and for a repeated name."""
    values: dict[str, str] = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        name = name.strip()
        if not equals or not name:
            raise OptionError(f"{option} needs name=value, not '{pair}'")
        if name in values:
            raise OptionError(f"{option} gives '{name}' twice; give it once")
        values[name] = value.strip()
    return values


def settings_by_method(names: Sequence[str], settings: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Settings for each of several methods: ``name`` applies to all methods that have it, ``method.name`` to one method
    and takes precedence.

    Raises :class:`OptionError` for a method that is not among ``names``. A setting that no method has is passed to the
    first method, whose error suggests the right name.
    """
    from etendue import methods

    known = {name: methods.get(name).Settings.names() for name in names}
    result: dict[str, dict[str, Any]] = {name: {} for name in names}
    for key in sorted(settings, key=lambda key: "." in key):
        owner, dot, setting = key.rpartition(".")
        if dot and owner not in result:
            raise OptionError(f"-D {key}: '{owner}' is not among the compared methods: {', '.join(names)}")
        takers = [owner] if dot else [name for name in names if key in known[name]]
        for name in takers or names[:1]:
            result[name][setting] = settings[key]
    return result


Scene = Annotated[
    str, typer.Argument(help="Mitsuba XML file, or a bundled scene (see `etendue scenes`).", metavar="SCENE")
]
Time = Annotated[
    float | None,
    typer.Option(
        "--time",
        "-t",
        help="Stop after this time: seconds, or 90s, 5m, 1h30m; for each method if several are rendered.",
        parser=parse_time,
        metavar="TIME",
    ),
]
Spp = Annotated[int | None, typer.Option("--spp", help="Stop at this many camera paths per pixel.", metavar="N")]
Error = Annotated[
    float | None,
    typer.Option(
        "--error",
        help="Stop at this relative standard error: of pixels, of irradiance, of a row of factors.",
        metavar="X",
    ),
]
PictureSize = Annotated[
    Size | None, typer.Option("--size", help="Size of the picture.", parser=parse_size, metavar="WxH")
]
Sensor = Annotated[int, typer.Option("--sensor", help="Index of the scene's sensor, from 0.", metavar="I")]
Method = Annotated[
    str | None,
    typer.Option(
        "--method",
        "-m",
        help="See `etendue methods`; by default auto, or the scene's integrator if it is one of them but path.",
        metavar="NAME",
    ),
]
Seed = Annotated[int, typer.Option("--seed", help="The same seed gives the same picture.", metavar="N")]
North = Annotated[
    float,
    typer.Option(
        "--north",
        help="Direction of north in degrees from the axis +y (up: z) or -z (up: y), clockwise seen from above.",
        metavar="DEGREES",
    ),
]
Variant = Annotated[
    str | None,
    typer.Option("--variant", help="Mitsuba variant; by default CUDA where usable, else LLVM.", metavar="NAME"),
]
Define = Annotated[
    list[str] | None,
    typer.Option(
        "-D",
        "--set",
        help="A setting, repeatable (see `etendue methods NAME`); in `compare` for every method that has it, or "
        "METHOD.NAME=VALUE.",
        metavar="NAME=VALUE",
    ),
]
Param = Annotated[
    list[str] | None,
    typer.Option("-P", "--param", help="Value of a $variable of the scene's XML, repeatable.", metavar="NAME=VALUE"),
]
LowPriority = Annotated[bool, typer.Option("--low-priority", help="Let other processes of the machine come first.")]
Threads = Annotated[int | None, typer.Option("--threads", help="CPU threads to use.", metavar="N")]
Tev = Annotated[
    str | None,
    typer.Option("--tev", help="Show the layers in the image viewer tev, as localhost:14158.", metavar="HOST:PORT"),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster", help="Make the passes on a Dask cluster: its address, as tcp://host:8786.", metavar="ADDRESS"
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers", help="Make the passes in so many processes, which share the threads.", min=1, metavar="N"
    ),
]
NoCheckpoint = Annotated[bool, typer.Option("--no-checkpoint", help="Write no checkpoint.")]
SaveEvery = Annotated[
    float | None,
    typer.Option(
        "--save-every", help="Time between intermediate saves; 0 for none.", parser=parse_period, metavar="TIME"
    ),
]
Memory = Annotated[
    int | None,
    typer.Option(
        "--memory",
        help="Limit on the memory that a method stores data in, such as 512M or 2G.",
        parser=parse_memory,
        metavar="BYTES",
    ),
]
Output = Annotated[
    list[Path] | None,
    typer.Option("-o", "--output", help="Picture: .exr (all layers, metadata) or .png; repeatable.", metavar="FILE"),
]
Tone = Annotated[
    str,
    typer.Option(
        "--tone",
        help="Tone curve of a .png: srgb, gamma, logarithmic, exponential, s-curve, reinhard, filmic, aces or agx.",
        metavar="NAME",
    ),
]
Exposure = Annotated[
    Any,
    typer.Option(
        "--exposure", help="Exposure of a .png in stops (1 doubles), or auto.", parser=parse_exposure, metavar="EV"
    ),
]
ColourRange = Annotated[
    Range | None,
    typer.Option(
        "--range",
        help="Ends of the false colours, or one of them; logarithmic from a ratio of 100.",
        parser=parse_range,
        metavar="LOW:HIGH",
    ),
]
Folder = Annotated[
    list[Path] | None,
    typer.Option("-o", "--output", help="Folder for pictures and page; created if needed.", metavar="DIR"),
]
Debug = Annotated[bool, typer.Option("--debug", help="Log what happens, and show tracebacks of errors.")]
