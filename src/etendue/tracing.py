"""Particles from Python: the functions behind `etendue particles`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from etendue.core import OptionError, Progress, use_variant
from etendue.distributed import opened_cluster
from etendue.engine import Budget
from etendue.jobs import TRACINGS, ParticleRequest, ParticleResult, ParticleWork, PathLike, run_work
from etendue.methods import ParticleTracing
from etendue.particles import ParticleFile, Particles

#: Called after each pass; ``False`` ends the tracing.
Callback = Callable[[Progress], object]

#: Names of limits in other functions and on the command line, and their names here.
_ELSEWHERE = {"samples": "paths", "spp": "paths", "time": "seconds"}


def trace_particles(
    scene: Any,
    *,
    paths: int | None = None,
    particles: int | None = None,
    seconds: float | None = None,
    seed: int | None = None,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | None = None,
    codec: str | None = None,
    method: str | None = None,
    resume: PathLike | None = None,
    cluster: Any = None,
    workers: int | None = None,
    boxes: tuple[int, int, int] | None = None,
    **settings: Any,
) -> ParticleResult:
    """Trace light paths of a scene, whose hits on surfaces are particles.

    ``scene``: as for :func:`etendue.render`. ``paths`` or ``particles`` (approximate), and ``seconds``, limit the run;
    the first limit that is reached ends it. Without limits, a million paths. ``settings`` are those of
    :class:`etendue.methods.ParticleTracing`: ``keep``, ``after``, ``specular``, ``max_bounces`` and others. ``method``:
    ``metropolis_particles`` traces by :class:`etendue.methods.MetropolisParticles`, whose paths are steps of chains.

    The result has the :class:`etendue.particles.Particles` in memory, unless ``save`` names a new file to which they
    are written pass by pass, by a ``codec`` (``packed`` by default, see docs/particles.md). ``resume`` names such a
    file to be continued: limits in paths or particles apply to the whole file, ``scene`` may be ``None`` if it was a
    file or a bundled scene, and everything else is taken from the file.
    ``callback`` is called with a :class:`etendue.core.Progress` after each pass; ``False`` ends the run. At Ctrl-C, or
    if a pass fails, the file has the passes before. ``cluster`` and ``workers`` trace the paths as for
    :func:`etendue.render`; the particles are the same. ``boxes``: numbers of boxes along x, y and z into which the
    scene is cut; each worker holds only a share of them, and paths go from worker to worker. See docs/cluster.md.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError`, and :class:`CheckpointError` if a file
    cannot be resumed.
    """
    use_variant(variant)
    if boxes is not None and cluster is None and workers is None:
        raise OptionError("a scene is divided among workers: give workers= or cluster= with boxes=")
    with opened_cluster(cluster, workers) as opened:
        work = _opened(
            scene, paths, particles, seconds, seed, parameters, memory, save, codec, method, resume, boxes, settings
        )
        work.cluster = opened
        return run_work(work, None if callback is None else lambda progress, _: callback(progress))


def _opened(
    scene: Any,
    paths: int | None,
    particles: int | None,
    seconds: float | None,
    seed: int | None,
    parameters: Mapping[str, Any] | None,
    memory: int | None,
    save: PathLike | None,
    codec: str | None,
    method: str | None,
    resume: PathLike | None,
    boxes: tuple[int, int, int] | None,
    settings: Mapping[str, Any],
) -> ParticleWork:
    """The work of the arguments of :func:`trace_particles`."""
    if resume is not None:
        given = {
            "seed": seed,
            "parameters": parameters,
            "memory": memory,
            "save": save,
            "codec": codec,
            "method": method,
            "boxes": boxes,
        } | dict(settings)
        ignored = [f"{name}=" for name, value in given.items() if value is not None]
        if ignored:
            raise OptionError(f"a resumed file has {', '.join(ignored)} of its own; leave them out, or trace anew")
        return ParticleWork.resume(Path(resume), Budget(seconds, paths), particles, scene)
    if (tracing := TRACINGS.get(method or ParticleTracing.name)) is not None:
        tracing.Settings.check_arguments(settings, f"tracing by {tracing.name}", trace_particles, _ELSEWHERE)
    request = ParticleRequest(
        scene=scene,
        output=None if save is None else Path(save),
        paths=paths,
        particles=particles,
        seconds=seconds,
        codec=codec or "packed",
        method=method or ParticleTracing.name,
        boxes=boxes,
        settings=settings,
        seed=0 if seed is None else seed,
        parameters=parameters,
        memory=memory,
    )
    return ParticleWork.open(request)


def read_particles(
    path: PathLike, *, shapes: Sequence[str | int] | None = None, box: ArrayLike | None = None
) -> Particles:
    """The particles of a file, or those on ``shapes`` (names or indices) and in ``box`` ((2, 3): lower and upper
    corner). Parts of the file without such particles are not read; for more particles than fit into memory, see
    :meth:`etendue.particles.ParticleFile.parts`.

    Raises :class:`etendue.particles.ParticleError` for a file that cannot be read, and for shapes that it does not
    have.
    """
    return ParticleFile(path).read(shapes, box)
