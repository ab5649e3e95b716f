"""The page of pictures: one HTML file that contains its pictures, figures and script, and loads nothing from the
network.

It reads as a page without its script: pictures, error maps, tables and the plot are in the markup. The script adds the
exposure, which needs radiance rather than bytes, and the comparison pixel by pixel.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.film import flip, flip_is_installed, relative_bias, relative_mse, relative_squared_error, write_bytes

from ..colours import css_gradient, false_colour
from ..plots import Series, convergence_plot
from ..tonemapping import auto_exposure, tonemap
from .entries import Entry, Image, check_entries
from .figures import Figure, fitted
from .machine import machine
from .packing import Layer, averaged
from .pages import render_page
from .parts import (
    Command,
    Facts,
    Failure,
    Figures,
    Folded,
    Measures,
    Page,
    Part,
    Plot,
    Pyramid,
    Scale,
    Text,
)
from .pyramid import in_pyramid, pyramids
from .race import equal_errors, equal_times
from .stacks import ERROR_RANGE, Stack, viewer_data
from .tables import Column, FactTable, fact_table, flatten, number_text, settings_tables, time_text

_TRIM = 0.001
#: Metadata that are not facts of a run: metadata with their own tables, and names of the shapes of a layer.
_ELSEWHERE = ("settings", "versions", "shapes")
#: Characters for pictures, error maps and layers as figures, each; and for pyramids. The data of the viewer get the
#: rest of a page.
_FIGURE_ROOM, _PYRAMID_ROOM = 420_000, 800_000
#: Width of a layer as a figure.
_LAYER_ACROSS = 360
#: Widths of the cells of a pyramid, tried in turn.
_CELLS = (240, 160, 112, 80, 56)


def write_report(
    path: str | os.PathLike[str], entries: Sequence[Entry], reference: Image | None = None, **options: Any
) -> None:
    """Write a self-contained HTML page that compares ``entries`` with each other and with ``reference``.

    ``options`` are those of :func:`render_report`. Raises :class:`OptionError` without an entry, on two entries of one
    name or on pictures of different sizes, and :class:`OutputError` if the file cannot be written.
    """
    write_bytes(path, render_report(entries, reference, **options).encode())


def render_report(
    entries: Sequence[Entry],
    reference: Image | None = None,
    *,
    title: str = "Comparison",
    subtitle: str = "",
    reference_note: str = "",
    exposure: float | None = None,
    curve: str = "srgb",
    error_name: str = "relMSE",
    failures: Sequence[Failure] = (),
    repeat: Sequence[Command] = (),
) -> str:
    """The text of the page that :func:`write_report` writes.

    All pictures are shown at one ``exposure`` (stops; by default the exposure that suits the reference, else the first
    entry). ``reference_note`` says how the reference was made, ``error_name`` names the measure of the error over time.
    ``failures`` are shown in the place of their pictures. ``repeat``: commands that make the page again.
    """
    check_entries(entries, reference)
    pictures = [(e.name, e.image) for e in entries] + ([("reference", reference)] if reference is not None else [])
    if exposure is None:
        exposure = auto_exposure(pictures[-1][1] if reference is not None else entries[0].image)
    page = Page(title, subtitle, _verdict(entries, reference), failures)
    heading = "Side by side" if len(pictures) + len(failures) > 1 else "Picture"
    page.add(heading, Figures(_pictures(entries, pictures, reference_note, exposure, curve), failures))
    page.add("Error against the reference", *_errors(entries, reference))
    page.add("Error over time", *_over_time(entries, error_name))
    page.add("Technique pyramid", *_pyramids(entries, exposure, curve))
    page.add("Layers", *_layers(entries, exposure, curve))
    page.add("Settings", *_settings(entries))
    page.add("Runs", *_facts(entries, lambda m: {k: v for k, v in m.items() if k not in _ELSEWHERE}))
    page.add("Versions and machine", *_facts(entries, lambda m: m.get("versions", {})), _machine())
    page.add("How to repeat it", *repeat, *_commands(entries))
    stacks = _stacks(entries, reference)
    return render_page(page, lambda room: viewer_data(stacks, exposure, curve, room, _number(entries, reference)))


def _verdict(entries: Sequence[Entry], reference: Image | None) -> list[tuple[str, bool]]:
    """Text that names the picture with the smallest error, if there are several pictures."""
    if reference is None or len(entries) < 2:
        return []
    errors = sorted((relative_mse(e.image, reference), e.name) for e in entries)
    (best, winner), (worst, loser) = errors[0], errors[-1]
    if not 0.0 < best < worst:
        return []
    factor = number_text(float(f"{worst / best:.2g}"), 2)
    text = f" has the smallest error: relMSE {number_text(best)}, {factor} times below {loser} ({number_text(worst)})."
    return [(winner, True), (text, False)]


def _number(entries: Sequence[Entry], reference: Image | None) -> int | None:
    """Number of the reference among the pictures; ``None`` without one."""
    return None if reference is None else len(entries)


def _stacks(entries: Sequence[Entry], reference: Image | None) -> list[Stack]:
    """All pictures with their layers, except layers of a pyramid, which the page already shows at small size."""
    stacks = []
    for entry in entries:
        others = [Layer.of(name, layer) for name, layer in entry.layers.items() if _is_shown(name)]
        same = [layer for layer in others if layer is not None and layer.values.shape[:2] == entry.image.shape[:2]]
        stacks.append(Stack(entry.name, [Layer("image", "radiance", entry.image), *same]))
    if reference is not None:
        stacks.append(Stack("reference", [Layer("image", "radiance", reference)]))
    return stacks


def _is_shown(layer: str) -> bool:
    return layer != "image" and not in_pyramid(layer)


def _pictures(
    entries: Sequence[Entry], pictures: Sequence[tuple[str, Image]], note: str, exposure: float, curve: str
) -> list[Figure]:
    figures = []
    for index, (name, image) in enumerate(pictures):
        caption = " · ".join(_caption(entries[index])) if index < len(entries) else note
        figures.append(Figure(tonemap(image, exposure, curve), f"picture: {name}", name, caption, index))
    return fitted(figures, _FIGURE_ROOM)


def _caption(entry: Entry) -> list[str]:
    facts = []
    if "seconds" in entry.metadata:
        facts.append(time_text(float(entry.metadata["seconds"])))
    if "passes" in entry.metadata:
        passes = int(entry.metadata["passes"])
        facts.append(f"{passes} pass{'es' if passes != 1 else ''}")
    bad = int(np.count_nonzero(~np.isfinite(entry.image).all(axis=2)))
    if bad:
        facts.append(f"{bad} pixel{'s' if bad != 1 else ''} not finite")
    return facts


def _errors(entries: Sequence[Entry], reference: Image | None) -> list[Part]:
    """Measures of error, one map for each picture, and the scale of the maps."""
    if reference is None:
        return []
    with_flip = flip_is_installed()
    columns = [
        Column.numbers("relMSE", [relative_mse(e.image, reference) for e in entries]),
        Column.numbers("without the worst 0.1 %", [relative_mse(e.image, reference, trim=_TRIM) for e in entries]),
        *([Column.numbers("FLIP", [flip(e.image, reference) for e in entries])] if with_flip else []),
        Column.shares("bias of the mean", [relative_bias(e.image, reference) for e in entries]),
    ]
    seconds = [e.metadata.get("seconds") for e in entries]
    if all(s is not None for s in seconds):
        columns.insert(0, Column.times("time", [float(s) for s in seconds if s is not None]))
    maps = []
    for entry in entries:
        pixels = false_colour(relative_squared_error(entry.image, reference), *ERROR_RANGE)
        caption = f"relMSE {number_text(relative_mse(entry.image, reference))}"
        maps.append(Figure(pixels, f"error map of {entry.name}", entry.name, caption))
    about = "relMSE is the mean of (x − ref)² / (ref² + 0.01) over channels and finite pixels; smaller is better."
    if with_flip:
        about += " FLIP is how different two pictures look when flipped, from 0 to 1 (HDR-FLIP, by flip-evaluator)."
    ticks = [f"{value:g}" for value in np.geomspace(*ERROR_RANGE, 4)]
    return [
        Measures([e.name for e in entries], columns),
        Text(about),
        Scale(css_gradient(), ticks),
        Figures(fitted(maps, _FIGURE_ROOM)),
        Text("Squared relative error of each pixel, logarithmic; turquoise where a pixel is not finite."),
    ]


def _over_time(entries: Sequence[Entry], error_name: str) -> list[Part]:
    """The plot, the tables that are read from it, and its points."""
    series = [Series(e.name, e.error_history) for e in entries]
    wide = convergence_plot(series, y_label=error_name)
    if not wide:
        return []
    parts: list[Part] = [Plot(wide, convergence_plot(series, y_label=error_name, width=360, height=320))]
    curves = [s for s in series if s.drawable()]
    names = [s.name for s in curves]
    if any(error for s in curves for _, _, error in s.drawable()):
        parts.append(Text("Bars are standard errors over seeds."))
    if times := equal_times(curves):
        parts.append(Measures(names, times, caption=f"{error_name} at equal time"))
    if errors := equal_errors(curves):
        parts.append(Measures(names, errors, caption=f"Time to equal {error_name}"))
    if times or errors:
        parts.append(
            Text(
                "Both tables are read from the curves, straight lines between their points on logarithmic axes, and "
                "never beyond them. An error is reached when the curve stays below it; × is the gain over the slowest."
            )
        )
    rows = [
        Measures(
            [time_text(t) for t, _, _ in s.drawable()],
            [Column(error_name, [_with_error(y, e) for _, y, e in s.drawable()])],
            "after",
            s.name,
        )
        for s in curves
    ]
    return [*parts, Folded("Points of the plot", rows)]


def _with_error(value: float, error: float) -> str:
    return f"{number_text(value)} ± {number_text(error, 2)}" if error > 0.0 else number_text(value)


def _pyramids(entries: Sequence[Entry], exposure: float, curve: str) -> list[Part]:
    found = [p for e in entries for p in pyramids(e.name, e.image, e.layers, exposure, curve)]
    if not found:
        return []
    views = found
    for across in _CELLS:
        views = [view.stored(across) for view in found]
        if sum(view.size for view in views) <= _PYRAMID_ROOM:
            break
    about = (
        "Paths of s vertices from the light and t from the camera, by length and by s, all at one exposure. Per cent "
        "are of the picture's mean; the weighted pictures add up to it."
    )
    return [Text(about), *(Folded(view.title, [Pyramid(view)], True) for view in views)]


def _layers(entries: Sequence[Entry], exposure: float, curve: str) -> list[Part]:
    """Layers of pictures that are not part of a pyramid, at small size; the viewer has them with exposure and zoom."""
    found = []
    for entry in entries:
        figures = [
            Figure(pixels, f"layer {name} of {entry.name}", name)
            for name, layer in entry.layers.items()
            if _is_shown(name) and (pixels := _layer_pixels(name, layer, exposure, curve)) is not None
        ]
        if figures:
            found.append((entry.name, figures))
    if not found:
        return []
    stored = fitted([f for _, figures in found for f in figures], _FIGURE_ROOM, _LAYER_ACROSS)
    parts: list[Part] = []
    for name, figures in found:
        parts.append(Folded(f"Layers of {name}", [Figures([stored.pop(0) for _ in figures])]))
    return parts


def _layer_pixels(name: str, layer: Image, exposure: float, curve: str) -> Any:
    """Directions as colours around grey, reflectances as they are, radiance like the picture, numbers in false
    colours."""
    shown = Layer.of(name, layer)
    if shown is None or shown.kind == "label":
        return None
    if block := layer.shape[1] // (2 * _LAYER_ACROSS):  # a small figure of a large picture
        layer = averaged(layer, block + 1).astype(np.float32)
        shown = replace(shown, values=layer if layer.shape[2] == 3 else layer[:, :, 0])
    if shown.kind == "direction":
        return np.round(127.5 * (np.nan_to_num(layer).clip(-1.0, 1.0) + 1.0)).astype(np.uint8)
    if shown.kind == "scalar":
        return false_colour(shown.values, *shown.range)
    is_albedo = shown.kind == "albedo"
    return tonemap(layer, 0.0 if is_albedo else exposure, "srgb" if is_albedo else curve)


def _settings(entries: Sequence[Entry]) -> list[Part]:
    names = [e.name for e in entries]
    settings = [flatten(e.metadata.get("settings", {})) for e in entries]
    changed, every = settings_tables(names, settings, [flatten(e.defaults) for e in entries])
    if every is None:
        return []
    if not any(e.defaults for e in entries):  # no defaults are known
        return [Facts(every), *_shaded(every)]
    folded = Folded("All settings", [Facts(every)])
    if changed is None:
        return [Text("All settings have their defaults."), folded]
    return [Facts(changed), *_shaded(changed), folded]


def _shaded(table: FactTable) -> list[Part]:
    return [Text("Shaded rows differ.")] if any(row.differs for row in table.rows) else []


def _facts(entries: Sequence[Entry], select: Any) -> list[Part]:
    facts: list[Mapping[str, Any]] = [flatten(select(e.metadata)) for e in entries]
    table = fact_table([e.name for e in entries], facts)
    return [] if table is None else [Facts(table)]


def _machine() -> Part:
    table = fact_table(["this machine"], [machine()])
    assert table is not None
    return Facts(table)


def _commands(entries: Sequence[Entry]) -> list[Part]:
    return [Command(e.command, f"The picture of {e.name} alone, with as many passes") for e in entries if e.command]
