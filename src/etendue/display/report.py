"""The comparison page: one HTML file that holds its pictures, figures and script, and asks the network for nothing.

It reads as a page without its script: pictures, error maps, tables and the plot are in the markup. The script adds the
exposure, which needs radiance rather than bytes: pictures travel as shared-exponent pixels [Ward 1991], deflated.
"""

from __future__ import annotations

import base64
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError
from etendue.film import relative_bias, relative_mse, relative_squared_error, write_bytes

from .colours import css_gradient, false_colour
from .figures import figure
from .plots import Series, convergence_plot
from .pyramid import in_pyramid, pyramid_block
from .tables import Column, comparison_table, flatten, number_text, run_table, time_text
from .tonemap import auto_exposure, tonemap

Image = NDArray[np.float32]

#: The range of the error maps: relMSE of a single pixel, from 1 % to ten times its value.
_ERROR_RANGE = (1e-4, 1e2)
_TRIM = 0.001
#: Larger pictures go without the exposure slider, as their page would not fit a browser comfortably.
_MOST_PIXELS = 1_500_000


@dataclass
class Entry:
    """One picture of a comparison.

    ``image`` is (height, width, 3) linear radiance. ``metadata`` is what a ``Result`` carries: ``settings`` and
    ``versions`` (mappings) get tables of their own, ``seconds`` and ``passes`` go to the caption, everything else is
    listed. ``error_history`` holds rows (seconds, relMSE). ``layers`` are further pictures to show, by name.
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
    page = render_report(
        entries,
        reference,
        title=title,
        subtitle=subtitle,
        reference_note=reference_note,
        exposure=exposure,
        curve=curve,
    )
    write_bytes(path, page.encode())


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
    sections = [
        _header(entries, reference, title, subtitle),
        _viewer_section(),
        _pictures_section(entries, pictures, reference_note, exposure, curve),
        _errors_section(entries, reference),
        _plot_section(entries),
        _pyramid_section(entries, exposure, curve),
        _layers_section(entries, exposure, curve),
        _settings_section(entries),
        _run_section(entries),
    ]
    return _page(title, "\n".join(s for s in sections if s), _script_data(pictures, exposure, curve))


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


def _header(entries: Sequence[Entry], reference: Image | None, title: str, subtitle: str) -> str:
    lines = [f"<h1>{escape(title)}</h1>"]
    if subtitle:
        lines.append(f'<p class="soft">{escape(subtitle)}</p>')
    if reference is not None and len(entries) > 1:
        errors = sorted((relative_mse(e.image, reference), e.name) for e in entries)
        (best, winner), (worst, loser) = errors[0], errors[-1]
        if 0.0 < best < worst:
            lines.append(
                f'<p class="verdict"><strong>{escape(winner)}</strong> has the smallest error: relMSE '
                f"{number_text(best)}, {number_text(worst / best, 2)} times below {escape(loser)} "
                f"({number_text(worst)}).</p>"
            )
    return f"<header>{''.join(lines)}</header>"


def _viewer_section() -> str:
    """The markup that the script fills; hidden until it has."""
    return files(__package__).joinpath("assets/viewer.html").read_text(encoding="utf-8")


def _pictures_section(
    entries: Sequence[Entry], pictures: list[tuple[str, Image]], note: str, exposure: float, curve: str
) -> str:
    figures = []
    for index, (name, image) in enumerate(pictures):
        facts = _facts(entries[index]) if index < len(entries) else [note] if note else []
        bad = int((~np.isfinite(image).all(axis=2)).sum())
        if bad:
            facts.append(f"{bad} pixel{'s' if bad != 1 else ''} not finite")
        alt = f"picture by {name}" if index < len(entries) else "reference picture"
        figures.append(figure(tonemap(image, exposure, curve), alt, name, " · ".join(facts), index))
    heading = "Side by side" if len(pictures) > 1 else "Picture"
    return f'<section><h2>{heading}</h2><div class="figures">{"".join(figures)}</div></section>'


def _facts(entry: Entry) -> list[str]:
    facts = []
    if "seconds" in entry.metadata:
        facts.append(time_text(float(entry.metadata["seconds"])))
    if "passes" in entry.metadata:
        passes = int(entry.metadata["passes"])
        facts.append(f"{passes} pass{'es' if passes != 1 else ''}")
    return facts


def _errors_section(entries: Sequence[Entry], reference: Image | None) -> str:
    if reference is None:
        return ""
    columns = [
        Column("relMSE", [relative_mse(e.image, reference) for e in entries]),
        Column("without the worst 0.1 %", [relative_mse(e.image, reference, trim=_TRIM) for e in entries]),
        Column("bias of the mean", [relative_bias(e.image, reference) for e in entries], percent=True),
    ]
    seconds = [e.metadata.get("seconds") for e in entries]
    if all(s is not None for s in seconds):
        columns.insert(0, Column("time", [float(s) for s in seconds if s is not None], seconds=True))
    table = comparison_table([e.name for e in entries], columns)
    maps = []
    for entry in entries:
        error = relative_squared_error(entry.image, reference)
        caption = f"relMSE {number_text(relative_mse(entry.image, reference))}"
        maps.append(figure(false_colour(error, *_ERROR_RANGE), f"error map of {entry.name}", entry.name, caption))
    ticks = "".join(f"<span>{value:g}</span>" for value in np.geomspace(*_ERROR_RANGE, 4))
    return (
        f"<section><h2>Error against the reference</h2>{table}"
        "<p class=soft>relMSE is the mean of (x − ref)² / (ref² + 0.01) over channels and finite pixels; smaller is "
        "better.</p><h3>Where the error is</h3>"
        f'<div class="scale"><div style="background:{css_gradient()}"></div><div>{ticks}</div></div>'
        f'<div class="figures">{"".join(maps)}</div>'
        "<p class=soft>Squared relative error of each pixel, logarithmic; turquoise where a pixel is not finite.</p>"
        "</section>"
    )


def _plot_section(entries: Sequence[Entry]) -> str:
    series = [Series(e.name, e.error_history) for e in entries]
    wide = convergence_plot(series)
    if not wide:
        return ""
    narrow = convergence_plot(series, width=360, height=320)
    wide, narrow = (s.replace('class="plot"', f'class="plot {c}"', 1) for s, c in ((wide, "wide"), (narrow, "narrow")))
    return f"<section><h2>Error over time</h2>{wide}{narrow}</section>"


def _pyramid_section(entries: Sequence[Entry], exposure: float, curve: str) -> str:
    blocks = "".join(pyramid_block(e.name, e.image, e.layers, exposure, curve) for e in entries)
    if not blocks:
        return ""
    return (
        "<section><h2>Technique pyramid</h2><p class=soft>Paths of s vertices from the light and t from the camera, by "
        "length and by s, all at one exposure. Per cent are of the picture's mean; the weighted pictures add up to "
        f"it.</p>{blocks}</section>"
    )


def _layers_section(entries: Sequence[Entry], exposure: float, curve: str) -> str:
    blocks = []
    for entry in entries:
        figures = [
            figure(_layer_pixels(name, layer, exposure, curve), f"layer {name} of {entry.name}", name, "")
            for name, layer in entry.layers.items()
            if name != "image" and not in_pyramid(name) and layer.ndim == 3 and layer.shape[2] == 3
        ]
        if figures:
            blocks.append(
                f"<details><summary>Layers of {escape(entry.name)}</summary>"
                f'<div class="figures">{"".join(figures)}</div></details>'
            )
    return f"<section><h2>Layers</h2>{''.join(blocks)}</section>" if blocks else ""


def _layer_pixels(name: str, layer: Image, exposure: float, curve: str) -> NDArray[np.uint8]:
    """Directions as colours around grey, reflectances as they are, radiance like the picture."""
    if name == "normal":
        return np.round(127.5 * (np.nan_to_num(layer).clip(-1.0, 1.0) + 1.0)).astype(np.uint8)
    return tonemap(layer, 0.0 if name == "albedo" else exposure, "srgb" if name == "albedo" else curve)


def _settings_section(entries: Sequence[Entry]) -> str:
    table = run_table([e.name for e in entries], [flatten(e.metadata.get("settings", {})) for e in entries], mark=True)
    if not table:
        return ""
    mark = "<p class=soft>Shaded rows differ.</p>" if len(entries) > 1 and "differs" in table else ""
    return f"<section><h2>Settings</h2>{table}{mark}</section>"


def _run_section(entries: Sequence[Entry]) -> str:
    facts = [flatten({k: v for k, v in e.metadata.items() if k not in ("settings", "versions")}) for e in entries]
    versions = [flatten(e.metadata.get("versions", {})) for e in entries]
    names = [e.name for e in entries]
    parts = [("Runs", run_table(names, facts)), ("Versions", run_table(names, versions))]
    return "".join(f"<section><h2>{heading}</h2>{table}</section>" for heading, table in parts if table)


def _script_data(pictures: list[tuple[str, Image]], exposure: float, curve: str) -> str:
    """What the script needs, as JSON that cannot end the element it is in; empty for very large pictures."""
    height, width = pictures[0][1].shape[:2]
    if height * width > _MOST_PIXELS:
        return ""
    data = {
        "width": width,
        "height": height,
        "names": [name for name, _ in pictures],
        "left": 0,
        "right": min(1, len(pictures) - 1),
        "exposure": exposure,
        "curve": curve,
        "planes": [base64.b64encode(zlib.compress(shared_exponent(p).tobytes(), 9)).decode() for _, p in pictures],
    }
    return json.dumps(data, ensure_ascii=False).replace("<", "\\u003c")


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


def _page(title: str, body: str, data: str) -> str:
    assets = files(__package__).joinpath("assets")
    style = assets.joinpath("report.css").read_text(encoding="utf-8")
    script = assets.joinpath("report.js").read_text(encoding="utf-8")
    active = f'<script type="application/json" id="pictures">{data}</script>\n<script>{script}</script>' if data else ""
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<main>
{body}
</main>
<footer>Made by étendue. This page holds all its data and loads nothing.</footer>
{active}
</body>
</html>
"""
