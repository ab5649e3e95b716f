"""Rendering from Python: :func:`render`, :func:`start` in the background, and :func:`resume` from a checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from etendue.core import Progress, logger, use_variant
from etendue.engine import Budget, Checkpoint, Job, Runner, Session, Task
from etendue.jobs import Outputs, PathLike, PictureWork, Rendering, Update, Writer, run_work, start_work

if TYPE_CHECKING:
    from etendue.distributed import Cluster

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
    cluster: Any = None,
    workers: int | None = None,
    **settings: Any,
) -> Rendering:
    """Render ``scene`` by ``method`` and return the picture with its layers and metadata.

    The default method is the scene's integrator, if it is a method of étendue other than ``path``, and else ``vcm``.
    (Nearly every scene file for Mitsuba names ``path``.)

    ``scene`` is the path of a Mitsuba XML file, a scene dictionary, a loaded ``mi.Scene`` or the name of a bundled
    scene. ``seconds``, ``samples`` (camera paths per pixel) and ``error`` (relative noise) limit the run; the first
    limit that is reached ends it. Without limits the scene's own sample count is used. ``settings`` are those of the
    method (see ``etendue methods NAME``). If no Mitsuba variant is set, a usable one is chosen.

    ``callback`` is called after each pass with an :class:`Update`; ``False`` ends the run. ``save`` names ``.exr`` or
    ``.png`` files, ``checkpoint`` a file for :func:`resume`. They are written at the end and, with ``save_every``, at
    intervals of so many seconds. If a pass fails, or at Ctrl-C, the passes so far are written before the error is
    raised.

    ``cluster`` is the address of a Dask scheduler or a ``distributed.Client``, whose workers make the passes.
    ``workers`` is instead a number of processes on this machine, which end with the run. See docs/cluster.md.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError`, :class:`BackendError` or
    :class:`ClusterError`, where possible before the first pass, and :class:`engine.RunError` if a later pass fails.
    """
    budget, outputs = Budget(seconds, samples, None, error), Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    chosen = choose_method(method, scene, parameters)
    task = Task(scene, chosen, _named(settings, chosen, render), seed, budget, size, sensor, parameters, memory)
    return _run(lambda: Job.open(task), outputs, callback, cluster, workers)


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
    cluster: Any = None,
    workers: int | None = None,
    **settings: Any,
) -> Session[Rendering]:
    """Start :func:`render` in the background: a thread loads the scene, renders it and calls ``callback``.

    The session has the current picture in ``image`` and the progress in ``progress``. ``cancel()`` ends the run after
    the current pass and waits for it. ``wait()`` and ``result`` raise the error of the run. Options and budgets are
    checked, and workers are started, before this function returns; the workers end with the session.
    """
    from etendue.distributed import open_cluster

    budget, outputs = Budget(seconds, samples, None, error), Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    chosen = choose_method(method, scene, parameters)
    task = Task(scene, chosen, _named(settings, chosen, start), seed, budget, size, sensor, parameters, memory)
    opened = open_cluster(cluster, workers)
    return start_job(lambda: Job.open(task), outputs, callback, opened, ends=True)


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
    cluster: Any = None,
    workers: int | None = None,
    **settings: Any,
) -> Rendering:
    """Continue the run of a checkpoint, and update the file.

    The result is that of an uninterrupted run. ``seconds`` are those of this run, ``samples`` and ``error`` are limits
    of the whole picture; without a budget the rest of the saved one is used. ``scene`` is needed if the scene was in
    memory or has moved. ``method`` and ``settings`` are not needed and cannot be changed. Raises
    :class:`CheckpointError` if the file is damaged, or if scene, method or settings differ.
    """
    from etendue import methods

    budget = Budget(seconds, samples, None, error)
    saved = Checkpoint.read(checkpoint)
    outputs = Outputs.of(save, checkpoint, save_every)
    use_variant(variant)
    kind = methods.get(method if method is not None else saved.method)
    saved.settings_of(kind, _named(settings, kind, resume))
    return _run(
        lambda: Job.resume(saved, kind, budget=budget or None, scene=scene), outputs, callback, cluster, workers
    )


def choose_method(
    name: str | None, scene: Any, parameters: Mapping[str, Any] | None, tell: Callable[[str], object] = logger.info
) -> type[Any]:
    """The class of the method ``name``; by default that of the scene's integrator (except ``path``), else ``vcm``.

    ``tell`` receives a line if the scene's integrator is not used. Raises :class:`OptionError` for an unknown name, and
    the errors of parsing the scene.
    """
    from etendue import methods
    from etendue.scene import integrator_of

    if name is not None:
        return methods.get(name)
    named = integrator_of(scene, parameters)
    if (method := methods.by_plugin(named)) is not None:
        return method
    if named:
        tell(f"the scene names the integrator '{named}'; no method is given, so vcm renders it")
    return methods.get("vcm")


def _named(settings: Mapping[str, Any], kind: type[Any], function: Callable[..., Any]) -> Mapping[str, Any]:
    """``settings`` of the method ``kind``; refuses names that it does not have, which may be misspelt arguments of
    ``function``."""
    kind.Settings.check_arguments(settings, f"method '{kind.name}'", function)
    return settings


def start_job(
    open_job: Callable[[], Job],
    outputs: Writer,
    callback: Callback | None = None,
    cluster: Cluster | None = None,
    ends: bool = False,
) -> Session[Rendering]:
    """A session that opens a job in its thread, runs it and writes ``outputs``, also if a pass fails.

    ``callback`` is called in that thread after each pass. ``cluster`` makes the passes; with ``ends`` it ends with the
    session.
    """
    close = cluster.close if ends and cluster is not None else _nothing
    return start_work(lambda: PictureWork(open_job(), outputs, cluster), _watch(callback), close)


def _run(
    open_job: Callable[[], Job], outputs: Outputs, callback: Callback | None, cluster: Any, workers: int | None
) -> Rendering:
    from etendue.distributed import opened_cluster

    with opened_cluster(cluster, workers) as opened:
        return run_work(PictureWork(open_job(), outputs, opened), _watch(callback))


def _nothing() -> None: ...


def _watch(callback: Callback | None) -> Callable[[Progress, Runner], object] | None:
    return None if callback is None else lambda progress, runner: callback(Update(progress, runner))
