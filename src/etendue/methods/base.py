"""What every image method shares: settings, lanes, and the way from device arrays to a Measurement and a Result."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import (
    IndependentSource,
    Iterations,
    Measurement,
    OptionError,
    Pass,
    Result,
    SampleSource,
    Settings,
    State,
    setting,
)
from etendue.points import OwenSobolSource
from etendue.scene import LightTable, Problem
from etendue.transport import CameraSampler, Visibility, Walker
from etendue.transport import dimensions as dim

W = TypeVar("W", bound=Walker)

#: One pass's sums of a layer, (height, width, channels).
Layer = NDArray[np.float32]

#: Camera paths of a pass that fill two cores: fewer waste time, more make a viewer wait. Other machines have as many
#: times more, up to the last figure, which a GPU has.
FULL_LANES = 1 << 19
_MOST_FULL = 8
#: The same where passes are steps: where something is learned after each, or all camera paths of a pass look at all of
#: its photons.
STEP_LANES = 1 << 17
#: Memory that a camera path takes until its pass is a picture.
_LANE_BYTES = 64
#: Camera paths of a pixel and pass at most, if nobody asks for more.
_MOST_SAMPLES = 32
#: Light and camera paths of a pilot pass.
PILOT_PATHS = 1 << 13
#: An array of the device holds fewer than 2^32 numbers, and a lane has a colour.
_MAX_LANES = 1 << 30
_WORD = 0xFFFFFFFF
#: Light paths of one kernel at most; a pass that has more traces them in groups.
MOST_LIGHT_LANES = 1 << 26


@dataclass(frozen=True)
class Lanes:
    """Consecutive lanes of a pass, which may have more than 2^32 of them."""

    first: int
    count: int

    def part(self, index: int, parts: int) -> Lanes:
        """One of ``parts`` nearly equal parts."""
        first, end = self.count * index // parts, self.count * (index + 1) // parts
        return Lanes(self.first + first, end - first)

    def numbers(self, offset: int = 0) -> tuple[Any, Any]:
        """(lower words, upper words) of ``offset`` plus the number of each lane."""
        return _places(dr.arange(mi.UInt32, self.count), offset + self.first)


@dataclass(frozen=True)
class ImageSettings(Settings):
    """Settings of every image method."""

    max_depth: int = setting(-1, "longest path in edges, 1 shows lights only; -1 is unlimited", minimum=-1)
    rr_depth: int = setting(5, "path edges after which Russian roulette by throughput begins", minimum=1)
    samples_per_pass: int = setting(
        0, "camera paths per pixel that one pass traces; 0 chooses enough to fill the machine", minimum=0, maximum=4096
    )
    sampler: str = setting(
        "owen",
        "random numbers: Owen-scrambled Sobol' points, even over the samples of a pixel and over the light paths of a "
        "pass (owen), or independent ones",
        choices=("owen", "independent"),
    )
    reconstruction: str = setting(
        "neighbours",
        "the film's filter: a sample counts for all pixels in reach, as in Mitsuba (neighbours), or for one that the "
        "filter draws: then pixels share no noise, as denoisers ask, but have more of it (independent)",
        choices=("neighbours", "independent"),
    )
    aovs: bool = setting(False, "add first-hit layers: albedo, normal, depth")


@dataclass(frozen=True)
class CameraSettings(ImageSettings):
    """Settings of the methods that trace camera paths."""

    clamp: float = setting(
        0.0,
        "most that a camera path may bring to a channel, colours kept; 0: no limit. Removes fireflies and their light",
        minimum=0.0,
    )


class ImageMethod(ABC):
    """Base of the methods that render an image pass by pass. A subclass implements ``render_pass``."""

    name: ClassVar[str]
    Settings: ClassVar[type[ImageSettings]]
    citations: ClassVar[tuple[str, ...]] = ()
    #: Name of the Mitsuba integrator where that is not ``name``; "" where Mitsuba has an own one that does the same. Of
    #: the class itself: those derived from it have their own names.
    plugin: ClassVar[str | None] = None
    #: Whether passes leave something behind for those after them, or begin from what the seed found in ``prepare``:
    #: each run then wants a method that was prepared for it. Others need the seed for pilots alone.
    carries_on: ClassVar[bool] = False
    #: Whether all camera paths of a pass lie at one place of their pixels, unless pixels are independent.
    one_place = False

    def __init__(self, settings: ImageSettings | None = None) -> None:
        self.settings: Any = settings if settings is not None else self.Settings()

    @classmethod
    def plugin_name(cls) -> str:
        """Name of the Mitsuba integrator, "" for none."""
        own = vars(cls).get("plugin")
        return cls.name if own is None else str(own)

    def prepare(self, problem: Problem, seed: int) -> None:
        """Build the tables that every pass shares."""
        if problem.size[0] * problem.size[1] * self._samples(problem) >= _MAX_LANES:
            raise OptionError("a pass has more camera paths than fit; lower samples_per_pass or the size")
        self.problem = problem
        self.scene = problem.scene
        self.camera = CameraSampler(problem, self.settings.reconstruction == "independent")
        self.lights = LightTable(problem.scene)
        self.visibility = Visibility(problem.scene)
        #: :meth:`max_edges` on the device, opaque.
        self.edges = dr.opaque(mi.UInt32, self.max_edges())

    def bind(self, scene: Any) -> None:
        """Take the scene that this was prepared for back, or let it go (``None``) until the next run."""
        self.problem.scene = self.scene = self.visibility.scene = scene

    @property
    def samples_per_iteration(self) -> int:
        """Camera paths per pixel of one pass."""
        return self._samples(self.problem)

    def _samples(self, problem: Problem) -> int:
        if self.settings.samples_per_pass:
            return int(self.settings.samples_per_pass)
        width, height = problem.size
        lanes = self.full_lanes()
        if problem.memory:
            lanes = min(lanes, problem.memory // _LANE_BYTES)
        return min(_MOST_SAMPLES, max(1, lanes // (width * height)))

    def full_lanes(self) -> int:
        """Camera paths of a pass where settings leave it open."""
        is_cpu = dr.backend_v(mi.Float) == dr.JitBackend.LLVM
        return FULL_LANES * (min(max(1, dr.thread_count() // 2), _MOST_FULL) if is_cpu else _MOST_FULL)

    def start(self) -> State:
        """Nothing is carried from pass to pass."""
        return {}

    def enter(self, state: State) -> None:  # noqa: B027 (a method without state need not override it)
        """See :class:`etendue.core.Method`."""

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """One pass: :attr:`samples_per_iteration` camera paths per pixel."""
        return Pass(self._step(iteration, seed), state)

    def _step(self, iteration: int, seed: int) -> Measurement:
        samples = self.samples_per_iteration
        layers, counters = self.render_pass(iteration, seed, samples)
        layers = with_image(layers)
        if self.settings.aovs:
            first, bad = self._first_hits(iteration, seed, samples)
            layers |= first
            counters["nonfinite"] += bad
        return Measurement(
            sums={name: layer.astype(np.float64) for name, layer in layers.items()},
            weights=dict.fromkeys(layers, float(samples)),
            iterations=Iterations.single(iteration),
            squares={"image": np.square(layers["image"], dtype=np.float64)},
            counters=counters | {"samples": float(samples)},
        )

    @abstractmethod
    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """Sums over the pass's ``samples`` camera paths per pixel: layers (height, width, channels), and counters.

        The layers are the technique families that the image is the sum of; or the image, and any others."""

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Mean over the passes, layer by layer."""
        layers = {name: measurement.mean(name).astype(np.float32) for name in measurement.sums}
        return Result(layers, {"method": self.name, "settings": self.settings.to_dict()})

    # ------------------------------------------------------------------ helpers of the subclasses

    def max_edges(self) -> int:
        """``max_depth`` as a number a kernel can compare with."""
        return self.settings.max_depth if self.settings.max_depth >= 0 else 1 << 30

    def walker(self, kind: type[W], **own: Any) -> W:
        """A walker of this ``kind`` for the prepared scene; ``own``: the fields that the kind adds."""
        common = {"visibility": self.visibility, "lights": self.lights, "max_edges": self.edges}
        return kind(**common, rr_depth=self.settings.rr_depth, **own)

    def camera_numbers(self, lanes: Any, samples: int, seed: int, iteration: int, role: str = "camera") -> SampleSource:
        """Random numbers of the camera paths ``lanes``, ``samples`` consecutive ones a pixel."""
        count = dr.opaque(mi.UInt32, samples)  # a pilot has another one, and shall have the same kernel
        pixel = lanes // count
        number = lanes - pixel * count
        if self.settings.sampler == "independent":
            source: SampleSource = IndependentSource(lanes, seed, role, iteration)
        else:
            index, high = _places(number, iteration * samples)
            source = OwenSobolSource(pixel, index, seed, role, high)
        if self.camera.independent:
            return source
        return SharedFilm(source, self._film_numbers(number, samples, seed, iteration, role))

    def _film_numbers(self, number: Any, samples: int, seed: int, iteration: int, role: str) -> SampleSource:
        """Numbers of the film's end of the camera paths ``number`` of a pixel: the same in all pixels, and even at
        least within a pass, since what they lack all pixels lack."""
        if self.one_place:
            number, samples = mi.UInt32(0), 1
        if self.settings.sampler == "independent":
            return OwenSobolSource(mi.UInt32(0), number, seed, role + " film", dr.opaque(mi.UInt32, iteration))
        index, high = _places(number, iteration * samples)
        return OwenSobolSource(mi.UInt32(0), index, seed, role + " film", high)

    def light_numbers(self, lanes: Lanes, paths: int, seed: int, iteration: int, role: str = "light") -> SampleSource:
        """Random numbers of the light paths ``lanes`` of the ``paths`` that a pass traces."""
        if self.settings.sampler == "independent":
            lane, high = lanes.numbers()
            return IndependentSource(lane, seed, role, iteration, high)
        index, high = lanes.numbers(iteration * paths)
        return OwenSobolSource(dr.zeros(mi.UInt32), index, seed, role, high)

    def kept(self, radiance: Any) -> tuple[Any, Any]:
        """(radiance of camera paths that counts, mask of those that were not finite); for :class:`CameraSettings`."""
        radiance, bad = keep_finite(radiance)
        if self.settings.clamp > 0.0:
            most = dr.opaque(mi.Float, self.settings.clamp)
            radiance *= most / dr.maximum(dr.max(radiance), most)
        return radiance, bad

    def image(self, values: Any, seed: int, iteration: int) -> Layer:
        """Colours or scalars of a pass's camera paths, consecutive lanes a pixel, summed into a (height, width,
        channels) image by the film's filter."""
        width, height = self.problem.size
        samples = max(1, dr.width(values) // (height * width))
        if self.camera.independent:
            pixels = dr.block_sum(values, samples) if samples > 1 else values
        else:
            if self.one_place and samples > 1:
                values, samples = dr.block_sum(values, samples), 1
            number = dr.arange(mi.UInt32, samples)
            places = self._film_numbers(number, samples, seed, iteration, "camera").next_2d(0, dim.FILM)
            dr.eval(values, places)
            pixels = self.camera.filter.spread(values, *places)
        # A copy: the device reuses the memory of the raveled array at once.
        return np.array(dr.ravel(pixels), np.float32).reshape(height, width, -1)

    def _first_hits(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], float]:
        """Albedo, shading normal and distance of what the camera sees first, zeros where it sees nothing; and how many
        values were not finite."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, _, _ = self.camera.primary(lanes // samples, source)
        si = self.scene.ray_intersect(ray)
        hit = si.is_valid()
        albedo, bad_albedo = keep_finite(si.bsdf(ray).eval_diffuse_reflectance(si, hit) & hit)
        normal, bad_normal = keep_finite(dr.select(hit, si.sh_frame.n, 0.0))
        depth = dr.select(hit, si.t / self.problem.space.scale, 0.0)
        dr.eval(albedo, normal, depth, bad_albedo, bad_normal)
        found = {"albedo": albedo, "normal": normal, "depth": depth}
        layers = {name: self.image(values, seed, iteration) for name, values in found.items()}
        return layers, total(bad_albedo) + total(bad_normal)


class SharedFilm:
    """Numbers of camera paths, those of the place in the pixel from a source of their own."""

    def __init__(self, base: SampleSource, film: SampleSource) -> None:
        self._base, self._film = base, film

    def next_1d(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return self._base.next_1d(vertex, component)

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """See :class:`SampleSource`."""
        on_film = isinstance(vertex, int) and vertex == 0 and component == dim.FILM
        return (self._film if on_film else self._base).next_2d(vertex, component)

    def decide(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return self._base.decide(vertex, component)


def _places(number: Any, first: int) -> tuple[Any, Any]:
    """(lower word, upper word) of ``first`` plus a number."""
    start = dr.opaque(mi.UInt32, first & _WORD)
    lower = start + number
    carry = dr.select(lower < start, mi.UInt32(1), mi.UInt32(0))
    return lower, dr.opaque(mi.UInt32, (first >> 32) & _WORD) + carry


def keep_finite(value: Any) -> tuple[Any, Any]:
    """``value`` with non-finite lanes set to zero, and their mask: they are counted, never written to a picture."""
    good = dr.all(dr.isfinite(value))
    return dr.select(good, value, 0.0), ~good


def with_image(layers: dict[str, Layer]) -> dict[str, Layer]:
    """``layers`` with the image, their sum, where it is not among them."""
    if "image" in layers:
        return layers
    # In single precision as long as only one pass is in it: memory traffic counts here.
    return {"image": functools.reduce(np.add, layers.values())} | layers


def total(values: Any) -> float:
    """Sum over all lanes of an evaluated array of counts or flags."""
    return float(np.asarray(values).sum(dtype=np.float64))


def corners(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Two corners of the box around a scene."""
    box = problem.scene.bbox()
    return np.asarray(box.min, float).ravel(), np.asarray(box.max, float).ravel()
