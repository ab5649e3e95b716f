"""The executor of a scene whose parts are in workers: in a pass, the client exchanges messages with all parts."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from etendue.core import Measurement, OptionError, Pass, logger
from etendue.engine import Order

from .content import Offered
from .dispatcher import Dispatcher
from .messages import Message, PartMessages, Reply, nbytes
from .pool import Pool
from .recipes import Recipe

_TICK = 0.1

#: Yields a message to each part, then ``None`` to wait for their answers; returns the measurement of a pass.
Conversation = Generator[Sequence[Message] | None, Sequence[Message] | None, Measurement]


@dataclass
class Shared:
    """The parts of a divided scene in a worker, and the worker's messages."""

    #: For each part in the worker, the largest number of bytes kept between two messages.
    parts: dict[int, int] = field(default_factory=dict)
    messages: int = 0
    loads: int = 0  #: how often a part was loaded
    sent: int = 0  #: bytes of arrays sent to the worker
    received: int = 0  #: bytes of arrays received from the worker
    seconds: float = 0.0

    @property
    def kept(self) -> int:
        """Upper bound on the bytes that all its parts kept at a time."""
        return sum(self.parts.values())


@dataclass
class Correspondence:
    """The messages of a run to and from parts of a scene in workers, by worker."""

    workers: dict[str, Shared] = field(default_factory=dict)
    rounds: int = 0  #: number of rounds, in each of which all parts get a message
    begun_anew: int = 0  #: parts that repeated a pass, because their worker was lost during it

    def of(self, worker: str) -> Shared:
        """The entry of a worker."""
        return self.workers.setdefault(worker, Shared())

    @property
    def sent(self) -> int:
        """Bytes of arrays that went to workers."""
        return sum(shared.sent for shared in self.workers.values())

    @property
    def received(self) -> int:
        """Bytes of arrays that came from workers."""
        return sum(shared.received for shared in self.workers.values())


@dataclass
class _Part:
    """A part of the scene during a pass."""

    recipe: str
    weight: float
    worker: str | None = None
    messages: list[Message] = field(default_factory=list)  #: of the pass so far
    known: int = 0  #: messages that its worker has answered
    in_flight: bool = False
    answer: Message | None = None  #: to the last message


