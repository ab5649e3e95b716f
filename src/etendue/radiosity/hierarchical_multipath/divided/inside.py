"""The work for boxes in a worker: their lines, and the exchange of power inside them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, Settings as AnySettings

from ...errors import RadiosityError
from ..exchange import Exchange
from ..light import Light, Shot
from ..lists import Lists, PartRays, lists_of
from ..method import HierarchicalMultipathSettings, PartProblem, check_memory
from ..parts import Part, Tree

#: A message between processes: words and arrays by name.
Message = Mapping[str, Any]


class Inside:
    """The boxes of one unit in a worker. It answers the messages of a pass, one after the other:

    ``cast``: casts and keeps lines through its parts; answers the ``transmittance`` (r,) of the boxes, and the
    ``bytes`` of the lists.

    ``exchange``: sends ``incoming`` (k, r, c), the power that enters at the regions of its k boxes, once along the
    lines. Answers ``outgoing`` (k, r, c), the power that leaves at these regions; ``totals`` (m, 3, c), see
    :meth:`.Exchange.sweep`, of its m nodes; and ``waiting`` (m, c), the unshot power in each of them. The first of
    these messages also has ``received`` (patches, c), the first shot, unless lines transport the emission.

    ``end``: answers the power ``received`` by its patches (patches, c), and forgets the pass.

    Lines and light depend on the seed, the index of the pass and the part's index in the whole scene, not on the
    process. Raises :class:`RadiosityError` for invalid messages, and as :class:`.HierarchicalMultipath`.

    numbers, lines: index of each part in the whole scene, and its lines of a pass; inner parts first.
    """

    name: ClassVar[str] = "boxes"
    carries_on: ClassVar[bool] = False
    Settings: ClassVar[type[AnySettings]] = HierarchicalMultipathSettings

    def __init__(
        self, settings: HierarchicalMultipathSettings, numbers: NDArray[np.int64], lines: NDArray[np.int64]
    ) -> None:
        self.settings, self._numbers, self._counts = settings, numbers, lines
        self._lists: dict[Part, Lists] = {}
        self._exchange: Exchange | None = None

    def prepare(self, problem: PartProblem, seed: int) -> None:
        """Build the arrays for ray casting. Raises :class:`RadiosityError` if memory does not hold the lists and the
        power."""
        self._tree, self._seed = Tree(problem.root), seed
        *self._parts, _ = self._tree.parts
        if not len(self._parts) == len(self._numbers) == len(self._counts):
            raise RadiosityError(
                f"{len(self._numbers)} numbers do not fit {len(self._parts)} parts: update étendue there"
            )
        counts = dict(zip(self._parts, self._counts.tolist(), strict=True))
        check_memory(self.settings, counts, problem.root.total, len(self._tree), problem.root.channels)
        self._rays = {part: PartRays(part) for part in self._parts}

    def begin(self, iteration: int) -> None:
        """Forget the previous pass; the next messages are of pass ``iteration``."""
        self._iteration, self._lists, self._exchange = iteration, {}, None

    @property
    def nbytes(self) -> int:
        """Bytes of the lists and of the power at patches and boxes."""
        lists = sum(lists.nbytes for lists in self._lists.values())
        return lists + (0 if self._exchange is None else self._exchange.nbytes)

    def answer(self, message: Message) -> dict[str, Any]:
        """Answer a message, see the class."""
        steps = {"cast": self._cast, "exchange": self._exchanged, "end": self._end}
        if message["do"] not in steps:
            raise RadiosityError(f"boxes cannot do '{message['do']}'; update étendue on the workers")
        return steps[message["do"]](message)

    def _cast(self, message: Message) -> dict[str, Any]:
        regions = self.settings.regions
        for part, number, count in zip(self._parts, self._numbers.tolist(), self._counts.tolist(), strict=True):
            points = self.settings.points_for(f"part {number}", self._seed)
            made = lists_of(self._rays[part], False, count, regions, self._lists, points, self._iteration * count)
            self._lists[part] = made
        # The part of the boxes is the last part before the root: it contains all others.
        return {
            "transmittance": self._lists[self._parts[-1]].transmittance,
            "bytes": sum(lists.nbytes for lists in self._lists.values()),
        }

    def _exchanged(self, message: Message) -> dict[str, Any]:
        if self._exchange is None:
            self._exchange = Exchange(self._tree, self._lists, self._shot(message), slice(1, None))
        exchange, top = self._exchange, self._tree.levels[1]
        boxes = slice(top.start, top.stop)
        exchange.incoming[boxes] = checked("incoming", message["incoming"], exchange.incoming[boxes].shape)
        totals = exchange.sweep()
        answer = {"outgoing": exchange.outgoing[boxes].copy(), "totals": totals[1:], "waiting": exchange.waiting()[1:]}
        exchange.outgoing[boxes] = 0.0  # the process of the root has this power now
        return answer

    def _shot(self, message: Message) -> Shot | None:
        if "received" not in message:
            return None
        tree = self._tree
        rows = checked("received", message["received"], (int(tree.offsets[-1]), tree.root.channels))
        nothing = np.zeros(tree.root.channels)  # sent and lost power is counted in the process of the root
        return Shot(Light.of_rows(tree, rows), nothing, nothing, nothing, rays=0)

    def _end(self, message: Message) -> dict[str, Any]:
        if self._exchange is None:
            raise RadiosityError("boxes have exchanged no light yet; start the run anew")
        received = self._exchange.received.by_node(self._tree, 1)
        self._lists, self._exchange = {}, None
        return {"received": received}


def make_inside(
    settings: HierarchicalMultipathSettings,
    problem: PartProblem,
    numbers: NDArray[np.int64],
    lines: NDArray[np.int64],
) -> Inside:
    """An :class:`Inside`, as recipes make it."""
    return Inside(settings, numbers, lines)


def checked(name: str, values: Any, shape: tuple[int, ...]) -> Array:
    """Power from another process. Raises :class:`RadiosityError` for another shape, and if it is not finite: otherwise
    the solution would be wrong without an error."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise RadiosityError(f"'{name}' of a box is {array.shape}, not {shape}: is another étendue on that worker?")
    if not np.isfinite(array).all():
        raise RadiosityError(f"'{name}' of a box is not finite: check emission and reflectance of its patches")
    return array
