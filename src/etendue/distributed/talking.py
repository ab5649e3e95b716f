"""Messages to the parts of a scene that live in workers, each with a state of its own during a pass."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

#: Words, numbers and arrays by name.
Message = Mapping[str, Any]


class Correspondent(Protocol):
    """A method of a part, as a recipe makes it. Its answers depend on the pass and the messages before, only."""

    def begin(self, iteration: int) -> None:
        """Forget what was; the next messages are of this pass."""
        ...

    def answer(self, message: Message) -> dict[str, Any]:
        """Answer the next message."""
        ...

    @property
    def nbytes(self) -> int:
        """Bytes that are kept for the next messages."""
        ...


@dataclass(frozen=True)
class Talk:
    """Messages of a pass to one part of a scene, whose recipe the worker has; the answer to the last one is wanted.

    ``first``: how many messages of the pass the worker has answered before. With 0 it begins the pass anew, so that a
    worker can take the place of another one, and none takes a message twice.
    """

    run: str
    recipe: str  #: digest
    seed: int
    iteration: int
    part: int
    first: int
    messages: Sequence[Message]
    #: Parts that the worker keeps, the latest ones.
    kept: int = 1
    threads: int | None = None


@dataclass
class Reply:
    """The answer to the last message of a :class:`Talk`."""

    answer: dict[str, Any]
    seconds: float
    loaded: bool  #: whether the part had to be loaded
    kept: int  #: bytes that the part keeps until the next message


@dataclass
class Talking:
    """A part in a worker, and how far it is in which pass."""

    method: Correspondent
    iteration: int = -1
    answered: int = 0

    def reply(self, task: Talk, loaded: bool) -> Reply | None:
        """``None`` if the part is elsewhere than the task takes for granted: then it begins the pass anew."""
        begin = time.monotonic()
        if task.first == 0:
            self.method.begin(task.iteration)
        elif (self.iteration, self.answered) != (task.iteration, task.first):
            return None
        # If a message raises, the state is not that after it, nor that before it.
        self.iteration, self.answered = -1, 0
        answer: dict[str, Any] = {}
        for message in task.messages:
            answer = self.method.answer(message)
        self.iteration, self.answered = task.iteration, task.first + len(task.messages)
        return Reply(answer, time.monotonic() - begin, loaded, self.method.nbytes)


def nbytes(message: Message) -> int:
    """Bytes of the arrays of a message."""
    return sum(value.nbytes for value in message.values() if isinstance(value, np.ndarray))
