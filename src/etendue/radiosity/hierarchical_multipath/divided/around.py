"""Hierarchical multipath in the process that has the root of a scene; its boxes are in other processes."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, Measurement

from ..exchange import Exchange, absorbed_by
from ..lists import lists_of
from ..method import HierarchicalMultipath, HierarchicalMultipathSettings, PartProblem, check_memory
from .inside import Message, checked, make_inside
from .units import Unit, units_of

#: Yields a message to each unit, then ``None`` to wait for their answers; returns the measurement of a pass.
PartMessages: TypeAlias = Generator[Sequence[Message] | None, Sequence[Message] | None, Measurement]


class _Seen:
    """The data of a part in another process that :func:`.lists_of` needs."""

    def __init__(self, transmittance: Array) -> None:
        self.transmittance = transmittance


class DividedMultipath(HierarchicalMultipath):
    """:class:`HierarchicalMultipath` of a scene whose boxes are in other processes, each :class:`.Unit` in one.

    This process has the lines around the boxes, the first shot, which needs all surfaces, and the power of all patches
    for each pass. :meth:`talk` makes a pass; its measurement is equal to that of :meth:`step`, bit for bit, except for
    the counter of bytes: a part that is inside several units has lists in each.

    workers: smallest number of units, if there are enough copies. The result does not depend on it.
    """

    #: Name of the function that makes :class:`.Inside` in the other processes, in the form that recipes need.
    inside = f"{make_inside.__module__}:{make_inside.__name__}"

    def __init__(self, settings: HierarchicalMultipathSettings | None = None, workers: int = 1) -> None:
        super().__init__(settings)  # the default points, which workers can make, too
        self._workers = workers

    def prepare(self, problem: PartProblem, seed: int) -> None:
        """See :class:`HierarchicalMultipath`. Raises :class:`RadiosityError` for a scene without boxes, too."""
        super().prepare(problem, seed)
        self.units = units_of(self.tree, self._workers)
        self._number = {id(part): k for k, part in enumerate(self.tree.parts)}

    def arguments(self, unit: Unit) -> dict[str, NDArray[Any]]:
        """Arguments of :func:`.make_inside` for a unit."""
        parts = unit.part.distinct
        lines, numbers = [self.lines[part] for part in parts], [self._number[id(part)] for part in parts]
        return {"numbers": np.array(numbers), "lines": np.array(lines)}

    def weight(self, unit: Unit) -> int:
        """A measure of the work and the memory of a unit: the number of its patches plus the number of its lines."""
        return unit.problem.root.total + sum(self.lines[part] for part in unit.part.distinct)

    def talk(self, iteration: int) -> PartMessages:
        """Make a pass. Raises :class:`RadiosityError` for answers of another shape."""
        options, tree, units, root = self._options, self.tree, self.units, self.root
        yield [{"do": "cast"}] * len(units)
        shot = self._first_shot(iteration)  # while the workers cast lines
        answers = yield from _answers()
        regions, channels = len(options.regions), root.channels
        seen = {
            unit.part: _Seen(checked("transmittance", answer["transmittance"], (regions,)))
            for unit, answer in zip(units, answers, strict=True)
        }
        number, count = self._number[id(root)], self.lines[root]
        points = self._points(f"part {number}", self._seed)
        lists = lists_of(self._rays[root], True, count, options.regions, seen, points, iteration * count)
        nbytes = lists.nbytes + sum(int(answer["bytes"]) for answer in answers)
        exchange = Exchange(tree, {root: lists}, shot, slice(0, 1))
        arrived, rays = (None, 0) if shot is None else (shot.received.by_node(tree), shot.rays)
        del shot
        waiting, left = np.zeros((len(tree), channels)), np.inf
        for _ in range(options.iterations):
            totals = exchange.sweep()
            messages: list[dict[str, Any]] = []
            for unit in units:
                first = {} if arrived is None else {"received": arrived[unit.rows]}
                messages.append({"do": "exchange", "incoming": exchange.incoming[unit.nodes], **first})
            exchange.incoming[:], arrived = 0.0, None
            yield messages
            answers = yield from _answers()
            waiting = exchange.waiting()
            for unit, answer in zip(units, answers, strict=True):
                nodes = len(unit.whole)
                shape = (len(unit.nodes), regions, channels)
                exchange.outgoing[unit.nodes] = checked("outgoing", answer["outgoing"], shape)
                totals[unit.whole] = checked("totals", answer["totals"], (nodes, 3, channels))
                waiting[unit.whole] = checked("waiting", answer["waiting"], (nodes, channels))
            exchange.count(totals)
            left = exchange.share(waiting.sum(axis=0))
            if left <= options.residual:
                break
        yield [{"do": "end"}] * len(units)
        answers = yield from _answers()
        received = np.zeros((root.total, channels))
        received[: len(root)] = exchange.received.of(tree, 0)
        for unit, answer in zip(units, answers, strict=True):
            received[unit.rows] = checked("received", answer["received"], (len(unit.rows), channels))
        sums = {"received": received, "sent": exchange.sent, "absorbed": self._absorbed(received)}
        sums |= {"to_sky": exchange.to_sky, "lost": exchange.lost, "residual": waiting.sum(axis=0)}
        return self._measured(iteration, sums, left, rays, nbytes)

    def _absorbed(self, received: Array) -> Array:
        """(c,) power absorbed by all patches, summed in the order of nodes as in :class:`.Exchange`."""
        tree, at = self.tree, self.tree.offsets
        rows = [absorbed_by(tree, node, received[at[node] : at[node + 1]]) for node in range(len(tree))]
        result: Array = np.array(rows).sum(axis=0)
        return result

    def _check_memory(self) -> None:
        # The power that entered boxes is kept until the end of a pass, for workers that replace lost workers.
        boxes, tables = 1 + len(self.root.children), self._options.iterations + 2
        lines = {self.root: self.lines[self.root]}
        check_memory(self._options, lines, self.root.total, boxes, self.root.channels, tables)


def _answers() -> Generator[None, Sequence[Message] | None, Sequence[Message]]:
    answers = yield None
    assert answers is not None, "whoever makes a pass sends the answers to its messages"
    return answers
