"""Tables of which the fast tests run a part: every row of a list now and then, every value of a cross in some pair."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

from etendue.scene import bundled

#: Bundled scenes for RGB variants.
RGB_SCENES = [name for name, scene in bundled().items() if not scene.is_spectral]
#: Bundled scenes of fast tests: those of the library's own, and two of the theses'.
FAST_SCENES = (*list(bundled())[: list(bundled()).index("smoke") + 1], "glass-of-water", "six-cubes")


def thinned(rows: Iterable[Any], fast: Sequence[Any]) -> list[Any]:
    """The rows, those that are not in ``fast`` marked slow."""
    rows = list(rows)
    assert set(fast) <= set(rows), f"no rows: {set(fast) - set(rows)}"
    return [
        row if row in fast else pytest.param(*(row if isinstance(row, tuple) else (row,)), marks=pytest.mark.slow)
        for row in rows
    ]


def crossed(first: Iterable[Any], second: Iterable[Any], every: int, slow: int = 1) -> list[Any]:
    """(first, second) of all pairs, or of one in ``slow`` of a row and of a column; one in ``every`` is fast."""
    assert every % slow == 0
    return [
        pytest.param(a, b, marks=() if (i + j) % every == 0 else pytest.mark.slow)
        for i, a in enumerate(first)
        for j, b in enumerate(second)
        if (i + j) % slow == 0
    ]
