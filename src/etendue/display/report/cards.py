"""A small piece of a page for notebooks: a picture, key figures, the progress of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..pages import page
from .figures import Figure, fitted
from .tables import flatten, value_text

#: Characters for the figures of a card, and their width in pixels.
_ROOM, _ACROSS = 300_000, 480


def card(
    title: str,
    facts: Mapping[str, Any],
    figures: Sequence[Figure] = (),
    *,
    fraction: float | None = None,
    status: str = "",
) -> str:
    """HTML without style sheet and script, for light and dark surroundings. ``fraction``: share of the work that is
    done, for a bar; ``status``: a line below the title."""
    shown = {name: value_text(value) for name, value in flatten(facts).items() if value is not None}
    return page(
        "card.html",
        title=title,
        facts=shown,
        figures=fitted(figures, _ROOM, _ACROSS) if figures else [],
        fraction=fraction,
        status=status,
    )
