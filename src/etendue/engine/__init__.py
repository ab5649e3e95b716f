"""Engine: drives whatever has ``step``. Budgets, progress, checkpoints, resume, cancellation; no concrete method."""

from .budget import Budget
from .checkpoint import Checkpoint
from .files import check_writable
from .job import Job, Task, versions, warn_of_nonfinite
from .runner import Cancelled, RunError, Runner, RunResult, run
from .session import Session

__all__ = [
    "Budget",
    "Cancelled",
    "Checkpoint",
    "Job",
    "RunError",
    "RunResult",
    "Runner",
    "Session",
    "Task",
    "check_writable",
    "run",
    "versions",
    "warn_of_nonfinite",
]
