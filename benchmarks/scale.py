"""Scenes of a thousand lamps, a thousand textures and ten million triangles, beside Mitsuba's ``path``."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import mitsuba as mi
import numpy as np
import typer

from .measuring import Record, child, console
from .options import Methods, Names

#: Half the side of the ground, and what every scene has.
_HALF = 10.0
_PASSES, _SPP, _SIZE = 5, 16, (256, 256)
_HEAD = f"""<scene version="3.0.0"><integrator type="path"/>
<sensor type="perspective"><float name="fov" value="50"/>
<transform name="to_world"><lookat origin="0,-14,9" target="0,0,0" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="{_SIZE[0]}"/><integer name="height" value="{_SIZE[1]}"/></film>
</sensor>
"""


def _places(count: int) -> list[tuple[float, float]]:
    side = int(np.ceil(np.sqrt(count)))
    return [(_HALF * (2.0 * (k % side) / side - 0.95), _HALF * (2.0 * (k // side) / side - 0.95)) for k in range(count)]


def _lamps(count: int, folder: Path) -> list[str]:
    """Small lamps of different colours and heights over a ground."""
    rng = np.random.default_rng(1)
    lines = [f'<shape type="rectangle"><transform name="to_world"><scale value="{_HALF}"/></transform></shape>']
    for (x, y), (z, *colour) in zip(_places(count), rng.uniform(0.3, 1.3, (count, 4)), strict=True):
        radiance = ",".join(f"{20.0 * c:.3f}" for c in colour)
        lines.append(
            '<shape type="rectangle"><transform name="to_world"><scale value="0.05"/><rotate x="1" angle="180"/>'
            f'<translate x="{x:.4f}" y="{y:.4f}" z="{z:.4f}"/></transform>'
            f'<emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>'
        )
    return lines


def _textures(count: int, folder: Path) -> list[str]:
    """Cubes under a sky, each with a picture of its own."""
    rng, lines = np.random.default_rng(2), ['<emitter type="constant"/>']
    for k, (x, y) in enumerate(_places(count)):
        mi.Bitmap(rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)).write(str(folder / f"{k}.png"))
        lines.append(
            '<shape type="cube"><transform name="to_world"><scale value="0.25"/>'
            f'<translate x="{x:.4f}" y="{y:.4f}"/></transform><bsdf type="diffuse"><texture type="bitmap" '
            f'name="reflectance"><string name="filename" value="{k}.png"/></texture></bsdf></shape>'
        )
    return lines


def _triangles(count: int, folder: Path) -> list[str]:
    """One mesh of waves, under a lamp."""
    side = int(np.sqrt(count / 2))
    x, y = np.meshgrid(*[np.linspace(-_HALF, _HALF, side + 1)] * 2)
    z = 0.3 * np.sin(3.0 * x) * np.cos(2.0 * y) + 0.05 * np.sin(31.0 * x + 17.0 * y)
    corner = ((side + 1) * np.arange(side)[:, None] + np.arange(side)).ravel()
    halves = [np.stack([corner, corner + a, corner + b], 1) for a, b in ((1, side + 2), (side + 2, side + 1))]
    mesh = mi.Mesh("waves", x.size, 2 * corner.size)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(np.stack([x, y, z], 2).astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.concatenate(halves).astype(np.uint32).ravel())
    parameters.update()
    mesh.write_ply(str(folder / "waves.ply"))
    return [
        '<shape type="ply"><string name="filename" value="waves.ply"/></shape>',
        '<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="180"/>'
        '<translate z="6"/></transform><emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>',
    ]


SCENES: dict[str, Callable[[int, Path], list[str]]] = {"lamps": _lamps, "textures": _textures, "triangles": _triangles}


def measure(
    names: Methods = "path,vcm,auto",
    scenes: Names = "lamps,textures,triangles",
    count: Annotated[int, typer.Option(help="Lamps and textures, and ten thousands of triangles.")] = 1000,
) -> Record:
    """CPU seconds to load, of the first pass and of later ones, and peak memory, each in a fresh process."""
    record = Record(
        f"Large scenes, {_SIZE[0]}x{_SIZE[1]}, {_SPP} spp a pass",
        ("scene", "", "load s", "first pass s", "pass s", "over Mitsuba's", "memory MB"),
    )
    for scene in scenes:
        amount = count * (10_000 if scene == "triangles" else 1)
        with tempfile.TemporaryDirectory(prefix="scale-") as folder:
            file = Path(folder) / "scene.xml"
            file.write_text("\n".join([_HEAD, *SCENES[scene](amount, Path(folder)), "</scene>"]), "utf-8")
            own = None
            for method in ("", *names):
                console.print(f"{amount} {scene}: {method or 'Mitsuba'}", highlight=False)
                options = {"scene": str(file), "size": _SIZE, "method": method, "passes": _PASSES, "spp": _SPP}
                options |= {"variant": mi.variant(), "settings": {"samples_per_pass": _SPP}}
                found = child("scale", options)
                label = (f"{amount:,} {scene}", method or "Mitsuba's path")
                if not found:
                    record.add(*label, *["failed"] * 5)
                    continue
                later = statistics.median(found["passes"][1:])
                own = own if method else later
                ratio = f"{later / own:.2f}" if own else ""  # none if Mitsuba failed
                cells = (f"{found['load']:.2f}", f"{found['first']:.2f}", f"{later:.2f}", ratio)
                record.add(*label, *cells, f"{found['bytes'] / 1e6:.0f}")
    record.notes.append(
        "CPU seconds; kernels not cached; load: with tables and pilots; pass: median of those after the first; memory: "
        "largest resident size"
    )
    return record
