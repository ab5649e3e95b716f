"""The Python door to form factors and radiosity: what `etendue form-factors` and `etendue radiosity` do, as calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import Progress, use_variant
from etendue.engine import Checkpoint, Runner, Session
from etendue.jobs import FormFactorResult, PathLike, RadiosityResult, listed, run_work, start_work

if TYPE_CHECKING:
    from etendue.jobs import FormFactorWork, RadiosityWork

#: Called after each piece of lines; casting ends there if it returns ``False``.
Callback = Callable[[Progress], object]


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
    save: PathLike | Sequence[PathLike] | None = None,
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
    save: files of the form factors, ``.npz``, ``.nc`` or ``.vf``.
    checkpoint: file for ``resume``, written at the end and, with ``save_every``, every so many seconds.
    resume: a checkpoint of the same patches, seed and options to go on with; ``bundles`` and ``error`` speak of all.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError` or :class:`CheckpointError`, before lines are
    cast where that is possible, and :class:`etendue.engine.RunError` if a later piece fails. Then, and at Ctrl-C, the
    checkpoint is written first, if one is named. Where nothing can be made of the lines, the error says where they are
    kept.
    """
    open_work, watch = _form_factors(**locals())
    return run_work(open_work(), watch)


def start_form_factors(
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
    save: PathLike | Sequence[PathLike] | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    resume: PathLike | None = None,
) -> Session[FormFactorResult]:
    """As :func:`compute_form_factors`, but return at once; see :func:`start_radiosity`."""
    return start_work(*_form_factors(**locals()))


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
) -> RadiosityResult:
    """Radiosities of the surfaces of a scene, all of whose materials count as diffuse.

    scene: :class:`etendue.radiosity.Patches`; or a Mitsuba scene in any form that :func:`etendue.render` takes, each
        face of which is a patch, cut where it is larger than ``max_area``. ``parameters`` give values to ``$variables``
        of an XML file.
    solver: ``conjugate-gradient``, ``jacobi``, ``gauss-seidel``, ``southwell`` or ``direct``.
    seconds, bundles, error: the first one reached ends the casting; ``error`` is the standard error of the irradiance,
        mean over the surface in units of its mean. Without any, 1024 bundles.
    shot: send the light of small emitters by local rays first.
    save: files of the solution, ``.vtu``, ``.ply``, ``.glb``, ``.gltf``, ``.npz`` or ``.nc``; and pictures of it,
        ``.exr`` or ``.png``, which are in the result, too.
    size, sensor, gather, samples, smooth: of pictures, see :func:`etendue.jobs.picture`.
    error_picture: beside a ``.png``, its relative standard error in false colours.
    lightmap: an ``.exr`` file, or that of a mesh that fits, ``.glb``, ``.gltf`` or ``.obj``, beside which the ``.exr``
        is; of at most ``lightmap_size`` texels a side. ``uv``: its coordinates, a glTF file with ``TEXCOORD_1``, or
        ``"scene"`` for the scene's own; without this an atlas is made.

    The rest, and what is raised, is as for :func:`compute_form_factors`.
    """
    open_work, watch = _radiosity(**locals())
    return run_work(open_work(), watch)


def start_radiosity(
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
) -> Session[RadiosityResult]:
    """As :func:`solve_radiosity`, but return at once: a thread reads the scene, casts lines, calls ``callback`` after
    each piece, solves and writes.

    The session has the state of the casting in ``progress``; ``cancel()`` ends it after the current piece, and returns
    when what was cast is solved and written; ``wait()`` and ``result`` raise what went wrong. Options, budgets and the
    names of files are checked before this returns.
    """
    return start_work(*_radiosity(**locals()))


def _form_factors(
    mesh: Any,
    save: PathLike | Sequence[PathLike] | None,
    checkpoint: PathLike | None,
    resume: PathLike | None,
    callback: Callback | None,
    **asked: Any,
) -> tuple[Callable[[], FormFactorWork], Callable[[Progress, Runner], object]]:
    """What opens the work, and what watches it. The arguments are those of :func:`compute_form_factors`."""
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
    **asked: Any,
) -> tuple[Callable[[], RadiosityWork], Callable[[Progress, Runner], object]]:
    """As :func:`_form_factors`, with the arguments of :func:`solve_radiosity`."""
    from etendue.jobs import RadiosityRequest, RadiosityWork, SolutionOutputs

    names = ("size", "sensor", "gather", "samples", "smooth", "error_picture", "lightmap_size")
    outputs = SolutionOutputs(
        files=listed(save),
        lightmap=_path(lightmap),
        uv=None if uv is None else str(uv),
        **{name: asked.pop(name) for name in names},
    )
    request = RadiosityRequest(source=scene, outputs=outputs, checkpoint=_path(checkpoint), **asked)
    saved = None if resume is None else Checkpoint.read(resume)
    use_variant()
    return lambda: RadiosityWork(request, saved), _watch(callback)


def _path(given: PathLike | None) -> Path | None:
    return None if given is None else Path(given)


def _watch(callback: Callback | None) -> Callable[[Progress, Runner], object]:
    return lambda progress, _: None if callback is None else callback(progress)
