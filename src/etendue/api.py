"""The Python door: one call that renders, one that renders in the background, one that goes on with a checkpoint."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, OutputError, Progress, Result, use_variant
from etendue.engine import (
    Budget,
    Checkpoint,
    Job,
    RunError,
    Runner,
    RunResult,
    Session,
    Task,
    check_writable,
    warn_of_nonfinite,
)

PathLike = str | os.PathLike[str]
Image = NDArray[np.float32]


@dataclass
class Rendering:
    """A picture, what it is made of, and how it was made.

    ``layers`` are float32 arrays (height, width, channels), linear RGB: ``image``, the technique families that it is
    the sum of, and first-hit layers if they were asked for. ``metadata`` has method, settings, seed, versions, passes,
    samples, seconds, rays and more.
    """

    layers: dict[str, Image]
    metadata: dict[str, Any]
    _checkpoint: Callable[[], Checkpoint] = field(repr=False)

    @property
    def image(self) -> Image:
        """The picture, (height, width, 3), linear RGB radiance."""
        return self.layers["image"]

    def save(self, path: PathLike) -> None:
        """Write ``.exr`` (every layer and the metadata) or ``.png`` (tone-mapped), by the suffix.

        Raises :class:`OptionError` for another suffix, :class:`OutputError` if the file cannot be written.
        """
        save_result(path, Result(self.layers, self.metadata))

    def save_checkpoint(self, path: PathLike) -> None:
        """Write all that :func:`resume` needs. Raises :class:`OutputError` if it cannot be written."""
        self._checkpoint().write(Path(path))


@dataclass(frozen=True)
class Update:
    """What a callback is given after a pass."""

    progress: Progress
    _runner: Runner = field(repr=False)

    @property
    def image(self) -> Image:
        """The picture so far, developed when asked for."""
        snapshot = self._runner.snapshot()
        assert snapshot is not None  # a callback follows a pass
        return snapshot.image


#: Called after each pass; rendering stops if it returns ``False``.
Callback = Callable[[Update], object]


def render(
    scene: Any,
    method: str = "vcm",
    *,
    seconds: float | None = None,
    samples: int | None = None,
    error: float | None = None,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    **settings: Any,
) -> Rendering:
    """Render ``scene`` by ``method`` and return the picture with its layers and metadata.

    ``scene`` is the path of a Mitsuba XML file, a scene dictionary, a loaded ``mi.Scene`` or the name of a bundled
    scene. ``seconds``, ``samples`` (camera paths per pixel) and ``error`` (relative noise) limit the run, the first
    one reached ends it; without any the scene's own sample count does. ``settings`` are those of the method (see
    ``etendue methods NAME``). If no Mitsuba variant is set, a usable one is chosen.

    ``callback`` is called after each pass with an :class:`Update`; if it returns ``False``, rendering stops there.
    ``save`` names ``.exr`` or ``.png`` files and ``checkpoint`` a file for :func:`resume`; they are written at the end
    and, with ``save_every``, every so many seconds. If a pass fails, or Ctrl-C interrupts, they are written with what
    there is before the error goes on.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError`, :class:`BackendError`, each before the first
    pass where that is possible, and :class:`engine.RunError` if a later pass fails.
    """
    task, outputs = _prepare(
        scene, method, seconds, samples, error, size, sensor, seed, parameters, memory, save, checkpoint, settings
    )
    use_variant(variant)
    return _drive(Job.open(task), outputs, callback, save_every)


def start(
    scene: Any,
    method: str = "vcm",
    *,
    seconds: float | None = None,
    samples: int | None = None,
    error: float | None = None,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    save: PathLike | Sequence[PathLike] = (),
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    **settings: Any,
) -> Session[Rendering]:
    """As :func:`render`, but return at once: the scene is loaded and rendered in a thread.

    The session has the picture so far in ``image`` and its state in ``progress``; ``cancel()`` stops after the current
    pass and returns when that has happened; ``wait()`` and ``result`` raise what went wrong. Options and budgets are
    checked before this returns.
    """
    task, outputs = _prepare(
        scene, method, seconds, samples, error, size, sensor, seed, parameters, memory, save, checkpoint, settings
    )
    use_variant(variant)
    return start_job(lambda: Job.open(task), outputs, save_every)


def resume(
    checkpoint: PathLike,
    *,
    scene: Any = None,
    seconds: float | None = None,
    samples: int | None = None,
    error: float | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    save_every: float | None = None,
) -> Rendering:
    """Go on with a checkpoint, and update it.

    The result is that of a run that was never interrupted. ``seconds`` count from now, ``samples`` and ``error`` speak
    of the whole picture; without a budget the interrupted one is used up. ``scene`` is needed if the scene lay in
    memory or has moved. Raises :class:`CheckpointError` if the file is damaged or the scene is another one.
    """
    from etendue import methods

    budget = Budget(seconds, samples, None, error)
    saved = Checkpoint.read(checkpoint)
    outputs = Outputs.of(save, checkpoint)
    use_variant(variant)
    job = Job.resume(saved, methods.get(saved.method), budget=budget or None, scene=scene)
    return _drive(job, outputs, callback, save_every)


@dataclass(frozen=True)
class Outputs:
    """Files that a run writes. Construction by :meth:`of` checks that they can be written."""

    pictures: tuple[Path, ...] = ()
    checkpoint: Path | None = None

    @classmethod
    def of(cls, pictures: PathLike | Sequence[PathLike], checkpoint: PathLike | None = None) -> Outputs:
        """Raises :class:`OptionError` for an unknown suffix, :class:`OutputError` for a place that is not writable."""
        listed = [pictures] if isinstance(pictures, (str, os.PathLike)) else list(pictures)
        outputs = cls(tuple(Path(p) for p in listed), Path(checkpoint) if checkpoint is not None else None)
        for path in outputs.pictures:
            _check_suffix(path)
        for path in (*outputs.pictures, *([outputs.checkpoint] if outputs.checkpoint else [])):
            check_writable(path)
        return outputs

    def __bool__(self) -> bool:
        return bool(self.pictures) or self.checkpoint is not None

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Develop ``run`` and write every file. One that fails does not keep the others from being written.

        Raises the first :class:`OutputError` when all have been tried; a picture whose place has failed at the end of
        a run is then in the system's folder for temporary files, if that takes it.
        """
        result = job.result(run)
        errors: list[str] = []
        for path in self.pictures:
            try:
                save_result(path, result)
            except OutputError as error:
                rescued = _rescue(path, result) if run.stopped_by != "running" else None
                errors.append(f"{error}; the picture is in '{rescued}' instead" if rescued else str(error))
        if self.checkpoint is not None:
            try:
                job.checkpoint(run).write(self.checkpoint)
            except OutputError as error:
                errors.append(str(error))
        if errors:
            raise OutputError(errors[0])
        return Rendering(result.layers, result.metadata, lambda: job.checkpoint(run))


def _rescue(path: Path, result: Result) -> Path | None:
    """Write ``result`` to a new file in the folder for temporary files; where, or ``None`` if that fails too."""
    try:
        place = Path(tempfile.mkdtemp(prefix="etendue-")) / path.name
        save_result(place, result)
    except (OSError, OutputError):
        return None
    return place


def save_result(path: PathLike, result: Result) -> None:
    """Write a result as ``.exr`` (layers and metadata) or ``.png`` (tone-mapped)."""
    from etendue import display, film

    path = Path(path)
    if _check_suffix(path) == ".exr":
        film.write_exr(path, result)
    else:
        display.write_png(path, display.tonemap(result.image, "auto"))


def start_job(
    open_job: Callable[[], Job],
    outputs: Outputs,
    save_every: float | None = None,
    watch: Callable[[Update], None] | None = None,
) -> Session[Rendering]:
    """A session that opens a job in its thread, runs it and writes ``outputs``, also when a pass fails.

    ``watch`` is called in that thread after each pass.
    """
    jobs: list[Job] = []

    def build(cancel: Any) -> Runner:
        jobs.append(open_job())
        runner = jobs[0].runner(**_saving(jobs[0], outputs, save_every), cancel=cancel)
        if watch is not None:
            runner.on_progress = lambda progress: watch(Update(progress, runner))
        return runner

    def finish(run: RunResult) -> Rendering:
        if run.stopped_by != "failure":
            warn_of_nonfinite(run)
        return outputs.write(jobs[0], run)

    return Session(build, finish)


def _prepare(
    scene: Any,
    method: str,
    seconds: float | None,
    samples: int | None,
    error: float | None,
    size: tuple[int, int] | None,
    sensor: int,
    seed: int,
    parameters: Mapping[str, Any] | None,
    memory: int | None,
    save: PathLike | Sequence[PathLike],
    checkpoint: PathLike | None,
    settings: Mapping[str, Any],
) -> tuple[Task, Outputs]:
    from etendue import methods

    task = Task(
        scene=scene,
        method=methods.get(method),
        settings=settings,
        seed=seed,
        budget=Budget(seconds, samples, None, error),
        size=size,
        sensor=sensor,
        parameters=parameters,
        memory=memory,
    )
    return task, Outputs.of(save, checkpoint)


def _saving(job: Job, outputs: Outputs, save_every: float | None) -> dict[str, Any]:
    if save_every is None or not outputs:
        return {}
    return {"on_save": lambda run: outputs.write(job, run), "save_every": save_every}


def _drive(job: Job, outputs: Outputs, callback: Callback | None, save_every: float | None) -> Rendering:
    """Run in this thread, so that the callback may do what it likes (plot, raise)."""
    stop = threading.Event()

    def after_pass(progress: Progress) -> None:
        assert callback is not None
        if callback(Update(progress, runner)) is False:
            stop.set()

    runner = job.runner(**_saving(job, outputs, save_every), cancel=stop)
    if callback is not None:
        runner.on_progress = after_pass
    try:
        run = runner.run()
    except RunError as failure:
        outputs.write(job, failure.run)
        raise
    except KeyboardInterrupt:
        if (done := runner.interrupted()) is not None:
            outputs.write(job, done)
        raise
    warn_of_nonfinite(run)
    return outputs.write(job, run)


def _check_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".exr", ".png"):
        raise OptionError(f"a picture is written as .exr or .png, not as '{path.name}'; change the name")
    return suffix
