"""Messages to the parts of a scene in workers; each part has a state of its own during a pass."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

#: Words, numbers and arrays by name.
Message = Mapping[str, Any]


class Correspondent(Protocol):
    """A method of a part, made by a recipe. Its answers depend only on the pass and on earlier messages of the pass."""

    def begin(self, iteration: int) -> None:
        """Discard the state; the next messages are those of this pass."""
        ...

    def answer(self, message: Message) -> dict[str, Any]:
        """Answer the next message."""
        ...

    @property
    def nbytes(self) -> int:
        """Bytes that are kept for the next messages."""
        ...


@dataclass(frozen=True)
class PartMessages:
    """Messages of a pass to one part of a scene; the answer to the last one is returned.

    ``first``: number of messages of the pass that the worker has answered before. With 0 it begins the pass anew, so
    that a worker can replace another one, and no part receives a message twice.
    """

    run: str
    recipe: str  #: digest
    seed: int
    iteration: int
    part: int
    first: int
    messages: Sequence[Message]
    #: Number of the latest parts that the worker keeps.
    kept: int = 1
    threads: int | None = None


@dataclass
class Reply:
    """The answer to the last message of a :class:`PartMessages`."""

    answer: dict[str, Any]
    seconds: float
    loaded: bool  #: whether the part had to be loaded
    kept: int  #: bytes that the part keeps until the next message


@dataclass
class Talking:
    """A part in a worker, its current pass, and the number of messages answered in it."""

    method: Correspondent
    iteration: int = -1
    answered: int = 0

    def reply(self, task: PartMessages, loaded: bool) -> Reply | None:
        """``None`` if the part has not answered exactly the messages before ``task.first``: the client then begins the
        pass anew."""
        begin = time.monotonic()
        if task.first == 0:
            self.method.begin(task.iteration)
        elif (self.iteration, self.answered) != (task.iteration, task.first):
            return None
        # If a message raises, the state is undefined.
        self.iteration, self.answered = -1, 0
        answer: dict[str, Any] = {}
        for message in task.messages:
            answer = self.method.answer(message)
        self.iteration, self.answered = task.iteration, task.first + len(task.messages)
        return Reply(answer, time.monotonic() - begin, loaded, self.method.nbytes)


def nbytes(message: Message) -> int:
    """Bytes of the arrays of a message."""
    return sum(value.nbytes for value in message.values() if isinstance(value, np.ndarray))
