"""The recursive exchange of power along stored lines, copy by copy [Castro 2002, sec. 5.3.6]."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, in_order, threads

from ..compiling import compiled
from .light import Light, Shot
from .lists import Lists
from .parts import Part, Tree

Index = NDArray[np.int64]

#: Largest number of copies whose exchange is one task.
_COPIES = 32


class Exchange:
    """The exchange of power in a scene of parts.

    lists: of every distinct part. shot: has sent all emission. Without a shot, patches send their emission along the
    lines; the sky always does.

    At the beginning of an iteration each patch distributes its unshot power over all its lines. Power that it receives
    along one line leaves along the next line, as in Multipath: nearly all light is absorbed within few iterations.

    levels: the levels of the tree that are exchanged here, by default all; ``lists`` then need only their parts. Power
    at the boxes of the level below is exchanged elsewhere, such as in another process.

    Power of patches: ``received``, and ``unshot``, which they have not sent on yet. Power (nodes, r, c) that waits at
    the regions of boxes: ``incoming`` to the copy, ``outgoing`` from it. Power (c,): ``sent`` by emission and sky,
    ``to_sky``, ``lost`` to backs of faces. Nodes are summed in their order, so that sums do not depend on the number of
    threads and processes.
    """

    def __init__(
        self, tree: Tree, lists: Mapping[Part, Lists], shot: Shot | None = None, levels: slice = slice(None)
    ) -> None:
        self.tree = tree
        self._levels = tree.levels[levels]
        self._nodes = range(self._levels[0].start, self._levels[-1].stop)
        held = np.zeros(len(tree.parts), dtype=bool)
        held[tree.part[self._nodes.start : self._nodes.stop]] = True
        self._lists = [lists[part] if mine else None for part, mine in zip(tree.parts, held, strict=True)]
        channels, regions = tree.root.channels, len(next(iter(lists.values())).regions)
        rows = next((level.stop for level in tree.levels if level.start == self._nodes.stop), self._nodes.stop)
        self.received = Light.none(tree, held) if shot is None else shot.received.only(held)
        self.unshot = Light.none(tree, held)
        self.incoming, self.outgoing = np.zeros((2, rows, regions, channels))
        self.sent, self.to_sky, self.lost = np.zeros((3, channels))
        if shot is not None:
            self.sent, self.to_sky, self.lost = shot.sent.copy(), shot.to_sky.copy(), shot.lost.copy()
        self._reflectance = []
        for k, (part, lines) in enumerate(zip(tree.parts, self._lists, strict=True)):
            rho = np.zeros((len(part) + 2 + regions if held[k] else 0, channels))
            self._reflectance.append(rho)
            if lines is None:
                continue
            if part.patches is not None:
                rho[: len(part)] = part.patches.reflectance
            if shot is not None:
                np.multiply(rho[: len(part)], shot.received.of_parts[k], out=self.unshot.of_parts[k])
            lines.donors, lines.child_donors  # noqa: B018 (made here, by one thread)
        self._own_is_unsent, self._sky_is_unsent = shot is None, True

    def iterate(self) -> None:
        """Send all power once along the lines of all parts, from the root down."""
        self.count(self.sweep())

    def sweep(self) -> Array:
        """:meth:`iterate` without counting. Returns (nodes, 3, c) power of each node: emission and sky that it sent,
        power to the sky, and power lost to backs of faces; zero for nodes of other levels."""
        totals = np.zeros((len(self.tree), 3, len(self.sent)))
        for level in self._levels:
            # Copies of a part follow each other, so that its lists stay in the cache.
            nodes = np.array(level)[np.argsort(self.tree.part[level.start : level.stop], kind="stable")]
            size = max(min(_COPIES, -(-len(nodes) // (4 * threads()))), 1)
            blocks = [nodes[k : k + size] for k in range(0, len(nodes), size)]
            for _ in in_order(partial(self._block, block, totals) for block in blocks):
                pass
        self._own_is_unsent = self._sky_is_unsent = False
        return totals

    def count(self, totals: Array) -> None:
        """Add the ``totals`` that :meth:`sweep` returned."""
        sent, to_sky, lost = totals.sum(axis=0)
        self.sent += sent
        self.to_sky += to_sky
        self.lost += lost

    def iterate_until(self, residual: float, most: int, told: Callable[[int, float], object] | None = None) -> float:
        """Iterate until the unshot power is at most the share ``residual`` of the sent power, at most ``most`` times.
        Returns the share. ``told`` is called with the number of iterations so far and the share."""
        share = np.inf
        for iteration in range(most):
            self.iterate()
            share = self.share(self.residual)
            if told is not None:
                told(iteration + 1, share)
            if share <= residual:
                break
        return share

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays of power at patches and boxes."""
        arrays = [*self.received.of_parts, *self.unshot.of_parts, self.incoming, self.outgoing]
        return sum(array.nbytes for array in arrays)

    def share(self, power: Array) -> float:
        """``power`` (c,) relative to the sent power, in the channel where this is largest."""
        return float((power / np.where(self.sent > 0, self.sent, 1)).max())

    def waiting(self) -> Array:
        """(nodes, c) unshot power of each node, of its patches and at its box; zero for nodes of other levels."""
        rows = np.zeros((len(self.tree), len(self.sent)))
        for node in self._nodes:
            at_box = (self.incoming[node] + self.outgoing[node]).sum(axis=0)
            rows[node] = self.unshot.of(self.tree, node).sum(axis=0) + at_box
        return rows

    @property
    def residual(self) -> Array:
        """(c,) unshot power."""
        result: Array = self.waiting().sum(axis=0)
        return result

    @property
    def absorbed(self) -> Array:
        """(c,) power absorbed by patches."""
        rows = [absorbed_by(self.tree, node, self.received.of(self.tree, node)) for node in self._nodes]
        result: Array = np.array(rows).sum(axis=0)
        return result

    @property
    def imbalance(self) -> float:
        """Sent power minus absorbed, lost and unshot power and power to the sky, relative to the sent power."""
        off = self.sent - self.absorbed - self.to_sky - self.lost - self.residual
        return float(np.abs(off).max() / max(self.sent.max(), 1e-300))

    def _block(self, nodes: Index, totals: Array) -> None:
        for node in nodes:
            totals[node] = self._node(int(node))

    def _node(self, node: int) -> Array:
        """Exchange in one copy. Returns (3, c) as for :meth:`sweep`."""
        tree, part = self.tree, self.tree.parts[self.tree.part[node]]
        lists, rho = self._lists[tree.part[node]], self._reflectance[tree.part[node]]
        assert lists is not None, "the node is exchanged elsewhere"
        n = len(part)
        values, sums = np.zeros((2, *rho.shape))
        unshot, totals = self.unshot.of(tree, node), np.zeros((3, len(self.sent)))
        counted = np.maximum(lists.counted, 1)[:, None]
        has_lines = (lists.counted > 0)[:, None]
        if self._own_is_unsent and part.patches is not None:
            own = tree.areas(node)[:, None] * part.patches.emission
            totals[0] = own.sum(axis=0)
            values[:n] = own / counted * has_lines
            unshot += own * ~has_lines  # there is no line to send it along
        if self._sky_is_unsent and node == 0 and part.patches is not None and part.patches.sky.any():
            values[n] = part.patches.sky * lists.surface / (2 * lists.lines)
            totals[0] += values[n] * np.count_nonzero(lists.ends == n)
        if node > 0:
            arrived, self.incoming[node] = _moved(self.incoming[node], lists.donors), 0.0
            hitting = lists.hitting[:, None]
            values[n + 2 :] = np.divide(arrived, hitting, out=np.zeros_like(arrived), where=hitting > 0)
        values[:n] += unshot / counted * has_lines
        unshot *= ~has_lines
        carried = np.zeros_like(values)
        if lists.begins is None:
            compiled("hierarchical_multipath.walking").exchange(lists.ends, rho, values, carried, sums)
        else:
            self._walk(node, lists, rho, values, carried, sums)
        unshot += carried[:n]
        self.received.of(tree, node)[:] += sums[:n]
        totals[1:] = sums[n : n + 2]
        if node > 0:
            self.outgoing[node] += sums[n + 2 :]
        return totals

    def _walk(self, node: int, lists: Lists, rho: Array, values: Array, carried: Array, sums: Array) -> None:
        first, count = int(self.tree.first[node]), len(lists.part.children)
        inner = slice(first, first + count)
        shape = (count * len(lists.regions), len(self.sent))
        leaving = _moved(self.outgoing[inner].reshape(shape), lists.child_donors)
        self.outgoing[inner] = 0.0
        leaving /= np.maximum(lists.child_lines, 1)[:, None]
        compiled("hierarchical_multipath.walking").walk(
            *(lists.ends, lists.begins, lists.crossings, lists.child_transmittance, leaving),
            *(self.incoming[inner].reshape(shape), len(lists.part) + 2, rho, values, carried, sums),
        )


def absorbed_by(tree: Tree, node: int, received: Array) -> Array:
    """(c,) power absorbed by the patches of a node that ``received`` (n, c) power."""
    patches = tree.parts[tree.part[node]].patches
    if patches is None:
        return np.zeros(tree.root.channels)
    absorbed: Array = ((1 - patches.reflectance) * received).sum(axis=0)
    return absorbed


def _moved(power: Array, donors: Index) -> Array:
    """Power of regions, moved to the regions ``donors`` that pass it on."""
    result = power.copy()
    away = np.flatnonzero((donors != np.arange(len(donors))) & power.any(axis=1))
    result[away] = 0.0
    np.add.at(result, donors[away], power[away])
    return result
