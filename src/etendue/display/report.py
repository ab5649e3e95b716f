"""The comparison page: one HTML file that contains its pictures, figures and script, and loads nothing from the
network.

It reads as a page without its script: pictures, error maps, tables and the plot are in the markup. The script adds the
exposure, which needs radiance rather than bytes: pictures travel as shared-exponent pixels [Ward 1991], deflated.
"""

from __future__ import annotations

import base64
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError
from etendue.film import flip, flip_is_installed, relative_bias, relative_mse, relative_squared_error, write_bytes

from .colours import css_gradient, false_colour
from .curves import CURVES, TABLE_RANGE
from .figures import Figure
from .pages import page
from .plots import Series, convergence_plot
from .pyramid import in_pyramid, pyramids
from .tables import Column, FactTable, fact_table, flatten, number_text, time_text
from .tonemap import auto_exposure, tonemap

Image = NDArray[np.float32]

#: The range of the error maps: relMSE of a single pixel, from 1 % to ten times its value.
_ERROR_RANGE = (1e-4, 1e2)
_TRIM = 0.001
#: Pictures above this size have no exposure slider, since their page would be too large for a browser.
_MOST_PIXELS = 1_500_000


@dataclass
class Entry:
    """One picture of a comparison.

    ``image`` is (height, width, 3) linear radiance. ``metadata`` is that of a ``Result``: ``settings`` and ``versions``
    (mappings) get tables of their own, ``seconds`` and ``passes`` go to the caption, everything else is listed.
    ``error_history`` holds rows (seconds, relMSE). ``layers`` are further pictures to show, by name.
    """

    name: str
    image: Image
    metadata: Mapping[str, Any] = field(default_factory=dict)
    error_history: Sequence[tuple[float, float]] = ()
    layers: Mapping[str, Image] = field(default_factory=dict)


def write_report(
    path: str | os.PathLike[str],
    entries: Sequence[Entry],
    reference: Image | None = None,
    *,
    title: str = "Comparison",
    subtitle: str = "",
    reference_note: str = "",
    exposure: float | None = None,
    curve: str = "srgb",
) -> None:
    """Write a self-contained HTML page that compares ``entries`` with each other and with ``reference``.

    All pictures are shown at one ``exposure`` (stops; by default the one that suits the reference, else the first
    entry). ``reference_note`` says how the reference was made. Raises :class:`OptionError` without an entry, on two
    entries of one name or on pictures of different sizes, and :class:`OutputError` if the file cannot be written.
    """
    text = render_report(
        entries,
        reference,
        title=title,
        subtitle=subtitle,
        reference_note=reference_note,
        exposure=exposure,
        curve=curve,
    )
    write_bytes(path, text.encode())


def render_report(
    entries: Sequence[Entry],
    reference: Image | None = None,
    *,
    title: str = "Comparison",
    subtitle: str = "",
    reference_note: str = "",
    exposure: float | None = None,
    curve: str = "srgb",
) -> str:
    """The text of the page that :func:`write_report` writes."""
    _check(entries, reference)
    pictures = [(e.name, e.image) for e in entries] + ([("reference", reference)] if reference is not None else [])
    if exposure is None:
        exposure = auto_exposure(pictures[-1][1] if reference is not None else entries[0].image)
    return page(
        "report.html",
        title=title,
        subtitle=subtitle,
        names=[e.name for e in entries],
        verdict=_verdict(entries, reference),
        pictures=_pictures(entries, pictures, reference_note, exposure, curve),
        errors=_errors(entries, reference),
        plots=_plots(entries),
        pyramids=[p for e in entries for p in pyramids(e.name, e.image, e.layers, exposure, curve)],
        layers=_layers(entries, exposure, curve),
        tables=_tables(entries),
        curves=list(CURVES),
        script_data=_script_data(pictures, exposure, curve),
    )


def _check(entries: Sequence[Entry], reference: Image | None) -> None:
    if not entries:
        raise OptionError("a comparison needs at least one picture")
    names = [e.name for e in entries]
    if len(set(names)) < len(names):
        raise OptionError(f"pictures of a comparison need different names, not {', '.join(names)}")
    shapes = {e.name: e.image.shape for e in entries} | ({} if reference is None else {"reference": reference.shape})
    if len(set(shapes.values())) > 1 or any(len(s) != 3 or s[2] != 3 for s in shapes.values()):
        listed = ", ".join(f"{name} is {' x '.join(map(str, shape))}" for name, shape in shapes.items())
        raise OptionError(f"pictures of a comparison need one size with three channels; {listed}")


def _verdict(entries: Sequence[Entry], reference: Image | None) -> dict[str, str] | None:
    """Which picture has the smallest error, if there is a choice."""
    if reference is None or len(entries) < 2:
        return None
    errors = sorted((relative_mse(e.image, reference), e.name) for e in entries)
    (best, winner), (worst, loser) = errors[0], errors[-1]
    if not 0.0 < best < worst:
        return None
    texts = {"best": number_text(best), "worst": number_text(worst), "factor": number_text(worst / best, 2)}
    return {"winner": winner, "loser": loser} | texts


def _pictures(
    entries: Sequence[Entry], pictures: list[tuple[str, Image]], note: str, exposure: float, curve: str
) -> list[Figure]:
    figures = []
    for index, (name, image) in enumerate(pictures):
        facts = _facts(entries[index]) if index < len(entries) else [note] if note else []
        bad = int((~np.isfinite(image).all(axis=2)).sum())
        if bad:
            facts.append(f"{bad} pixel{'s' if bad != 1 else ''} not finite")
        alt = f"picture by {name}" if index < len(entries) else "reference picture"
        figures.append(Figure(tonemap(image, exposure, curve), alt, name, " · ".join(facts), index))
    return figures


