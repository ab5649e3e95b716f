"""The server: the page, its assets, saved files, and the WebSocket of a session, for requests with the token.

Every address begins with the token (``/TOKEN/``), so that the relative addresses of the page contain it, also in a
frame of a notebook, where cookies of another site are refused. A request is answered only if its header Host is a name
of this machine and its header Origin a page of this server; a request without Origin, from a program, needs the token
alone. Further origins can be allowed, see :mod:`etendue.viewer.access.trusted`.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import socket
import threading
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any, Protocol
from urllib.parse import quote

from etendue.core import EtendueError, OptionError, describe, library, logger

from .access.trusted import Trusted, is_everywhere
from .clients import Client
from .protocol import LARGEST_MESSAGE, parsed

_PURPOSE, _EXTRA = "the viewer", "viewer"
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' ws: wss:; object-src 'none'; base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class Served(Protocol):
    """The methods of a session that a server uses. They may be called from any thread, and return at once."""

    def join(self, client: Client) -> None:
        """A page has connected."""
        ...

    def leave(self, client: Client) -> None:
        """A page has disconnected."""
        ...

    def post(self, client: Client, message: dict[str, Any]) -> None:
        """A page has sent a message."""
        ...

    def file(self, name: str) -> bytes | None:
        """A file that the session has saved."""
        ...


class Server:
    """A server in a thread of its own. ``origins``: further origins that it answers, of hubs and proxies.
    Raises :class:`OptionError` if the address cannot be used, or for an invalid origin."""

    def __init__(self, session: Served, host: str = "127.0.0.1", port: int = 0, origins: Iterable[str] = ()) -> None:
        library("tornado", _PURPOSE, _EXTRA)
        self.trusted = Trusted(host, origins)
        self.token = secrets.token_urlsafe(24)
        self.host, self.port = host, port
        self._session = session
        self._why = ""
        self._sockets: set[Any] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._ready = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="etendue-viewer-server", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error

    @property
    def url(self) -> str:
        """The address of the page, with the token."""
        host = socket.gethostname() if is_everywhere(self.host) else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{self.token}/"

    def close(self, why: str = "") -> None:
        """Disconnect all pages and end the thread. ``why`` is sent to the pages, in at most 123 bytes."""
        self._why = why
        if self._loop is not None and self._stop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=5.0)

    def knows(self, token: str) -> bool:
        """Whether ``token`` is that of the server, in a time that does not depend on the token."""
        return hmac.compare_digest(token.encode(), self.token.encode())

    # ------------------------------------------------------------------ in the server's thread

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._error = error
        finally:
            self._ready.set()

    async def _serve(self) -> None:
        from tornado.httpserver import HTTPServer
        from tornado.netutil import bind_sockets

        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        try:
            sockets = bind_sockets(self.port, self.host or "127.0.0.1")
        except OSError as error:
            raise OptionError(f"cannot listen at {self.host}:{self.port}: {_why(error, self.port)}") from None
        except (UnicodeError, OverflowError) as error:
            raise OptionError(f"cannot listen at {self.host}:{self.port}: {error}") from None
        self.port = int(sockets[0].getsockname()[1])
        server = HTTPServer(application(self), max_buffer_size=LARGEST_MESSAGE * 2)
        server.add_sockets(sockets)
        self._ready.set()
        await self._stop.wait()
        server.stop()
        for opened in list(self._sockets):
            opened.close(1001, self._why or None)
        await asyncio.sleep(0.05)  # lets the last messages leave
        await server.close_all_connections()


def _why(error: OSError, port: int) -> str:
    import errno

    if error.errno == errno.EADDRINUSE:
        return f"port {port} is taken; give another one by --port, or 0 for any that is free"
    if error.errno == errno.EACCES:
        return f"port {port} is reserved; give one above 1023 by --port"
    return f"{error.strerror or error}; correct --host, or leave it out"


def application(server: Server) -> Any:
    """Tornado's application with the handlers of ``server``."""
    from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
    from tornado.websocket import WebSocketHandler

    def check(handler: RequestHandler) -> None:
        """Refuse requests without the token, and pages of other servers. Called in ``prepare``, by every request:
        tornado asks ``check_origin`` for WebSockets only, and from 6.6 on not if Origin and Host agree."""
        if not server.knows(handler.path_args[0] if handler.path_args else ""):
            raise HTTPError(403, reason="The address needs the token that etendue view has printed")
        headers = handler.request.headers
        if why := server.trusted.refusal(headers.get("Origin"), headers.get("Host", "")):
            logger.warning("viewer: a request was refused: %s", why)
            handler.set_status(403)
            handler.set_header("Content-Type", "text/plain; charset=utf-8")
            handler.finish(f"403: {why}\n")

    class Guarded(RequestHandler):
        """Refuses requests without the token, and pages of other servers."""

        def set_default_headers(self) -> None:
            for name, value in _HEADERS.items():
                self.set_header(name, value)

        def prepare(self) -> None:
            check(self)

        def write_error(self, status_code: int, **_: Any) -> None:
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish(f"{status_code}: {self._reason}\n")

    class Bare(Guarded):
        """Adds the slash after the token, which relative addresses need."""

        def get(self, token: str) -> None:
            self.redirect(f"{token}/")  # relative, since a proxy may have put a path before it

    class Page(Guarded):
        def get(self, token: str) -> None:
            self.set_header("Content-Type", "text/html; charset=utf-8")
            self.write(files(__package__).joinpath("assets", "index.html").read_bytes())

    class Asset(Guarded, StaticFileHandler):
        async def get(self, token: str, path: str, include_body: bool = True) -> None:  # type: ignore[override]
            await StaticFileHandler.get(self, path, include_body)

        async def head(self, token: str, path: str) -> None:  # type: ignore[override]
            await StaticFileHandler.get(self, path, False)

        def get_cache_time(self, *_: Any) -> int:
            return 0

    class File(Guarded):
        def get(self, token: str, name: str) -> None:
            content = server._session.file(name)
            if content is None:
                raise HTTPError(404, reason="The session has saved no file of that name")
            self.set_header("Content-Type", "application/octet-stream")
            self.set_header("Content-Disposition", f"attachment; filename*=UTF-8''{quote(name, safe='')}")
            self.write(content)

    class Pages(WebSocketHandler):
        """The socket of a page."""

        client: Client | None = None

        def prepare(self) -> None:
            check(self)

        def check_origin(self, origin: str) -> bool:
            return server.trusted.origin(origin, self.request.headers.get("Host", ""))

        def open(self, token: str) -> None:
            self.set_nodelay(True)
            self.client = Client(self, asyncio.get_running_loop())
            server._sockets.add(self)
            server._session.join(self.client)

        def on_message(self, message: str | bytes) -> None:
            if self.client is None:
                return
            try:
                content = parsed(message)
                if content["type"] == "drawn":
                    frame = content.get("frame")
                    if isinstance(frame, int):
                        self.client.drawn(frame)
                    return
            except EtendueError as error:
                self.client.send("error", text=describe(error))
                return
            server._session.post(self.client, content)

        def on_close(self) -> None:
            server._sockets.discard(self)
            if self.client is not None:
                self.client.close()
                server._session.leave(self.client)

    def quiet(handler: RequestHandler) -> None:
        logger.debug("viewer: %s %s", handler.get_status(), handler.request.method)  # not the address: it has the token

    assets = str(files(__package__).joinpath("assets"))
    routes: list[tuple[Any, ...]] = [
        (r"/([^/]*)/", Page),
        (r"/([^/]*)/assets/(.+)", Asset, {"path": assets}),
        (r"/([^/]*)/files/([^/]+)", File),
        (r"/([^/]*)/socket", Pages),
        (r"/(.*)", Bare),
    ]
    make: Callable[..., Any] = Application
    return make(
        routes,
        log_function=quiet,
        websocket_max_message_size=LARGEST_MESSAGE,
        websocket_ping_interval=20,
        compress_response=False,
    )
