"""Requests that the server answers: to a name of this machine, from its own pages or from allowed origins."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from urllib.parse import SplitResult, urlsplit

from etendue.core import OptionError

#: Names of this machine, for which a page may be opened if the server is bound to them.
_LOCAL = ("localhost", "127.0.0.1", "::1")
_PORTS = {"http": 80, "https": 443}


class Trusted:
    """The headers Host and Origin that a server at ``host`` accepts.

    A page of another site cannot read the token, but it can let its own name point to this machine (DNS rebinding);
    then Host and Origin agree, because both have that name. Therefore the name is checked, too.

    ``origins`` are origins of hubs and proxies, such as ``https://hub.example.org``. Raises :class:`OptionError` for
    another form.
    """

    def __init__(self, host: str, origins: Iterable[str] = ()) -> None:
        self._host = host.lower()
        self._origins = [origin_of(origin) for origin in origins]

    def allow(self, origins: Iterable[str]) -> None:
        """Answer pages of further origins. Raises :class:`OptionError` for a text that is not an origin."""
        self._origins += [origin_of(origin) for origin in origins]

    def host(self, host: str) -> bool:
        """Whether the server accepts the header Host: a name of this machine, the name of an allowed origin, or any
        name if the server is bound to all addresses."""
        if is_everywhere(self._host):
            return True
        place = _split(f"//{host}")
        if place is None or not place.hostname:
            return False
        if place.hostname in (*_LOCAL, self._host):
            return True
        return any(
            (place.hostname, place.port or _PORTS[scheme]) == (name, port) for scheme, name, port in self._origins
        )

    def origin(self, origin: str, host: str) -> bool:
        """Whether the server, at the name ``host``, answers a page of ``origin``: a page of this server, or of an
        allowed origin."""
        place = _split(origin)
        if place is None or place.scheme not in _PORTS or not place.hostname:
            return False
        if (place.scheme, place.hostname, place.port or _PORTS[place.scheme]) in self._origins:
            return True
        return place.netloc.lower() == host.lower() and self.host(host)

    def refusal(self, origin: str | None, host: str) -> str:
        """Why a request with these headers is refused, with a remedy; empty if it is answered."""
        if self.host(host) and (origin is None or self.origin(origin, host)):
            return ""
        name = origin if self.host(host) else f"https://{host}"
        place = _split(name or "")
        if place is None or place.scheme not in _PORTS or not place.hostname or not place.netloc.isascii():
            return "The viewer answers its own pages only"
        return (
            f"The viewer does not know pages of {place.netloc}; if it is your hub or proxy, start the viewer with "
            f"--allow-origin {place.scheme}://{place.netloc}, in Python allow_origin="
        )


def origin_of(text: str) -> tuple[str, str, int]:
    """Scheme, name and port of an origin. Raises :class:`OptionError` if ``text`` is not an origin."""
    place = _split(text) if isinstance(text, str) else None
    named = place is not None and place.scheme in _PORTS and place.hostname and place.path in ("", "/")
    if place is not None and named and not (place.query or place.fragment or "@" in place.netloc):
        return place.scheme, place.hostname or "", place.port or _PORTS[place.scheme]
    raise OptionError(f"an allowed origin is a scheme and a name, such as https://hub.example.org, not {text!r}")


def is_everywhere(host: str) -> bool:
    """Whether an address stands for all addresses of the machine."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False


def _split(text: str) -> SplitResult | None:
    """The parts of an address, ``None`` if its port or its brackets are invalid."""
    try:
        place = urlsplit(text.strip())
        place.port  # noqa: B018 - raises for what is no number
    except ValueError:
        return None
    return place
