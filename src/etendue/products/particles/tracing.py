"""Particles of light paths: each pass is written to a file, or kept in memory."""

from __future__ import annotations

import shutil
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from etendue.core import (
    CheckpointError,
    InNotebooks,
    Iterations,
    Measurement,
    OptionError,
    Pass,
    Progress,
    Record,
    Settings,
    State,
    describe,
    format_count,
    logger,
)
from etendue.engine import (
    Budget,
    Checkpoint,
    InTurn,
    Job,
    MakeExecutor,
    Order,
    Product,
    RunResult,
    Task,
    check_count,
    silent,
    versions,
)
from etendue.film import replacing
from etendue.methods import (
    MetropolisParticles,
    ParticleTracing,
    box_arguments,
    check_divisible,
    gathered,
    make_box_tracing,
)
from etendue.particles import BoxGrid, Codec, ParticleFile, Particles, ParticleWriter
from etendue.scene import SceneSource, shape_boxes

if TYPE_CHECKING:
    from etendue.distributed import Cluster, Traffic

#: Light paths, if no budget is given.
DEFAULT_PATHS = 1_000_000
_ROWS = "particles"  #: name of the record of particles
_PASS = "after_pass"  #: name of the number of the last pass in the file of a state
#: Ways to trace particles, by name.
TRACINGS: dict[str, Any] = {kind.name: kind for kind in (ParticleTracing, MetropolisParticles)}


@dataclass
class ParticleResult(InNotebooks):
    """The result of a run. ``particles`` are in memory; ``None`` if they are in the file."""

    particles: Particles | None
    file: Path | None
    counters: dict[str, float]
    passes: int
    stopped_by: str
    elapsed: float
    traffic: Traffic | None = None  #: for a scene in boxes: the tasks of the workers

    def __repr__(self) -> str:
        count, where = int(self.counters["particles"]), "" if self.file is None else f" in {self.file}"
        return f"<etendue.ParticleResult {count} particles{where}, {self.elapsed:.1f} s>"


