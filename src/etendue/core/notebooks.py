"""Display of results in notebooks."""

from __future__ import annotations

from importlib import import_module


class InNotebooks:
    """Base of objects that a notebook shows as a picture and key figures.

    ``etendue.jobs.pages.notebook`` makes the HTML. It depends on all packages that make results, and is therefore
    imported only when a notebook displays one.
    """

    def _repr_html_(self) -> str | None:
        """HTML for a notebook; ``None`` if there is nothing to show: the notebook then shows the text."""
        html: str | None = import_module("etendue.jobs.pages.notebook").html_of(self)
        return html
