"""Room for lines: how many bundles fit into memory and onto the disk."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.core import free_memory
from etendue.engine import Budget, Job, RunResult
from etendue.radiosity import SEGMENTS, LineCasting, RadiosityError

if TYPE_CHECKING:
    from etendue.core import Measurement, RecordFile

#: Share of the memory or of the disk that a run without a number of bundles may fill.
_SHARE = 0.6
#: Share of the free memory that segments may take before they are written to the records of the checkpoint.
_UNSAVED_SHARE = 0.25
#: Saves join small files of records, so that the disk needs room for twice the segments.
_COPIES = 2


class LineRoom:
    """Room for the lines of a job by :class:`LineCasting`.

    checkpoint: the file in whose records the segments are stored; without it they stay in memory. entry_bytes: bytes of
    each form factor that will be computed from the segments; 0 if none are.
    """

    def __init__(self, job: Job, checkpoint: Path | None, entry_bytes: float) -> None:
        assert isinstance(job.method, LineCasting)
        self._casting, self._checkpoint, self._entry_bytes = job.method, checkpoint, entry_bytes
        self._budget = job.budget
        self._is_limited_by_disk = False
        self._room: float | None = None  # bytes of segments in memory before they are written
        self._files: list[RecordFile] = []
        self._rows_in_files = 0
        self._casting.most, job.limits = self._limited(job.start)
        if job.start is not None:
            self._casting.go_on(job.start)

    def fills_memory(self, measurement: Measurement) -> bool:
        """Whether the segments that are not in files yet take so much memory that they should be written."""
        if self._room is None:
            free = free_memory()
            self._room = float("inf") if free is None else _UNSAVED_SHARE * free
        record = measurement.records[SEGMENTS]
        if record.files is not self._files:  # a new list after each save
            self._files, self._rows_in_files = record.files, sum(map(len, record.files))
        rows = next(iter(record))
        return (len(record) - self._rows_in_files) * rows.itemsize * rows.shape[1] > self._room

    def warning(self, run: RunResult) -> str | None:
        """A warning if full memory or a full disk, not the budget, ended the run."""
        if self._budget.samples is not None or run.stopped_by != "samples":
            return None
        bundles = self._casting.bundles(run.measurement)
        if self._is_limited_by_disk:
            return f"the disk has room for no more than these {bundles} bundles of lines: free some, or use another one"
        return f"memory holds no more than these {bundles} bundles of lines: free some, or make patches larger"

    def _limited(self, start: Measurement | None) -> tuple[int, Budget]:
        """The largest number of bundles, and a budget with this number."""
        budget, casting = self._budget, self._casting
        before, passes = (0, 0) if start is None else (casting.bundles(start), len(start.iterations))
        wanted = {} if budget.samples is None else {"wanted": budget.samples - before}
        room = casting.memory(self._entry_bytes, in_files=self._checkpoint is not None, **wanted)
        place = "into memory"
        if self._checkpoint is not None:
            on_disk = int(shutil.disk_usage(self._checkpoint.parent).free / (_COPIES * casting.bytes_per_bundle))
            if on_disk < room:
                room, place = on_disk, f"on the disk of '{self._checkpoint}'"
                self._is_limited_by_disk = True
        most = budget.samples or before + int(_SHARE * room)
        if most > before + room or most < 1:
            raise RadiosityError(
                f"{most} bundles of lines through {len(casting.patches)} patches do not fit {place}, {before + room} "
                "do: ask for fewer, or make patches larger"
            )
        # One more pass casts bundles that the last pass has left out, even if its own are all beyond the limit.
        whole = casting.samples_per_iteration * (passes + 1) if most > before else most
        return most, Budget(budget.seconds, max(most, whole), None, budget.error)
