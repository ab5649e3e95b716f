"""Display of results in notebooks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar


class InNotebooks:
    """Base of objects that a notebook shows as a picture and key figures."""

    #: Makes the HTML of an object, ``None`` if there is nothing to show. Set by the package, since it depends on all
    #: rooms that make results.
    make_html: ClassVar[Callable[[Any], str | None]] = staticmethod(lambda thing: None)

    def _repr_html_(self) -> str | None:
        """HTML for a notebook; ``None``: the notebook shows the text."""
        make: Callable[[Any], str | None] = type(self).make_html
        return make(self)
