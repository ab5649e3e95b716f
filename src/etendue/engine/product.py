"""Products: what leaves a run, such as a picture or a solution, and its files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from etendue.core import Method, Progress, Settings

from .budget import Budget

if TYPE_CHECKING:
    from .executor import MakeExecutor
    from .job import Job, Task
    from .runner import RunResult

R = TypeVar("R")

#: Seconds of a run up to which it is brief.
_BRIEF = 10.0


def silent(*_: object) -> None:
    """Tell nobody."""


class Product(ABC, Generic[R]):
    """What leaves a run. It is checked before passes are made, kept if the run fails, and made and written at the end.

    An instance has the requested options and belongs to one run.
    """

    #: Names the product in checkpoints and listings.
    kind: ClassVar[str]
    checkpoint: Path | None = None
    #: Seconds between intermediate saves, ``None`` for none.
    save_every: float | None = None
    #: Passes that are made even if they exceed a limit in time.
    least_passes: ClassVar[int] = 1

    @property
    @abstractmethod
    def files(self) -> Sequence[Path]:
        """Files that are or will be written."""

    def check(self, problem: Any) -> None:
        """Raise an error if the product cannot be made of this problem; called before the method is prepared."""

    @abstractmethod
    def default_budget(self, task: Task, problem: Any) -> Budget:
        """The budget of a run for which none is given."""

    def is_brief(self, problem: Any, budget: Budget) -> bool:
        """Whether a run is so short that LLVM would spend more time on optimising its kernels than that saves."""
        return budget.seconds is not None and budget.seconds <= _BRIEF

    def settings(self, task: Task, problem: Any, budget: Budget) -> Settings:
        """The settings of the method."""
        made: Settings = task.method.Settings.from_mapping(task.settings, owner=f"method '{task.method.name}'")
        return made

    def make_method(self, task: Task, settings: Settings, problem: Any, budget: Budget) -> Method:
        """The method of the task, not prepared yet."""
        kind: Any = task.method
        made: Method = kind(settings)
        return made

    def budget(self, method: Method, budget: Budget) -> Budget:
        """The budget in samples, if it is known only when the method is prepared."""
        return budget

    def prepared(self, job: Job) -> None:
        """Called when the method is prepared, also of a resumed job. May set ``job.limits``."""

    def divided(self, job: Job, cluster: Any) -> MakeExecutor:
        """The executor of the workers of a ``distributed.Cluster``."""
        make: MakeExecutor = cluster.executor(job)
        return make

    def executor(self, job: Job, make: MakeExecutor) -> MakeExecutor:
        """The executor of the run; ``make`` is that of this process or of the workers."""
        return make

    def saving(self, job: Job) -> dict[str, Any]:
        """Options of the :class:`Runner` for intermediate saves."""
        return {}

    def described(self, job: Job, progress: Progress) -> Progress:
        """The progress after a pass, in words of this product."""
        return progress

    @abstractmethod
    def keep(self, job: Job, run: RunResult) -> object:
        """Save the finished passes after a failure, before its error is raised."""

    @abstractmethod
    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> R:
        """Make the product and write its files. ``tell`` receives a description of the current step."""

    def notes(self) -> dict[str, Any]:
        """Plain values for the checkpoint, from which the product is made again."""
        return {}
