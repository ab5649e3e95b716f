"""What the commands take: option types with their help, and the reading of values that people type."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from etendue.core import OptionError

_TIME = re.compile(r"^(?:(?P<h>[\d.]+)h)?(?:(?P<m>[\d.]+)m(?:in)?)?(?:(?P<s>-?[\d.]+(?:e[+-]?\d+)?)s?)?$")
_MEMORY = re.compile(r"^(?P<number>[\d.]+)\s*(?P<unit>[kmgt]?)i?b?$", re.IGNORECASE)

Scene = Annotated[
    str, typer.Argument(help="Mitsuba XML file, or a bundled scene (see `etendue scenes`).", metavar="SCENE")
]
Time = Annotated[
    str | None,
    typer.Option("--time", "-t", help="Stop after this time: seconds, or 90s, 5m, 1h30m.", metavar="TIME"),
]
Spp = Annotated[int | None, typer.Option("--spp", help="Stop at this many camera paths per pixel.", metavar="N")]
Error = Annotated[
    float | None,
    typer.Option("--error", help="Stop at this relative noise (mean of variance / (mean² + 0.01)).", metavar="X"),
]
Size = Annotated[str | None, typer.Option("--size", help="Size of the picture.", metavar="WxH")]
Sensor = Annotated[int, typer.Option("--sensor", help="Which of the scene's sensors, counted from 0.", metavar="I")]
Seed = Annotated[int, typer.Option("--seed", help="The same seed gives the same picture.", metavar="N")]
Variant = Annotated[
    str | None,
    typer.Option("--variant", help="Mitsuba variant; by default CUDA where usable, else LLVM.", metavar="NAME"),
]
Define = Annotated[
    list[str] | None,
    typer.Option(
        "-D", "--set", help="A setting of the method, repeatable; see `etendue methods NAME`.", metavar="NAME=VALUE"
    ),
]
Param = Annotated[
    list[str] | None,
    typer.Option("-P", "--param", help="Value of a $variable of the scene's XML, repeatable.", metavar="NAME=VALUE"),
]
MaxDepth = Annotated[
    int | None,
    typer.Option("--max-depth", help="Longest path in edges, -1 for unlimited; by default the scene's.", metavar="N"),
]
Threads = Annotated[int | None, typer.Option("--threads", help="CPU threads to use.", metavar="N")]
SaveEvery = Annotated[
    str, typer.Option("--save-every", help="Time between intermediate saves; 0 for none.", metavar="TIME")
]
Memory = Annotated[
    str | None, typer.Option("--memory", help="Bound on what a method stores, as 512M or 2G.", metavar="BYTES")
]
Aovs = Annotated[bool, typer.Option("--aovs", help="Add first-hit layers: albedo, normal, depth.")]
Debug = Annotated[bool, typer.Option("--debug", help="Log what happens, and show tracebacks of errors.")]


def parse_time(text: str, option: str = "--time") -> float:
    """Seconds from ``90``, ``1.5m``, ``1h30m``. Raises :class:`OptionError`."""
    match = _TIME.match(text.strip().lower())
    try:
        if match is None or not text.strip():
            raise ValueError
        hours, minutes, seconds = (float(match[unit] or 0) for unit in "hms")
    except ValueError:
        raise OptionError(f"{option} wants a time such as 60, 90s, 5m or 1h30m, not '{text}'") from None
    return 3600 * hours + 60 * minutes + seconds


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Width and height from ``640x480``. Raises :class:`OptionError`."""
    if text is None:
        return None
    match = re.match(r"^\s*(\d+)\s*[x×,]\s*(\d+)\s*$", text.lower())
    if match is None or "0" in (match[1].lstrip("0") or "0", match[2].lstrip("0") or "0"):
        raise OptionError(f"--size wants WIDTHxHEIGHT in pixels, as 640x480, not '{text}'")
    return int(match[1]), int(match[2])


def parse_memory(text: str | None) -> int | None:
    """Bytes from ``2G`` (2³⁰ each), ``512M``, ``100000000``. Raises :class:`OptionError`."""
    if text is None:
        return None
    match = _MEMORY.match(text.strip())
    try:
        if match is None:
            raise ValueError
        size = int(float(match["number"]) * 1024 ** " kmgt".index(match["unit"].lower() or " "))
        if size < 1:
            raise ValueError
    except ValueError:
        raise OptionError(f"--memory wants a size above 0 such as 512M or 2G, not '{text}'") from None
    return size


def parse_pairs(pairs: list[str] | None, option: str) -> dict[str, str]:
    """Names and values from ``name=value``. Raises :class:`OptionError` on another form or a name that comes twice."""
    values: dict[str, str] = {}
    for pair in pairs or ():
        name, equals, value = pair.partition("=")
        name = name.strip()
        if not equals or not name:
            raise OptionError(f"{option} wants name=value, not '{pair}'")
        if name in values:
            raise OptionError(f"{option} names '{name}' twice; give it once")
        values[name] = value.strip()
    return values
