"""Panels: parts of the viewer with a handler in Python and a module of the page in JavaScript.

A panel is a subclass of :class:`Panel` in a file of this folder, listed in :data:`PANELS`, and an ES module in
``assets/panels``. It gets the messages whose type begins with its name (``rays.trace`` is ``handle("trace", ...)`` of
the panel ``rays``), and sends its own messages with the same beginning.

All methods of a panel run in the session's thread, between two passes. No other thread uses Mitsuba or Dr.Jit.

The module exports a function that is called once with its ``host``::

    export default function (host) {
      host.element          // where the panel puts its controls, in the side bar; the page has made its heading
      host.overlay          // an SVG group above the picture; its unit is a pixel of the picture
      host.send(verb, data)                 // message to the panel in Python
      host.on(verb, (message, data) => {})  // from it; data is a DataView, empty without data
      host.onState((state) => {})           // the session's state, now and after every change
      host.onPick((picked) => {})           // after a click into the picture
      host.project([x, y, z])               // -> [x, y] in pixels of the picture, null behind the camera
      host.controls(list, values, (name, value) => {})  // -> a <div> of labelled fields, see etendue.viewer.controls
      host.canvas(title)                    // -> {canvas, close()}: a large canvas in place of the picture; set onclose
      host.page(title)                      // -> {element, close()}: the same with an element for text and pictures
      host.ask(type, data)                  // a message to the session itself, such as "camera"
      host.make(tag, attributes, ...children), host.short(number)  // build elements, write numbers
      host.numeric(text), host.numerics(text)  // -> the number or numbers typed; text that is no number stays text
      host.fillIn(input, value)             // show the current value in a field, unless something is being typed there
      host.isTyping(element)                // whether something is being typed below an element
      host.say(text, kind)                  // a line in the log of the page; kind "error" for an error
    }

Colours, spacing and focus rings come from ``viewer.css``; use its variables (``--ink``, ``--panel``, ``--accent``).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Final

if TYPE_CHECKING:
    import mitsuba as mi

    from ..clients import Client
    from ..session import ViewerSession

#: The panels in the order of the side bar: module in this folder, class.
PANELS: Final[tuple[tuple[str, str], ...]] = (
    ("lights", "Lights"),
    ("parameters", "Parameters"),
    ("space", "Space"),
    ("pyramid", "Pyramid"),
)


class Panel:
    """A part of the viewer. A subclass overrides what it needs."""

    name: ClassVar[str]  #: beginning of the types of its messages, letters only
    title: ClassVar[str]  #: heading in the page
    script: ClassVar[str]  #: module in ``assets/panels``, such as ``rays.js``

    def __init__(self, session: ViewerSession) -> None:
        #: ``session.problem``: scene, sensor and size that are rendered, ``None`` without a scene; ``session.pose``;
        #: ``session.layers``: layers of the latest picture; ``session.again()``: start the picture anew after a change;
        #: ``session.broadcast(kind, payload, **fields)`` to all pages, ``client.send`` to one.
        self.session = session

    def handle(self, verb: str, message: Mapping[str, Any], client: Client) -> None:
        """A message of a page. An :class:`EtendueError` that it raises is shown in that page and in the terminal."""

    def state(self) -> Any:
        """Plain values for the page, in the session's state under ``panels[name]``; ``None`` for nothing."""
        return None

    def scene_loaded(self) -> None:
        """Another scene was loaded, or the same scene again (a light was added). ``session.problem`` is new."""

    def scene_edited(self) -> None:
        """Parameters of the scene were changed in place: everything computed from it is outdated."""

    def after_pass(self) -> None:
        """A pass was added to the picture, and pages were informed."""

    def work(self) -> bool:
        """A slice of work of its own, of at most about 0.2 seconds, between two passes; returns whether more is left.
        Called whenever the session is not moving the camera."""
        return False

    def loading(self, state: mi.parser.ParserState, same: bool) -> None:
        """Change the parsed scene before its objects are built. ``same``: it is the previous scene, loaded again."""

    def describe(self, state: mi.parser.ParserState) -> None:
        """Change the parsed scene before it is written to a file, so that it has the panel's edits."""

    def is_edited(self) -> bool:
        """Whether :meth:`describe` has something to change."""
        return False

    def close(self) -> None:
        """The session ends: release scenes and arrays."""


def panels(session: ViewerSession) -> dict[str, Panel]:
    """All panels of a session, by name."""
    made: list[Panel] = [getattr(import_module(f"{__name__}.{module}"), kind)(session) for module, kind in PANELS]
    return {panel.name: panel for panel in made}
