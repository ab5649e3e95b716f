"""Opening a viewer: a session and its server."""

from __future__ import annotations

import atexit
import webbrowser
from collections.abc import Iterable
from html import escape
from typing import Self

from etendue import methods
from etendue.core import OptionError, Result
from etendue.display import TevDisplay

from .access.addresses import given_address, origins_of, reached
from .cells import Cell, running_cell
from .server import Server
from .session import ViewerSession
from .states import Asked

#: All open viewers, also viewers without another reference: their threads go on. A process that ends in the middle of a
#: kernel may crash, so viewers are closed before the process ends.
_open: set[Viewer] = set()
#: Why a viewer is closed when its cell opens another one.
_AGAIN = "this cell was run again"
#: Height of the frame in a notebook, in pixels.
_HEIGHT = 720


@atexit.register
def _close_all() -> None:
    for viewer in list(_open):
        viewer.close()


def _close_earlier(cell: Cell) -> None:
    """Close the viewers of earlier runs of a cell, which have no page any more, and viewers that a page has ended."""
    for viewer in list(_open):
        if cell.is_again(viewer._cell):
            viewer._why = _AGAIN
            viewer.close()
        elif viewer.wait(0):
            viewer.close()


class Viewer:
    """A scene that is shown in browsers until :meth:`close`; in a notebook, below the cell, until that cell opens
    another one. ``url``: its address."""

    def __init__(
        self,
        asked: Asked,
        host: str = "127.0.0.1",
        port: int = 0,
        tev: str | None = None,
        origins: Iterable[str] = (),
        address: str | None = None,
    ) -> None:
        if not isinstance(port, int) or not 0 <= port < 1 << 16:
            raise OptionError(f"a port is a whole number from 0 (any that is free) to 65535, not {port!r}")
        methods.get(asked.method).Settings.from_mapping(asked.settings, owner=f"method '{asked.method}'")
        self._address = given_address(address)
        self._why = ""  # reason for the end, if known
        self._cell = running_cell()
        _close_earlier(self._cell)  # before the port is taken and the scene loaded
        self._second = None if tev is None else TevDisplay(tev, "etendue view")
        self._session = ViewerSession(asked)
        self._server = Server(self._session, host, port, origins)  # before the scene is loaded, which may take long
        self._server.trusted.allow(origins_of(self._address, self._server.port))
        if self._second is not None and self._second.connect():
            offer = self._second.offer
            self._session.on_picture = lambda layers: offer(lambda: Result(dict(layers)))
        self._session.start()
        _open.add(self)

    @property
    def url(self) -> str:
        """The address of the page, with the token that every request needs; below ``address`` if that was given."""
        server = self._server
        return reached(self._address, server.port, server.token) if self._address else server.url

    def show(self) -> bool:
        """Open the page in a browser of this machine; returns whether one was found."""
        return webbrowser.open(self._server.url)

    def loaded(self, timeout: float | None = None) -> bool:
        """Wait until loading the scene has ended, also by failure; returns whether it has."""
        return self._session.opened.wait(timeout)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until a page or :meth:`close` has ended the session; returns whether it has ended."""
        return self._session.ended.wait(timeout)

    def close(self) -> None:
        """End the session, disconnect the pages and release the scene."""
        self._session.close()
        self._server.close(self._why)
        if self._second is not None:
            self._second.close()
        _open.discard(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<etendue.Viewer {'ended' if self._session.ended.is_set() else self.url}>"

    def _repr_html_(self) -> str:
        if self._session.ended.is_set():
            return f"<p>The viewer has ended{f': {self._why}' if self._why else ''}.</p>"
        # An object and not an iframe: without the server, as in a saved notebook, browsers show the content of the
        # object instead of an error page. It is inline, so that only the live page has the fixed height.
        return (
            '<div style="box-sizing: border-box; width: 100%; overflow: hidden; border: 1px solid #8888; '
            f'border-radius: 6px"><object type="text/html" data="{escape(self.url)}" aria-label="étendue viewer" '
            f'style="width: 100%; height: {_HEIGHT}px; vertical-align: bottom">'
            '<p style="margin: 1em">This viewer has ended, or the browser cannot reach it. Run the cell again to open '
            "one; if Python runs on another machine, give <code>address=</code>.</p></object></div>"
        )
