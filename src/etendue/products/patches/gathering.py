"""Pictures of a solution from a camera: the radiosities of the visible surfaces, or paths that end in the solution."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, Progress, Result, is_whole, prepared
from etendue.engine import Budget, RunError, Runner
from etendue.methods import ImageMethod, ImageSettings, Path
from etendue.radiosity import RadiosityError, Solution, check_colours, irradiance_on, radiosity_on
from etendue.scene import Problem, check, described_sensor, load
from etendue.surfaces import PatchSurfaces, SurfaceValues, check_place, solution_map
from etendue.transport import CameraSampler, past_lamps

#: Suffixes of pictures and their meaning.
PICTURE_FILES = {".exr": "picture with its layers", ".png": "picture, tone-mapped"}


def picture(
    solution: Solution,
    scene: Any,
    *,
    spp: int = 16,
    gather: int = 0,
    smooth: bool = True,
    irradiance: bool = False,
    angle: float = 30.0,
    irradiance_error: ArrayLike | None = None,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    seed: int = 0,
    on_pass: Callable[[int, int], object] | None = None,
) -> Result:
    r"""A picture of a solution from a sensor of ``scene``: ``layers["image"]``, (height, width, 3), linear radiance.

    ``scene`` is an argument or a result of :func:`etendue.scene.load`; its shapes are those of the patches, including
    curved ones. All sensors are supported, and pixels are filtered as in other methods.

    Without ``gather`` the picture shows the radiosity B of the visible surfaces as the radiance B / pi, by ``spp``
    rays per pixel. B consists of the emission and the reflectance of the patch and of the irradiance, which is
    interpolated over edges of at most ``angle`` degrees; with ``smooth=False`` it is constant on each patch. Only the
    shapes of the scene are used.

    With ``gather`` paths per pixel [Reichert 1992], the picture is that of method ``path`` with the solution as its map
    and ``map_after=1``: the materials and lights of the scene are used at the first surface that is not specular, and
    paths end at the next diffuse one, where the irradiance is that of the solution.

    irradiance: show the irradiance of the visible surfaces instead of their radiance, and its error; without
    ``gather``. The sky is black.
    irradiance_error: see :func:`save_solution`; adds the layer ``error``, the standard error of the radiance B / pi of
    the visible surfaces due to the lines. on_pass: called with the number of finished passes and of all passes.

    Raises :class:`RadiosityError` unless there are one or three channels, and for errors of another shape,
    :class:`etendue.core.OptionError` for less than one sample, :class:`etendue.surfaces.SurfaceError` for patches that
    are not on the surfaces of the scene, and the errors of loading.
    """
    check_colours(solution)
    for name, value, least in (("spp", spp, 1), ("gather", gather, 0)):
        if not is_whole(value) or value < least:
            raise OptionError(f"{name} is a whole number of at least {least}, not {value!r}")
    error = None if irradiance_error is None else np.asarray(irradiance_error, dtype=np.float64)
    if error is not None and error.shape != solution.irradiance.shape:
        raise RadiosityError(f"errors of the irradiance have its shape, {solution.irradiance.shape}: {error.shape}")
    if irradiance and gather:
        raise OptionError("final gathering is of radiance: leave out gather for irradiance")
    if isinstance(scene, Problem) and (size is not None or sensor):
        raise OptionError("a loaded scene has its sensor and size: give these to etendue.scene.load")
    problem = scene if isinstance(scene, Problem) else load(scene, size=size, sensor=sensor, check=False)
    if gather or problem.scene.emitters():
        check(problem.scene, problem.sensor)  # without gathering, a scene needs no lights
    check_place(solution.patches, problem, "the solution is")
    surfaces = PatchSurfaces(solution.patches)
    method: ImageMethod
    if gather:
        method = Path(Path.Settings.from_mapping({"map_after": 1, "hide_emitters": problem.hide_emitters}))
        method.map = solution_map(solution, smooth, problem.space)
    else:
        on = irradiance_on if irradiance else radiosity_on
        values = on(surfaces, solution, smooth=smooth, angle=angle)
        factor, sky = (1.0, 0.0) if irradiance else (1.0 / np.pi, solution.patches.sky)
        method = _Seen(surfaces, values, factor, sky)
    layers = {"image": _run(method, problem, gather or spp, seed, on_pass)}
    if error is not None:
        shown = (error, 1.0) if irradiance else (solution.patches.reflectance * error, 1 / np.pi)
        seen = _Seen(surfaces, SurfaceValues(surfaces, shown[0]), shown[1])
        layers["error"] = _run(seen, problem, min(spp, 16), seed)
    known = {"method": method.name, "samples": gather or spp, "smooth": smooth, "patches": len(solution.patches)}
    return Result(layers, known | {"sensor": described_sensor(problem)})


def _run(
    method: ImageMethod, problem: Problem, samples: int, seed: int, on_pass: Callable[[int, int], object] | None = None
) -> NDArray[np.float32]:
    """The picture from ``samples`` paths per pixel, or a few more."""
    prepared(method, problem, seed)
    if method.samples_per_iteration > samples:
        method.settings = dataclasses.replace(method.settings, samples_per_pass=samples)
    passes = -(-samples // method.samples_per_iteration)

    def tell(progress: Progress) -> None:
        if on_pass is not None:
            on_pass(progress.passes, passes)

    runner = Runner(method, seed=seed, budget=Budget(iterations=passes), on_progress=tell, watched=False)
    try:
        return runner.run().result.image
    except RunError as error:  # the passes of a picture are not kept
        failure = error.__cause__ or error
    raise failure


class _Seen(ImageMethod):
    """Values at the first hit of camera rays, and that of the sky, times a factor."""

    name: ClassVar[str] = "radiosity"
    Settings: ClassVar[type[ImageSettings]] = ImageSettings

    def __init__(self, surfaces: PatchSurfaces, values: SurfaceValues, factor: float, sky: ArrayLike = 0.0) -> None:
        super().__init__()
        self._surfaces, self._values, self._factor = surfaces, values, factor
        self._sky = [factor * float(value) for value in np.broadcast_to(sky, (3,))]

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. The scene may have no lights."""
        self.problem, self.scene, self.camera = problem, problem.scene, CameraSampler(problem)

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, mi.TensorXf], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, weight, _ = self.camera.primary(lanes // samples, source)
        found = self.scene.ray_intersect_preliminary(ray, coherent=True)
        if self.problem.hide_emitters:
            found = past_lamps(self.scene, found, ray)
        si = found.compute_surface_interaction(ray, mi.RayFlags.Minimal)
        hit, n = si.is_valid(), _towards(si, ray.d)
        dr.eval(si.p, n, hit, weight)
        value = self._values.at(self._surfaces.find(si.p, n, hit, self.problem.space)) * self._factor
        sky = mi.Color3f(0.0) if self.problem.hide_emitters else mi.Color3f(*self._sky)
        image = self.image(weight * dr.select(hit, value, sky), seed, iteration)
        count = float(len(lanes))
        return {"image": image}, {"rays": 2 * count, "paths": count, "nonfinite": 0.0}


def _towards(si: mi.SurfaceInteraction3f, direction: mi.Vector3f) -> mi.Normal3f:
    """The geometric normal on the side that rays along ``direction`` come from."""
    return dr.select(dr.dot(si.n, direction) > 0.0, -si.n, si.n)
