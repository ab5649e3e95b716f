"""Daylight coefficients beside Radiance's ``rfluxmtx``: CPU time for the same error."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import etendue
from etendue.core import OptionError
from etendue.lighting import Meters
from etendue.scene import box

from .measuring import Record, console, timed
from .options import Names, Seconds, Seeds

#: A room, its window, and a table and a cupboard in it, in metres; and the reflectances of floor, walls, ceiling, and
#: of furniture.
_ROOM, _WINDOW = (6.0, 8.0, 3.0), (1.5, 4.5, 1.0, 2.5)
_FLOOR, _WALLS, _CEILING, _FURNITURE = 0.2, 0.5, 0.8, 0.35
_BOXES = (((2.0, 3.0, 0.0), (4.0, 4.0, 0.75)), ((0.0, 6.5, 0.0), (0.6, 8.0, 2.0)))
_POINTS = (20, 25)
#: Settings of the peer, from coarse to fine, and paths of each meter of our run and of the reference.
_PEER = (
    ("-ab", "6", "-ad", "512", "-lw", "1e-4"),
    ("-ab", "8", "-ad", "2048", "-lw", "2e-5"),
    ("-ab", "10", "-ad", "8192", "-lw", "5e-6"),
)
_PATHS, _REFERENCE = 1 << 12, 1 << 18

Folder = Annotated[
    Path | None, typer.Option("--radiance", help="Folder of Radiance's programs, if they are not on the PATH.")
]


def measure(radiance: Folder = None, seeds: Seeds = 3) -> Record:
    """500 points in a furnished room with a window, 145 patches of the sky and the ground."""
    program = shutil.which("rfluxmtx", path=None if radiance is None else str(radiance))
    if program is None:
        raise OptionError("Radiance is missing: put rfluxmtx on the PATH, or name its folder by --radiance")
    meters = Meters.grid((0.15, 0.15, 0.85), (_ROOM[0] - 0.3, 0, 0), (0, _ROOM[1] - 0.3, 0), _POINTS)
    surfaces = _surfaces()
    reference = _own(surfaces, meters, _REFERENCE, 999)
    rows = []
    _own(surfaces, meters, _PATHS, 0)  # compiles
    found = [_with_clock(surfaces, meters, seed) for seed in range(seeds)]
    own_seconds = float(np.mean([seconds for _, seconds in found]))
    own_error = float(np.sqrt(np.mean([_error(values, reference) ** 2 for values, _ in found])))
    rows.append(["étendue", f"{_PATHS} paths", f"{own_seconds:.2f}", f"{own_error:.4f}", ""])
    for options in _PEER:
        values, seconds = _peer(program, surfaces, meters, options)
        error = _error(values, reference)
        equal = own_seconds * (own_error / error) ** 2
        rows.append(["rfluxmtx", " ".join(options), f"{seconds:.2f}", f"{error:.4f}", f"{equal / seconds:.3f}"])
        console.print(" | ".join(rows[-1]), style="dim")
    heads = ["program", "settings", "CPU seconds", "error", "étendue's CPU time for this error, relative"]
    note = (
        "Error: root mean square of the differences of the coefficients to those of a long run of étendue, relative to "
        "the root mean square of these. The bar is 0.2."
    )
    return Record("Daylight coefficients", heads, rows, [note])


def _surfaces() -> list[tuple[np.ndarray, float]]:
    """Quadrilaterals (4, 3) and their reflectances; the window is a hole in the wall x = 0."""
    x, y, z = _ROOM
    y0, y1, z0, z1 = _WINDOW

    def wall(a: float, b: float, low: float, high: float) -> np.ndarray:
        return np.array([[0, a, low], [0, b, low], [0, b, high], [0, a, high]])

    quads = [
        (np.array([[0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]]), _FLOOR),
        (np.array([[0, 0, z], [0, y, z], [x, y, z], [x, 0, z]]), _CEILING),
        (np.array([[x, 0, 0], [x, y, 0], [x, y, z], [x, 0, z]]), _WALLS),
        (np.array([[0, 0, 0], [x, 0, 0], [x, 0, z], [0, 0, z]]), _WALLS),
        (np.array([[0, y, 0], [0, y, z], [x, y, z], [x, y, 0]]), _WALLS),
        *((wall(*part), _WALLS) for part in ((0, y, 0, z0), (0, y, z1, z), (0, y0, z0, z1), (y1, y, z0, z1))),
    ]
    for low, high in _BOXES:
        points, faces = box(low, high)
        quads += [(points[face], _FURNITURE) for face in faces]
    return quads


def _scene(surfaces: list[tuple[np.ndarray, float]]) -> dict:
    import mitsuba as mi

    scene: dict = {"type": "scene"}
    for number, reflectance in enumerate(sorted({value for _, value in surfaces})):
        quads = np.concatenate([quad for quad, value in surfaces if value == reflectance])
        first = 4 * np.arange(len(quads) // 4)[:, None]
        faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
        grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}
        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict({"type": "twosided", "bsdf": grey})
        mesh = mi.Mesh(f"part{number}", len(quads), len(faces), props=properties)
        values = mi.traverse(mesh)
        values["vertex_positions"] = quads.astype(np.float32).ravel()
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        scene[f"part{number}"] = mesh
    return scene


def _own(surfaces: list[tuple[np.ndarray, float]], meters: Meters, paths: int, seed: int) -> np.ndarray:
    found = etendue.daylight(_scene(surfaces), meters, spp=paths, seed=seed)
    return found.coefficients.values[..., 0]


def _with_clock(surfaces: list[tuple[np.ndarray, float]], meters: Meters, seed: int) -> tuple[np.ndarray, float]:
    values = []
    clock = timed(lambda: values.append(_own(surfaces, meters, _PATHS, seed)))
    return values[0], clock.cpu


def _peer(
    program: str, surfaces: list[tuple[np.ndarray, float]], meters: Meters, options: tuple[str, ...]
) -> tuple[np.ndarray, float]:
    """(coefficients (meters, patches), CPU seconds) of rfluxmtx."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lines = []
        for reflectance in sorted({value for _, value in surfaces}):
            lines.append(f"void plastic m{reflectance:g} 0 0 5 {reflectance} {reflectance} {reflectance} 0 0")
        for number, (quad, reflectance) in enumerate(surfaces):
            numbers = " ".join(f"{v:g}" for v in quad.ravel())
            lines.append(f"m{reflectance:g} polygon p{number} 0 0 12 {numbers}")
        (folder / "room.rad").write_text("\n".join(lines) + "\n")
        (folder / "sky.rad").write_text(
            "#@rfluxmtx h=u u=+Y\nvoid glow ground_glow 0 0 4 1 1 1 0\nground_glow source ground 0 0 4 0 0 -1 180\n"
            "#@rfluxmtx h=r1 u=+Y\nvoid glow sky_glow 0 0 4 1 1 1 0\nsky_glow source sky 0 0 4 0 0 1 180\n"
        )
        rows = np.concatenate([meters.points, meters.directions], axis=1)
        text = "\n".join(" ".join(f"{v:.6g}" for v in row) for row in rows) + "\n"
        place = Path(program).resolve().parent
        paths = {"PATH": f"{place}{os.pathsep}{os.environ['PATH']}", "RAYPATH": f".{os.pathsep}{place.parent / 'lib'}"}
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [program, "-I+", "-h", "-y", str(len(rows)), "-n", "1", *options, "-", "sky.rad", "room.rad"]
        done = subprocess.run(command, input=text, cwd=folder, env=os.environ | paths, capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise OptionError(f"rfluxmtx failed: {done.stderr.strip()[:200]}")
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return np.array(done.stdout.split(), float).reshape(len(rows), -1, 3)[..., 0], seconds


def _error(values: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(np.mean((values - reference) ** 2) / np.mean(reference**2)))


def grid(names: Names = "guided,path,bpt", seconds: Seconds = 60.0) -> Record:
    """10,000 points on the work plane of the same room under an overcast sky."""
    meters = Meters.grid((0.15, 0.15, 0.85), (_ROOM[0] - 0.3, 0, 0), (0, _ROOM[1] - 0.3, 0), (80, 125))
    sky = {"type": "sky", "kind": 1, "diffuse_illuminance": 10_000.0}
    record = Record("10,000 points under an overcast sky", ["method", "seconds", "paths", "error", "mean lux"])
    for name in names:
        read = etendue.measure(_scene(_surfaces()) | {"sky": sky}, meters, method=name, seconds=seconds)
        lit = read.photometric > 0.0  # some are inside the cupboard
        error = float(np.mean(read.photometric_error[lit] / read.photometric[lit]))
        about = read.metadata
        record.add(
            name, f"{about['seconds']:.0f}", f"{about['samples']}", f"{error:.4f}", f"{read.photometric.mean():.1f}"
        )
    record.notes.append("The error is the mean over the points of standard error over reading.")
    return record
