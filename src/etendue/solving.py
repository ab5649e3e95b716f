"""The Python door to form factors and radiosity: what `etendue form-factors` and `etendue radiosity` do, as calls."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import EtendueError, OptionError, OutputError, Progress, describe, logger, suggest, use_variant

if TYPE_CHECKING:
    from etendue.core import Array
    from etendue.engine import RunResult
    from etendue.jobs import LinesJob
    from etendue.radiosity import CastLines, FormFactors, Patches, Segments, Solution

PathLike = str | os.PathLike[str]
#: Called after each piece of lines; casting ends there if it returns ``False``.
Callback = Callable[[Progress], object]
#: Bundles, if no budget is given.
DEFAULT_BUNDLES = 1024
#: Solvers that work on segments; the others need the matrix.
ON_SEGMENTS = ("jacobi", "conjugate-gradient")


@dataclass(frozen=True)
class _Asked:
    """What both functions take."""

    seconds: float | None
    bundles: int | None
    error: float | None
    seed: int
    lines: float
    local_rays: bool
    callback: Callback | None
    checkpoint: PathLike | None
    save_every: float | None
    resume: PathLike | None
    files: Sequence[PathLike]


@dataclass
class _Cast:
    """Lines that were cast."""

    patches: Patches
    segments: Segments
    bundles: int
    #: What ended the casting: ``seconds``, ``samples`` (bundles), ``error`` or ``cancel`` (the callback).
    stopped_by: str
    #: Seconds of this run.
    elapsed: float


@dataclass
class FormFactorResult(_Cast):
    """Form factors, and the lines they are counted from."""

    factors: FormFactors


@dataclass
class RadiosityResult(_Cast):
    """A solution, and the lines that carried its light."""

    solution: Solution
    #: (n, c) standard error of the irradiance; ``None`` where lines cannot tell it.
    irradiance_error: Array | None


def compute_form_factors(
    mesh: Any,
    estimator: str = "F1",
    *,
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    local_rays: bool = True,
    callback: Callback | None = None,
    save: PathLike | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
) -> FormFactorResult:
    """Form factors of patches, by lines through the whole scene.

    mesh: :class:`etendue.radiosity.Patches`, or the path of a mesh file, each face of which is a patch.
    estimator: ``F1``, ``F2``, ``F3``, ``F4`` or ``reciprocal``, see :func:`etendue.radiosity.form_factors`.
    seconds, bundles, error: the first one reached ends the casting; ``error`` is the standard error of the row of a
        patch, mean over patches. Without any, 1024 bundles.
    lines: of a bundle through the bounding sphere; 0 for as many as suit the patches.
    callback: called with a :class:`etendue.core.Progress` after each piece of lines; ``False`` ends the casting. Its
        ``samples`` are bundles, its ``relative_error`` is the square of what ``error`` means.
    save: file of the form factors, ``.npz``, ``.nc`` or ``.vf``.
    checkpoint: file for ``resume``, written at the end and, with ``save_every``, every so many seconds.
    resume: a checkpoint of the same patches, seed and options to go on with; ``bundles`` and ``error`` speak of all.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError` or :class:`CheckpointError`, before lines are
    cast where that is possible, and :class:`etendue.engine.RunError` if a later piece fails. Then, and at Ctrl-C, the
    checkpoint is written first, if one is named.
    """
    from etendue.radiosity import (
        ESTIMATORS,
        FORM_FACTOR_FILES,
        check_file,
        check_text_size,
        form_factors,
        save_form_factors,
    )

    if estimator not in ESTIMATORS:
        raise OptionError(f"there is no estimator '{estimator}'; {suggest(estimator, ESTIMATORS)}")
    if save is not None:
        check_file(save, FORM_FACTOR_FILES)
    use_variant()
    patches, source = _patches(mesh, {})
    files = [] if save is None else [save]
    asked = _Asked(seconds, bundles, error, seed, lines, local_rays, callback, checkpoint, save_every, resume, files)
    if save is not None and Path(save).suffix.lower() == ".vf":
        check_text_size(save, len(patches), 0)
    job, run, found, cast = _cast(patches, source, asked, goal="rows", shot=False, needs_matrix=True)
    with _lines_kept(job, run, found, checkpoint):
        factors = form_factors(cast.segments, estimator)
        about = {"source": source, "bundles": cast.bundles, "seed": seed, "estimator": estimator}
        if save is not None:
            save_form_factors(save, factors, emissivity=1 - patches.reflectance[:, 0], metadata=about)
    return FormFactorResult(**vars(cast), factors=factors)


def solve_radiosity(
    scene: Any,
    solver: str = "conjugate-gradient",
    *,
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    shot: bool = True,
    local_rays: bool = True,
    parameters: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
) -> RadiosityResult:
    """Radiosities of the surfaces of a scene, all of whose materials count as diffuse.

    scene: :class:`etendue.radiosity.Patches`; or a Mitsuba scene in any form that :func:`etendue.render` takes, each
        face of which is a patch, cut where it is larger than ``max_area``. ``parameters`` give values to ``$variables``
        of an XML file.
    solver: ``conjugate-gradient``, ``jacobi``, ``gauss-seidel``, ``southwell`` or ``direct``.
    seconds, bundles, error: the first one reached ends the casting; ``error`` is the standard error of the irradiance,
        mean over the surface in units of its mean. Without any, 1024 bundles.
    shot: send the light of small emitters by local rays first.
    save: files of the solution, ``.vtu``, ``.ply``, ``.glb``, ``.gltf``, ``.npz`` or ``.nc``.

    The rest, and what is raised, is as for :func:`compute_form_factors`.
    """
    from etendue.radiosity import (
        SOLUTION_FILES,
        SOLVERS,
        check_direct,
        check_file,
        form_factors,
        save_solution,
        solve,
    )

    if solver not in SOLVERS:
        raise OptionError(f"there is no solver '{solver}'; {suggest(solver, SOLVERS)}")
    files = [save] if isinstance(save, (str, os.PathLike)) else list(save)
    for path in files:
        check_file(path, SOLUTION_FILES)
    use_variant()
    patches, source = _patches(scene, {"max_area": max_area, "parameters": parameters}, is_lit=True)
    if solver == "direct":
        check_direct(len(patches))
    for path in files:
        if Path(path).suffix.lower() in (".ply", ".glb", ".gltf") and patches.channels not in (1, 3):
            raise OptionError(f"'{path}' shows one channel or three, not {patches.channels}; write .vtu or .npz")
    needs_matrix = solver not in ON_SEGMENTS
    asked = _Asked(seconds, bundles, error, seed, lines, local_rays, callback, checkpoint, save_every, resume, files)
    job, run, found, cast = _cast(patches, source, asked, goal="irradiance", shot=shot, needs_matrix=needs_matrix)
    with _lines_kept(job, run, found, checkpoint):
        transport: Any = form_factors(cast.segments) if needs_matrix else cast.segments
        solution = solve(patches, transport, solver, shot=found.shot())
        scatter = solution.irradiance_error(cast.segments) if cast.segments.batch_count > 1 else None
        about = {"source": source, "bundles": cast.bundles, "seed": seed, "solver": solver}
        for path in files:
            save_solution(path, solution, irradiance_error=scatter, metadata=about)
    return RadiosityResult(**vars(cast), solution=solution, irradiance_error=scatter)


def _patches(scene: Any, options: Mapping[str, Any], is_lit: bool = False) -> tuple[Patches, str]:
    """Patches of what a user gave, and where they are from."""
    from etendue.core import SceneError
    from etendue.radiosity import Patches, read_patches, scene_patches
    from etendue.scene import load

    given = {key: value for key, value in options.items() if value is not None}
    if isinstance(scene, Patches):
        if given:
            raise OptionError(f"patches are what they are: leave out {', '.join(given)}, or give a scene")
        found, source = scene, "<patches>"
    elif options:
        problem = load(scene, parameters=given.pop("parameters", None), check=False)
        found, source = scene_patches(problem, **given), problem.source
    else:
        found, source = read_patches(scene), str(scene)
    if is_lit and not (found.emission.any() or found.sky.any()):
        raise SceneError(f"{source} has no light: give emission, a sky, or an emitter of type 'area' or 'constant'")
    return found, source


@contextmanager
def _lines_kept(job: LinesJob, run: RunResult, lines: CastLines, checkpoint: PathLike | None) -> Iterator[None]:
    """If nothing can be made of the lines, an error says where they are kept."""
    try:
        yield
    except EtendueError as error:
        kept = checkpoint if checkpoint is not None else job.rescued(run)
        more = "" if kept is None else f"; the lines are kept: resume='{kept}', bundles={lines.count}"
        raise type(error)(f"{error}{more}") from error


def _cast(patches: Patches, source: str, asked: _Asked, **how: Any) -> tuple[LinesJob, RunResult, CastLines, _Cast]:
    """Cast lines in this thread, so that the callback may do what it likes."""
    from etendue.engine import Budget, Checkpoint, RunError, check_period, remaining
    from etendue.film import check_writable
    from etendue.jobs import LinesJob, LinesTask

    named = [Path(path) for path in (*asked.files, asked.checkpoint) if path is not None]
    for path in named:
        check_writable(path)
    if len({path.resolve() for path in named}) < len(named):
        raise OptionError("a file is named for two outputs; give each a name of its own")
    check_period(asked.save_every)
    saved = None if asked.resume is None else Checkpoint.read(asked.resume)
    seconds, bundles, error = asked.seconds, asked.bundles, asked.error
    Budget(seconds, bundles, None, error)  # checks what was given, before it is squared
    if (seconds, bundles, error) == (None, None, None):
        budget = Budget(samples=DEFAULT_BUNDLES) if saved is None else remaining(saved, "seconds, bundles or error")
    else:
        budget = Budget(seconds, bundles, None, None if error is None else error**2)
    to_error = error is not None if saved is None else '"replicates": 1' not in saved.settings
    task = LinesTask(
        patches,
        budget=budget,
        source=source,
        seed=asked.seed,
        lines=asked.lines,
        local_rays=asked.local_rays,
        to_error=to_error,
        notes={} if saved is None else saved.notes,
        **how,
    )
    job, stop = LinesJob(task, saved), threading.Event()

    def keep(run: RunResult) -> None:
        if asked.checkpoint is not None:
            job.checkpoint(run).write(asked.checkpoint)

    def after_piece(progress: Progress) -> None:
        if asked.callback is not None and asked.callback(progress) is False:
            stop.set()

    periodic: dict[str, Any] = {}
    if asked.checkpoint is not None and asked.save_every is not None:
        periodic = {"on_save": keep, "save_every": asked.save_every}
    runner = job.runner(cancel=stop, on_progress=after_piece, **periodic)
    try:
        run = runner.run()
    except (RunError, KeyboardInterrupt) as failure:
        done = failure.run if isinstance(failure, RunError) else runner.interrupted()
        if done is not None:
            job.cast(done)
            try:
                keep(done)
            except OutputError as problem:
                logger.warning("the lines could not be kept: %s", describe(problem))
        raise
    lines = job.cast(run)
    keep(run)
    if job.is_full(run):
        logger.warning("memory holds no more than these %d bundles of lines", lines.count)
    return job, run, lines, _Cast(patches, lines.segments(), lines.count, run.stopped_by, run.elapsed)