class Rounds(Dispatcher[PartMessages]):
    """Makes passes of a method whose scene is divided: the client exchanges messages with each part, which is in a
    worker; implements ``engine.Executor``.

    recipes: of each part; its function makes a :class:`.Correspondent`. weights: of each part; parts are given to
    workers by weight, the heaviest first, and a part stays with its worker. talk: begins a pass, see
    :data:`Conversation`; it may work between its messages and the wait for the answers. correspondence: records the
    messages.

    If a worker is lost, another one gets its parts and all messages of the pass, and only the answer to the last
    message counts. One pass is made at a time, and the end of a run waits for it.
    """

    keeps_time: ClassVar[bool] = False

    def __init__(
        self,
        pool: Pool,
        recipes: Sequence[Recipe],
        weights: Sequence[float],
        order: Order,
        talk: Callable[[int], Conversation],
        *,
        correspondence: Correspondence | None = None,
    ) -> None:
        if not recipes or len(recipes) != len(weights):
            raise OptionError(f"a divided scene has a weight for each part, not {len(weights)} for {len(recipes)}")
        contents: dict[str, Any] = {}
        for recipe in recipes:
            contents |= recipe.offered.contents
        super().__init__(pool, Offered(contents))
        self._order, self._begin_talk = order, talk
        self._parts = [_Part(recipe.digest, weight) for recipe, weight in zip(recipes, weights, strict=True)]
        self.correspondence = correspondence if correspondence is not None else Correspondence()
        self._missing = order.done.missing()
        self._iteration = 0
        self._talk: Conversation | None = None
        self._look(now=True)

    # ------------------------------------------------------------------ an executor

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        self._look()
        if self._talk is None:
            self._iteration = next(self._missing)
            self._leave_idle_workers()
            self._talk = self._begin_talk(self._iteration)
            for part in self._parts:
                part.messages, part.known = [], 0
            return self._listen(None)
        self._feed()
        if (arrival := self._pool.wait(_TICK)) is not None and (taken := self._take(arrival)) is not None:
            self._answered(*taken)
        if any(part.answer is None for part in self._parts):
            return None
        return self._listen([part.answer for part in self._parts if part.answer is not None])

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`: the pass under way is finished, as one in this process would be."""
        while self._talk is not None:
            if (made := self.next()) is not None:
                yield made

    def close(self) -> None:
        """See :class:`Executor`."""
        if self._talk is not None:
            self._talk.close()
            self._talk = None
        self._cancel()

    def shares(self) -> dict[str, int]:
        """Messages that each worker has answered."""
        return {name: shared.messages for name, shared in self.correspondence.workers.items()}

    def _listen(self, answers: Sequence[Message] | None) -> Pass | None:
        """Continue the pass until it waits for answers or ends."""
        assert self._talk is not None
        try:
            while (said := self._talk.send(answers)) is not None:
                answers = None
                for part, message in zip(self._parts, said, strict=True):
                    part.messages.append(message)
                    part.answer = None
                self.correspondence.rounds += 1
                self._feed()
        except StopIteration as ended:
            self._talk = None
            for part in self._parts:  # messages may be large
                part.messages, part.answer = [], None
            return Pass(ended.value, self._order.state)
        except BaseException:
            self._talk = None
            raise
        return None

    # ------------------------------------------------------------------ workers

    def _joined(self, name: str) -> None:
        """Parts are given out where they are needed."""

    def _gone(self, name: str) -> None:
        for part in self._parts:
            if part.worker == name:
                part.worker, part.known = None, 0

    def _not_made(self, task: PartMessages) -> None:
        # In any case the worker gets all messages of the pass, and begins the pass anew.
        part = self._parts[task.part]
        part.in_flight, part.known = False, 0

    def _leave_idle_workers(self) -> None:
        """Give idle workers parts of workers that have several. Only at the beginning of a pass, when parts have no
        state."""
        for name in self._workers:
            loads = self._loads()
            most = max(loads, key=lambda other: (loads[other], other))
            theirs = [part for part in self._parts if part.worker == most]
            if loads[name] == 0 and len(theirs) > 1:
                min(theirs, key=lambda part: part.weight).worker = name

    def _loads(self) -> dict[str, float]:
        loads = dict.fromkeys(sorted(self._workers), 0.0)
        for part in self._parts:
            if part.worker is not None:
                loads[part.worker] += part.weight
        return loads

    def _give_out(self) -> None:
        """Give each part without a worker, the heaviest first, to the worker with the least weight."""
        for part in sorted(self._parts, key=lambda part: -part.weight):
            if part.worker is None and self._workers:
                loads = self._loads()
                part.worker = min(loads, key=lambda name: loads[name])
                logger.debug("a part of the scene is given to worker %s", part.worker)

    def _feed(self) -> None:
        self._give_out()
        for number, part in enumerate(self._parts):
            name = part.worker
            if name is None or part.in_flight or part.answer is not None or not part.messages:
                continue
            if (worker := self._workers[name]).coming:
                continue
            kept = sum(other.worker == name for other in self._parts)
            messages = tuple(part.messages[part.known :])
            part.in_flight = True
            self.correspondence.begun_anew += len(messages) > 1
            shared = self.correspondence.of(name)
            shared.parts.setdefault(number, 0)
            shared.sent += sum(map(nbytes, messages))
            known: Any = {"kept": kept, "threads": worker.threads}
            order = self._order
            task = PartMessages(
                self._run, part.recipe, order.seed, self._iteration, number, part.known, messages, **known
            )
            self._send(name, task)

    # ------------------------------------------------------------------ outcomes

    def _answered(self, name: str, task: PartMessages, made: Any) -> None:
        assert isinstance(made, Reply)
        part = self._parts[task.part]
        part.in_flight, part.answer = False, made.answer
        part.known = task.first + len(task.messages) if part.worker == name else 0
        shared = self.correspondence.of(name)
        shared.parts[task.part] = max(shared.parts[task.part], made.kept)
        shared.messages += 1
        shared.loads += made.loaded
        shared.received += nbytes(made.answer)
        shared.seconds += made.seconds