@dataclass
class ParticleProduct(Product[ParticleResult]):
    """Particles in memory, or in a new file to which each pass is written.

    particles: about so many, in place of a budget in paths; a pilot estimates the number of paths. boxes: with workers,
    numbers of boxes along x, y and z into which the scene is cut; each worker holds a share of them.
    """

    kind: ClassVar[str] = "particles"

    output: Path | None = None
    particles: int | None = None
    codec: str = "packed"
    boxes: tuple[int, int, int] | None = None
    known: ParticleFile | None = None  #: the file of a run that is resumed

    def __post_init__(self) -> None:
        self.particles = check_count("particles", self.particles)
        Codec.parse(self.codec)
        if self.boxes is not None:
            BoxGrid.check_counts(self.boxes)
        if self.known is None and self.output is not None and self.output.exists():
            raise OptionError(
                f"'{self.output}' exists: choose another name, remove it, or go on with it by `etendue resume`"
            )
        self._writer: ParticleWriter | None = None
        self._traffic: Traffic | None = None

    @classmethod
    def resumed(cls, path: Path, particles: int | None = None) -> tuple[Self, Checkpoint]:
        """The product of a file that is continued, and the checkpoint of its run. Raises :class:`ParticleError` for a
        file that cannot be read, :class:`CheckpointError` if its run cannot go on."""
        known = ParticleFile(path)
        boxes = known.header.get("boxes")
        made = cls(path, particles, boxes=None if boxes is None else (boxes[0], boxes[1], boxes[2]), known=known)
        return made, _checkpoint(known)

    @property
    def files(self) -> Sequence[Path]:
        """See :class:`Product`."""
        return () if self.output is None else (self.output,)

    def default_budget(self, task: Task, problem: Any) -> Budget:
        """A million paths, unless there is a number of particles."""
        return Budget(samples=DEFAULT_PATHS) if self.particles is None else Budget()

    def settings(self, task: Task, problem: Any, budget: Budget) -> Settings:
        """See :class:`Product`. The length of chains suits a given number of paths or particles."""
        settings: Any = super().settings(task, problem, budget)
        if issubclass(task.method, MetropolisParticles) and (steps := task.budget.samples or self.particles):
            settings = settings.for_budget(steps, task.settings)
        return settings

    def budget(self, method: Any, budget: Budget) -> Budget:
        """See :class:`Product`: the paths of a number of particles."""
        if self.particles is None:
            return budget
        if self.known is None:
            return replace(budget, samples=method.paths_for(self.particles))
        per_path = len(self.known) / max(self.known.paths, 1) or 1.0
        return replace(budget, samples=max(1, round(self.particles / per_path)))

    def prepared(self, job: Job) -> None:
        """See :class:`Product`: makes the file."""
        if self.known is not None:
            self._writer = ParticleWriter.resume(self.known)
            return
        if self.output is None:
            return
        tracing: Any = job.method
        header = {
            "scene": job.problem.source,
            "fingerprint": job.problem.fingerprint,
            "light_fingerprint": job.problem.light_fingerprint,
            "place": job.task.source.place(),
            "seed": job.seed,
            "method": tracing.name,
            "settings": tracing.settings.to_json(),
            "paths_per_pass": tracing.samples_per_iteration,
            "versions": versions(),
        } | ({} if self.boxes is None else {"boxes": list(self.boxes)})
        self._writer = ParticleWriter.create(self.output, header, tracing.surfaces, Codec.parse(self.codec))

    def divided(self, job: Job, cluster: Cluster) -> MakeExecutor:
        """See :class:`Product`. Workers send passes singly, because the file contains single passes."""
        try:
            if job.method.carries_on:
                raise OptionError(
                    f"'{job.method.name}' cannot be divided among workers, because its chains go on from pass to pass; "
                    f"trace by '{ParticleTracing.name}', or without workers"
                )
            return cluster.executor(job, longest=1) if self.boxes is None else self._in_boxes(job, cluster, self.boxes)
        except Exception:
            self._give_up()
            raise

    def _in_boxes(self, job: Job, cluster: Cluster, boxes: tuple[int, int, int]) -> MakeExecutor:
        """The executor of a divided scene."""
        from etendue.distributed import Divided, Traffic, recipe

        tracing, source = job.method, job.task.source
        assert isinstance(tracing, ParticleTracing) and isinstance(source, SceneSource)
        check_divisible(tracing)
        ids, bounds = shape_boxes(job.problem)
        grid = BoxGrid.even(bounds, boxes)
        make = f"{make_box_tracing.__module__}:{make_box_tracing.__name__}"
        recipes = [
            recipe(
                source.part_ingredients({ids[k] for k in grid.touching(box, bounds)}),
                *(tracing, None, box_arguments(grid, box, ids), make),
            )
            for box in range(len(grid))
        ]
        self._traffic = traffic = Traffic()
        paths = tracing.samples_per_iteration
        return lambda order: Divided(cluster.pool, recipes, order, paths, gathered, traffic=traffic)

    def executor(self, job: Job, make: MakeExecutor) -> MakeExecutor:
        """See :class:`Product`: writes the particles of each pass."""
        if self.boxes is not None and make is InTurn and job.start is None:
            logger.info("without workers the scene is not divided into boxes")
        return make if self._writer is None else partial(_Written, self._writer, job, make)

    def described(self, job: Job, progress: Progress) -> Progress:
        """See :class:`Product`."""
        return replace(progress, made=format_count(progress.samples, "path"))

    def keep(self, job: Job, run: RunResult) -> None:
        """See :class:`Product`: passes are in the file already."""
        if self._writer is not None and self._writer.passes:
            self._writer.close(stopped_by=run.stopped_by, elapsed=run.elapsed, **_budget_of(job))

    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> ParticleResult:
        """See :class:`Product`."""
        self.keep(job, run)
        if bad := int(run.measurement.counters["nonfinite"]):
            logger.warning("%d particles had a power that is not finite, and were left out", bad)
        tracing: Any = job.method
        return ParticleResult(
            tracing.particles(run.measurement) if self._writer is None else None,
            None if self._writer is None else self._writer.path,
            dict(run.measurement.counters),
            run.passes,
            str(run.stopped_by),
            run.elapsed,
            self._traffic,
        )

    def _give_up(self) -> None:
        if self._writer is not None and not self._writer.passes:
            self._writer.discard()


def _budget_of(job: Job) -> dict[str, Any]:
    """What a file notes of the budget, so that a resumed run has the rest."""
    return {"budget": job.budget.to_dict(), "earlier": job.earlier}


