"""Engine: runs a method pass by pass, with budgets, progress, checkpoints, resuming and cancelling. It knows no
concrete method."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .budget import Budget as Budget, check_count as check_count
    from .checkpoint import Checkpoint as Checkpoint
    from .executor import Executor as Executor, InTurn as InTurn, MakeExecutor as MakeExecutor, Order as Order
    from .fitting import (
        fit_samples as fit_samples,
        fitting_samples as fitting_samples,
        settle_samples as settle_samples,
    )
    from .job import Job as Job, Source as Source, Task as Task, remaining as remaining, versions as versions
    from .product import Product as Product, silent as silent
    from .recordfiles import check_records as check_records
    from .replicas import Replicated as Replicated, replica_seed as replica_seed
    from .runner import Cancelled as Cancelled, RunError as RunError, Runner as Runner, RunResult as RunResult
    from .saving import check_period as check_period, check_save_times as check_save_times
    from .session import Session as Session, jit_flags as jit_flags, set_jit_flags as set_jit_flags
    from .stopping import LEAST_PASSES_FOR_ERROR as LEAST_PASSES_FOR_ERROR, CancelEvent as CancelEvent
else:
    __getattr__, __dir__ = on_use(__name__)
