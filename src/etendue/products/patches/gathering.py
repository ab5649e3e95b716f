"""Pictures of a solution from a camera: the radiosities of the visible surfaces, or a final gather at these surfaces.

The final gather is a path of :mod:`etendue.methods` that ends in a solution of :mod:`etendue.radiosity`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, Progress, Result, SampleSource, is_whole, prepared
from etendue.engine import Budget, RunError, Runner
from etendue.methods import CameraSettings, ImageMethod, ImageSettings, total
from etendue.radiosity import RadiosityError, Solution, check_colours, radiosity_on
from etendue.scene import Problem, check, load
from etendue.surfaces import PatchSurfaces, SurfaceValues, check_place
from etendue.transport import CameraPath, CameraSampler, DirectWeights, Walker

#: Suffixes of pictures and their meaning.
PICTURE_FILES = {".exr": "picture with its layers", ".png": "picture, tone-mapped"}


def picture(
    solution: Solution,
    scene: Any,
    *,
    spp: int = 16,
    gather: int = 0,
    smooth: bool = True,
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

    With ``gather`` paths per pixel [Reichert 1992], the materials and lights of the scene are used at the first
    surface that is not specular, which the camera may see through mirrors. Direct light is sampled there by next event
    and BSDF as in ``path``; light reflected by other surfaces is taken from the solution at the next hit:

    .. math:: L = L_e + \int f (L_e' + (B' - E') / \pi) |cos| d\omega

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
    if isinstance(scene, Problem) and (size is not None or sensor):
        raise OptionError("a loaded scene has its sensor and size: give these to etendue.scene.load")
    problem = scene if isinstance(scene, Problem) else load(scene, size=size, sensor=sensor, check=False)
    if gather or problem.scene.emitters():
        check(problem.scene, problem.sensor)  # without gathering, a scene needs no lights
    check_place(solution.patches, problem, "the solution is")
    surfaces = PatchSurfaces(solution.patches)
    values = radiosity_on(surfaces, solution, smooth=smooth, angle=angle, emission=gather == 0)
    method = _Gathered(surfaces, values) if gather else _Seen(surfaces, values, solution.patches.sky)
    layers = {"image": _run(method, problem, gather or spp, seed, on_pass)}
    if error is not None:
        reflected = SurfaceValues(surfaces, solution.patches.reflectance * error)
        layers["error"] = _run(_Seen(surfaces, reflected), problem, min(spp, 16), seed)
    known = {"method": method.name, "samples": gather or spp, "smooth": smooth, "patches": len(solution.patches)}
    return Result(layers, known)


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
    """Values over pi at the first hit of camera rays, and those of the sky."""

    name: ClassVar[str] = "radiosity"
    Settings: ClassVar[type[ImageSettings]] = ImageSettings

    def __init__(self, surfaces: PatchSurfaces, values: SurfaceValues, sky: ArrayLike = 0.0) -> None:
        super().__init__()
        self._surfaces, self._values = surfaces, values
        self._sky = [float(value) / np.pi for value in np.broadcast_to(sky, (3,))]

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. The scene may have no lights."""
        self.problem, self.scene, self.camera = problem, problem.scene, CameraSampler(problem)

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, mi.TensorXf], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, weight, _ = self.camera.primary(lanes // samples, source)
        si = self.scene.ray_intersect(ray, mi.RayFlags.Minimal, coherent=True)
        hit, n = si.is_valid(), _towards(si, ray.d)
        dr.eval(si.p, n, hit, weight)
        value = self._values.at(self._surfaces.find(si.p, n, hit, self.problem.space)) / np.pi
        image = self.image(weight * dr.select(hit, value, mi.Color3f(*self._sky)), seed, iteration)
        count = float(len(lanes))
        return {"image": image}, {"rays": 2 * count, "paths": count, "nonfinite": 0.0}


@dataclass(kw_only=True)
class _EndedPath(CameraPath):
    """State of a camera path that ends at the second surface that is not specular."""

    scattered: mi.Bool  #: whether it has scattered at the first such surface
    reached: mi.Bool  #: whether it has reached the second one
    end: mi.Point3f  #: position on the second one
    normal: mi.Normal3f  #: normal there, on the side of the path
    at_end: mi.Color3f  #: throughput up to there


class _Gathered(ImageMethod):
    """Path tracing that ends at the second surface that is not specular, with the reflected light of the solution."""

    name: ClassVar[str] = "radiosity-gather"
    Settings: ClassVar[type[ImageSettings]] = CameraSettings
    citations: ClassVar[tuple[str, ...]] = ("Reichert1992",)

    def __init__(self, surfaces: PatchSurfaces, reflected: SurfaceValues) -> None:
        super().__init__()
        self._surfaces, self._reflected = surfaces, reflected

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, mi.TensorXf], dict[str, float]]:
        """See :class:`ImageMethod`. The solution is evaluated when all paths have ended, since its evaluation traces
        rays in another scene."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, importance, _ = self.camera.primary(lanes // samples, source)
        walker = self.walker(Walker)
        path = _EndedPath.start(
            ray,
            walker.max_edges,
            scattered=mi.Bool(False),
            reached=mi.Bool(False),
            end=mi.Point3f(0.0),
            normal=mi.Normal3f(0.0),
            at_end=mi.Color3f(0.0),
        )
        path = walker.walk(path, lambda s: self._edge(s, walker, source), "radiosity gathering")
        radiance, throughput = path.radiance * importance, path.at_end * importance
        dr.eval(radiance, path.rays, path.end, path.normal, throughput, path.reached)
        place = self._surfaces.find(path.end, path.normal, path.reached, self.problem.space)
        reflected = throughput * self._reflected.at(place) / np.pi
        radiance, bad = self.kept(radiance + dr.select(path.reached, reflected, 0.0))
        dr.eval(radiance, bad)
        counters = {"rays": total(path.rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
        return {"image": self.image(radiance, seed, iteration)}, counters

    def _edge(self, s: _EndedPath, walker: Walker, source: SampleSource) -> _EndedPath:
        """Trace one edge, and scatter at its end unless the path ends there."""
        vertex, weights = walker.arrive(s), DirectWeights()
        hit = walker.emission(s, vertex)
        s.radiance[hit.active] += s.throughput * hit.radiance * weights.hit(s.pdf, hit.direct_pdf)
        s.active &= vertex.valid & (s.depth < walker.max_edges)

        ends = s.active & s.scattered
        s.end = dr.select(ends, vertex.position, s.end)
        s.normal = dr.select(ends, _towards(vertex.si, vertex.incoming), s.normal)
        s.at_end = dr.select(ends, s.throughput, s.at_end)
        s.reached |= ends
        s.active &= ~ends

        light = walker.light_point(vertex, source, s.active & vertex.smooth)
        scattered, (f,) = vertex.sample(source, s.active, [light])
        contribution, visible = walker.next_event(s, vertex, light, f, weights.light_point(light, f.pdf))
        s.radiance[visible] += contribution
        s.scattered |= s.active & scattered.active & ~scattered.is_delta & ~scattered.is_null
        s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
        walker.advance(s, vertex, scattered, source)
        return s


def _towards(si: mi.SurfaceInteraction3f, direction: mi.Vector3f) -> mi.Normal3f:
    """The geometric normal on the side that rays along ``direction`` come from."""
    return dr.select(dr.dot(si.n, direction) > 0.0, -si.n, si.n)
