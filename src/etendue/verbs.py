"""What one does with étendue, as functions: render, measure, compute form factors, solve radiosity and so on.

Each function makes a task of its arguments, and runs it here or, with ``wait=False``, in the background. The rooms that
it needs are imported when it is called.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, Protocol, TypeVar, cast, overload

import numpy as np

from etendue.core import OptionError, logger, use_variant

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from etendue.engine import Checkpoint, Session, Task
    from etendue.lighting import Meters, Quantity, Suns, Weather
    from etendue.particles import Particles
    from etendue.products import (
        Callback,
        DaylightResult,
        FormFactorResult,
        HeatResult,
        PathLike,
        RadiosityResult,
        Readings,
        Rendering,
    )
    from etendue.products.particles import MadeMap, ParticleResult
    from etendue.products.patches import FactorRun, SolutionRun
    from etendue.radiosity import PointFactors, Sunlight
    from etendue.viewer import Viewer

P = ParamSpec("P")
T = TypeVar("T")


class _Verb(Protocol[P, T]):
    """A function that returns a session instead of its result if it is called with ``wait=False``."""

    @overload
    def __call__(self, *args: Any, wait: Literal[False], **kwargs: Any) -> Session[T]: ...
    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T: ...


def _verb(function: Callable[P, T]) -> _Verb[P, T]:
    return cast("_Verb[P, T]", function)


@_verb
def render(
    scene: Any,
    method: str | None = None,
    *,
    seconds: float | None = None,
    spp: int | None = None,
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
    wait: bool = True,
    **settings: Any,
) -> Rendering:
    """Render ``scene`` by ``method`` and return the picture with its layers and metadata.

    scene: the path of a Mitsuba XML file, a scene dictionary, a loaded ``mi.Scene`` or the name of a bundled scene.
        ``parameters`` are the values of ``$variables`` of an XML file, ``size`` and ``sensor`` those of the picture.
    method: by default ``auto``, or the scene's integrator if it is a method of étendue other than ``path``. (Nearly
        every scene file for Mitsuba names ``path``.) ``settings`` are those of the method, see ``etendue methods
        NAME``.
    seconds, spp, error: limits, of which the first that is reached ends the run: time, camera paths per pixel, and the
        relative standard error of the pixels. Without limits the scene's own sample count is used.
    memory: limit in bytes on what a method stores.
    variant: Mitsuba's; if none is given or set, a usable one is chosen.
    callback: called with an :class:`Update` after each pass; ``False`` ends the run.
    save, checkpoint: ``.exr`` or ``.png`` files, and a file for :func:`resume`; written at the end and, with
        ``save_every``, at intervals of so many seconds. If a pass fails, or at Ctrl-C, the passes so far are written
        before the error is raised.
    cluster, workers: make the passes in the workers of a Dask scheduler (its address, or a ``distributed.Client``), or
        in so many processes of this machine, which end with the run. See docs/cluster.md.
    wait: if false, return a :class:`Session` at once: a thread loads the scene, renders it and calls ``callback``. The
        session has the current picture in ``image`` and the progress in ``progress``; ``cancel()`` ends the run after
        the current pass, ``result`` waits for the end and raises the error of the run.

    Raises :class:`OptionError`, :class:`SceneError`, :class:`OutputError`, :class:`BackendError` or
    :class:`ClusterError`, where possible before the first pass, and :class:`engine.RunError` if a later pass fails.
    """
    from etendue.products import Picture, budget_of, choose_method, picture_task
    from etendue.scene import SceneSource, use_variant_of

    product = Picture.of(save, checkpoint, save_every)
    use_variant_of(scene, variant)
    kind = choose_method(method, scene, parameters)
    kind.Settings.check_arguments(settings, f"method '{kind.name}'", render)
    budget = budget_of(kind, {"seconds": seconds, "spp": spp, "error": error})
    source = SceneSource(scene, size, sensor, parameters, memory)
    return _run(picture_task(source, kind, product, settings, seed, budget), callback, cluster, workers, wait)


@_verb
def measure(
    scene: Any,
    meters: Meters | PathLike | ArrayLike,
    directions: ArrayLike = (0.0, 0.0, 1.0),
    method: str = "path",
    *,
    quantity: Quantity = "irradiance",
    seconds: float | None = None,
    spp: int | None = None,
    error: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    photometric: bool = False,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
    **settings: Any,
) -> Readings:
    """Measure irradiance, or radiance, at points of a scene, which needs no camera.

    meters: points (n, 3), :class:`etendue.lighting.Meters`, or a file of points and directions that
        :meth:`etendue.lighting.Meters.read` takes.
    directions: with points: the normals of meters of irradiance, or the directions in which meters of radiance look;
        (n, 3), or one for all.
    quantity: with points or a file: ``irradiance``, ``radiance``, ``cylindrical`` (around the direction) or
        ``spherical`` irradiance.
    method: ``path``, ``guided`` or ``bpt``.
    seconds, spp, error: limits, of which the first that is reached ends the run: time, paths of each meter, and their
        relative standard error; without limits 4096 paths. Two passes are made in any time, for the standard errors.
    save: tables, ``.csv``, and of a grid pictures in false colours, ``.png``; with ``photometric`` in lx or cd/m^2.
    checkpoint: a file for :func:`resume`.

    Paths have any number of edges unless ``max_depth`` says otherwise; 2 is the direct light. The other arguments and
    the errors are those of :func:`render`; :class:`etendue.lighting.LightingError` for meters that are not valid,
    :class:`SceneError` for meters inside solids.
    """
    from etendue.engine import Task
    from etendue.products import MeterTable, budget_of, choose_method
    from etendue.scene import SceneSource, use_variant_of

    placed = _meters(meters, directions, quantity)
    product = MeterTable.of(placed, save, photometric, save_every, checkpoint=checkpoint)
    use_variant_of(scene, variant)
    kind = choose_method(method, scene, parameters)
    kind.Settings.check_arguments(settings, f"method '{kind.name}'", measure)
    budget = budget_of(kind, {"seconds": seconds, "spp": spp, "error": error})
    source = SceneSource(scene, parameters=parameters, memory=memory, meters=placed)
    return _run(Task(source, kind, product, settings, seed, budget), callback, cluster, workers, wait)


@_verb
def daylight(
    scene: Any,
    meters: Meters | PathLike | ArrayLike | None = None,
    directions: ArrayLike = (0.0, 0.0, 1.0),
    weather: Weather | PathLike | None = None,
    *,
    surfaces: bool = False,
    max_area: float | None = None,
    seconds: float | None = None,
    spp: int | None = None,
    bundles: int | None = None,
    error: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
    **settings: Any,
) -> DaylightResult:
    """Daylight coefficients of meters, or of surfaces: what each patch of the sky contributes, through openings and by
    reflections. The scene needs no lamp, and its own have no effect.

    meters, directions: as for :func:`measure`.
    surfaces: in place of meters, all patches of ``scene``, which is then as for :func:`compute_form_factors`, with
        ``max_area``; by lines and one radiosity solution, with ``bundles`` of lines (16 to 32 for each patch of the sky
        without limits). The result's ``meters`` are the centres of the patches. All materials are diffuse.
    weather: :class:`etendue.lighting.Weather` or an EPW file; the result then has the illuminance of all hours of the
        year, daylight autonomy, useful daylight illuminance and the level of EN 17037.
    seconds, spp, error: limits, of which the first that is reached ends the run: time, paths of each meter (65,536
        without limits), and the relative standard error of the irradiance by a uniform sky; of surfaces, the standard
        error of a row of form factors.
    save: ``.mtx``, coefficients for Radiance's ``dctimestep``; ``.npz``, all arrays; ``.csv``, with weather, the
        metrics of each meter.
    settings: ``patches``, ``up``, ``north`` and ``max_depth``, see :class:`etendue.methods.SkySettings`.

    The other arguments and the errors are those of :func:`measure`.
    """
    from etendue.engine import Task
    from etendue.lighting import Weather, read_epw
    from etendue.methods import SkyTracing
    from etendue.products import Daylight, budget_of, listed
    from etendue.scene import SceneSource

    if (meters is None) != surfaces:
        raise OptionError("daylight is that of meters or of surfaces: give points, or surfaces=True")
    if meters is None:
        from etendue.products.patches import daylight_run

        limits = {"seconds": seconds, "spp": spp, "error": error, "bundles": bundles}
        asked: dict[str, Any] = {"source": scene, "max_area": max_area, "parameters": parameters, "seed": seed}
        run = daylight_run(settings, limits=limits, weather=weather, outputs=listed(save), **asked)
        task = run.task()
        use_variant(variant)
        return cast("DaylightResult", _run(task, callback, cluster, workers, wait))
    for name, value in (("bundles", bundles), ("max_area", max_area)):
        if value is not None:
            raise OptionError(f"{name} is for surfaces: give surfaces=True, or leave it out")
    placed = _meters(meters, directions, "irradiance")
    year = weather if weather is None or isinstance(weather, Weather) else read_epw(weather)
    product = Daylight.of(placed, year, save)
    SkyTracing.Settings.check_arguments(settings, "daylight", daylight)
    use_variant(variant)
    budget = budget_of(SkyTracing, {"seconds": seconds, "spp": spp, "error": error})
    source = SceneSource(scene, parameters=parameters, meters=placed, lit=False)
    return _run(Task(source, SkyTracing, product, settings, seed, budget), callback, cluster, workers, wait)


def _meters(meters: Any, directions: ArrayLike, quantity: Quantity) -> Meters:
    """Meters, those of a file, or at points."""
    from etendue.lighting import Meters

    if isinstance(meters, (str, os.PathLike)):
        return Meters.read(Path(meters), quantity)
    if isinstance(meters, Meters):
        return meters
    return Meters(np.atleast_2d(meters), np.atleast_2d(directions), quantity)


@_verb
def resume(
    checkpoint: PathLike,
    *,
    scene: Any = None,
    seconds: float | None = None,
    spp: int | None = None,
    error: float | None = None,
    bundles: int | None = None,
    points: int | None = None,
    passes: int | None = None,
    paths: int | None = None,
    particles: int | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    save_every: float | None = None,
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
) -> Any:
    """Continue the run of a checkpoint or of a file of particles, of any kind, and update the file.

    The result is that of an uninterrupted run. ``seconds`` are those of this run; the other limits, of which the method
    has one beside ``error``, are those of the whole. Without a budget the rest of the saved one is used. ``scene`` is
    needed if the scene was in memory or has moved. ``save``: output files; without them those of a run on patches are
    written again. The other arguments are those of :func:`render`. Raises :class:`CheckpointError` if the file is
    damaged, or if the scene differs.
    """
    from etendue.products import saved_task

    counts = {"spp": spp, "bundles": bundles, "points": points, "passes": passes, "paths": paths}
    limits = {"seconds": seconds, "error": error, "particles": particles, **counts}
    task, saved = saved_task(checkpoint, scene=scene, limits=limits, save=save, save_every=save_every)
    use_variant(variant, saved.colours)
    return _run(task, callback, cluster, workers, wait, saved)


@_verb
def compute_form_factors(
    mesh: Any,
    method: str = "lines",
    *,
    estimator: str | None = None,
    objects: Any = None,
    walls: Sequence[str | int] | None = None,
    row_sums: bool = False,
    reciprocal: bool = False,
    threshold: float = 0.0,
    groups: bool = False,
    up: str | None = None,
    north: float = 0.0,
    sky_patches: int | None = None,
    rows: Sequence[str] = (),
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
    **settings: Any,
) -> FormFactorResult:
    """Form factors (view factors) of patches.

    mesh: :class:`etendue.radiosity.Patches`, the path of a mesh file, or a Mitsuba scene in any form that
        :func:`render` takes. Each face is a patch; faces larger than ``max_area`` are subdivided.
    method: ``lines`` through the whole scene; ``spheres``, lines in spheres around ``objects`` and in the whole scene;
        ``exact``, by integrals, see :func:`etendue.radiosity.exact_form_factors`; ``rays`` from each patch, 4096 or as
        many as an ``error`` needs, see :func:`etendue.radiosity.local_form_factors`; or ``auto``, exact or lines: the
        faster one to an ``error``, by a measurement; without it exact if it takes at most 10 seconds. ``settings`` are
        those of the method, see ``etendue methods lines``.
    estimator: ``F1``, ``F2``, ``F3``, ``F4``, ``reciprocal`` or ``pooled``, see :func:`etendue.radiosity.estimate`; by
        default F1, or F4 with ``spheres``.
    objects, walls: for ``spheres``, what makes an object and which objects are walls, see
        :func:`etendue.radiosity.find_objects`; or the name of an array of the mesh file.
    row_sums, reciprocal, threshold: rows that sum to exactly 1, with the sky; ``A_i F_ij = A_j F_ji``; factors below
        the threshold dropped. See :func:`etendue.radiosity.corrected`, and ``correction`` of the result for what that
        changed; a warning is given if it is more than errors explain.
    groups: also the factors between groups of patches, ``groups`` of the result; they are what files contain. A group
        has the name of a shape, or, in a mesh without names, a label. See :func:`etendue.radiosity.between_groups`.
    up: the axis that is up, ``y`` or ``z``: what leaves the scene downward is then ``factors.ground``, apart from the
        ``sky``; without, ``sky`` is both.
    sky_patches: m for the shares of 144 m^2 + 1 patches of the sky, ``factors.sky_patches``; up is z unless given, and
        ``north`` as for :func:`daylight`. See :func:`etendue.radiosity.sky_parts`.
    rows: for ``rays``, names of files (``files`` of the patches) whose rows alone are computed, such as a tile of a
        city; :func:`etendue.radiosity.joined_rows` joins those of all.
    seconds, bundles, error: the first limit that is reached ends the casting; ``error`` is the standard error of a row
        of form factors, averaged over patches. Without limits, 1024 bundles, or 16 to 32 for each patch of the sky.
    save: files for the form factors, in the formats of :func:`etendue.radiosity.save_form_factors`.
    checkpoint: with it, lines are stored in a folder beside it instead of memory.

    The other arguments and the errors are those of :func:`render`. If the lines cannot be evaluated, the error says
    where they are kept.
    """
    from etendue.products import listed
    from etendue.products.patches import FactorRun, without_hierarchy

    run = FactorRun(
        source=mesh,
        method=method,
        limits={"seconds": seconds, "bundles": bundles, "error": error},
        max_area=max_area,
        seed=seed,
        parameters=parameters,
        objects=objects,
        walls=walls,
        row_sums=row_sums,
        reciprocal=reciprocal,
        threshold=threshold,
        groups=groups,
        up=up,
        north=north,
        sky_patches=sky_patches,
        rows=(rows,) if isinstance(rows, str) else tuple(rows),
        estimator=estimator,
        outputs=listed(save),
        checkpoint=None if checkpoint is None else Path(checkpoint),
        save_every=save_every,
    )
    without_hierarchy(run, settings.pop("hierarchy", None))
    return _run_on_patches(run, compute_form_factors, settings, variant, callback, cluster, workers, wait)


def sunlight(
    mesh: Any,
    suns: Suns | Weather | PathLike | ArrayLike,
    *,
    up: str = "z",
    north: float = 0.0,
    lines: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variant: str | None = None,
    save: PathLike | Sequence[PathLike] = (),
) -> Sunlight:
    """The sunlit share of each patch and its direct irradiance, for a list of suns.

    mesh, max_area, parameters: as for :func:`compute_form_factors`.
    suns: :class:`etendue.lighting.Suns` (directions with their irradiances, of times at a place, or of hours of
        weather), :class:`etendue.lighting.Weather` or an EPW file (all hours with direct light), a table of suns
        (:meth:`etendue.lighting.Suns.read`), or vectors towards them (k, 3), x east, y north, z up, of 1 W/m^2.
    up, north, lines: see :func:`etendue.radiosity.sunlight`.
    save: ``.csv``, ``.npz`` or ``.nc``, see :func:`etendue.radiosity.save_sunlight`.

    The errors are those of :func:`compute_form_factors`, and :class:`etendue.lighting.LightingError` for suns that are
    not valid.
    """
    from etendue.lighting import Suns, Weather, read_epw
    from etendue.products.patches import make_sunlight
    from etendue.radiosity import PatchSource

    if isinstance(suns, (str, os.PathLike)):
        path = Path(suns)
        suns = read_epw(path) if path.suffix.lower() == ".epw" else Suns.read(path)
    if isinstance(suns, Weather):
        suns = Suns.of_weather(suns)
    asked = suns if isinstance(suns, Suns) else Suns(np.asarray(suns), np.array(1.0))
    source = PatchSource(source=mesh, max_area=max_area, parameters=parameters)
    use_variant(variant)
    return make_sunlight(source, asked, save, logger.info, up=up, north=north, lines=lines, seed=seed)


def compute_point_factors(
    mesh: Any,
    sensors: Meters | PathLike | ArrayLike,
    normals: ArrayLike | None = None,
    *,
    up: str = "z",
    rays: int | None = None,
    error: float | None = None,
    groups: bool = False,
    solution: PathLike | None = None,
    max_area: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variant: str | None = None,
    save: PathLike | Sequence[PathLike] = (),
) -> PointFactors:
    """View factors from sensors to the patches of a mesh, to the sky and to the ground, with standard errors.

    mesh, max_area, parameters: as for :func:`compute_form_factors`.
    sensors, normals: points (k, 3) and their normals (k, 3) or one for all, for plane sensors: F is the share of the
        hemisphere around the normal, weighted by the cosine. Without normals sensors are spherical: F is the share of
        all directions, 4 pi. Or :class:`etendue.lighting.Meters`; or a file of plane sensors, see
        :meth:`etendue.lighting.Meters.read`.
    up, rays: see :func:`etendue.radiosity.point_factors`; 8,192 rays for each sensor unless given.
    error: rays are cast until no factor has a larger standard error, at most ``rays``.
    groups: the factors of groups of patches instead of patches, as of :func:`compute_form_factors`.
    solution: ``.npz`` of :func:`solve_radiosity` or :func:`solve_heat`, of the same patches: also the ``irradiance`` at
        the sensors, with the ``irradiance_error`` by the rays.
    save: ``.csv`` or ``.npz``, see :func:`etendue.radiosity.save_point_factors`.

    The errors are those of :func:`compute_form_factors`, and :class:`etendue.lighting.LightingError` for sensors that
    are not valid.
    """
    from etendue.products.patches import make_point_factors
    from etendue.radiosity import PatchSource

    in_a_file = isinstance(sensors, (str, os.PathLike))
    quantity: Quantity = "spherical" if normals is None and not in_a_file else "irradiance"
    placed = _meters(sensors, (0.0, 0.0, 1.0) if normals is None else normals, quantity)
    source = PatchSource(source=mesh, max_area=max_area, parameters=parameters)
    use_variant(variant)
    options: Any = {"up": up, "seed": seed} | ({} if rays is None else {"rays": rays})
    options["error"] = error
    return make_point_factors(source, placed, save, logger.info, groups=groups, solution=solution, **options)


def solve_heat(
    mesh: Any,
    conditions: PathLike,
    loads: PathLike | None = None,
    *,
    surroundings: float | None = None,
    factors: PathLike | None = None,
    solver: str | None = None,
    seconds: float | None = None,
    bundles: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    variant: str | None = None,
    save: PathLike | Sequence[PathLike] = (),
    **settings: Any,
) -> HeatResult:
    """Temperatures and heat of the groups of a mesh that exchange heat by radiation.

    mesh: as for :func:`compute_form_factors`; groups are its named shapes, or its labels.
    conditions: a table with a row for each group: its temperature, or its heat flux, power or exchange with a body of
        known temperature, and its emissivity. loads: a table with a row for each case, such as an hour. See
        :func:`etendue.radiosity.read_conditions`.
    surroundings: temperature in kelvin of the black sky around an open mesh, 0 if not given; loads may have it, too.
    factors: a file of the form factors of all patches; without it they are computed, by ``bundles``, ``seconds`` or
        ``error`` as by :func:`compute_form_factors`, and repaired: heat is neither lost nor gained.
    save: ``.csv``, ``.npz``, or of one case ``.vtu`` and ``.png``.

    Raises :class:`etendue.radiosity.RadiosityError` for conditions that cannot be, see
    :func:`etendue.radiosity.heat_balance`; the other errors are those of :func:`compute_form_factors`.
    """
    from dataclasses import replace

    from etendue.products import HeatResult, heat_files, warn_of_cold_sky
    from etendue.radiosity import (
        PatchSource,
        factors_of_patches,
        group_index,
        heat_balance,
        no_factors,
        read_conditions,
    )

    source = PatchSource(source=mesh, max_area=max_area)
    patches = source.open().patches
    names, group = group_index(no_factors(patches))
    known, cases = read_conditions(
        Path(conditions), names.tolist(), group, patches, None if loads is None else Path(loads)
    )
    if surroundings is not None:
        if np.ndim(known.surroundings):
            raise OptionError(f"'{loads}' has the surroundings of each case: leave out surroundings, or its column")
        known = replace(known, surroundings=surroundings)
    known.arrays(len(patches))
    files = heat_files(save, len(cases))
    if factors is None:
        asked: Any = {"seconds": seconds, "bundles": bundles, "error": error, "variant": variant, "seed": seed}
        made = compute_form_factors(patches, row_sums=True, reciprocal=True, **asked, **settings).factors
    else:
        made = factors_of_patches(factors, patches)
    if surroundings is None and not np.any(known.surroundings):
        warn_of_cold_sky(made)
    balance = heat_balance(patches, made, known, solver=solver)  # type: ignore[arg-type]
    result = HeatResult(balance, made, names.tolist(), group, cases)
    for path in files:
        result.save(path)
    return result


@_verb
def solve_radiosity(
    scene: Any,
    method: str | None = None,
    *,
    solver: str | None = None,
    ambient: str | None = None,
    bounces: int | None = None,
    sub_scenes: str | None = None,
    objects: Any = None,
    threshold: float | None = None,
    least: int | None = None,
    levels: int | None = None,
    factors: PathLike | None = None,
    divide: bool = False,
    seconds: float | None = None,
    bundles: int | None = None,
    points: int | None = None,
    passes: int | None = None,
    error: float | None = None,
    max_area: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | Sequence[PathLike] = (),
    photometric: bool = False,
    scale: tuple[float | None, float | None] = (None, None),
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    gather: int = 0,
    spp: int = 16,
    smooth: bool = True,
    error_picture: bool = False,
    lightmap: PathLike | None = None,
    lightmap_size: int = 1024,
    uv: PathLike | None = None,
    checkpoint: PathLike | None = None,
    save_every: float | None = None,
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
    **settings: Any,
) -> RadiosityResult:
    """Radiosities of the surfaces of a scene; all materials are treated as diffuse.

    scene: :class:`etendue.radiosity.Patches`, or a Mitsuba scene in any form that :func:`render` takes. Each face of a
        scene is a patch; faces larger than ``max_area`` are subdivided. For ``boxes`` also a
        :class:`etendue.radiosity.Part`.
    method: ``lines``, which are stored and solved by a ``solver``; ``multipath``, which exchanges light along single
        lines and stores none; ``boxes``, multipath in boxes around objects or instances; or ``ambient``, without lines.
        ``settings`` are those of the method, see ``etendue methods multipath``.
    solver: of ``lines``: ``conjugate-gradient``, ``jacobi``, ``gauss-seidel``, ``southwell`` or ``direct``; by default
        conjugate-gradient, or jacobi with ``bounces``.
    ambient, bounces: ``classic``, ``crisp`` or ``fuzzy``, see :func:`etendue.radiosity.ambient_solution`: all light by
        an ambient term; or, with ``bounces``, the light that is left after so many iterations of the solver.
    sub_scenes: with an ambient solution without lines, parts of the scene in which light spreads first: ``objects``, or
        ``boxes`` around groups of objects. See :func:`etendue.radiosity.hierarchical_ambient`.
    objects, threshold, least, levels: for boxes and sub-scenes, what makes an object (``shapes``, ``components``,
        ``labels`` or an array of the mesh file), and how objects are grouped, see :func:`etendue.radiosity.grouped`.
    factors: a file of form factors of the same patches, ``.npz``, ``.nc`` or ``.vf`` of View3D, which the ``solver``
        takes instead of lines; by default gauss-seidel if they are not reciprocal.
    divide: with ``boxes`` and workers, each worker has some of the boxes with their lines, and all make a pass
        together; otherwise each makes whole passes. The result is the same, and its ``correspondence`` lists the
        messages.
    seconds, bundles, points, passes, error: the first limit that is reached ends the casting. ``lines`` counts bundles
        (1024 without limits), ``multipath`` points (4,194,304), ``boxes`` passes (16). ``error`` is the standard error
        of the irradiance, averaged over the surface and divided by the mean irradiance.
    save: files for the solution, ``.vtu``, ``.ply``, ``.glb``, ``.gltf``, ``.npz`` or ``.nc``, a page, ``.html``, and
        pictures, ``.exr`` or ``.png``. The picture is also in the result.
    photometric: also illuminance in lx and luminous exitance in lm/m^2, as arrays of ``.vtu``, ``.npz`` and ``.nc`` and
        on the page; the picture is of irradiance, a ``.png`` of illuminance in false colours.
    scale: low and high end of these colours in lx; ``None``: chosen.
    size, sensor, gather, spp, smooth: options of pictures, see :func:`etendue.products.patches.picture`.
    error_picture: beside a ``.png``, write its relative standard error in false colours.
    lightmap: an ``.exr`` file, or a ``.glb``, ``.gltf`` or ``.obj`` file for the mesh with the ``.exr`` beside it; of
        at most ``lightmap_size`` texels a side.
    uv: texture coordinates of the lightmap: a glTF file with ``TEXCOORD_1``, or ``"scene"`` for those of the scene.
        Without it an atlas is made.

    The other arguments and the errors are those of :func:`render`.
    """
    from etendue.products import listed
    from etendue.products.patches import SolutionFiles, SolutionRun, without_hierarchy

    groups = {"threshold": threshold, "least": least, "levels": levels}
    run = SolutionRun(
        source=scene,
        method=method,
        limits={"seconds": seconds, "bundles": bundles, "points": points, "passes": passes, "error": error},
        max_area=max_area,
        seed=seed,
        parameters=parameters,
        objects=objects,
        solver=solver,
        ambient=ambient,
        bounces=bounces,
        sub_scenes=sub_scenes,
        factors=None if factors is None else Path(factors),
        groups={name: value for name, value in groups.items() if value is not None},
        divide=divide,
        outputs=SolutionFiles(
            files=listed(save),
            photometric=photometric,
            scale=scale,
            size=size,
            sensor=sensor,
            gather=gather,
            spp=spp,
            smooth=smooth,
            error_picture=error_picture,
            lightmap=None if lightmap is None else Path(lightmap),
            lightmap_size=lightmap_size,
            uv=None if uv is None else str(uv),
        ),
        checkpoint=None if checkpoint is None else Path(checkpoint),
        save_every=save_every,
    )
    without_hierarchy(run, settings.pop("hierarchy", None))
    if divide and (cluster, workers) == (None, None):
        raise OptionError("boxes are divided among workers: give workers or cluster with divide")
    return _run_on_patches(run, solve_radiosity, settings, variant, callback, cluster, workers, wait)


@_verb
def trace_particles(
    scene: Any,
    method: str = "particles",
    *,
    paths: int | None = None,
    particles: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callback | None = None,
    save: PathLike | None = None,
    codec: str = "packed",
    boxes: tuple[int, int, int] | None = None,
    cluster: Any = None,
    workers: int | None = None,
    wait: bool = True,
    **settings: Any,
) -> ParticleResult:
    """Trace light paths of a scene, whose hits on surfaces are particles.

    ``method``: ``particles`` traces independent paths, ``metropolis_particles`` steps of chains; ``settings`` are those
    of the method: ``keep``, ``after``, ``specular``, ``max_bounces`` and others. ``paths`` or ``particles``
    (approximate), and ``seconds``, limit the run; the first limit that is reached ends it. Without limits, a million
    paths.

    The result has the :class:`etendue.particles.Particles` in memory, unless ``save`` names a new file to which they
    are written pass by pass, by a ``codec`` (see docs/particles.md); at Ctrl-C, or if a pass fails, it has the passes
    before, and :func:`resume` continues it. ``boxes``: with workers, numbers of boxes along x, y and z into which the
    scene is cut; each worker holds only a share of them, and paths go from worker to worker. See docs/cluster.md. The
    other arguments and the errors are those of :func:`render`.
    """
    from etendue.engine import Task
    from etendue.products import PARTICLES, budget_of, chosen
    from etendue.products.particles import ParticleProduct
    from etendue.scene import SceneSource

    kind = chosen(method, PARTICLES, "particles")
    kind.Settings.check_arguments(settings, f"tracing by {kind.name}", trace_particles, {"spp": "paths"})
    budget = budget_of(kind, {"paths": paths, "seconds": seconds})
    if particles is not None and paths is not None:
        raise OptionError("paths and particles limit the same; give one of them")
    if boxes is not None and (cluster, workers) == (None, None):
        raise OptionError("a scene is divided among workers: give workers or cluster with boxes")
    product = ParticleProduct(None if save is None else Path(save), particles, codec, boxes)
    # Shapes keep their names.
    source = SceneSource(scene, parameters=parameters, memory=memory, merge=False)
    use_variant(variant)
    return _run(Task(source, kind, product, settings, seed, budget), callback, cluster, workers, wait)


def read_particles(
    path: PathLike, *, shapes: Sequence[str | int] | None = None, box: ArrayLike | None = None
) -> Particles:
    """The particles of a file, or those on ``shapes`` (names or indices) and in ``box`` ((2, 3): lower and upper
    corner). Parts of the file without such particles are not read; for more particles than fit into memory, see
    :meth:`etendue.particles.ParticleFile.parts`.

    Raises :class:`etendue.particles.ParticleError` for a file that cannot be read, and for shapes that it does not
    have.
    """
    from etendue.particles import ParticleFile

    return ParticleFile(path).read(shapes, box)


def map_particles(
    particles: Particles | PathLike | Callable[[], Iterable[Particles]],
    scene: Any = None,
    kind: str = "histogram",
    *,
    save: PathLike | Sequence[PathLike] = (),
    size: int = 1024,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    callback: Callable[[str], object] = lambda text: None,
    **options: Any,
) -> MadeMap:
    """A map of irradiance on the surfaces of a scene, from particles in memory, in a file, or from a function that
    opens their stream anew.

    ``scene``: as for :func:`render`; for a file, by default the scene in which it was traced. ``kind``: ``histogram``,
    ``kernel``, ``variable`` or ``knn``; ``options`` are those of :class:`etendue.products.particles.MapOptions`:
    ``cells``, ``bandwidth``, ``rule``, ``kernel``, ``boundary``, ``k``. ``save`` names files as of
    :func:`etendue.products.particles.write_map`, ``size`` the largest side of lightmaps in texels. ``callback``
    receives a line of text for each pass.

    The result has the map, its surfaces and the number of particles; :func:`etendue.surfaces.irradiance_at` evaluates
    the map. Raises :class:`OptionError`, :class:`etendue.surfaces.SurfaceError`, and the errors of loading and writing.
    """
    from etendue.particles import Particles
    from etendue.products import listed
    from etendue.products.particles import FileSource, MapOptions, check_map_file, make_map, write_map

    chosen = MapOptions(kind=kind, **options)  # type: ignore[arg-type]
    files = listed(save)
    for path in files:
        check_map_file(path)
    use_variant(variant)
    source: Any = particles
    if not isinstance(particles, Particles) and not callable(particles):
        source = FileSource(particles)
        scene = source.scene(scene, parameters, memory)
    elif scene is None:
        raise OptionError("particles in memory do not know their scene; give it as the second argument")
    made = make_map(scene, source, chosen, callback)
    for path in files:
        write_map(path, made.map, made.surfaces, size=size, metadata={"particles": made.particles})
    return made


def view(
    scene: Any,
    method: str = "auto",
    *,
    seconds: float | None = None,
    spp: int | None = None,
    error: float | None = None,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    memory: int | None = None,
    variant: str | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    allow_origin: str | Sequence[str] = (),
    address: str | None = None,
    tev: str | None = None,
    folder: str | Path = ".",
    solution: str | Path | None = None,
    **settings: Any,
) -> Viewer:
    """Show ``scene`` live in the browser, and in a notebook below the cell. The arguments are those of
    :func:`etendue.render`.

    The server listens at ``host`` and ``port`` (0: any that is free); its address has a token. It answers pages of this
    machine's names; ``allow_origin`` are origins of a hub or proxy before it, such as ``https://hub.example.org``.
    ``address`` is the address at which the reader's browser reaches a server on another machine: a URL, whose origin is
    then allowed, or a path on the server of the notebook, such as ``/user/me/proxy/{port}``; by default the value of
    the environment variable ``ETENDUE_VIEW_ADDRESS``, else the server's own address.

    The session goes on in the background until ``close()``, or until the same cell of a notebook is run again. During
    this time use no other Mitsuba or Dr.Jit code in this process, or pause the session in the page. Files that are
    saved are written to ``folder``. ``tev`` is the address of the image viewer tev, such as ``localhost:14158``, which
    then shows the picture and its layers, too. ``solution`` is a file of a solution of radiosity, which the 3-D view
    then shows.

    Raises :class:`OptionError` for an argument out of range, :class:`SceneError` if there is no such scene, and
    :class:`BackendError` if tornado is not installed. If a scene cannot be loaded, the page says so, and another scene
    can be opened there.
    """
    from etendue import methods
    from etendue.products import budget_of
    from etendue.scene import described, is_described, use_variant_of
    from etendue.viewer import Asked, Viewer, is_picture

    kind = methods.get(method)
    kind.Settings.check_arguments(settings, f"method '{method}'", view)
    use_variant_of(scene, variant)
    if is_described(scene) and not is_picture(scene):
        described(scene, logger.debug)
    asked = Asked(
        scene=scene,
        method=method,
        settings=settings,
        budget=budget_of(kind, {"seconds": seconds, "spp": spp, "error": error}),
        size=size,
        sensor=sensor,
        parameters=parameters,
        memory=memory,
        seed=seed,
        folder=Path(folder).absolute(),
        solution=None if solution is None else Path(solution).absolute(),
    )
    origins = (allow_origin,) if isinstance(allow_origin, str) else allow_origin
    return Viewer(asked, host, port, tev, origins, address)


def _run(
    task: Task,
    callback: Callback | None,
    cluster: Any,
    workers: int | None,
    wait: bool,
    saved: Checkpoint | None = None,
) -> Any:
    """Run a task, or go on with the checkpoint ``saved``: the result, or the session if ``wait`` is false."""
    from etendue.distributed import open_cluster, opened_cluster
    from etendue.engine import Job
    from etendue.products import run_job, start_job

    def open_job() -> Job:
        return Job.open(task) if saved is None else Job.resume(saved, task)

    if wait:
        with opened_cluster(cluster, workers) as opened:
            return run_job(open_job, callback, opened)
    started = open_cluster(cluster, workers)  # before the session, so that its errors are raised here
    return start_job(open_job, callback, started, at_end=(lambda: None) if started is None else started.close)


def _run_on_patches(
    run: FactorRun | SolutionRun,
    function: Callable[..., Any],
    settings: Mapping[str, Any],
    variant: str | None,
    callback: Callback | None,
    cluster: Any,
    workers: int | None,
    wait: bool,
) -> Any:
    from etendue.products.patches import AtOnce

    run.settings = {**run.settings, **settings}
    run.check_settings(function)
    task = run.task()
    use_variant(variant)
    if not isinstance(task, AtOnce):
        return _run(task, callback, cluster, workers, wait)
    if (cluster, workers) != (None, None) or not wait:
        given = "wait" if not wait else "cluster and workers"
        why = task.why or f"method '{run.method}' makes its result at once, without passes"
        raise OptionError(f"{why}: leave out {given}")
    return task.make(logger.info)
