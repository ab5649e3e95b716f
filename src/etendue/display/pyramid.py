"""A technique pyramid on the comparison page: the triangle that papers print [Veach 1997, fig. 10.3].

A row holds the ways of making paths of one length, a column those with the same number of light vertices. All pictures
are shown at the exposure of the page, so that the weighted ones add up to the picture by eye, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import NDArray

from etendue.film import LONGER, Technique, block_average

from .figures import figure
from .tonemap import tonemap

Image = NDArray[np.float32]

#: Pictures of a triangle are averaged in blocks down to this many pixels across.
_ACROSS = 240


def in_pyramid(layer: str) -> bool:
    """Whether a layer of this name belongs to a technique pyramid."""
    return layer == LONGER or Technique.of_layer(layer) is not None


def pyramid_block(name: str, image: Image, layers: Mapping[str, Image], exposure: float, curve: str) -> str:
    """The triangles of one picture, weighted and unweighted; empty if ``layers`` holds no pyramid."""
    whole = _level(image)
    blocks = []
    for weighted, title in ((True, "weighted: the parts of the picture"), (False, "unweighted: each technique alone")):
        pictures = {
            found[0]: layer
            for key, layer in layers.items()
            if (found := Technique.of_layer(key)) is not None and found[1] == weighted
        }
        if not pictures:
            continue
        tables, most = "", max(t.s for t in pictures)
        for merged, heading in ((False, "Sub-paths joined by an edge"), (True, "Sub-paths merged at a vertex")):
            chosen = {t: layer for t, layer in pictures.items() if t.merged == merged}
            if chosen:
                tables += _triangle(f"{heading}, {title.partition(':')[0]}", name, chosen, most, whole, exposure, curve)
        if weighted and LONGER in layers:
            alt = f"longer paths of {name}, weighted"
            longer = figure(_small(layers[LONGER], exposure, curve), alt, "longer paths", _share(layers[LONGER], whole))
            tables += f'<div class="longer">{longer}</div>'
        blocks.append(f"<details open><summary>{escape(name)}, {title}</summary>{tables}</details>")
    return "".join(blocks)


def _triangle(
    heading: str, name: str, pictures: Mapping[Technique, Image], most: int, whole: float, exposure: float, curve: str
) -> str:
    """A table of the techniques of one kind, with columns up to s = ``most``."""
    columns = range(most + 1)
    head = "".join(f'<th scope="col">s = {s}</th>' for s in columns)
    rows = []
    for edges in sorted({t.edges for t in pictures}):
        row = {t.s: t for t in pictures if t.edges == edges}
        cells = []
        for s in columns:
            cell = ""
            if technique := row.get(s):
                layer = pictures[technique]
                alt = f"s = {s}, t = {technique.t} of {name}: {heading}"
                cell = figure(_small(layer, exposure, curve), alt, f"t = {technique.t}", _share(layer, whole))
            cells.append(f"<td>{cell}</td>")
        rows.append(f'<tr><th scope="row">{edges} edge{"s" if edges > 1 else ""}</th>{"".join(cells)}</tr>')
    return (
        f'<div class="scroll"><table class="pyramid"><caption>{escape(heading)}</caption>'
        f"<thead><tr><td></td>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _small(layer: Image, exposure: float, curve: str) -> NDArray[np.uint8]:
    """Averaged as radiance, then tone-mapped; what does not fill a block at the edges is left out."""
    height, width = layer.shape[:2]
    factor = min(max(1, round(width / _ACROSS)), height)
    cropped = layer[: height // factor * factor, : width // factor * factor]
    return tonemap(block_average(cropped, factor), exposure, curve)


def _level(image: Image) -> float:
    finite = np.isfinite(image).all(axis=2)
    return float(np.asarray(image, np.float64)[finite].mean()) if finite.any() else 0.0


def _share(layer: Image, whole: float) -> str:
    """Mean of the layer as a share of that of the picture."""
    return f"{100.0 * _level(layer) / whole:.2g} %" if whole > 0.0 else ""
