"""The one template of all pages."""

from __future__ import annotations

from ..curves import CURVES
from ..pages import page
from .parts import Page


def render_page(shown: Page) -> str:
    """The text of a page."""
    return page("report.html", page=shown, curves=list(CURVES))