class _Written:
    """Takes the passes of an executor, writes their particles, and removes these from the measurement."""

    def __init__(self, writer: ParticleWriter, job: Job, make: MakeExecutor, order: Order) -> None:
        self._writer, self._job = writer, job
        try:
            self._inner = make(order)
        except BaseException:
            self._give_up()
            raise
        self._last = time.perf_counter()
        self._began = self._last - job.preparation

    @property
    def keeps_time(self) -> bool:
        """See :class:`Executor`."""
        return self._inner.keeps_time

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        made = self._inner.next()
        return None if made is None else self._write(made)

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`."""
        return map(self._write, self._inner.rest())

    def shares(self) -> dict[str, int]:
        """Passes of each worker."""
        return dict(getattr(self._inner, "shares", dict)())

    def _write(self, made: Pass) -> Pass:
        measurement, begin = made.measurement, self._last
        ((key, rows),) = ((key, measurement.records[_ROWS][key]) for key in measurement.records[_ROWS].passes)
        self._last = time.perf_counter()
        counters = measurement.counters | {"seconds": self._last - begin}
        elapsed = round(self._last - self._began, 3)
        if made.state:  # first: without it, the particles of a killed run could not go on
            _save_state(self._writer.path, made.state, key[1])
        self._writer.add(key[1], rows, counters, elapsed=elapsed, **_budget_of(self._job))
        # A file contains only particles and counters.
        kept = Measurement({}, {}, measurement.iterations, counters=measurement.counters, records={_ROWS: Record()})
        return Pass(kept, made.state)

    def close(self) -> None:
        """See :class:`Executor`: a run that ends before its first pass leaves no file."""
        self._inner.close()
        self._give_up()

    def _give_up(self) -> None:
        if not self._writer.passes:
            self._writer.discard()


def state_file(path: Path) -> Path:
    """The file beside a file of particles with the state after its last pass, of tracings that have one."""
    return path.with_name(path.name + ".state")


def _save_state(path: Path, state: State, iteration: int) -> None:
    arrays: dict[str, Any] = {name: np.asarray(values) for name, values in state.items()} | {_PASS: iteration}
    with replacing(state_file(path)) as part, open(part, "wb") as file:
        np.savez(file, **arrays)


def _load_state(path: Path, iteration: int) -> State:
    """The state after the last pass, ``iteration``, or the next one, if the run was killed before that was written."""
    place = state_file(path)
    try:
        with np.load(place, allow_pickle=False) as arrays:
            state = {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
        raise CheckpointError(
            f"the chains of '{path}' cannot go on without '{place}', which cannot be read ({describe(error)}): put it "
            "back, or trace a new file"
        ) from error
    if (after := int(state.pop(_PASS, iteration))) not in (iteration, iteration + 1):
        where = f"'{place}' has their state after pass {after}, but the last pass is {iteration}"
        raise CheckpointError(f"the chains of '{path}' cannot go on: {where}; trace a new file")
    return state


def _checkpoint(known: ParticleFile) -> Checkpoint:
    """A checkpoint of a run, made from its file of particles."""
    header = known.header
    passes = [[0, int(block.head["pass"]), int(block.head["pass"]) + 1] for block in known.passes]
    if not passes:
        raise CheckpointError(f"'{known.path}' has no whole pass; remove it, and trace the particles anew")
    ending = {"stopped_by": "running"} | known.passes[-1].head | known.ending
    names = {_ROWS: Record()}
    method = str(header.get("method", ParticleTracing.name))
    if method not in TRACINGS:
        raise CheckpointError(f"'{known.path}' was traced by '{method}', which this étendue does not have")
    return Checkpoint(
        measurement=Measurement({}, {}, Iterations.from_json(passes), counters=dict(known.counters), records=names),
        method=method,
        state=dict(_load_state(Path(known.path), passes[-1][1])) if TRACINGS[method].carries_on else {},
        settings=header["settings"],
        seed=int(header["seed"]),
        fingerprint=header["fingerprint"],
        scene=dict(header["place"]),
        budget=dict(ending["budget"]),
        stopped_by=str(ending["stopped_by"]),
        versions=dict(header["versions"]),
        elapsed=float(ending["elapsed"]),
        earlier=float(ending["earlier"]),
    )


def repack(source: Path, output: Path, codec: str, tell: Callable[[int, int], object] = lambda done, of: None) -> Path:
    """Write the particles of a file by another codec; ``tell`` gets the number of passes done and of all passes.

    Raises :class:`ParticleError` for a file that cannot be read, :class:`OutputError` if ``output`` exists or cannot be
    written; an incomplete ``output`` is removed."""
    chosen, known = Codec.parse(codec), ParticleFile(source)
    header = {name: value for name, value in known.header.items() if name not in ("crc", "surfaces", "format")}
    if known.codec.is_bounded:
        header["before"] = [*known.header.get("before", []), str(known.codec)]
        logger.info("%s is packed with bounded loss already", source)
    writer = ParticleWriter.create(output, header, known.surfaces, chosen)
    try:
        for done, (end, rows) in enumerate(known.rows_of_passes(), start=1):
            more = {name: value for name, value in end.head.items() if name not in ("pass", "counters", "crc")}
            writer.add(int(end.head["pass"]), rows, end.head["counters"], **more)
            tell(done, len(known.passes))
        ending = {name: value for name, value in known.ending.items() if name != "crc"}
        if state_file(source).exists():  # of chains, which go on with it
            shutil.copyfile(state_file(source), state_file(output))
        writer.close(**ending)  # without an ending the copy is not finished either
    except BaseException:
        writer.discard()
        raise
    return output
