"""`etendue info` and `etendue diff`: what is in a file, and how two pictures differ."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from etendue import display, film
from etendue.core import CheckpointError, OptionError, format_count, format_seconds
from etendue.engine import Budget, Checkpoint
from etendue.particles import ParticleFile, is_particle_file
from etendue.products import current, find, limits_of
from etendue.scene import is_model
from etendue.surfaces import diagnose, is_mesh_file, read_patches, zone_names

from ..console import output_console, say

#: Shapes that are listed, those with most particles.
_LISTED = 20
#: Suffixes of pictures.
_PICTURES = (".exr", ".png", ".jpg", ".jpeg", ".hdr")


def show_info(file: Path, as_json: bool) -> int:
    """Show what a file has: a picture, a checkpoint, particles, a solution, form factors or a mesh."""
    if not file.is_file():
        raise OptionError(f"there is no file '{file}'")
    if is_particle_file(file):
        return _show_particles(ParticleFile(file), as_json)
    if file.suffix.lower() in _PICTURES:
        found = _of_picture(file)
    elif is_mesh_file(file) or is_model(file):
        found = _of_mesh(file)
    else:
        found = _of_checkpoint(file) or _of_arrays(file)
    if as_json:
        say(json.dumps(found, indent=1, default=str))
    else:
        _print_rows([(name, _text(value)) for name, value in found.items() if value not in (None, {}, "")])
    return 0


def show_difference(one: Path, other: Path, output: Path | None, limit: float | None) -> int:
    """Show how far a picture is from another, the reference. Exit status 1 if relMSE is above ``limit``."""
    image, reference = film.read_image(one), film.read_image(other)
    error = film.relative_mse(image, reference)
    rows = [
        ("relMSE", f"{error:.4g} ({film.relative_mse(image, reference, 0.001):.4g} without the worst 0.1 %)"),
        ("RMS of luminance", f"{film.luminance_rmse(image, reference):.4g}"),
        ("bias of the mean", f"{film.relative_bias(image, reference):+.3g}"),
        ("largest difference", f"{float(np.nanmax(np.abs(image - reference))):.4g}"),
    ]
    if film.flip_is_installed():
        rows.insert(1, ("FLIP", f"{film.flip(image, reference):.4g}"))
    _print_rows(rows)
    if output is not None:
        if output.suffix.lower() != ".png":
            raise OptionError(f"the picture of errors is a .png, not '{output.name}'")
        errors = np.sqrt(film.relative_squared_error(image, reference))
        display.write_png(output, display.false_colour(errors, 1e-3, 1.0))
        say(str(output))
    return 1 if limit is not None and not error <= limit else 0


def _of_picture(file: Path) -> dict[str, Any]:
    if file.suffix.lower() != ".exr":
        height, width = film.read_image(file).shape[:2]
        return {"picture": f"{width} x {height}"}
    read = film.read_exr(file)
    first = next(iter(read.layers.values()))
    layers = ", ".join(
        name if layer.shape[2] == 3 else f"{name} ({layer.shape[2]})" for name, layer in read.layers.items()
    )
    return {"picture": f"{first.shape[1]} x {first.shape[0]}", "layers": layers, **read.metadata}


def _of_checkpoint(file: Path) -> dict[str, Any] | None:
    try:
        saved = Checkpoint.read(file)
    except CheckpointError:
        return None
    place = saved.scene
    return {
        "checkpoint": f"of method {current(saved.method)}, {format_count(len(saved.measurement.iterations), 'pass')}",
        "scene": place.get("source") or place.get("bundled") or "in memory",
        "settings": json.loads(saved.settings),
        "seed": saved.seed,
        "budget": limits_of(Budget(**saved.budget), find(saved.method).counts),
        "seconds": format_seconds(saved.earlier + saved.elapsed),
        "stopped_by": saved.stopped_by,
        "versions": saved.versions,
    }


def _of_mesh(file: Path) -> dict[str, Any]:
    """The faces of a mesh and where they are, which shows in what unit, and what is up."""
    patches = read_patches(file)
    low, high = patches.bounds
    names = [name for name in dict.fromkeys(patches.names.tolist()) if name]
    return {
        "mesh": f"{format_count(len(patches.faces), 'face')}, {diagnose(patches)}",
        "extent": " x ".join(f"{x:.6g}" for x in high - low),
        "from": ", ".join(f"{x:.9g}" for x in low),
        "to": ", ".join(f"{x:.9g}" for x in high),
        "area": f"{patches.areas.sum():.6g}",
        "zones": ", ".join(zone_names(patches)),
        "names": ", ".join(names[:_LISTED]) + (f", ... ({len(names)})" if len(names) > _LISTED else ""),
    }


def _of_arrays(file: Path) -> dict[str, Any]:
    try:
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError) as error:
        raise OptionError(
            f"'{file}' is no picture, checkpoint, file of particles, solution, form factors or mesh"
        ) from error
    metadata = json.loads(str(arrays.pop("metadata"))) if "metadata" in arrays else {}
    shapes = {name: " x ".join(map(str, x.shape)) or str(x) for name, x in arrays.items()}
    return {**metadata, "arrays": shapes}


def _show_particles(known: ParticleFile, as_json: bool) -> int:
    """Scene, counts, codec, bounds of loss, and the particles on each shape, without unpacking them."""
    found = _of_particles(known)
    if as_json:
        say(json.dumps(found, indent=1))
        return 0
    count, passes = found["particles"], format_count(found["passes"], "pass")
    rows = [
        ("scene", f"{found['scene']}, fingerprint {found['fingerprint']}, seed {found['seed']}"),
        (
            "particles",
            f"{count} of {found['paths']} light paths in {passes}; {found['state']}",
        ),
        ("power", " ".join(f"{x:.6g}" for x in found["power"]) + " W incident on all surfaces (red, green, blue)"),
        ("size", f"{known.size} bytes, {known.size / max(count, 1):.2f} a particle; codec {found['codec']}"),
    ]
    if b := found["bounds"]:
        rows.append(
            (
                "loss",
                f"position {b['position']:.2g} (scene units), direction {b['direction']:.2g} rad, power "
                f"{b['power']:.2g} of its largest channel",
            )
        )
    _print_rows([*rows, ("settings", _text(found["settings"]))])
    shapes = Table("", "shape", "particles", "share", "a unit of area", box=None, pad_edge=False, title_justify="left")
    for shape in sorted(found["shapes"], key=lambda shape: -shape["particles"])[:_LISTED]:
        if not shape["particles"]:
            continue
        area, own = shape["area"], shape["particles"]
        density = f"{own / area:.4g}" if area else ""
        shapes.add_row(str(shape["index"]), escape(shape["name"]), str(own), f"{own / count:.2%}", density)
    output_console().print("", shapes)
    return 0


def _of_particles(known: ParticleFile) -> dict[str, Any]:
    state = "finished" if known.is_finished else "not finished, whole passes only"
    if known.ending.get("stopped_by") in ("cancel", "failure"):
        state = "stopped early"
    areas, counts = known.surfaces.areas, known.counts
    return {
        "scene": known.header["scene"],
        "fingerprint": known.header["fingerprint"],
        "seed": known.header["seed"],
        "settings": json.loads(known.header["settings"]),
        "versions": known.header["versions"],
        "particles": len(known),
        "paths": known.paths,
        "passes": len(known.passes),
        "state": state,
        "power": [float(x) for x in known.power],
        "bytes": known.size,
        "codec": str(known.codec),
        "codecs_before": known.header.get("before", []),
        "bounds": known.bounds,
        "shapes": [
            {"index": k, "name": name, "particles": int(counts[k]), "area": float(areas[k]) if areas[k] > 0 else None}
            for k, name in enumerate(known.surfaces.names)
        ],
    }


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(inner)}" for name, inner in value.items())
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value) or "''"


def _print_rows(rows: list[tuple[str, str]]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    for row in rows:
        table.add_row(*map(escape, row))
    output_console().print(table)
