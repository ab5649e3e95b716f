"""Messages between the page and the session, over one WebSocket.

A message is a JSON object with a ``type``, sent as text. A message with data (pictures, arrays) is sent in binary form:
a 32-bit little-endian number n, n bytes of JSON (padded with spaces so that the data begins at a multiple of eight
bytes), then the data.

Page to session:

==================  ====================================================================================================
``drawn``           ``frame``: the page has drawn this frame. The server sends no picture to a page that has not drawn
                    the last two; afterwards it sends the latest picture and leaves out the pictures between
``camera``          ``orbit`` [right, up], ``look`` [right, up], ``pan`` [right, up], ``fly`` [right, up, forward],
                    ``dolly``, ``zoom``, ``roll``: movements, angles in radians, lengths relative to the distance of the
                    target; or ``set`` {origin, target, up, fov}; or ``reset``: true
``views``           ``save``: true, ``show``: number or "next", ``remove``: number
``pick``            ``x``, ``y``: place in the picture, 0 to 1 from its top left corner; answered by ``picked``
``render``          any of ``method``, ``settings`` {name: value}, ``budget`` {seconds, spp, error}, ``size``
                    [width, height] of the film, ``paused``, ``again``: true
``show``            any of ``layer``, ``denoise`` (see :func:`etendue.display.parse_filters`; "" for none), ``radius``,
                    ``strength``, ``curve``, ``exposure`` (stops or "auto")
``compare``         ``method`` with ``settings``, or ``reference`` (a picture file on the machine of the session), or
                    neither to stop; ``map``: whether to show the error map instead of the second picture
``open``            ``scene``: a scene file, the name of a bundled scene, or a picture file
``save``            ``what``: picture, scene or run; ``name``: of the file; ``times``: autosaves of a run, as "20, 60";
                    answered by ``saved``
``quit``            end the session
``PANEL.verb``      for the panel of that name, see :class:`etendue.viewer.panels.Panel`
==================  ====================================================================================================

Session to page:

==================  ====================================================================================================
``about``           the available choices, and the panels' modules; the first message
``state``           everything that the controls show, see ``ViewerSession.state``; sent to all pages after every change
``frame``           with data, an encoded picture: ``frame`` (number), ``side`` ("a", or "b" for the second picture),
                    ``width``, ``height``, ``format`` (MIME type), ``moving``
``camera``          the pose of a moving picture, as in the state
``progress``        of the picture: passes, samples, seconds, rays per second, noise, error against the second picture
``picked``          at this place: shape, material, position, depth, radiance
``saved``           ``path``, and ``file``, the name under which the page can download it (``files/NAME``)
``error``, ``note`` ``text``: one line; also written to the terminal
``PANEL.verb``      from a panel, with or without data
==================  ====================================================================================================

All pages of a server share one session: they see the same picture, camera and settings, as on a shared screen. Only
the layout of a page, and the place of the slider between two pictures, belong to the page itself.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

from etendue.core import OptionError, is_number

#: Largest message of a page, in bytes.
LARGEST_MESSAGE = 1 << 20
_LENGTH = struct.Struct("<I")


def packed(kind: str, payload: bytes | memoryview | None = None, /, **fields: Any) -> str | bytes:
    """A message to a page: text, or binary with a ``payload``. NaN and infinite numbers become null."""
    text = json.dumps(_plain({"type": kind, **fields}), allow_nan=False, separators=(",", ":"))
    if payload is None:
        return text
    header = text.encode()
    header += b" " * (-(len(header) + _LENGTH.size) % 8)
    return b"".join((_LENGTH.pack(len(header)), header, payload))


def unpacked(message: str | bytes) -> tuple[dict[str, Any], bytes]:
    """(fields, data) of a message made by :func:`packed`."""
    if isinstance(message, str):
        return json.loads(message), b""
    end = _LENGTH.size + _LENGTH.unpack_from(message)[0]
    return json.loads(message[_LENGTH.size : end]), message[end:]


def parsed(text: str | bytes) -> dict[str, Any]:
    """A message of a page. Raises :class:`OptionError` for anything but a JSON object with a type."""
    if isinstance(text, bytes):
        raise OptionError("the viewer takes messages as text, not binary ones")
    try:
        message = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise OptionError(f"a message is not valid JSON: {error}") from None
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise OptionError("a message is a JSON object with a type")
    return message


def number(message: Mapping[str, Any], key: str, default: float | None = None) -> float:
    """A finite number of a message. Raises :class:`OptionError` for another value."""
    value = message.get(key, default)
    if not is_number(value) or not math.isfinite(value):
        raise OptionError(f"{key} must be a finite number, not {_shown(value)}")
    return float(value)


def numbers(message: Mapping[str, Any], key: str, count: int) -> list[float]:
    """A list of ``count`` finite numbers of a message. Raises :class:`OptionError` for another value."""
    values = message.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise OptionError(f"{key} must be {count} numbers, not {_shown(values)}")
    return [number({key: value}, key) for value in values]


def text(message: Mapping[str, Any], key: str, default: str | None = None) -> str:
    """A text of a message. Raises :class:`OptionError` for another value."""
    value = message.get(key, default)
    if not isinstance(value, str):
        raise OptionError(f"{key} must be a text, not {_shown(value)}")
    return value


def _shown(value: Any) -> str:
    shown = repr(value)
    return shown if len(shown) < 60 else f"{shown[:57]}..."


def _refused(constant: str) -> Any:
    raise ValueError(f"{constant} is not a number")


def _plain(value: Any) -> Any:
    """``value`` for JSON: NumPy's numbers become Python's, numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
