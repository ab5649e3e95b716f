"""Engine: runs a method pass by pass, with budgets, progress, checkpoints, resuming and cancelling. It knows no
concrete method."""

from .budget import Budget
from .checkpoint import Checkpoint
from .executor import Executor, InTurn, MakeExecutor, Order
from .fitting import fit_samples, settle_samples
from .job import Job, Task, remaining, task_settings, versions
from .recordfiles import check_records
from .replicas import Replicated, replica_seed, replicated
from .runner import Cancelled, RunError, Runner, RunResult
from .saving import check_period, check_save_times
from .session import Session, jit_flags, set_jit_flags
from .stopping import LEAST_PASSES_FOR_ERROR, CancelEvent

__all__ = [
    "LEAST_PASSES_FOR_ERROR",
    "Budget",
    "CancelEvent",
    "Cancelled",
    "Checkpoint",
    "Executor",
    "InTurn",
    "Job",
    "MakeExecutor",
    "Order",
    "Replicated",
    "RunError",
    "RunResult",
    "Runner",
    "Session",
    "Task",
    "check_period",
    "check_records",
    "check_save_times",
    "fit_samples",
    "jit_flags",
    "remaining",
    "replica_seed",
    "replicated",
    "set_jit_flags",
    "settle_samples",
    "task_settings",
    "versions",
]
