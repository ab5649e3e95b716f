"""Projections of a point set as squares side by side, in SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import ArrayLike

#: Size of a square and of its margins, in pixels.
_SQUARE, _GAP, _HEAD, _FOOT = 240.0, 28.0, 44.0, 22.0


@dataclass(frozen=True)
class Projection:
    """A square of points: ``x`` and ``y`` in [0, 1], the names of both axes, and an optional line above."""

    x: ArrayLike
    y: ArrayLike
    x_label: str
    y_label: str
    note: str = ""


def projection_plot(projections: Sequence[Projection], title: str, *, columns: int = 4) -> str:
    """The squares, ``columns`` in a row, under ``title``: a complete SVG file, legible on light and dark pages."""
    columns = max(1, min(columns, len(projections)))
    rows = -(-len(projections) // columns)
    width = _GAP + columns * (_SQUARE + _GAP)
    height = _HEAD + rows * (_SQUARE + _GAP + _FOOT)
    squares = "".join(
        _square(p, _GAP + (i % columns) * (_SQUARE + _GAP), _HEAD + 18 + (i // columns) * (_SQUARE + _GAP + _FOOT))
        for i, p in enumerate(projections)
    )
    names = "; ".join(f"{p.y_label} over {p.x_label}{f', {p.note}' if p.note else ''}" for p in projections)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" role="img" aria-label="{escape(f"{title}: {names}")}" '
        'font-family="sans-serif" font-size="13">'
        "<style>:root{color:#222;background:#fff}"
        "@media(prefers-color-scheme:dark){:root{color:#ddd;background:#181818}}"
        "text{fill:currentColor}</style>"
        f'<text x="{_GAP}" y="24" font-size="15" font-weight="bold">{escape(title)}</text>{squares}</svg>\n'
    )


def _square(projection: Projection, left: float, top: float) -> str:
    x, y = np.asarray(projection.x, float), np.asarray(projection.y, float)
    # All points are one path of round dots, which is much smaller than an element for each point.
    radius = float(np.clip(0.22 * _SQUARE / np.sqrt(max(len(x), 1)), 0.6, 2.2))
    dots = "".join(f"M{a:.2f} {b:.2f}h0" for a, b in zip(x * _SQUARE, (1 - y) * _SQUARE, strict=True))
    note = escape(projection.note)
    return (
        f'<g transform="translate({left:.1f} {top:.1f})">'
        f'<rect width="{_SQUARE:.0f}" height="{_SQUARE:.0f}" fill="none" stroke="currentColor" stroke-opacity=".5"/>'
        f'<path d="{dots}" stroke="#0072b2" stroke-width="{2 * radius:.2f}" stroke-linecap="round" fill="none"/>'
        f'<text x="0" y="-6">{note}</text>'
        f'<text x="{_SQUARE / 2:.0f}" y="{_SQUARE + 16:.0f}" text-anchor="middle">{escape(projection.x_label)}</text>'
        f'<text transform="translate(-8 {_SQUARE / 2:.0f}) rotate(-90)" text-anchor="middle">'
        f"{escape(projection.y_label)}</text></g>"
    )
