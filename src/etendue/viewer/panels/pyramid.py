"""The technique pyramid of the picture: the contribution of each sampling technique."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from etendue.core import OptionError
from etendue.display import in_pyramid, pyramids

from ..shown import encoded
from . import Panel

if TYPE_CHECKING:
    from ..clients import Client


class Pyramid(Panel):
    """Shows the layers of ``pyramid=true`` as triangles."""

    name: ClassVar[str] = "pyramid"
    title: ClassVar[str] = "Technique pyramid"
    script: ClassVar[str] = "pyramid.js"

    def state(self) -> dict[str, Any]:
        """Whether the picture has the layers."""
        return {"there": any(map(in_pyramid, self.session.layers))}

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """``show``: the triangles of the picture as it is now."""
        if verb != "show":
            raise OptionError(f"there is no message 'pyramid.{verb}'; there is show")
        session = self.session
        if not any(map(in_pyramid, session.layers)):
            raise OptionError("the picture has no technique pyramid: choose bpt, bpm or vcm and set pyramid")
        image = session.layers["image"]
        views = pyramids(session.asked.method, image, session.layers, session.stops, session.show.curve)
        shown = [
            {
                "title": view.title,
                "triangles": [
                    {
                        "heading": triangle.heading,
                        "columns": list(triangle.columns),
                        "rows": [[edges, [_plain(figure) for figure in row]] for edges, row in triangle.rows],
                    }
                    for triangle in view.triangles
                ],
                "longer": _plain(view.longer),
            }
            for view in views
        ]
        client.send("pyramid.shown", views=shown)


def _plain(figure: Any) -> dict[str, Any] | None:
    if figure is None:
        return None
    data, mime = encoded(figure.pixels)
    source = f"data:{mime};base64,{base64.b64encode(data).decode()}"
    return {"source": source, "alt": figure.alt, "name": figure.name, "caption": figure.caption}
