"""The Python door: one call that renders, one that renders in the background, one that goes on with a checkpoint."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from etendue.core import (
    OptionError,
    OutputError,
    Progress,
    Result,
    describe,
    logger,
    use_variant,
    warn_of_nonfinite,
)
from etendue.engine import (
    Budget,
    Checkpoint,
    Job,
    RunError,
    Runner,
    RunResult,
    Session,
    Task,
    check_period,
)
from etendue.film import check_writable

PathLike = str | os.PathLike[str]
Image = NDArray[np.float32]


@dataclass(repr=False)
class Rendering:
    """A picture, what it is made of, and how it was made.

    ``layers`` are float32 arrays (height, width, channels), linear RGB: ``image``; with the setting ``split_layers``
    the technique families that it is the sum of; with ``pyramid`` the techniques (``film.Technique`` reads their
    names); with ``aovs`` first-hit layers. ``metadata`` has method, settings,
    seed, versions, passes, samples, seconds, rays and more.
    """

    layers: dict[str, Image]
    metadata: dict[str, Any]
    _checkpoint: Callable[[], Checkpoint]

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

    def __repr__(self) -> str:
        m, (height, width) = self.metadata, self.image.shape[:2]
        return f"<etendue.Rendering {m['method']} {width}x{height}, {m['samples']} spp, {m['seconds']:.1f} s>"


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
    method: str | None = None,
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

    Without a method it is the integrator that the scene names, if that is one of étendue's other than ``path`` (which
    every scene file for Mitsuba names), else ``vcm``.

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
    budget, outputs = Budget(seconds, samples, None, error), Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    chosen = choose_method(method, scene, parameters)
    task = Task(scene, chosen, _named(settings), seed, budget, size, sensor, parameters, memory)
    return _run(Job.open(task), outputs, callback)


def start(
    scene: Any,
    method: str | None = None,
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
) -> Session[Rendering]:
    """As :func:`render`, but return at once: a thread loads the scene, renders it and calls ``callback``.

    The session has the picture so far in ``image`` and its state in ``progress``; ``cancel()`` stops after the current
    pass and returns when that has happened; ``wait()`` and ``result`` raise what went wrong. Options and budgets are
    checked before this returns.
    """
    budget, outputs = Budget(seconds, samples, None, error), Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    chosen = choose_method(method, scene, parameters)
    task = Task(scene, chosen, _named(settings), seed, budget, size, sensor, parameters, memory)
    return start_job(lambda: Job.open(task), outputs, callback)


def resume(
    checkpoint: PathLike,
    method: str | None = None,
    *,
    scene: Any = None,
    seconds: float | None = None,
    samples: int | None = None,
    error: float | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    save_every: float | None = None,
    **settings: Any,
) -> Rendering:
    """Go on with a checkpoint, and update it.

    The result is that of a run that was never interrupted. ``seconds`` count from now, ``samples`` and ``error`` speak
    of the whole picture; without a budget the interrupted one is used up. ``scene`` is needed if the scene lay in
    memory or has moved. ``method`` and ``settings`` need not be given; they cannot be changed. Raises
    :class:`CheckpointError` if the file is damaged, or scene, method or settings are other ones.
    """
    from etendue import methods

    budget = Budget(seconds, samples, None, error)
    saved = Checkpoint.read(checkpoint)
    outputs = Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    kind = methods.get(method if method is not None else saved.method)
    saved.settings_of(kind, _named(settings))
    job = Job.resume(saved, kind, budget=budget or None, scene=scene)
    return _run(job, outputs, callback)


def choose_method(
    name: str | None, scene: Any, parameters: Mapping[str, Any] | None, tell: Callable[[str], object] = logger.info
) -> type[Any]:
    """The class of the method ``name``; without a name that of the scene's integrator (not ``path``), else ``vcm``.

    ``tell`` is given a line if the scene's integrator is passed over.
    Raises :class:`OptionError` for an unknown name, and what the parsing of the scene raises.
    """
    from etendue import methods
    from etendue.scene import integrator_of

    if name is not None:
        return methods.get(name)
    named = integrator_of(scene, parameters)
    if named in methods.table() and named != "path":
        return methods.get(named)
    if named:
        tell(f"the scene names the integrator '{named}'; as no method was asked for, vcm renders it")
    return methods.get("vcm")


def _named(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """``settings``, unless one is a budget by the name that it has elsewhere."""
    for elsewhere, here in (("spp", "samples"), ("time", "seconds")):
        if elsewhere in settings:
            raise OptionError(f"there is no argument '{elsewhere}'; did you mean '{here}'?")
    return settings


class Writer(Protocol):
    """What keeps a run: told how often and, at the end, that it is to write. :class:`Outputs` is one."""

    @property
    def files(self) -> Sequence[Path]:
        """What is written, or has been."""
        ...

    def saving(self, job: Job) -> dict[str, Any]:
        """Options of a :class:`Runner` of ``job`` that write from time to time."""
        ...

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Write the outcome of a run."""
        ...


