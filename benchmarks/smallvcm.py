"""``auto`` beside SmallVCM, the program that vertex connection and merging was published with, on its own scenes.

Build it from https://github.com/SmallVCM/SmallVCM by
``g++ -O3 -march=native -std=c++11 -fopenmp -o smallvcm src/smallvcm.cxx``.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue import scene
from etendue.core import OptionError
from etendue.scene.builtin.pieces import camera, diffuse, glass, mirror, rectangle, rgb

from .choice import error, error_note
from .measuring import Record, console, verdict
from .options import Seconds, Seeds
from .tuning import Passes

#: Error of ``auto`` over that of the best algorithm of SmallVCM, at most.
BAR = 0.2
#: The algorithms of SmallVCM, by the name of its option; the others are a preview, and light tracing alone.
ALGORITHMS = ("pt", "bpt", "bpm", "ppm", "vcm")
#: Its scenes, in the order of their numbers: the light, and the ball or balls.
SCENES = (("sun", "balls"), ("ceiling", "mirror"), ("point", "balls"), ("sky", "balls"))
#: Its pictures and longest paths.
_SIZE, _DEPTH = (512, 512), 10
#: Each half of the reference takes this many times the time of a picture.
_HALF = 3.0
#: The camera.
_EYE, _FORWARD = (-0.0439815, -4.12529, 0.222539), (0.00688625, 0.998505, -0.0542161)
_UP = (3.73896e-4, 0.0542148, 0.998529)
#: Sides of the room: x, y, z.
_X, _Y, _Z = (-1.27029, 1.28975), (-1.25549, 1.30455), (-1.28002, 1.28002)

Program = Annotated[
    str | None, typer.Option("--smallvcm", help="The program, built as benchmarks/smallvcm.py says.", metavar="PROGRAM")
]


def measure(program: Program = None, seconds: Seconds = 30.0, seeds: Seeds = 1) -> Record:
    """A row a scene: errors after the same CPU time of all threads together."""
    found = shutil.which(program or "smallvcm") or (program and os.path.abspath(program))
    if not found or not Path(found).is_file():
        raise OptionError(
            "SmallVCM is missing: name its program by --smallvcm; benchmarks/smallvcm.py says how to build it"
        )
    record = Record(
        f"auto and SmallVCM, {seconds:g} s of CPU, {_SIZE[0]}x{_SIZE[1]}",
        ("light", *ALGORITHMS, "auto", "chosen", "brightness", "auto / best", "bar"),
    )
    for number, (light, content) in enumerate(SCENES):
        problem = scene.load(room(light, content), size=_SIZE)
        halves = [Passes(problem, "vcm", 1000 + k, radius=0.002).until(_HALF * seconds).mean() for k in range(2)]
        level = float(np.mean(halves))
        theirs: dict[str, list[float]] = {}
        brightness = 0.0
        for name in ALGORITHMS:
            image, used = _theirs(found, number, name, seconds)
            theirs[name] = error(image, halves) * used / seconds
            if name == "vcm":
                brightness = float(image.mean()) / level - 1.0
        ours, chosen = [], []
        for seed in range(seeds):
            passes = Passes.warm(problem, "auto", seed).until(seconds)
            ours.append(error(passes.mean(), halves) * passes.seconds / seconds)
            chosen.append(str(passes.result().metadata["chosen"]))
        ratio = float(np.median(ours)) / min(theirs.values())
        cells = [f"{value:.3g}" for value in (*theirs.values(), np.median(ours))]
        console.print(f"{light}: {', '.join(cells)}", style="dim")
        record.add(
            light, *cells, ", ".join(dict.fromkeys(chosen)), f"{brightness:+.2%}", f"{ratio:.2f}", verdict(ratio, BAR)
        )
    record.notes += [
        f"{error_note(seeds)}; of SmallVCM's algorithms one run each; times the CPU seconds that were used over those "
        "that were given",
        f"reference: vcm with a first radius of 0.002, {2 * _HALF * seconds:g} s of CPU in two halves; brightness: of "
        "SmallVCM's vcm, to it",
        "auto: kernels are compiled before, preparation counts",
    ]
    return record


def room(light: str, content: str) -> dict[str, Any]:
    """A scene of SmallVCM: a box open to the camera, with a glossy floor."""
    (x0, x1), (y0, y1), (z0, z1) = _X, _Y, _Z
    wide, deep, high = x1 - x0, y1 - y0, z1 - z0
    white, blue = diffuse(0.803922, 0.803922, 0.803922), diffuse(0.156863, 0.172549, 0.803922)
    floor = {
        "type": "phong",
        "diffuse_reflectance": rgb(0.1, 0.1, 0.1),
        "specular_reflectance": rgb(0.7, 0.7, 0.7),
        "exponent": 90.0,
    }
    target = tuple(np.add(_EYE, _FORWARD))
    parts = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _DEPTH},
        "sensor": camera(_EYE, target, 45.0, _SIZE, "box", _UP),
        "floor": rectangle([x0, y0, z0], [wide, 0, 0], [0, deep, 0], floor),
        "ceiling": rectangle([x0, y0, z1], [0, deep, 0], [wide, 0, 0], white),
        "back": rectangle([x0, y1, z0], [wide, 0, 0], [0, 0, high], blue),
        "left": rectangle([x0, y0, z0], [0, deep, 0], [0, 0, high], diffuse(0.156863, 0.803922, 0.172549)),
        "right": rectangle([x1, y0, z0], [0, 0, high], [0, deep, 0], diffuse(0.803922, 0.152941, 0.152941)),
    }
    middle = (x0 + x1) / 2, (y0 + y1) / 2
    if content == "mirror":
        parts["ball"] = _ball((*middle, z0 + 0.8), 0.8, mirror(1.0, 1.0, 1.0))
    else:
        aside, centre = 2.0 * wide / 7.0, z0 + 0.5
        parts["mirror"] = _ball((x0 + aside, middle[1], centre), 0.5, mirror(1.0, 1.0, 1.0))
        parts["glass"] = _ball((x1 - aside, middle[1], centre), 0.5, glass(1.6))
    if light != "point":  # a flat box below the ceiling
        low, half, lip = 1.26002, 0.25, z1 - 1.26002
        radiance = (25.03329895614464,) * 3 if light == "ceiling" else ()
        parts["lamp"] = rectangle([-half, -half, low], [0, 2 * half, 0], [2 * half, 0, 0], white, *radiance)
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        for index, (a, b) in enumerate(zip(corners, corners[1:] + corners[:1], strict=True)):
            along = [b[0] - a[0], b[1] - a[1], 0]
            parts[f"side-{index}"] = rectangle([*a, low], along, [0, 0, lip], white)
    lights = {
        "sun": {"type": "directional", "direction": [-1.0, 1.5, -1.0], "irradiance": rgb(10.0, 4.0, 0.0)},
        "point": {"type": "point", "position": [0.0, -0.5, 1.0], "intensity": rgb(*(70.0 / (4.0 * np.pi),) * 3)},
        "sky": {"type": "constant", "radiance": rgb(135 / 255, 206 / 255, 250 / 255)},
    }
    return parts | ({"light": lights[light]} if light in lights else {})


def _ball(centre: tuple[float, ...], radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "sphere", "center": list(centre), "radius": radius, "bsdf": bsdf}


def _theirs(program: str, number: int, algorithm: str, seconds: float) -> tuple[np.ndarray, float]:
    """(picture by SmallVCM, CPU seconds that it took)."""
    with tempfile.TemporaryDirectory(prefix="smallvcm-") as folder:
        out = Path(folder) / "picture.hdr"
        command = [program, "-s", str(number), "-a", algorithm, "-t", f"{seconds:g}", "-o", str(out)]
        told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        used = re.search(r"done in ([0-9.]+) s", told)
        if used is None:
            raise SystemExit(f"SmallVCM did not say how long it took: {told!r}")
        return _colours(out), float(used[1])


def _colours(path: Path) -> np.ndarray:
    """A picture (height, width, 3) in RGBE without compression. SmallVCM rounds mantissas of eight bits down."""
    pixels = np.frombuffer(path.read_bytes()[-4 * _SIZE[0] * _SIZE[1] :], np.uint8).reshape(*_SIZE[::-1], 4)
    mantissa, exponent = pixels[..., :3].astype(np.float32), pixels[..., 3:].astype(np.int32)
    return np.where(mantissa > 0, np.ldexp(mantissa + 0.5, exponent - 136), 0.0).astype(np.float32)
