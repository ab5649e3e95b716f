"""Results show themselves in notebooks."""

from __future__ import annotations

from importlib import import_module


class InNotebooks:
    """Base of what a notebook shows as a picture and key figures.

    How is known to ``etendue.jobs.pages.notebook``, above all rooms that make results; it is imported when a notebook
    asks.
    """

    def _repr_html_(self) -> str | None:
        """HTML for a notebook; ``None`` if there is nothing to show, for the text instead."""
        html: str | None = import_module("etendue.jobs.pages.notebook").html_of(self)
        return html
