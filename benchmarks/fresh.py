"""The first pass, cold and warm, and peak memory: each in a fresh process."""

from __future__ import annotations

import tempfile
from typing import Annotated, Any

import mitsuba as mi
import typer

from etendue.cli.options import parse_size

from .measuring import COST_SCENE, COST_SETTINGS, Record, child, verdict
from .options import Methods, Size, words

#: Seconds of the first pass: nothing compiled before, and kernels found on disk.
BAR_COLD, BAR_WARM = 5.0, 1.0
#: Peak memory of ``vcm`` in bytes, by size of the picture.
MEMORY_BARS = {(512, 512): 0.5e9, (1920, 1080): 2.0e9}


def first_pass(
    names: Methods = "path,bpt,vcm", size: Size = "512x512", passes: int = 4, source: str = COST_SCENE
) -> Record:
    """Time to the first picture; an empty folder stands in for Dr.Jit's kernel cache, then the same one again."""
    record = Record(
        f"First pass, {source}, {size[0]}x{size[1]}",
        ("", "import s", "load s", "prepare s", "first pass s", "later passes s", "compiled later", "prepare + first"),
    )
    for name in names:
        with tempfile.TemporaryDirectory(prefix="kernels-") as cache:
            for state, bar in (("cold", BAR_COLD), ("warm", BAR_WARM)):
                options = {
                    "scene": source,
                    "size": size,
                    "method": name,
                    "settings": COST_SETTINGS[name],
                    "variant": mi.variant(),
                    "passes": passes,
                }
                outcome = child("first-pass", options, {"DRJIT_CACHE_DIR": cache})
                if not outcome:
                    record.add(f"{name}, {state}", *["failed"] * 7)
                    continue
                later = sorted(outcome["passes"][1:])
                total = outcome["prepare"] + outcome["passes"][0]
                record.add(
                    f"{name}, {state}",
                    f"{outcome['import']:.2f}",
                    f"{outcome['load']:.2f}",
                    f"{outcome['prepare']:.2f}",
                    f"{outcome['passes'][0]:.2f}",
                    f"{later[len(later) // 2]:.2f}",
                    f"{outcome['compiled']} of {outcome['launched']}",
                    f"{total:.2f}, {verdict(total, bar)}",
                )
    record.notes += [
        "cold: DRJIT_CACHE_DIR is an empty folder; warm: a second process with the same folder",
        "compiled later: kernels of two later passes that were not in memory yet, of those launched; should be 0",
        "prepare holds the pilot passes with their compilation",
    ]
    return record


def _sizes(text: str) -> list[tuple[int, int]]:
    return [parse_size(word) for word in words(text)]


def memory(
    names: Methods = "vcm",
    sizes: Annotated[
        Any, typer.Option(parser=_sizes, help="Sizes, separated by commas.", metavar="WxH,...")
    ] = "512x512,1920x1080",
    bound: Annotated[float | None, typer.Option(help="What --memory is given, in MB.", metavar="MB")] = None,
    passes: int = 3,
    source: str = COST_SCENE,
) -> Record:
    """Peak resident memory of a process that loads the scene and runs a few passes."""
    record = Record(f"Peak memory, {source}", ("", "size", "scene loaded MB", "first pass MB", "end MB", "bar"))
    for name in names:
        for size in sizes:
            options = {
                "scene": source,
                "size": size,
                "method": name,
                "settings": COST_SETTINGS[name],
                "variant": mi.variant(),
                "passes": passes,
                "memory": int(bound * 1e6) if bound else None,
            }
            outcome = child("memory", options)
            if not outcome:
                record.add(name, f"{size[0]}x{size[1]}", *["failed"] * 4)
                continue
            peak = outcome["peaks"][-1]
            bar = MEMORY_BARS.get(size) if name == "vcm" and bound is None else None
            record.add(
                name,
                f"{size[0]}x{size[1]}",
                f"{outcome['loaded_bytes'] / 1e6:.0f}",
                f"{outcome['peaks'][0] / 1e6:.0f}",
                f"{peak / 1e6:.0f}",
                f"≤ {bar / 1e6:.0f} MB: {'reached' if peak <= bar else 'missed'}" if bar else "",
            )
    limit = f"--memory {bound:.0f} MB" if bound else "no bound on the light store"
    record.notes.append(
        f"largest resident size (getrusage), everything included; {passes} passes; {limit}; 1 MB = 10⁶ bytes"
    )
    return record
