"""The first pass, cold and warm, from the command to the picture, and peak memory: each in a fresh process."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import mitsuba as mi
import typer

from etendue.cli.options import parse_size
from etendue.scene import bundled

from .measuring import COST_SCENE, COST_SETTINGS, PUBLIC_SCENES, Record, child, console, verdict
from .options import Methods, Names, Rounds, Size, words

#: Seconds of the first pass: nothing compiled before, and kernels found on disk.
BAR_COLD, BAR_WARM = 5.0, 1.0
#: Peak memory of ``vcm`` in bytes, by size of the picture.
MEMORY_BARS = {(512, 512): 0.5e9, (1920, 1080): 2.0e9, (3840, 2160): 3.0e9}


#: Time from the command to the saved picture relative to Mitsuba's ``path``: no kernel cached, and all.
START_BARS = {"path": (1.4, 1.6), "bpt": (2.2, 1.6), "vcm": (2.2, 1.6), "auto": (2.2, 1.6)}
_SPP = 4
#: A picture by Mitsuba: scene, size, samples, file.
_BY_MITSUBA = """
import sys
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
scene = mi.load_file(sys.argv[1])
parameters = mi.traverse(scene)
size = next(key for key in parameters.keys() if key.endswith("film.size"))
parameters[size] = [int(n) for n in sys.argv[2].split("x")]
parameters.update()
integrator = mi.load_dict({"type": "path"})
mi.util.write_bitmap(sys.argv[4], mi.render(scene, integrator=integrator, spp=int(sys.argv[3])))
"""


def start(
    names: Methods = "path,bpt,vcm,auto",
    scenes: Names = "cornell-glass,grey-white-room,street",
    size: Size = "128x128",
    rounds: Rounds = 5,
) -> Record:
    """Seconds from the command to the saved picture, beside those of Mitsuba's ``path`` in a fresh process."""
    shape = f"{size[0]}x{size[1]}"
    record = Record(f"From the command to the picture, {shape}, {_SPP} spp", ("scene", "", "cold s", "", "warm s", ""))
    with tempfile.TemporaryDirectory(prefix="start-") as folder:
        for name in scenes:
            file = file_of(name, folder)
            picture = Path(folder) / "picture.exr"
            commands = {"Mitsuba's path": [sys.executable, "-c", _BY_MITSUBA, file, shape, str(_SPP), str(picture)]}
            for method in names:
                words_of = ["render", file, "-m", method, "--spp", str(_SPP), "--size", shape, "-o", str(picture)]
                commands[method] = [sys.executable, "-m", "etendue", *words_of]
            seconds: dict[str, tuple[list[float], list[float]]] = {label: ([], []) for label in commands}
            for number in range(rounds):
                console.print(f"{name}: round {number + 1} of {rounds}", highlight=False)
                for label, command in commands.items():
                    with tempfile.TemporaryDirectory(prefix="kernels-") as cache:
                        for taken in seconds[label]:
                            picture.unlink(missing_ok=True)
                            begin = time.perf_counter()
                            subprocess.run(
                                command, check=True, capture_output=True, env=os.environ | {"DRJIT_CACHE_DIR": cache}
                            )
                            taken.append(time.perf_counter() - begin)
                            assert picture.exists()
            own = [statistics.median(taken) for taken in seconds["Mitsuba's path"]]
            for label, taken in seconds.items():
                cells = [name, label]
                for state, times in enumerate(taken):
                    median = statistics.median(times)
                    ratio = median / own[state]
                    told = verdict(ratio, START_BARS[label][state]) if label in START_BARS else ""
                    cells += [f"{median:.2f}", f"{ratio:.2f}, {told}".rstrip(", ")]
                record.add(*cells)
    record.notes += [
        f"median of {rounds} processes each, in turn; cold: DRJIT_CACHE_DIR is an empty folder; warm: the same command "
        "again",
        "after the seconds: relative to Mitsuba's path, by a script that loads the same file, renders and saves",
    ]
    return record


def file_of(name: str, folder: str) -> str:
    """The file of a public scene, or of a bundled one, written into ``folder``, whose integrator Mitsuba knows."""
    if name not in bundled():
        return str(PUBLIC_SCENES / name / "scene.xml")
    file = Path(folder) / f"{name}.xml"
    command = [sys.executable, "-m", "etendue", "scenes", name, "-o", str(file)]
    subprocess.run(command, check=True, capture_output=True)
    method = f'type="{bundled()[name].build().get("integrator", {}).get("type", "path")}"'
    file.write_text(file.read_text("utf-8").replace(method, 'type="path"'), "utf-8")
    return str(file)


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
    ] = "1920x1080,3840x2160",
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
