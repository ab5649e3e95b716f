"""The page of a solution of radiosity: pictures of the mesh, energy balance, convergence, the worst patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import Array, Result
from etendue.display import (
    Column,
    Command,
    Facts,
    Figure,
    Figures,
    Layer,
    Measures,
    Page,
    Plot,
    Series,
    Stack,
    Text,
    auto_exposure,
    convergence_plot,
    fact_table,
    flatten,
    machine,
    number_text,
    render_page,
    tonemap,
    viewer_data,
)
from etendue.engine import versions
from etendue.film import write_bytes

from ..pages.meshviews import mesh_views, on_pixels, seen_patches
from .illuminance import illuminance_picture, illuminance_text

if TYPE_CHECKING:
    from etendue.display import Part
    from etendue.radiosity import Solution
    from etendue.scene import Problem

#: Suffix of a page and its meaning.
PAGE_FILES = {".html": "page with pictures, tables and plots"}
#: Width of the pictures of the mesh.
_WIDTH = 640
#: Rows of the tables of patches, and the share of the largest radiosity below which a value is rounding.
_WORST, _ROUNDING = 10, 1e-12


@dataclass(frozen=True)
class Making:
    """How a solution was made. ``settings``: the requested ones. ``history``: (count, standard error) during the run;
    ``unit``: what is counted. ``command``: a command that repeats the run."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    history: Sequence[tuple[float, float]] = ()
    unit: str = "bundles"
    command: str = ""


def write_solution_page(
    path: Path,
    solution: Solution,
    error: Array | None,
    metadata: Mapping[str, Any],
    problem: Problem | None,
    making: Making,
    picture: Result | None = None,
    *,
    photometric: bool = False,
    scale: tuple[float | None, float | None] = (None, None),
) -> None:
    """Write the page. ``error``: of the irradiance; ``picture``: a picture of the solution, if ``photometric`` of its
    irradiance, whose illuminance is shown from low to high of ``scale``, in lx. Raises :class:`OutputError` if the file
    cannot be written."""
    text = render_solution_page(
        solution, error, metadata, problem, making, picture, photometric=photometric, scale=scale
    )
    write_bytes(path, text.encode())


def render_solution_page(
    solution: Solution,
    error: Array | None,
    metadata: Mapping[str, Any],
    problem: Problem | None,
    making: Making,
    picture: Result | None = None,
    *,
    photometric: bool = False,
    scale: tuple[float | None, float | None] = (None, None),
) -> str:
    """The text of the page, see :func:`write_solution_page`."""
    patches = solution.patches
    source = str(metadata.get("source", "patches"))
    size = _WIDTH, _height(problem)
    stacks, exposure = _stacks(solution, error, problem, size, photometric)
    page = Page(f"Radiosity of {Path(source).name}", _subtitle(solution))
    page.verdict = [(words, False) for words in [_key_figures(solution, error, photometric)] if words]
    figures = [
        Figure(tonemap(s.layers[0].values, exposure), f"mesh, {s.name}", s.name, index=i) for i, s in enumerate(stacks)
    ]
    if picture is not None:
        shown = illuminance_picture(picture, *scale) if photometric else tonemap(picture.image, "auto")
        name = "illuminance" if photometric else "picture"
        figures.append(Figure(shown, f"{name} of the solution", name, "smooth"))
    page.add(
        "Mesh", Figures(figures), Text("Radiance of the patches; from outside, walls are seen through their backs.")
    )
    page.add("Energy balance", _balance(solution), Text(_about_balance(solution)))
    page.add("Convergence", *_convergence(solution, making))
    left = patches.emission + patches.reflectance * solution.irradiance - solution.radiosity
    page.add(
        "Worst patches",
        _worst("Largest residuals", "residual", np.abs(left).max(axis=1), solution),
        None if error is None else _worst("Largest standard errors", "of irradiance", error.max(axis=1), solution),
        Text("The residual is what emission and reflected light differ from the radiosity by, in its units."),
    )
    page.add("Settings", _facts("value", making.settings))
    page.add("Run", _facts("value", {k: v for k, v in flatten(metadata).items() if k != "software"}))
    page.add("Versions and machine", _facts("this machine", {**versions(), **machine()}))
    page.add("How to repeat it", Command(making.command) if making.command else None)
    return render_page(page, lambda room: viewer_data(stacks, exposure, "srgb", room, pair=False))


