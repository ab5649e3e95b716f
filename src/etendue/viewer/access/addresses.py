"""The address at which the reader's browser reaches a viewer behind a tunnel, a hub or a proxy."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

from etendue.core import OptionError

#: Environment variable with the address for the case that none is given.
VARIABLE = "ETENDUE_VIEW_ADDRESS"


def given_address(address: str | None) -> str:
    """The address as given, or that of the variable ``ETENDUE_VIEW_ADDRESS``; empty without either. Raises
    :class:`OptionError` unless it is a URL, or begins with ``/``."""
    where = "address" if address is not None else f"the variable {VARIABLE}"
    text = os.environ.get(VARIABLE, "") if address is None else address
    if isinstance(text, str):
        if address is None and not text:
            return ""
        if text.startswith("/") and not text.startswith("//"):
            return text
        if text.startswith(("http://", "https://")) and _is_url(text):
            return text
    wanted = "https://hub.example.org/user/me/proxy/{port} or /user/me/proxy/{port}"
    raise OptionError(f"{where} is where a browser reaches the viewer, such as {wanted}, not {text!r}")


def origins_of(address: str, port: int) -> list[str]:
    """The origin of an address, whose pages the server then answers; none for a path. ``port``: of the server."""
    if not address or address.startswith("/"):
        return []
    place = urlsplit(address.replace("{port}", str(port)))
    return [f"{place.scheme}://{place.netloc}"]


def reached(address: str, port: int, token: str) -> str:
    """The address of the page: ``address`` with ``{port}`` replaced, and the token."""
    return f"{address.replace('{port}', str(port)).rstrip('/')}/{token}/"


def _is_url(text: str) -> bool:
    try:
        place = urlsplit(text.replace("{port}", "1"))
        place.port  # noqa: B018 - raises for what is no number
    except ValueError:
        return False
    return bool(place.hostname) and not (place.query or place.fragment or "@" in place.netloc)
