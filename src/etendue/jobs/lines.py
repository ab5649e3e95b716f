"""Lines cast through patches until a budget is used up, for form factors or for a solution."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from etendue.core import free_memory, prepared
from etendue.distributed import Ingredients, Recipe, recipe
from etendue.engine import Budget, Checkpoint, Job, Runner, RunResult
from etendue.radiosity import (
    REPLICATES,
    CastingSettings,
    CastLines,
    DividedMultipath,
    HierarchicalCasting,
    HierarchicalCastingSettings,
    HierarchicalMultipath,
    LineCasting,
    MultipathPasses,
    Objects,
    Part,
    PartProblem,
    Patches,
    PatchProblem,
    RadiosityError,
)

if TYPE_CHECKING:
    from etendue.core import Measurement, RecordFile
    from etendue.distributed import Cluster

#: Share of the memory or of the disk that a run without a number of bundles may fill.
_SHARE = 0.6
#: Share of the free memory that segments may take before they are written to the records of the checkpoint.
_UNSAVED_SHARE = 0.25
#: Saves join small files of records, so that the disk needs room for twice the segments.
_COPIES = 2


@dataclass(frozen=True)
class LinesTask:
    """The input of a :class:`LinesJob`. A sample of the budget is a bundle, its error is the *square* of a standard
    error: see :class:`LineCasting`."""

    patches: Patches
    goal: Literal["rows", "irradiance"]  #: errors of the rows of form factors, or of the irradiance
    budget: Budget
    source: str = "<patches>"
    seed: int = 0
    lines: float = 0.0
    shot: bool = True
    local_rays: bool = True
    #: For lines in a hierarchy: its objects, and further options of :class:`HierarchicalCastingSettings`.
    objects: Objects | None = None
    hierarchy: Mapping[str, Any] = field(default_factory=dict)
    #: Whether an error ends this run, or the run that it resumes: lines are then cast as replicates.
    to_error: bool = False
    #: Whether errors are estimated during the run even if the budget has none.
    is_watched: bool = False
    #: Bytes of each form factor that will be computed from the segments; 0 if none are.
    entry_bytes: float = 0.0
    #: The checkpoint in whose records the segments are stored; without it they stay in memory.
    checkpoint: Path | None = None
    #: Plain values for the checkpoint.
    notes: Mapping[str, Any] = field(default_factory=dict)
    #: Name of the number of bundles in messages.
    bundles_option: str = "bundles="


class LinesJob:
    """A task and its line casting, which continues the checkpoint ``saved``."""

    def __init__(self, task: LinesTask, saved: Checkpoint | None = None) -> None:
        self.task, self._saved = task, saved
        self._job: Job | None = None
        self._room: float | None = None  # bytes of segments in memory before they are written
        self._files: list[RecordFile] = []
        self._rows_in_files = 0
        self._is_limited_by_disk = False
        self.casting = self._casting()

    def runner(self, cluster: Cluster | None = None, **options: Any) -> Runner:
        """Prepare the casting, in the workers of ``cluster`` if it is given; ``options`` are those of :class:`Runner`.

        Raises :class:`RadiosityError` if memory or disk has no room for the requested bundles, and
        :class:`CheckpointError` for a checkpoint of other patches.
        """
        task, saved, casting = self.task, self._saved, self.casting
        problem = PatchProblem(task.patches, task.source)
        begin = time.perf_counter()
        if saved is not None:
            asked = casting.settings.to_dict()
            del asked["bundles_per_pass"]  # keep that of the checkpoint: another machine may choose another
            settings = saved.settings_of(type(casting), asked, task.seed)
            saved.require_scene(problem.fingerprint)
            casting = self.casting = self._casting(settings)
        prepared(casting, problem, task.seed)
        casting.most, limited = self._limited()
        earlier = 0.0
        if saved is not None:
            casting.go_on(saved.measurement)
            earlier = saved.earlier + saved.elapsed
            options |= {"start": saved.measurement, "state": saved.state}
        known: Any = {"seed": task.seed, "budget": task.budget, "place": {}, "earlier": earlier, "notes": task.notes}
        self._job = Job(problem, casting, **known)  # type: ignore[arg-type]
        if cluster is not None:
            of_run = {"most": casting.most, "owed": casting.owed}
            options["executor"] = cluster.executor(patch_recipe(problem, casting), of_run)
        return Runner(casting, seed=task.seed, budget=limited, spent=time.perf_counter() - begin, **options)

    def checkpoint(self, run: RunResult) -> Checkpoint:
        """All that is needed to resume ``run`` later."""
        assert self._job is not None, "there is no run without a runner"
        return self._job.checkpoint(run)

    def cast(self, run: RunResult) -> CastLines:
        """End the casting and return the lines of ``run``."""
        self.casting.close()
        return CastLines(self.casting, run.measurement)

    def fills_memory(self, measurement: Measurement) -> bool:
        """Whether the segments that are not in files yet take so much memory that they should be written."""
        if self._room is None:
            free = free_memory()
            self._room = float("inf") if free is None else _UNSAVED_SHARE * free
        (record,) = measurement.records.values()
        if record.files is not self._files:  # a new list after each save
            self._files, self._rows_in_files = record.files, sum(map(len, record.files))
        rows = next(iter(record))
        return (len(record) - self._rows_in_files) * rows.itemsize * rows.shape[1] > self._room

    def is_full(self, run: RunResult) -> bool:
        """Whether full memory or a full disk, not the budget, ended the run."""
        return self.task.budget.samples is None and run.stopped_by == "samples"

    def why_full(self, bundles: int) -> str:
        """The message for a full run."""
        if self._is_limited_by_disk:
            return f"the disk has room for no more than these {bundles} bundles of lines: free some, or use another one"
        return f"memory holds no more than these {bundles} bundles of lines: free some, or make patches larger"

    def _casting(self, settings: Any = None) -> LineCasting:
        """The line casting of the task, with the settings of a checkpoint if there is one."""
        task = self.task
        goal: Any = task.goal if task.is_watched or task.budget.error is not None else None
        if task.objects is not None:
            options = {"lines": task.lines, **task.hierarchy}
            asked = HierarchicalCastingSettings.from_mapping(options, owner="a hierarchy")
            return HierarchicalCasting(task.objects, settings or asked, goal=goal)
        asked_flat = CastingSettings(
            lines=task.lines,
            shot=task.shot,
            local_rays=task.local_rays,
            replicates=REPLICATES if task.to_error else 1,
        )
        return LineCasting(settings or asked_flat, goal=goal)

    def _limited(self) -> tuple[int, Budget]:
        """The largest number of bundles, and a budget with this number."""
        budget, casting, checkpoint = self.task.budget, self.casting, self.task.checkpoint
        saved = self._saved
        before, passes = (
            (0, 0) if saved is None else (casting.bundles(saved.measurement), len(saved.measurement.iterations))
        )
        wanted = {} if budget.samples is None else {"wanted": budget.samples - before}
        room = casting.memory(self.task.entry_bytes, in_files=checkpoint is not None, **wanted)
        place = "into memory"
        if checkpoint is not None:
            on_disk = int(shutil.disk_usage(checkpoint.parent).free / (_COPIES * casting.bytes_per_bundle))
            if on_disk < room:
                room, place = on_disk, f"on the disk of '{checkpoint}'"
                self._is_limited_by_disk = True
        most = budget.samples or before + int(_SHARE * room)
        if most > before + room or most < 1:
            raise RadiosityError(
                f"{most} bundles of lines through {len(casting.patches)} patches do not fit {place}, {before + room} "
                f"do: ask for fewer ({self.task.bundles_option}), or make patches larger"
            )
        # One more pass casts bundles that the last pass has left out, even if its own are all beyond the limit.
        whole = casting.samples_per_iteration * (passes + 1) if most > before else most
        return most, Budget(budget.seconds, max(most, whole), None, budget.error)


# -- on a cluster ----------------------------------------------------------------------------------------------------


def patch_recipe(problem: PatchProblem, method: LineCasting | MultipathPasses) -> Recipe:
    """The recipe of a method that works on patches."""
    arrays = problem.patches.arrays()
    make: str | None = None
    given: dict[str, NDArray[Any]] = {}
    if isinstance(method, HierarchicalCasting):
        make = f"{__name__}:casting_in_hierarchy"
        found = method.objects
        given = {name: getattr(found, name) for name in ("of_patch", "areas", "lower", "upper")}
        given["names"] = np.array(found.names, dtype=str)
    ingredients = Ingredients(f"{__name__}:open_patches", {}, arrays)
    return recipe(ingredients, method, problem.fingerprint, given, make)


def part_recipe(
    problem: PartProblem,
    method: HierarchicalMultipath,
    given: Mapping[str, NDArray[Any]] | None = None,
    make: str | None = None,
) -> Recipe:
    """The recipe of a method that works on parts; ``given`` and ``make``: ``arguments`` and ``make`` of
    :func:`etendue.distributed.recipe`."""
    parts = problem.root.distinct
    number = {id(part): k for k, part in enumerate(parts)}
    arrays: dict[str, NDArray[Any]] = {}
    rows = []
    for k, part in enumerate(parts):
        if part.patches is not None:
            arrays |= {f"{k}/{name}": array for name, array in part.patches.arrays().items()}
        arrays[f"{k}:numbers"] = part.numbers
        for c, copy in enumerate(part.copies):
            arrays[f"{k}:copies{c}"] = copy.transforms
        copies = [number[id(copy.part)] for copy in part.copies]
        rows.append({"has_patches": part.patches is not None, "objects": part.objects, "copies": copies})
    ingredients = Ingredients(f"{__name__}:open_parts", {"parts": rows}, arrays)
    return recipe(ingredients, method, problem.fingerprint, given, make)


def unit_recipes(method: DividedMultipath) -> list[Recipe]:
    """Recipes for the workers of a divided scene, each with the boxes of one unit and nothing around them."""
    return [part_recipe(unit.problem, method, method.arguments(unit), method.inside) for unit in method.units]


def open_patches(ingredients: Ingredients, folder: Path) -> PatchProblem:
    """The problem of :func:`patch_recipe`."""
    return PatchProblem(Patches.of_arrays(ingredients.arrays))


def open_parts(ingredients: Ingredients, folder: Path) -> PartProblem:
    """The problem of :func:`part_recipe`."""
    arrays = ingredients.arrays
    parts: list[Part] = []
    for k, row in enumerate(ingredients.values["parts"]):
        own = {name.removeprefix(f"{k}/"): array for name, array in arrays.items() if name.startswith(f"{k}/")}
        copies = [(parts[inner], arrays[f"{k}:copies{c}"]) for c, inner in enumerate(row["copies"])]
        patches = Patches.of_arrays(own) if row["has_patches"] else None
        parts.append(Part(patches, copies, numbers=arrays[f"{k}:numbers"], objects=row["objects"]))
    return PartProblem(parts[-1])


def casting_in_hierarchy(
    settings: HierarchicalCastingSettings, problem: PatchProblem, names: NDArray[Any], **objects: Any
) -> HierarchicalCasting:
    """The method of :func:`patch_recipe` in a hierarchy."""
    return HierarchicalCasting(Objects(problem.patches, names=tuple(map(str, names)), **objects), settings)