def _height(problem: Problem | None) -> int:
    """Height of the pictures, in the camera's aspect ratio."""
    width, height = (4, 3) if problem is None else problem.size
    return int(np.clip(round(_WIDTH * height / width), _WIDTH // 3, _WIDTH))


def _stacks(
    solution: Solution, error: Array | None, problem: Problem | None, size: tuple[int, int], photometric: bool
) -> tuple[list[Stack], float]:
    """Views of the mesh with their layers, and the exposure that suits them."""
    patches, stacks = solution.patches, []
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = None if error is None else error.mean(axis=1) / solution.irradiance.mean(axis=1)
    left = np.abs(patches.emission + patches.reflectance * solution.irradiance - solution.radiosity).max(axis=1)
    for view in mesh_views(patches, problem, size[0] / size[1]):
        seen = seen_patches(patches, view, size)
        layers = [
            Layer("radiance", "radiance", on_pixels(_colours(solution.radiosity) / np.pi, seen)),
            Layer("irradiance / π", "radiance", on_pixels(_colours(solution.irradiance) / np.pi, seen)),
            Layer("reflectance", "albedo", on_pixels(_colours(patches.reflectance), seen)),
        ]
        if photometric:
            layers.append(Layer("illuminance", "scalar", on_pixels(solution.illuminance, seen), unit="lx"))
            luminance = on_pixels(solution.luminous_exitance / np.pi, seen)
            layers.append(Layer("luminance", "scalar", luminance, unit="cd/m²"))
        if relative is not None:
            layers.append(Layer("relative standard error", "scalar", on_pixels(relative, seen), (1e-3, 1.0)))
        layers.append(Layer("residual", "scalar", on_pixels(left, seen), _scale(left)))
        layers.append(Layer("patch", "label", on_pixels(np.arange(len(patches), dtype=np.float64), seen, -1.0)))
        stacks.append(Stack(view.name, layers))
    return stacks, auto_exposure(np.concatenate([s.layers[0].values.reshape(-1, 3) for s in stacks])[None])


def _colours(values: Array) -> Array:
    """(n, 3) colours: three channels as they are; of one channel, or of bands, the mean as grey."""
    return values if values.shape[1] == 3 else np.repeat(values.mean(axis=1, keepdims=True), 3, axis=1)


def _scale(values: Array) -> tuple[float, float]:
    highest = float(values.max(initial=0.0)) or 1.0
    return 1e-4 * highest, highest


def _subtitle(solution: Solution) -> str:
    patches = solution.patches
    parts = [f"{len(patches)} patches of {len(patches.faces)} faces", f"area {number_text(float(patches.areas.sum()))}"]
    if patches.channels not in (1, 3):
        parts.append(f"{patches.channels} channels")
    return ", ".join(parts)


def _key_figures(solution: Solution, error: Array | None, photometric: bool) -> str:
    parts = [f"imbalance of power {100 * solution.imbalance:.2g} %"]
    areas = solution.patches.areas[:, None]
    if error is not None and (light := float((areas * solution.irradiance).sum())) > 0.0:
        parts.insert(0, f"standard error of irradiance {100 * float((areas * error).sum()) / light:.2g} % in the mean")
    if solution.residuals:
        count = len(solution.residuals)
        parts.append(f"residual {solution.residual:.1g} after {count} iteration{'' if count == 1 else 's'}")
    if photometric:
        parts.insert(0, illuminance_text(solution))
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


_POWERS = {
    "emitted": "emitted",
    "from_sky": "from the sky",
    "absorbed": "absorbed",
    "to_sky": "to the sky",
}


def _balance(solution: Solution) -> Measures:
    """Powers by channel, and their share of the incoming power."""
    power = solution.power
    come = power["emitted"] + power["from_sky"]
    rows = {words: power[name] for name, words in _POWERS.items()}
    rows["difference"] = come - power["absorbed"] - power["to_sky"]
    channels = solution.patches.channels
    heads = {1: ("power",), 3: ("red", "green", "blue")}.get(channels, tuple(f"band {c}" for c in range(channels)))
    columns = [
        Column(head, [_signed(float(values[c])) for values in rows.values()]) for c, head in enumerate(heads[:8])
    ]
    total = float(come.sum()) or 1.0
    columns.append(Column.shares("of all that comes", [float(values.sum()) / total for values in rows.values()]))
    return Measures(list(rows), columns, "power")


def _signed(value: float) -> str:
    return number_text(value, 4).replace("-", "−")


def _about_balance(solution: Solution) -> str:
    return (
        "Power in the units of emission times area. What comes from emitters and the sky is absorbed or leaves to the "
        f"sky; the difference, {100 * solution.imbalance:.2g} % over all channels, is due to errors of form factors."
    )


def _convergence(solution: Solution, making: Making) -> list[Part]:
    parts: list[Part] = []
    steps = [(float(i), r) for i, r in enumerate(solution.residuals, 1)]
    if (plot := _plot("residual", steps, "iterations", 0.0)) is not None:
        parts += [plot, Text("The largest residual of the system, in units of the largest emission.")]
    if (plot := _plot("standard error of irradiance", making.history, making.unit, 0.5)) is not None:
        parts += [plot, Text("Mean over the surface, relative to the mean irradiance, as estimated during the run.")]
    return parts


def _plot(name: str, points: Sequence[tuple[float, float]], unit: str, rate: float) -> Plot | None:
    if len(points) < 2:
        return None
    options: dict[str, Any] = {"x_label": unit, "y_label": name, "title": f"{name} over {unit}", "rate": rate}
    wide = convergence_plot([Series(name, points)], **options)
    return Plot(wide, convergence_plot([Series(name, points)], width=360, height=320, **options)) if wide else None


def _worst(caption: str, heading: str, values: Array, solution: Solution) -> Measures | None:
    """The patches with the largest ``values``."""
    patches = solution.patches
    numbers = np.argsort(-np.nan_to_num(values), kind="stable")[:_WORST]
    numbers = numbers[values[numbers] > _ROUNDING * np.abs(solution.radiosity).max(initial=0.0)]
    if not len(numbers):
        return None
    columns = [
        Column(heading, [f"{values[i]:.2e}" for i in numbers]),
        Column("radiosity", [number_text(float(solution.radiosity[i].mean())) for i in numbers]),
        Column("irradiance", [number_text(float(solution.irradiance[i].mean())) for i in numbers]),
        Column("area", [number_text(float(patches.areas[i])) for i in numbers]),
        Column("centre", [", ".join(f"{x:.3g}" for x in np.round(patches.centres[i], 6) + 0.0) for i in numbers]),
    ]
    if patches.shapes is not None and patches.shape_names:
        columns.append(Column("shape", [_shape(patches.shapes[i], patches.shape_names) for i in numbers]))
    return Measures([str(i) for i in numbers], columns, "patch", caption)


def _shape(number: Any, names: Sequence[str]) -> str:
    return names[number] if 0 <= number < len(names) else "–"


def _facts(heading: str, values: Mapping[str, Any]) -> Facts | None:
    table = fact_table([heading], [flatten(values)])
    return None if table is None else Facts(table)