def _facts(entry: Entry) -> list[str]:
    facts = []
    if "seconds" in entry.metadata:
        facts.append(time_text(float(entry.metadata["seconds"])))
    if "passes" in entry.metadata:
        passes = int(entry.metadata["passes"])
        facts.append(f"{passes} pass{'es' if passes != 1 else ''}")
    return facts


def _errors(entries: Sequence[Entry], reference: Image | None) -> dict[str, Any] | None:
    """Measures of error, one map for each picture, and the scale of the maps."""
    if reference is None:
        return None
    with_flip = flip_is_installed()
    columns = [
        Column("relMSE", [relative_mse(e.image, reference) for e in entries]),
        Column("without the worst 0.1 %", [relative_mse(e.image, reference, trim=_TRIM) for e in entries]),
        *([Column("FLIP", [flip(e.image, reference) for e in entries])] if with_flip else []),
        Column("bias of the mean", [relative_bias(e.image, reference) for e in entries], percent=True),
    ]
    seconds = [e.metadata.get("seconds") for e in entries]
    if all(s is not None for s in seconds):
        columns.insert(0, Column("time", [float(s) for s in seconds if s is not None], seconds=True))
    maps = []
    for entry in entries:
        pixels = false_colour(relative_squared_error(entry.image, reference), *_ERROR_RANGE)
        caption = f"relMSE {number_text(relative_mse(entry.image, reference))}"
        maps.append(Figure(pixels, f"error map of {entry.name}", entry.name, caption))
    ticks = [f"{value:g}" for value in np.geomspace(*_ERROR_RANGE, 4)]
    return {"columns": columns, "maps": maps, "ticks": ticks, "gradient": css_gradient(), "flip": with_flip}


def _plots(entries: Sequence[Entry]) -> dict[str, str] | None:
    """The error over time as SVG, for wide and for narrow windows."""
    series = [Series(e.name, e.error_history) for e in entries]
    wide = convergence_plot(series)
    return {"wide": wide, "narrow": convergence_plot(series, width=360, height=320)} if wide else None


def _layers(entries: Sequence[Entry], exposure: float, curve: str) -> list[tuple[str, list[Figure]]]:
    """Names of pictures, and their layers that are not part of a pyramid."""
    found = []
    for entry in entries:
        figures = [
            Figure(_layer_pixels(name, layer, exposure, curve), f"layer {name} of {entry.name}", name)
            for name, layer in entry.layers.items()
            if name != "image" and not in_pyramid(name) and layer.ndim == 3 and layer.shape[2] == 3
        ]
        if figures:
            found.append((entry.name, figures))
    return found


def _layer_pixels(name: str, layer: Image, exposure: float, curve: str) -> NDArray[np.uint8]:
    """Directions as colours around grey, reflectances as they are, radiance like the picture."""
    if name == "normal":
        return np.round(127.5 * (np.nan_to_num(layer).clip(-1.0, 1.0) + 1.0)).astype(np.uint8)
    return tonemap(layer, 0.0 if name == "albedo" else exposure, "srgb" if name == "albedo" else curve)


def _tables(entries: Sequence[Entry]) -> list[tuple[str, FactTable | None]]:
    names = [e.name for e in entries]
    settings = [flatten(e.metadata.get("settings", {})) for e in entries]
    facts = [flatten({k: v for k, v in e.metadata.items() if k not in ("settings", "versions")}) for e in entries]
    versions = [flatten(e.metadata.get("versions", {})) for e in entries]
    return [
        ("Settings", fact_table(names, settings, mark=True)),
        ("Runs", fact_table(names, facts)),
        ("Versions", fact_table(names, versions)),
    ]


def _script_data(pictures: list[tuple[str, Image]], exposure: float, curve: str) -> dict[str, Any] | None:
    """Data of the script; ``None`` for very large pictures."""
    height, width = pictures[0][1].shape[:2]
    if height * width > _MOST_PIXELS:
        return None
    return {
        "width": width,
        "height": height,
        "names": [name for name, _ in pictures],
        "left": 0,
        "right": min(1, len(pictures) - 1),
        "exposure": exposure,
        "curve": curve,
        "range": TABLE_RANGE,
        "curves": {name: known.tables() for name, known in CURVES.items()},
        "planes": [base64.b64encode(zlib.compress(shared_exponent(p).tobytes(), 9)).decode() for _, p in pictures],
    }


def shared_exponent(image: Image) -> NDArray[np.uint8]:
    """Planes (4, height, width) of three mantissas and an exponent: value = mantissa 2^(exponent - 136) [Ward 1991].

    NaN and negative values become 0, values beyond the range its largest.
    """
    x = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, posinf=1e30, neginf=0.0).clip(0.0, 1e30)
    _, exponent = np.frexp(x.max(axis=2) * (1.0 + 1.0 / 510.0))  # so that the largest mantissa rounds to 255 at most
    exponent = np.clip(exponent, -127, 127)
    mantissa = np.minimum(np.round(np.ldexp(x, 8 - exponent[:, :, None])), 255.0)
    planes = np.concatenate([mantissa, (exponent + 128)[:, :, None]], axis=2).astype(np.uint8)
    return np.ascontiguousarray(np.moveaxis(planes, 2, 0))