@dataclass(frozen=True)
class Outputs:
    """Files that a run writes. Construction by :meth:`of` checks that they can be written."""

    pictures: tuple[Path, ...] = ()
    checkpoint: Path | None = None
    save_every: float | None = None  #: seconds between intermediate saves, ``None`` for none
    separate: bool = False  #: each layer of an ``.exr`` in a file of its own

    @classmethod
    def of(
        cls,
        pictures: PathLike | Sequence[PathLike],
        checkpoint: PathLike | None = None,
        save_every: float | None = None,
        separate: bool = False,
    ) -> Outputs:
        """Raises :class:`OptionError` for an unknown suffix, a file that is named twice or a time that is not above 0,
        :class:`OutputError` for a place that is not writable."""
        listed = [pictures] if isinstance(pictures, (str, os.PathLike)) else list(pictures)
        check_period(save_every)
        outputs = cls(
            tuple(map(Path, listed)), Path(checkpoint) if checkpoint is not None else None, save_every, separate
        )
        for path in outputs.pictures:
            _check_suffix(path)
        places = [path.resolve() for path in outputs.files]
        for path in outputs.files:
            if places.count(path.resolve()) > 1:
                raise OptionError(f"'{path}' is named for two outputs; give each a name of its own")
            check_writable(path)
        return outputs

    @property
    def files(self) -> tuple[Path, ...]:
        """Pictures, then the checkpoint."""
        return self.pictures if self.checkpoint is None else (*self.pictures, self.checkpoint)

    def saving(self, job: Job) -> dict[str, Any]:
        """Options of a :class:`Runner` of ``job`` that write the files from time to time."""
        if self.save_every is None or not self.files:
            return {}
        return {"on_save": lambda run: self.write(job, run), "save_every": self.save_every}

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Write the checkpoint, develop ``run`` and write every picture. One that fails does not keep the others from
        being written, whatever the reason.

        Raises :class:`OutputError` with every failure when all have been tried. At the end of a run what has failed is
        then in the system's folder for temporary files, if that takes it: a picture, as arrays (``.npz``) if it is the
        writing that fails; the checkpoint; and a checkpoint, asked for or not, if the picture cannot be developed.
        """
        ending = run.stopped_by != "running"
        failures: list[str] = []

        def attempt(path: Path, what: str, write: _Write, plainly: _Write | None = None) -> None:
            try:
                write(path)
            except Exception as error:
                failure = str(error) if isinstance(error, OutputError) else f"cannot write '{path}': {describe(error)}"
                failures.append(failure + (_rescue(path.name, what, write, plainly) if ending else ""))

        def write_checkpoint(path: Path) -> None:
            job.checkpoint(run).write(path)

        if self.checkpoint is not None:  # first, as it holds all that was measured
            attempt(self.checkpoint, "checkpoint", write_checkpoint)
        try:
            result = job.result(run)
        except Exception as error:
            failures.append(f"cannot develop the picture: {describe(error)}")
            if ending and self.checkpoint is None:
                failures[-1] += _rescue("render.checkpoint", "checkpoint", write_checkpoint)
            raise OutputError("; ".join(failures)) from error
        for picture in self.pictures:
            attempt(
                picture,
                "picture",
                lambda path: save_result(path, result, self.separate),
                lambda path: _write_arrays(path, result.layers),
            )
        if failures:
            raise OutputError("; ".join(failures))
        return Rendering(result.layers, result.metadata, lambda: job.checkpoint(run))


_Write = Callable[[Path], None]


def _rescue(name: str, what: str, write: _Write, plainly: _Write | None = None) -> str:
    """Write to the folder for temporary files, ``plainly`` if need be; in words where it is, "" if all has failed."""
    for suffix, way in (("", write), (".npz", plainly)):
        with contextlib.suppress(Exception):
            if way is not None:
                place = Path(tempfile.mkdtemp(prefix="etendue-")) / (name + suffix)
                way(place)
                return f"; the {what} is in '{place}' instead"
    return ""


def _write_arrays(path: Path, layers: Mapping[str, Image]) -> None:
    with path.open("wb") as file:
        np.savez(file, **layers)  # type: ignore[arg-type]


def save_result(path: PathLike, result: Result, separate: bool = False) -> None:
    """Write a result as ``.exr`` (layers and metadata; ``separate``: a file each) or ``.png`` (tone-mapped)."""
    from etendue import display, film

    path = Path(path)
    if _check_suffix(path) == ".exr" and separate:
        film.write_layers(path, result)
    elif path.suffix.lower() == ".exr":
        film.write_exr(path, result)
    else:
        display.write_png(path, display.tonemap(result.image, "auto"))


def start_job(open_job: Callable[[], Job], outputs: Writer, callback: Callback | None = None) -> Session[Rendering]:
    """A session that opens a job in its thread, runs it and writes ``outputs``, also when a pass fails.

    ``callback`` is called in that thread after each pass.
    """
    jobs: list[Job] = []

    def build(stop: threading.Event) -> Runner:
        jobs.append(open_job())
        return _runner(jobs[0], outputs, callback, stop)

    return Session(build, lambda run: _finish(jobs[0], outputs, run))


def _run(job: Job, outputs: Outputs, callback: Callback | None) -> Rendering:
    """Run in this thread, so that the callback may do what it likes (plot, raise)."""
    runner = _runner(job, outputs, callback, threading.Event())
    try:
        run = runner.run()
    except RunError as failure:
        _keep(job, outputs, failure.run)
        raise
    except KeyboardInterrupt:
        if (done := runner.interrupted()) is not None:
            _keep(job, outputs, done)
        raise
    return _finish(job, outputs, run)


def _keep(job: Job, outputs: Outputs, run: RunResult) -> None:
    """Write what there is before an error; that error is what the caller should hear of."""
    try:
        _finish(job, outputs, run)
    except Exception as error:
        logger.warning("what was rendered could not be saved: %s", describe(error))


def _runner(job: Job, outputs: Writer, callback: Callback | None, stop: threading.Event) -> Runner:
    runner = job.runner(**outputs.saving(job), cancel=stop)

    def after_pass(progress: Progress) -> None:
        if callback is not None and callback(Update(progress, runner)) is False:
            stop.set()

    runner.on_progress = after_pass
    return runner


def _finish(job: Job, outputs: Writer, run: RunResult) -> Rendering:
    warn_of_nonfinite(run.measurement)
    return outputs.write(job, run)


def _check_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".exr", ".png"):
        raise OptionError(f"a picture is written as .exr or .png, not as '{path.name}'; change the name")
    return suffix
