"""Engine: drives whatever has ``step``. Budgets, progress, checkpoints, resume, cancellation; no concrete method."""

from .budget import Budget
from .checkpoint import Checkpoint
from .fitting import fit_samples, settle_samples
from .job import Job, Task, remaining, versions
from .runner import Cancelled, RunError, Runner, RunResult, check_period, check_save_times
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
    "check_period",
    "check_save_times",
    "fit_samples",
    "remaining",
    "settle_samples",
    "versions",
]
