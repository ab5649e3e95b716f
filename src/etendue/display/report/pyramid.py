"""A technique pyramid on a page: the usual triangle [Veach 1997, fig. 10.3].

A row holds the techniques for paths of one length, a column techniques with the same number of light vertices. All
pictures are shown at the exposure of the page, so that the sum of the weighted pictures is the displayed picture.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from etendue.film import LONGER, Technique, block_average

from ..tonemapping import tonemap
from .figures import Figure

Image = NDArray[np.float32]

#: Pictures of a triangle are averaged in blocks down to this many pixels across.
_ACROSS = 240


@dataclass(frozen=True)
class Triangle:
    """Techniques of one kind. ``rows``: the number of edges, and a figure or ``None`` for each of ``columns``."""

    heading: str
    columns: Sequence[int]
    rows: Sequence[tuple[int, Sequence[Figure | None]]]


@dataclass(frozen=True)
class PyramidView:
    """Triangles of one picture, and the picture of the paths that are too long for them."""

    title: str
    triangles: Sequence[Triangle]
    longer: Figure | None

    @property
    def size(self) -> int:
        """Number of characters that its figures take on a page."""
        cells = [cell for t in self.triangles for _, row in t.rows for cell in row]
        return sum(figure.size for figure in (*cells, self.longer) if figure is not None)

    def stored(self, across: int) -> PyramidView:
        """The same with figures of at most ``across`` pixels."""

        def small(figure: Figure | None) -> Figure | None:
            return None if figure is None else replace(figure, across=across)

        triangles = [
            replace(t, rows=[(edges, [small(cell) for cell in row]) for edges, row in t.rows]) for t in self.triangles
        ]
        return replace(self, triangles=triangles, longer=small(self.longer))


def in_pyramid(layer: str) -> bool:
    """Whether a layer of this name belongs to a technique pyramid."""
    return layer == LONGER or Technique.of_layer(layer) is not None


def pyramids(name: str, image: Image, layers: Mapping[str, Image], exposure: float, curve: str) -> list[PyramidView]:
    """The pyramids of one picture, weighted and unweighted; none if ``layers`` holds no technique."""
    whole, found = _level(image), []

    def show(layer: Image, alt: str, caption: str) -> Figure:
        return Figure(_small(layer, exposure, curve), alt, caption, _share(layer, whole))

    for weighted, kind, meaning in (
        (True, "weighted", "the parts of the picture"),
        (False, "unweighted", "each technique alone"),
    ):
        pictures = {
            technique[0]: layer
            for key, layer in layers.items()
            if (technique := Technique.of_layer(key)) is not None and technique[1] == weighted
        }
        if not pictures:
            continue
        columns = range(max(t.s for t in pictures) + 1)
        triangles = []
        for merged, joint in ((False, "Sub-paths joined by an edge"), (True, "Sub-paths merged at a vertex")):
            heading = f"{joint}, {kind}"
            figures = {
                t: show(layer, f"s = {t.s}, t = {t.t} of {name}: {heading}", f"t = {t.t}")
                for t, layer in pictures.items()
                if t.merged == merged
            }
            rows = []
            for edges in sorted({t.edges for t in figures}):
                row = {t.s: shown for t, shown in figures.items() if t.edges == edges}
                rows.append((edges, [row.get(s) for s in columns]))
            if rows:
                triangles.append(Triangle(heading, columns, rows))
        longer = None
        if weighted and LONGER in layers:
            longer = show(layers[LONGER], f"longer paths of {name}, weighted", "longer paths")
        found.append(PyramidView(f"{name}, {kind}: {meaning}", triangles, longer))
    return found


def _small(layer: Image, exposure: float, curve: str) -> NDArray[np.uint8]:
    """The layer averaged as radiance, then tone-mapped; incomplete blocks at the edges are omitted."""
    height, width = layer.shape[:2]
    factor = min(max(1, round(width / _ACROSS)), height)
    cropped = layer[: height // factor * factor, : width // factor * factor]
    return tonemap(block_average(cropped, factor), exposure, curve)


def _level(image: Image) -> float:
    finite = np.isfinite(image).all(axis=2)
    return float(np.asarray(image, np.float64)[finite].mean()) if finite.any() else 0.0


def _share(layer: Image, whole: float) -> str:
    """Mean of the layer relative to the mean of the picture, as text."""
    return f"{100.0 * _level(layer) / whole:.2g} %" if whole > 0.0 else ""
