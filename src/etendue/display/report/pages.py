"""The one template of all pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..curves import CURVES
from ..pages import page
from .parts import Page

#: Characters of a page: below 6 MB with the viewer's tables of curves.
_ROOM, _TABLES = 5_800_000, 180_000
#: Characters that the data of pictures may always have.
_LEAST = 500_000


def render_page(shown: Page, viewer: Callable[[int], dict[str, Any]] | None = None) -> str:
    """The text of a page. ``viewer`` makes the viewer's data in about the number of characters left for it."""
    if viewer is not None:
        shown.viewer = None
        shown.viewer = viewer(max(_LEAST, _ROOM - _TABLES - len(_text(shown).encode())))
    return _text(shown)


def _text(shown: Page) -> str:
    return page("report.html", page=shown, curves=list(CURVES))
