"""Multipath: light sent along global lines as they are cast, without form factors [Sbert 1996]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.core import Array

from .engine import LineEngine
from .errors import RadiosityError
from .parallel import compiled
from .patches import Patches
from .shot import FirstShot


@dataclass(frozen=True)
class Multipath:
    """What lines have exchanged.

    ``radiosity``: (n, c). ``unshot``: (n, c) power that patches have received and not sent on. Power (c,): ``sent`` of
    their own by patches and sky, ``absorbed`` and gone ``to_sky``; what was sent is absorbed, in the sky or unshot. A
    first shot is included.
    """

    radiosity: Array
    unshot: Array
    sent: Array
    absorbed: Array
    to_sky: Array


def multipath(engine: LineEngine, count: int, first: int = 0, shot: FirstShot | None = None) -> Multipath:
    """Exchange power segment by segment, in the order in which lines were cast [Castro 2002, sec. 2.3.4].

    Along a segment each end sends what it has unshot, and of its own power the share for one line; what the other end
    reflects of it replaces what that had unshot. One line so advances many paths, and a path serves all its beginnings.

    The lines of ``count`` points from ``first`` on are cast through the patches of the engine. shot: of
    :func:`first_shot`; the patches it has lit are then the sources. Raises :class:`RadiosityError` if nothing emits.
    """
    patches, expected = engine.patches, engine.expected(count)
    own = _own(patches, shot)
    reflectance, per_line, unshot, received = np.zeros((4, len(patches) + 2, patches.channels))
    reflectance[:-2] = patches.reflectance
    per_line[:-2] = own / expected[:, None]
    per_line[-2] = _sky_per_line(patches, expected)
    lines = np.zeros((len(patches) + 2, 3), np.int64)
    for chunk in engine.stream(count, first):
        compiled().multipath(chunk, reflectance, per_line, unshot, received)
        compiled().count_ends(chunk, lines)
    return _result(patches, shot, (per_line * lines[:, :1]).sum(axis=0), unshot[:-2], received)


def multipath_bundles(engine: LineEngine, count: int, first: int = 0, shot: FirstShot | None = None) -> Multipath:
    """Exchange power piece by piece of the engine's stream, such as some bundles of lines: each of the lines through a
    patch carries an equal part of its unshot power, which what is received replaces when the piece is done.

    No power is lost: own power is shared out over the pieces, and a patch that no line of a piece meets keeps what it
    has. Arguments as in :func:`multipath`.
    """
    patches, expected = engine.patches, engine.expected(count)
    loops, own = compiled(), _own(patches, shot)
    values, received = np.zeros((2, len(patches) + 2, patches.channels))
    values[-2] = _sky_per_line(patches, expected)
    sent, unshot = np.zeros(patches.channels), np.zeros_like(own)
    for done, chunk in enumerate(engine.stream(count, first)):
        share = own * (min(engine.piece(count), count - done * engine.piece(count)) / count)
        ends, sums = np.zeros((len(values), 3), np.int64), np.zeros_like(values)
        loops.count_ends(chunk, ends)
        lines = ends[:-2, :1]
        unshot += share
        values[:-2] = np.divide(unshot, lines, out=np.zeros_like(unshot), where=lines > 0)
        loops.gather(chunk, values, sums)
        received += sums
        sent += share.sum(axis=0) + values[-2] * ends[-2, 0]
        unshot = np.where(lines > 0, 0.0, unshot) + patches.reflectance * sums[:-2]
    return _result(patches, shot, sent, unshot, received)


def _own(patches: Patches, shot: FirstShot | None) -> Array:
    """Power (n, c) that patches have to send along lines."""
    if not (patches.emission.any() or patches.sky.any()):
        raise RadiosityError("no patch emits light, nor does the sky: give one an emission above zero")
    if shot is None:
        return patches.areas[:, None] * patches.emission
    return patches.areas[:, None] * (patches.emission - shot.emission) + shot.reflected


def _sky_per_line(patches: Patches, expected: Array) -> Array:
    # A_i times the sky is what would come to a patch that sees nothing else, along all of its lines.
    return patches.sky * patches.areas.sum() / expected.sum()


def _result(patches: Patches, shot: FirstShot | None, sent: Array, unshot: Array, received: Array) -> Multipath:
    left = patches.areas[:, None] * patches.emission + patches.reflectance * received[:-2]
    absorbed = ((1 - patches.reflectance) * received[:-2]).sum(axis=0) + received[-1]
    to_sky = received[-2]
    if shot is not None:
        # What the shot has sent and left to reflect is sent again by the lines.
        sent = sent + (patches.areas[:, None] * shot.emission - shot.reflected).sum(axis=0)
        left = left + shot.reflected
        absorbed, to_sky = absorbed + shot.absorbed, to_sky + shot.to_sky
    return Multipath(left / patches.areas[:, None], unshot, sent, absorbed, to_sky)
