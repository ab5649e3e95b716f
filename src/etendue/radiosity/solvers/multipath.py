"""Multipath: light sent along global lines as they are cast, without form factors [Sbert 1996]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from etendue.core import Array
from etendue.surfaces import Patches

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.engine import LineEngine
from ..lines.segments import Pairs
from .shot import FirstShot

#: A round of bundles could take this multiple of its power from a patch, without feedback. A larger value makes the
#: last round shorter, and the result noisier.
_SHARES = 16.0
#: Accepted share of unshot power at the end, and largest number of rounds unless another is asked for.
_LEFT, _ROUNDS = 1e-6, 4


@dataclass(frozen=True)
class Multipath:
    """The result of the exchange along lines.

    ``radiosity``: (n, c). ``unshot``: (n, c) power that patches have received and not sent on. Power (c,): ``sent``,
    the emission of patches and sky; ``absorbed``; and ``to_sky``. ``sent`` is the sum of absorbed, to_sky and unshot
    power. A first shot is included.
    """

    radiosity: Array
    unshot: Array
    sent: Array
    absorbed: Array
    to_sky: Array


def multipath(engine: LineEngine, count: int, first: int = 0, shot: FirstShot | None = None) -> Multipath:
    """Exchange power segment by segment, in the order in which lines were cast [Castro 2002, sec. 2.3.4].

    Along a segment each end sends its unshot power, and the share of its own power for one line; the part that the
    other end reflects replaces the unshot power of that end. One line thus advances many paths. What a patch receives
    along one line leaves along the next line through it, which must have another direction.

    The lines of ``count`` points from ``first`` on are cast through the patches of the engine. shot: of
    :func:`first_shot`; the lit patches are then the sources. Power that is not yet absorbed at the end stays unshot.

    Raises :class:`RadiosityError` if nothing emits, for less than one point, and for an engine whose successive lines
    are parallel (:attr:`LineEngine.shares_directions`): light would bounce between the same two patches.
    """
    exchange = LineExchange(engine, count, shot)
    unshot, received = np.zeros((2, *exchange.shape))
    sent = np.zeros(engine.patches.channels)
    for chunk in engine.stream(count, first):
        sent += exchange.along(chunk, unshot, received)
    return exchange.result(sent, unshot, received)


class LineExchange:
    """The exchange of :func:`multipath` along segments; the lines of ``count`` points send the own power of patches
    once. Raises the errors of :func:`multipath`."""

    def __init__(self, engine: LineEngine, count: int, shot: FirstShot | None = None) -> None:
        patches, own = engine.patches, _own(engine.patches, shot, count)
        if engine.shares_directions:
            raise RadiosityError(
                f"multipath needs lines of different directions, but {type(engine).__name__} casts parallel bundles: "
                "take multipath_bundles(), or one line per bundle"
            )
        self.patches, self.shot = patches, shot
        #: Shape of arrays of power: patches, sky and dark; channels.
        self.shape = len(patches) + 2, patches.channels
        self._reflectance, self._per_line = np.zeros((2, *self.shape))
        expected = engine.expected(count)
        self._reflectance[:-2] = patches.reflectance
        self._per_line[:-2] = own / np.where(patches.empty, 1, expected)[:, None]
        self._per_line[-2] = _sky_per_line(patches, expected)

    def along(self, pairs: Pairs, unshot: Array, received: Array) -> Array:
        """Exchange power along segments: changes ``unshot`` and ``received``. Returns the power (c,) of emission and
        sky that is sent."""
        compiled().multipath(pairs, self._reflectance, self._per_line, unshot, received)
        ends = np.zeros((len(unshot), 3), np.int64)
        compiled().count_ends(pairs, ends)
        sent: Array = (self._per_line * ends[:, :1]).sum(axis=0)
        return sent

    def result(self, sent: Array, unshot: Array, received: Array) -> Multipath:
        """The result, from sent, unshot and received power."""
        return _result(self.patches, self.shot, sent, unshot[:-2], received)


def multipath_bundles(
    engine: LineEngine, count: int, first: int = 0, shot: FirstShot | None = None, rounds: int = _ROUNDS
) -> Multipath:
    r"""Exchange power bundle by bundle: each line takes a share of the unshot power of its patch, and later bundles
    send on what the patch receives.

    A bundle has :math:`C_{ij}` segments between patches i and j, :math:`n_i` in all at i. With a part p of the own
    power for each of N bundles, and w_i the share per line, the unshot power u and the received power r become

    .. math:: u \leftarrow u + p, \quad \Delta r = C w u, \quad u \leftarrow u - n w u + \rho\, \Delta r.

    *No bias.* :math:`E\,C_{ij} = m_i F_{ij}`, and a bundle is independent of the bundles that delivered u. So in the
    mean j receives the share F_ij of all that i sends, for any w, and i sends own + rho r except for the final u. With
    u = 0, :math:`r = F^T (own + \rho r)` in the mean. A share of u / n_i would be biased: it would give all directions
    the same power, although directions along the normal have the most lines.

    *Bounded variance.* A bundle has at most ``most_i`` lines through a patch (:meth:`Bundles.most`). If
    :math:`w_i \le 1 / most_i`, no patch sends more than it has: u is never negative, and its sum grows by p only.
    Within this bound the shares are :math:`w_i = 16 / (m_i N (1 - \rho))`: smaller shares smooth u, larger shares empty
    it sooner.

    *Start-up.* The first bundles find little power to send, and the last bundles leave some: so the bundles are used
    cyclically. The first bundles are cast once more, without own power, until a millionth of the sent power is unshot.
    This takes 0.7 more rounds, or more with few bundles and high reflectances (two with 64 bundles and reflectances of
    0.8); there are at most ``rounds`` in all. The rest is ``unshot``: :func:`finished` spreads it by an ambient term;
    one round may then suffice.

    *Order.* The order of bundles is random, since successive points of a sequence are far apart by design; each bundle
    occurs once per round. Light can therefore not return along the bundle that delivered it. Independent bundles would
    allow this with probability 1 / N. Light may therefore also leave at once along the bundle that delivered it, with
    the weight 1 / N. The remaining bias is a part of the noise.

    Arguments and result as of :func:`multipath`. The result depends only on the points of the engine, not on how many
    are cast at once; backends differ by single lines. Raises :class:`RadiosityError` if nothing emits, for less than
    one point or round, and for an engine without bundles.
    """
    patches, own, bundles = engine.patches, _own(engine.patches, shot, count), engine.bundles
    if rounds < 1:
        raise RadiosityError(f"there is nothing to cast: {rounds} rounds")
    if bundles is None:
        raise RadiosityError(
            f"multipath_bundles takes bundles of parallel lines, such as those of ABuffer; {type(engine).__name__} has "
            "single lines: take multipath()"
        )
    # No line meets an empty patch, which has no power.
    expected, most = (np.where(patches.empty, 1, x)[:, None] for x in (engine.expected(1), bundles.most(patches)))
    absorbed = (patches.areas[:, None] * (1 - patches.reflectance)).sum(axis=0).min() / patches.areas.sum()
    for_line = np.minimum(_SHARES / (count * max(absorbed, 1e-12) * expected), 1 / most)
    at_once = np.minimum(1 / (count * expected), 1 / most)

    sky = _sky_per_line(patches, engine.expected(count))
    values, received = np.zeros((2, len(patches) + 2, patches.channels))
    sent, unshot = np.zeros(patches.channels), np.zeros_like(own)
    for done, chunk in enumerate(_rounds(engine.shuffled(count, first), count, first, rounds)):
        ends = np.zeros((len(values), 3), np.int64)
        compiled().count_ends(chunk, ends)
        lines = ends[:-2, :1]
        values[-2] = 0
        if done < count:
            unshot += own / count
            values[-2] = sky
            sent += own.sum(axis=0) / count + sky * ends[-2, 0]
        values[:-2] = for_line * unshot
        unshot -= lines * values[:-2]
        found = _received(chunk, values)
        fresh = patches.reflectance * found[:-2]
        values[:-2], values[-2] = at_once * fresh, 0
        again = _received(chunk, values)
        unshot += fresh - lines * values[:-2] + patches.reflectance * again[:-2]
        received += found + again
        if done + 1 >= count and (unshot.sum(axis=0) <= _LEFT * sent).all():
            break
    return _result(patches, shot, sent, unshot, received)


def _rounds(engine: LineEngine, count: int, first: int, rounds: int) -> Iterator[Pairs]:
    """The segments of each bundle, one round after the other."""
    for _ in range(rounds):
        yield from engine.stream(count, first, 1)


def _received(pairs: Pairs, values: Array) -> Array:
    sums = np.zeros_like(values)
    compiled().gather(pairs, values, sums)
    return sums


def _own(patches: Patches, shot: FirstShot | None, count: int) -> Array:
    """Power (n, c) that patches send along the lines of ``count`` points."""
    if count < 1:
        raise RadiosityError(f"multipath needs at least one point, not {count}")
    if not (patches.emission.any() or patches.sky.any() or (shot is not None and shot.irradiance.any())):
        raise RadiosityError("no patch emits light, nor does the sky: give one of them an emission above zero")
    if shot is None:
        return patches.areas[:, None] * patches.emission
    return patches.areas[:, None] * (patches.emission - shot.emission) + shot.reflected


def _sky_per_line(patches: Patches, expected: Array) -> Array:
    # A_i times the sky is the power that a patch would receive along all of its lines if it saw only the sky.
    return patches.sky * patches.areas.sum() / expected.sum()


def _result(patches: Patches, shot: FirstShot | None, sent: Array, unshot: Array, received: Array) -> Multipath:
    left = patches.areas[:, None] * patches.emission + patches.reflectance * received[:-2]
    absorbed = ((1 - patches.reflectance) * received[:-2]).sum(axis=0) + received[-1]
    to_sky = received[-2]
    if shot is not None:
        # Light of the shot that patches reflect is sent on by the lines.
        sent = sent + shot.sent - shot.reflected.sum(axis=0)
        left = left + shot.reflected
        absorbed, to_sky = absorbed + shot.absorbed, to_sky + shot.to_sky
    return Multipath(left / patches.divisors[:, None], unshot, sent, absorbed, to_sky)
