"""The Python door: one call that renders, one that renders in the background, one that goes on with a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from etendue.core import OptionError, Progress, logger, use_variant
from etendue.engine import Budget, Checkpoint, Job, Runner, Session, Task
from etendue.jobs import Outputs, PathLike, PictureWork, Rendering, Update, Writer, run_work, start_work

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
    if (method := methods.by_plugin(named)) is not None:
        return method
    if named:
        tell(f"the scene names the integrator '{named}'; as no method was asked for, vcm renders it")
    return methods.get("vcm")


def _named(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """``settings``, unless one is a budget by the name that it has elsewhere."""
    for elsewhere, here in (("spp", "samples"), ("time", "seconds")):
        if elsewhere in settings:
            raise OptionError(f"there is no argument '{elsewhere}'; did you mean '{here}'?")
    return settings


def start_job(open_job: Callable[[], Job], outputs: Writer, callback: Callback | None = None) -> Session[Rendering]:
    """A session that opens a job in its thread, runs it and writes ``outputs``, also when a pass fails.

    ``callback`` is called in that thread after each pass.
    """
    return start_work(lambda: PictureWork(open_job(), outputs), _watch(callback))


def _run(job: Job, outputs: Outputs, callback: Callback | None) -> Rendering:
    return run_work(PictureWork(job, outputs), _watch(callback))


def _watch(callback: Callback | None) -> Callable[[Progress, Runner], object] | None:
    return None if callback is None else lambda progress, runner: callback(Update(progress, runner))
