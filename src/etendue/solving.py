"""Form factors and radiosity from Python: the functions behind `etendue form-factors` and `etendue radiosity`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, Progress, use_variant
from etendue.distributed import open_cluster, opened_cluster
from etendue.engine import Checkpoint, Runner, Session
from etendue.jobs import FormFactorResult, PathLike, RadiosityResult, listed, run_work, start_work

if TYPE_CHECKING:
    from etendue.jobs import FormFactorWork

#: Called after each pass of lines; ``False`` ends the casting.
Callback = Callable[[Progress], object]


def compute_form_factors(
    mesh: Any,
    estimator: str | None = None,
    *,
    hierarchy: Any = None,
    walls: Sequence[str | int] | None = None,
    engine: str | None = None,
    point_set: str | None = None,
    main_share: float | None = None,
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    local_rays: bool = True,
    parameters: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
    cluster: Any = None,
    workers: int | None = None,
) -> FormFactorResult:
    """Form factors of patches, by lines through the whole scene.

    mesh: :class:`etendue.radiosity.Patches`, the path of a mesh file, or a Mitsuba scene in any form that
        :func:`etendue.render` takes. Each face is a patch; faces larger than ``max_area`` are subdivided.
        ``parameters`` are the values of ``$variables`` of an XML file.
    estimator: ``F1``, ``F2``, ``F3``, ``F4``, ``reciprocal`` or ``pooled``, see :func:`etendue.radiosity.estimate`; by
        default F1, or F4 with a hierarchy.
    hierarchy: cast lines in a hierarchy of spheres around objects, which are ``components``, ``shapes``, ``labels`` or
        an array, see :func:`etendue.radiosity.find_objects`, or the name of an array of the mesh file; ``True`` for
        shapes of scenes, and components of other patches. ``walls`` are the walls of the hierarchy.
    engine, point_set, main_share: ``engine``, ``points`` and ``main_share`` of
        :class:`etendue.radiosity.HierarchicalCastingSettings`.
    seconds, bundles, error: the first limit that is reached ends the casting; ``error`` is the standard error of a row
        of form factors, averaged over patches. Without limits, 1024 bundles.
    lines: lines of a bundle through the bounding sphere; 0 for a number that suits the patches.
    callback: called with a :class:`etendue.core.Progress` after each pass; ``False`` ends the casting. Its ``samples``
        are bundles, its ``relative_error`` is the square of the standard error.
    save: files for the form factors, ``.npz``, ``.nc`` or ``.vf``.
    checkpoint: file for ``resume``, written at the end and, with ``save_every``, at intervals of so many seconds. Lines
        are stored in a folder beside it instead of memory.
    resume: a checkpoint of the same patches, seed and options to continue; ``bundles`` and ``error`` then limit the
        whole casting, ``seconds`` this run.
    cluster, workers: processes that cast the lines, see :func:`etendue.render`.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError` or :class:`CheckpointError`, where possible
    before lines are cast, and :class:`etendue.engine.RunError` if a later pass fails. In this case, and at Ctrl-C, the
    checkpoint is written first, if one is named. If the lines cannot be evaluated, the error says where they are kept.
    """
    asked = locals()
    device = asked.pop("cluster"), asked.pop("workers")
    return _run(*_form_factors(**asked), *device)


def start_form_factors(
    mesh: Any,
    estimator: str | None = None,
    *,
    hierarchy: Any = None,
    walls: Sequence[str | int] | None = None,
    engine: str | None = None,
    point_set: str | None = None,
    main_share: float | None = None,
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    local_rays: bool = True,
    parameters: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
    cluster: Any = None,
    workers: int | None = None,
) -> Session[FormFactorResult]:
    """Start :func:`compute_form_factors` in the background; see :func:`start_radiosity`."""
    asked = locals()
    device = asked.pop("cluster"), asked.pop("workers")
    return _start(*_form_factors(**asked), *device)


def solve_radiosity(
    scene: Any,
    solver: str | None = None,
    *,
    seconds: float | None = None,
    bundles: int | None = None,
    points: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    shot: bool = True,
    point_set: str | None = None,
    generator: str | None = None,
    ambient: str | None = None,
    bounces: int | None = None,
    sub_scenes: str | Mapping[str, Any] | None = None,
    local_rays: bool = True,
    hierarchy: bool | str | Mapping[str, Any] = False,
    divide: bool = False,
    parameters: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    gather: int = 0,
    samples: int = 16,
    smooth: bool = True,
    error_picture: bool = False,
    lightmap: PathLike | None = None,
    lightmap_size: int = 1024,
    uv: PathLike | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
    cluster: Any = None,
    workers: int | None = None,
) -> RadiosityResult:
    """Radiosities of the surfaces of a scene; all materials are treated as diffuse.

    scene: :class:`etendue.radiosity.Patches`, or a Mitsuba scene in any form that :func:`etendue.render` takes. Each
        face of a scene is a patch; faces larger than ``max_area`` are subdivided. ``parameters`` are the values of
        ``$variables`` of an XML file.
    solver: ``conjugate-gradient``, ``jacobi``, ``gauss-seidel``, ``southwell`` or ``direct``; or ``multipath``, which
        exchanges light along single lines and stores none. By default conjugate-gradient, or jacobi with ``bounces``.
    seconds, bundles, error: the first limit that is reached ends the casting; ``error`` is the standard error of the
        irradiance, averaged over the surface and divided by the mean irradiance. Without limits, 1024 bundles.
    points: number of lines of multipath, in place of ``bundles``; 4,194,304 without limits.
    shot: send the light of small emitters by local rays first.
    point_set, generator: of ``multipath`` and ``hierarchy``: what draws the lines (``sobol``, ``halton``, ``weyl`` or
        ``independent``), and how a line is made of a point (``sphere-pairs``, ``box-walls`` or ``great-circle``; the
        first by default, the second with ``hierarchy``).
    ambient: ``classic``, ``crisp`` or ``fuzzy``, see :func:`etendue.radiosity.ambient_solution`: all light by an
        ambient term, without lines. With ``bounces``, a solution by lines: the solver makes this number of iterations,
        and only the light left after them is ambient.
    sub_scenes: with an ambient solution without lines, parts of the scene in which light spreads first: ``shapes``,
        ``components``, ``labels`` or an array of the mesh file, whose objects are the parts; or ``boxes`` around groups
        of objects, or a dictionary of settings of these boxes (``objects``, ``threshold``, ``least``, ``levels``). See
        :func:`etendue.radiosity.hierarchical_ambient`.
    hierarchy: solve by hierarchical multipath, with boxes around objects: ``True``, the kind of objects (``shapes``,
        ``components``, ``labels`` or an array of the mesh file), or a dictionary of settings:
        ``objects``, ``threshold``, ``least``, ``levels``, and those of
        :class:`etendue.radiosity.HierarchicalMultipathSettings`. ``bundles`` are then passes of lines (16 by
        default), and the result is an
        :class:`etendue.jobs.HierarchyResult`. The scene may also be a :class:`etendue.radiosity.Part`.
    divide: with ``hierarchy`` and workers, each worker has some of the boxes with their lines, and all make a pass
        together; otherwise each makes whole passes. The result is the same, and its ``correspondence`` lists the
        messages.
    save: files for the solution, ``.vtu``, ``.ply``, ``.glb``, ``.gltf``, ``.npz`` or ``.nc``, and for pictures of it,
        ``.exr`` or ``.png``. The picture is also in the result.
    size, sensor, gather, samples, smooth: options of pictures, see :func:`etendue.jobs.picture`.
    error_picture: beside a ``.png``, write its relative standard error in false colours.
    lightmap: an ``.exr`` file, or a ``.glb``, ``.gltf`` or ``.obj`` file for the mesh with the ``.exr`` beside it; of
        at most ``lightmap_size`` texels a side.
    uv: texture coordinates of the lightmap: a glTF file with ``TEXCOORD_1``, or ``"scene"`` for those of the scene.
        Without it an atlas is made.

    The other arguments and the errors are those of :func:`compute_form_factors`.
    """
    asked = locals()
    device = asked.pop("cluster"), asked.pop("workers")
    _check_divided(divide, hierarchy, device)
    request, open_work, watch = _radiosity(**asked)
    if request.is_instant:
        from etendue.jobs import solve_ambient

        if device != (None, None):
            raise OptionError("an ambient solution has no passes for workers: leave out cluster= and workers=")
        if resume is not None:
            raise OptionError("an ambient solution needs no lines: leave out resume=, or give bounces=")
        return solve_ambient(request)
    return _run(open_work, watch, *device)


def start_radiosity(
    scene: Any,
    solver: str | None = None,
    *,
    seconds: float | None = None,
    bundles: int | None = None,
    points: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    lines: float = 0.0,
    shot: bool = True,
    point_set: str | None = None,
    generator: str | None = None,
    ambient: str | None = None,
    bounces: int | None = None,
    sub_scenes: str | Mapping[str, Any] | None = None,
    local_rays: bool = True,
    hierarchy: bool | str | Mapping[str, Any] = False,
    divide: bool = False,
    parameters: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    gather: int = 0,
    samples: int = 16,
    smooth: bool = True,
    error_picture: bool = False,
    lightmap: PathLike | None = None,
    lightmap_size: int = 1024,
    uv: PathLike | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
    cluster: Any = None,
    workers: int | None = None,
) -> Session[RadiosityResult]:
    """Start :func:`solve_radiosity` in the background: a thread reads the scene, casts lines, calls ``callback`` after
    each pass, solves and writes.

    The session's ``progress`` is that of the casting. ``cancel()`` ends the casting after the current pass, and returns
    when the solution from the lines so far is written. ``wait()`` and ``result`` raise the error of the run. Options,
    budgets and names of files are checked, and workers are started, before this function returns; the workers end with
    the session.
    """
    asked = locals()
    device = asked.pop("cluster"), asked.pop("workers")
    _check_divided(divide, hierarchy, device)
    request, open_work, watch = _radiosity(**asked)
    if request.is_instant:
        raise OptionError("an ambient solution is there at once: take solve_radiosity, or give bounces=")
    return _start(open_work, watch, *device)


def _run(open_work: Callable[[], Any], watch: Any, cluster: Any, workers: int | None) -> Any:
    with opened_cluster(cluster, workers) as opened:
        work = open_work()
        work.cluster = opened
        return run_work(work, watch)


def _start(open_work: Callable[[], Any], watch: Any, cluster: Any, workers: int | None) -> Session[Any]:
    opened = open_cluster(cluster, workers)

    def with_workers() -> Any:
        work = open_work()
        work.cluster = opened
        return work

    return start_work(with_workers, watch, opened.close if opened is not None else lambda: None)


def _form_factors(
    mesh: Any,
    save: PathLike | Sequence[PathLike] | None,
    checkpoint: PathLike | None,
    resume: PathLike | None,
    callback: Callback | None,
    **asked: Any,
) -> tuple[Callable[[], FormFactorWork], Callable[[Progress, Runner], object]]:
    """Functions that open and watch the work. The arguments are those of :func:`compute_form_factors`."""
    from etendue.jobs import FormFactorRequest, FormFactorWork

    files = () if save is None else listed(save)
    request = FormFactorRequest(source=mesh, outputs=files, checkpoint=_path(checkpoint), **asked)
    saved = None if resume is None else Checkpoint.read(resume)
    use_variant()
    return lambda: FormFactorWork(request, saved), _watch(callback)


def _radiosity(
    scene: Any,
    save: PathLike | Sequence[PathLike],
    lightmap: PathLike | None,
    uv: PathLike | None,
    checkpoint: PathLike | None,
    resume: PathLike | None,
    callback: Callback | None,
    hierarchy: bool | str | Mapping[str, Any],
    divide: bool,
    **asked: Any,
) -> tuple[Any, Callable[[], Any], Callable[[Progress, Runner], object]]:
    """As :func:`_form_factors`, with the arguments of :func:`solve_radiosity`; and the request."""
    from etendue.jobs import RadiosityRequest, SolutionOutputs, radiosity_work, split_settings

    names = ("size", "sensor", "gather", "samples", "smooth", "error_picture", "lightmap_size")
    outputs = SolutionOutputs(
        files=listed(save),
        lightmap=_path(lightmap),
        uv=None if uv is None else str(uv),
        **{name: asked.pop(name) for name in names},
    )
    saved = None if resume is None else Checkpoint.read(resume)
    if not isinstance(hierarchy, (bool, str, Mapping)):
        raise OptionError(f"hierarchy= is True, what makes objects, or a dictionary of settings, not {hierarchy!r}")
    if hierarchy is not False:
        from etendue.jobs import HierarchyRequest, HierarchyWork

        named = {"objects": hierarchy} if isinstance(hierarchy, str) else {}
        groups, settings = split_settings(hierarchy if isinstance(hierarchy, Mapping) else named)
        boxes = HierarchyRequest(
            source=scene,
            outputs=outputs,
            checkpoint=_path(checkpoint),
            hierarchy=settings,
            divide=divide,
            **groups,
            **asked,
        )
        use_variant()
        return boxes, lambda: HierarchyWork(boxes, saved), _watch(callback)
    if isinstance(asked["sub_scenes"], Mapping):
        groups, others = split_settings(asked["sub_scenes"])
        if others:
            raise OptionError(f"sub_scenes= has objects, threshold, least and levels, no {', '.join(others)}")
        asked |= {"sub_scenes": "boxes", **groups}
    request = RadiosityRequest(source=scene, outputs=outputs, checkpoint=_path(checkpoint), **asked)
    use_variant()
    return request, lambda: radiosity_work(request, saved), _watch(callback)


def _check_divided(divide: Any, hierarchy: Any, device: tuple[Any, Any]) -> None:
    if not isinstance(divide, bool):
        raise OptionError(f"divide= is True or False, not {divide!r}")
    if divide and hierarchy is False:
        raise OptionError("divide= puts the boxes of hierarchical multipath on workers: give hierarchy=, too")
    if divide and device == (None, None):
        raise OptionError("boxes are divided among workers: give workers= or cluster= with divide=")


def _path(given: PathLike | None) -> Path | None:
    return None if given is None else Path(given)


def _watch(callback: Callback | None) -> Callable[[Progress, Runner], object]:
    return lambda progress, _: None if callback is None else callback(progress)
