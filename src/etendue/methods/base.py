"""Base of the image methods: common settings, random numbers, filtering of a pass, measurement and result."""

from __future__ import annotations

import functools
import math
import operator
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import (
    CONTRAST,
    Array,
    IndependentSource,
    Iterations,
    Measurement,
    Method,
    OptionError,
    Pass,
    Result,
    SampleSource,
    Settings,
    SquaresOf,
    State,
    UnsupportedError,
    free_memory,
    logger,
    seed_key,
    setting,
    uses_cuda,
)
from etendue.film import ALPHA, BANDS, COMPONENTS, variance_of
from etendue.points import OwenSobolSource, Weyl
from etendue.scene import (
    LEAST_WHITE,
    Bands,
    LightTable,
    Packet,
    Problem,
    band_names,
    graph,
    is_rgb,
    is_spectral,
    media_of,
    refuse_one_way,
    scatters,
)
from etendue.transport import (
    CameraPath,
    CameraSampler,
    FirstHits,
    Recording,
    Splats,
    Visibility,
    Walker,
    component_fields,
    coverage,
    dimensions as dim,
    seen_shapes,
)

from .layers import (
    PARTS,
    Layer as Layer,
    keep_finite as keep_finite,
    reweighted,
    seen,
    total as total,
    with_image as with_image,
)
from .numbers import Lanes as Lanes, SharedFilm, camera_numbers, light_numbers as light_numbers

W = TypeVar("W", bound=Walker)

REWEIGHT = (
    "reduce fireflies: pixels much noisier between the passes than those around them lose up to their standard error, "
    "so that rare bright light is missing until it has been found more often"
)
#: Camera paths of a pass for two cores: fewer use the cores badly, more delay the first picture. The number grows with
#: the cores, up to a factor of ``_MOST_FULL``. A GPU has the factor ``_GPU_FULL``: on an H100, what Python and the host
#: do for a pass takes as long as the kernels of four million paths.
FULL_LANES = 1 << 19
_MOST_FULL = 8
_GPU_FULL = 32
#: Passes on a GPU, if there are as many samples: its passes are large, and an error is that between passes.
_GPU_PASSES = 8
#: Camera paths of a pass, or of a lot of one, for methods that learn after each.
STEP_LANES = 1 << 17
#: Memory of a camera path during its pass, in bytes.
_LANE_BYTES = 64
#: Most camera paths per pixel and pass, unless ``samples_per_pass`` is set.
_MOST_SAMPLES = 64
#: Passes of ``for_denoising``, if there are as many samples: fewer tell the variance of a pixel badly.
DENOISING_PASSES = 8
#: Passes under a spectral variant, if there are as many samples: each has four wavelengths.
SPECTRAL_PASSES = 16
#: The same for each band of a film that records bands.
BAND_PASSES = 8
#: Settings whose layers are colours also where the film records bands; the first implies others.
_OF_COLOURS = ("for_denoising", "aovs", "cryptomatte")
#: Bytes of a pixel of a splat image in cells, and the share of the memory that such images may take.
_CELL_BYTES, _CELL_SHARE = 120, 0.125
#: Light and camera paths of a pilot pass.
PILOT_PATHS = 1 << 13
#: Most camera paths of a pass: a device array has fewer than 2^32 numbers, and a path has three.
_MAX_LANES = 1 << 30
#: Most light paths of one kernel; a pass with more traces them in groups.
MOST_LIGHT_LANES = 1 << 26


@dataclass(frozen=True)
class ImageSettings(Settings):
    """Settings of every image method."""

    max_depth: int = setting(
        -1, "longest path, in edges; 1: only lights seen directly, 2: direct light, -1: no limit", minimum=-1
    )
    rr_depth: int = setting(5, "path length, in edges, from which on Russian roulette may end a path", minimum=1)
    samples_per_pass: int = setting(
        0,
        "camera paths per pixel and pass; 0: chosen by image size, number of cores and memory",
        minimum=0,
        maximum=4096,
    )
    sampler: str = setting(
        "owen",
        "random numbers of the paths: Owen-scrambled Sobol' points, stratified over the samples of a pixel and over "
        "the light paths of a pass (owen), Halton's sequence (halton), Hammersley's points, a set for each pass "
        "(hammersley), or independent numbers (independent); Markov chains take halton and hammersley as independent",
        choices=("owen", "halton", "hammersley", "independent"),
    )
    scrambling: str = setting(
        "digits",
        "randomisation of sampler=halton and hammersley in each pixel: random maps of the digits (digits), a random "
        "shift modulo 1 (shift), or the same shift for all pixels (same), whose error is a visible pattern",
        choices=("digits", "shift", "same"),
    )
    reconstruction: str = setting(
        "neighbours",
        "use of the film's reconstruction filter: a sample contributes to all pixels within its radius, as in Mitsuba "
        "(neighbours), or the filter is importance sampled and a sample contributes to one pixel (independent): more "
        "noise, but independent between pixels, as denoisers need",
        choices=("neighbours", "independent"),
    )
    aovs: bool = setting(
        False,
        "add layers of the first surfaces hit by camera rays: albedo, shading normal, depth (distance in scene units), "
        "emitted radiance, number of the shape; and, after two passes, the variance of the picture's pixels, estimated "
        "from the passes",
    )
    hide_emitters: bool = setting(
        False,
        "hide lights from the camera, which sees what is behind them, and a black background in place of the "
        "environment; mirrors and glass show them",
    )
    components: bool = setting(
        False,
        "add layers of the components of light: emission, direct, caustic and indirect, whose sum is the picture",
    )
    cryptomatte: bool = setting(
        False, "add a Cryptomatte: ids of the shapes that a pixel shows and how much of it each covers, for compositing"
    )
    coverage: bool = setting(
        False,
        "add how much of a pixel surfaces and media cover, as the alpha of EXR and PNG files; an environment covers "
        "all of it unless hide_emitters is on; always on if the film of the scene has an alpha channel",
    )
    for_denoising: bool = setting(
        False,
        "render what denoisers need: turns on aovs, components (unless split_layers is on) and "
        f"reconstruction=independent, and makes {DENOISING_PASSES} passes or more of a given number of samples",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.for_denoising:
            for name, value in self._needed():
                object.__setattr__(self, name, value)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], owner: str = "") -> Self:
        """See :class:`Settings`. Raises :class:`OptionError` also for a value that contradicts ``for_denoising``."""
        made = super().from_mapping(values, owner)
        if made.for_denoising:
            alone = super().from_mapping({**values, "for_denoising": False}, owner)
            for name, value in made._needed():
                if name in values and getattr(alone, name) != value:
                    raise OptionError(f"for_denoising turns on {name}={str(value).lower()}; leave out {name}")
        return made

    def _needed(self) -> list[tuple[str, Any]]:
        """Settings that ``for_denoising`` turns on, with their values."""
        is_split = getattr(self, "split_layers", False)
        return [("aovs", True), ("reconstruction", "independent"), *([] if is_split else [("components", True)])]


@dataclass(frozen=True)
class CameraSettings(ImageSettings):
    """Settings of the methods that trace camera paths."""

    clamp: float = setting(
        0.0,
        "upper limit of the radiance of a camera path: brighter ones are scaled down, which removes fireflies, but "
        "makes the picture darker; 0: no limit",
        minimum=0.0,
    )
    reweight: bool = setting(False, REWEIGHT)


class ImageMethod(Method):
    """Base of the methods that render an image pass by pass. A subclass implements ``render_pass``, sets ``Settings``
    and declares its class as the type of ``settings``."""

    name: ClassVar[str]
    Settings: ClassVar[type[ImageSettings]]
    #: Name of the Mitsuba integrator, if it is not ``name``; "" if there is none. Not inherited.
    plugin: ClassVar[str | None] = None
    #: Whether all camera paths of a pass have the same offset in their pixel, unless ``reconstruction=independent``.
    one_place = False
    #: The method for a scene whose lamps are all switched off, if it is another one.
    in_the_dark: ClassVar[type[ImageMethod] | None] = None
    #: Layers that no pass changes and their metadata, if asked for; subclasses may have a ``prepare`` of their own.
    _still: tuple[dict[str, Any], dict[str, Any]] = {}, {}
    #: Participating media that the method renders: "absorbing", "scattering" (both kinds), or None.
    media: ClassVar[str | None] = "absorbing"
    #: Whether the method renders hair, by camera paths alone: see :func:`etendue.scene.one_way`.
    one_way: bool = False
    #: Whether the method renders under variants whose light is not RGB.
    spectral: ClassVar[bool] = False
    #: Whether the method renders bands of wavelengths, as it does if all paths of a pass have the same wavelengths.
    renders_bands: ClassVar[bool] = True
    bands: Bands | None = None  #: of the film, if it records no colours
    #: Whether meters may take the place of a camera: not if photons are merged, of which there are none on meters, nor
    #: if paths are chosen by where they are in a picture.
    measures: ClassVar[bool] = False
    recording = Recording()  #: of the rays of the next walks

    def __init__(self, settings: ImageSettings | None = None) -> None:
        self.settings = settings if settings is not None else self.Settings()
        self.notes: dict[str, Any] = {}  #: for the metadata of pictures, of one scene
        if uses_cuda():
            self.least_passes = max(self.least_passes, _GPU_PASSES)
        if self.settings.for_denoising:
            self.least_passes = max(self.least_passes, DENOISING_PASSES)
        if is_spectral():
            self.least_passes = max(self.least_passes, SPECTRAL_PASSES)

    @classmethod
    def plugin_name(cls) -> str:
        """Name of the Mitsuba integrator, "" if there is none."""
        own = vars(cls).get("plugin")
        return cls.name if own is None else str(own)

    def prepare(self, problem: Problem, seed: int) -> None:
        """Build the tables that all passes share."""
        if not self.spectral and not is_rgb():
            raise UnsupportedError(
                f"method '{self.name}' renders in RGB only, not under {mi.variant()}; use llvm_ad_rgb, or auto, vcm, "
                "bpt, sppm or path"
            )
        if problem.size[0] * problem.size[1] * self.samples_for(problem) >= _MAX_LANES:
            raise OptionError(
                f"a pass would have {_MAX_LANES} camera paths or more; lower samples_per_pass or the picture's size"
            )
        if graph.plugin_name(problem.sensor) in ("meters", "distant") and not self.measures:
            raise UnsupportedError(
                f"method '{self.name}' measures nothing at points or in one direction; use path, guided or bpt"
            )
        if not self.one_way:
            refuse_one_way(problem.scene, f"method '{self.name}'")
        graph.without_literals(problem.scene)
        # Variables are emitted in the order of scopes: those of the scene before all others, once there is a new scope.
        # Without one, the first kernel of a pilot would not be that of the passes.
        dr.while_loop((mi.UInt32(0),), lambda n: n < 1, lambda n: (n + 1,), mode="symbolic", label="new scope")
        self.problem, self.scene, self.notes = problem, problem.scene, {}
        self.bands = self._bands_of(problem)
        self.packet = Packet(self.bands)
        self.camera = CameraSampler(problem, self.settings.reconstruction == "independent", self.packet)
        self.lights = LightTable(problem.scene, self.packet)
        if self.settings.hide_emitters:
            _check_hidden(problem.scene)
        self.visibility = Visibility(problem.scene, problem.sensor, self.packet, self.settings.hide_emitters)
        if self.visibility.media is not None:
            self._check_media(problem)
        self._hits: FirstHits | None = None  # of the pass that is being made
        #: :meth:`max_edges` on the device, opaque.
        self.edges = dr.opaque(mi.UInt32, self.max_edges())
        self._still = seen_shapes(problem, self.settings.aovs, self.settings.cryptomatte)
        if self.settings.coverage or mi.has_flag(problem.sensor.film().flags(), mi.FilmFlags.Alpha):
            take = functools.partial(self.take_wavelengths, seed=seed)
            self._still[0][ALPHA] = coverage(self.camera, self.visibility, take)
        self._most_cell_bytes = _CELL_SHARE * (problem.memory or free_memory() or math.inf)

    def _check_media(self, problem: Problem) -> None:
        """Raise :class:`UnsupportedError` if the scene has media that the method cannot render."""
        for medium in media_of(problem.scene, problem.sensor):
            if self.media is None or (scatters(medium) and self.media != "scattering"):
                what, others = "absorbs light", "auto, vcm, bpt or path"
                if scatters(medium):
                    what, others = "scatters light", "auto, vcm, bpt, sppm or path"
                raise UnsupportedError(
                    f"{graph.describe(medium, 'medium')} {what}, which method '{self.name}' does not render; use "
                    f"{others}"
                )

    def _bands_of(self, problem: Problem) -> Bands | None:
        """The bands that the film records. Raises :class:`UnsupportedError` if they cannot be rendered as asked."""
        film = problem.sensor.film()
        bands = Bands(film) if band_names(film) else None
        if bands is not None and not self.renders_bands:
            raise UnsupportedError(
                f"method '{self.name}' renders no bands of a 'specfilm'; use auto, vcm, bpt, sppm or path, or an "
                "'hdrfilm'"
            )
        for name in _OF_COLOURS if bands is not None else ():
            if getattr(self.settings, name):
                raise OptionError(f"{name} has colours, which a 'specfilm' does not record; leave out {name}")
        if bands is not None and self.settings.coverage and "A" in bands.names:
            raise OptionError("coverage is the channel A, as is the band 'A' of the film; rename the band")
        return bands

    def bind(self, scene: mi.Scene | None) -> None:
        """Set the scene for which the method was prepared, or release it (``None``) until the next run."""
        self.problem.scene = self.scene = self.visibility.scene = scene

    def tables(self) -> tuple[object, ...]:
        """The objects that the kernels of the prepared method read, for ``core.Frozen``."""
        return self.scene, self.camera, self.lights, self.visibility, self.edges

    @property
    def samples_per_iteration(self) -> int:
        """Camera paths per pixel of one pass."""
        return self.samples_for(self.problem)

    def samples_for(self, problem: Problem) -> int:
        """Camera paths per pixel of one pass; known before :meth:`prepare`."""
        if self.settings.samples_per_pass:
            return int(self.settings.samples_per_pass)
        lanes = self.full_lanes()
        if problem.memory:
            lanes = min(lanes, problem.memory // _LANE_BYTES)
        return min(_MOST_SAMPLES, max(1, lanes // math.prod(problem.size)))

    def passes_for(self, problem: Problem) -> int:
        """See ``core.Method``."""
        if not is_spectral():  # the problem may be one without a sensor
            return self.least_passes
        return max(self.least_passes, BAND_PASSES * len(band_names(problem.sensor.film())))

    def full_lanes(self) -> int:
        """Camera paths of a pass if ``samples_per_pass`` is 0."""
        return FULL_LANES * (_GPU_FULL if uses_cuda() else min(max(1, dr.thread_count() // 2), _MOST_FULL))

    def step(self, iteration: int, seed: int, state: State) -> Pass:
        """One pass: :attr:`samples_per_iteration` camera paths per pixel."""
        return Pass(self._step(iteration, seed), state)

    def _step(self, iteration: int, seed: int) -> Measurement:
        samples = self.samples_per_iteration
        self.take_wavelengths(iteration, seed)
        self._hits = self._new_hits(samples) if self.settings.aovs else None
        layers, counters = self.render_pass(iteration, seed, samples)
        layers = with_image(layers)
        if self.settings.components and not layers.keys() >= set(COMPONENTS):
            raise OptionError(f"'{self.name}' does not keep the components of light apart; leave out components")
        if self.settings.aovs:
            first, bad = self.first_layers(iteration, seed, samples)
            layers |= first
            counters["nonfinite"] += bad
        if self.bands is not None:
            layers = {name: self.packet.in_bands(layer) for name, layer in layers.items()}
        sums: dict[str, Any] = dict(layers)  # in single precision, as they are of one pass
        measured = ["image", *(name for name in layers if self.settings.aovs and name in PARTS)]
        return Measurement(
            sums=sums,
            weights={name: self._weight_of(name, samples) for name in layers},
            iterations=Iterations.single(iteration),
            squares=SquaresOf(sums, measured),
            counters=counters | {"samples": float(samples)},
        )

    def take_wavelengths(self, iteration: int, seed: int) -> None:
        """Take the wavelengths of a pass, under a spectral variant."""
        if not is_spectral():
            return
        self.packet.choose(iteration, seed, self.visibility.disperses)
        if self.visibility.media is not None:
            self.visibility.media.take(self.packet.wavelengths)

    def _weight_of(self, layer: str, samples: int) -> float | Array:
        """Weight of a pass in a layer's mean: the light of white lamps by channel, times the camera paths per pixel."""
        light = is_spectral() and layer not in ("normal", "depth", "seen_normal", "seen_share")
        return samples * self.packet.white if light else float(samples)

    @abstractmethod
    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """Sums over the pass's ``samples`` camera paths per pixel: layers (height, width, channels), and counters.

        The channels are as of ``Packet.recorded``. The layers either include ``image``, or the image is their sum."""

    def develop(self, measurement: Measurement, state: State) -> Result:
        """Mean over the passes, layer by layer; with ``reweight``, without fireflies. With ``aovs`` and two passes, the
        variance of the mean (of all paths) is a layer, for the picture and for each of its parts."""
        names = (name for name in measurement.sums if not name.endswith(CONTRAST))
        layers = seen({name: measurement.mean(name).astype(np.float32) for name in names})
        metadata: dict[str, Any] = {"method": self.name, "settings": self.settings.to_dict()} | self.notes
        if self.bands is not None:
            metadata[BANDS] = list(self.bands.names)
        layers, metadata = layers | self._still[0], metadata | self._still[1]
        if getattr(self.settings, "reweight", False):
            reach = 1 if self.camera.independent else self.camera.filter.reach
            layers, metadata["fireflies"] = reweighted(layers, measurement, reach)
        if self.settings.aovs and len(measurement.iterations) > 1:
            for name in filter(measurement.has_error, list(layers)):
                layers[variance_of(name)] = measurement.variance_of_mean(name).astype(np.float32)
        return Result(layers, metadata)

    # ------------------------------------------------------------------ helpers of the subclasses

    def max_edges(self) -> int:
        """``max_depth`` as an upper limit: 2^30 for -1."""
        return self.settings.max_depth if self.settings.max_depth >= 0 else 1 << 30

    def walker(self, kind: type[W], **own: Any) -> W:
        """A walker of class ``kind`` for the prepared scene; ``own``: fields to add, or to override."""
        common: dict[str, Any] = {"visibility": self.visibility, "lights": self.lights, "max_edges": self.edges}
        common["rays"] = self.recording.light if kind.from_lights else self.recording.camera
        if self.visibility.mipmaps and not kind.from_lights:
            common["footprint"] = lambda p: self.camera.footprint(p, mi.Point2f(0.5))
        return kind(**(common | {"rr_depth": self.settings.rr_depth} | own))

    def camera_numbers(
        self, lanes: mi.UInt32, samples: int, seed: int, iteration: int, role: str = "camera"
    ) -> SampleSource:
        """Random numbers of the camera paths ``lanes``, of which ``samples`` consecutive ones belong to a pixel."""
        count = dr.opaque(mi.UInt32, samples)  # opaque, so that pilot and passes share a kernel
        pixel = lanes // count
        number = lanes - pixel * count
        if self.settings.sampler == "independent":
            source: SampleSource = IndependentSource(lanes, seed, role, iteration)
        else:
            source = camera_numbers(
                self.settings.sampler, self.settings.scrambling, pixel, number, samples, seed, iteration, role
            )
        if self.camera.independent:
            return source
        return SharedFilm(source, self._film_numbers(number, samples, seed, iteration, role))

    def _film_numbers(self, number: mi.UInt32, samples: int, seed: int, iteration: int, role: str) -> SampleSource:
        """Numbers for the offset in the pixel of the camera paths ``number`` of a pixel. They are the same in all
        pixels, and stratified within a pass for any ``sampler``, because their error would be the same in all
        pixels."""
        if self.one_place:
            number, samples = mi.UInt32(0), 1
        if self.settings.sampler == "independent":
            return OwenSobolSource(mi.UInt32(0), number, seed, role + " film", dr.opaque(mi.UInt32, iteration))
        first, o = mi.UInt32(0), self.settings
        return camera_numbers(o.sampler, o.scrambling, first, number, samples, seed, iteration, role + " film")

    def light_numbers(self, lanes: Lanes, paths: int, seed: int, iteration: int, role: str = "light") -> SampleSource:
        """See :func:`light_numbers`."""
        return light_numbers(self.settings.sampler, lanes, paths, seed, iteration, role, self.settings.scrambling)

    def splats(self, seed: int, iteration: int, images: int = 1, role: str = "", in_cells: bool = True) -> Splats:
        """Images for the splats of a pass."""
        start = np.array(seed_key(seed, role + "splats", 0)) / 2.0**32
        across, down = (start + Weyl(2).value(iteration % (1 << 32))) % 1.0  # well spread over the passes
        in_cells = in_cells and _CELL_BYTES * self.camera.pixels * images <= self._most_cell_bytes
        return Splats(self.camera, images, (across, down) if in_cells else None)

    def path_fields(self) -> dict[str, Any]:
        """Additional fields of the state of a camera path, for ``CameraPath.start``."""
        fields = component_fields() if self.settings.components else {}
        fields["hidden"] = self.visibility.hidden
        return fields | ({} if self._hits is None else {"through": self._hits.through})

    def kept(self, radiance: mi.Spectrum) -> tuple[mi.Color3f, mi.Bool]:
        """(radiance of camera paths, as it is recorded, clamped, 0 where it is not finite; mask of lanes where it is
        not finite). For methods with :class:`CameraSettings`."""
        radiance, bad = keep_finite(self.packet.recorded(radiance))
        if self.settings.clamp > 0.0:
            radiance *= self._clamping(radiance)
        return radiance, bad

    def _clamping(self, radiance: mi.Color3f) -> mi.Float:
        """Factor on the radiance of camera paths, which is negative where the filter is."""
        most = dr.opaque(mi.Float, self.settings.clamp)
        return most / dr.maximum(dr.max(dr.abs(radiance)), most)

    def kept_together(self, parts: dict[str, mi.Spectrum]) -> tuple[dict[str, mi.Color3f], mi.Bool]:
        """As :meth:`kept`, of the layers whose sum is the radiance: all have the same factor."""
        parts = {name: self.packet.recorded(part) for name, part in parts.items()}
        whole, bad = keep_finite(functools.reduce(operator.add, parts.values()))
        factor = self._clamping(whole) if self.settings.clamp > 0.0 else mi.Float(1.0)
        return {name: dr.select(bad, 0.0, part * factor) for name, part in parts.items()}, bad

    def kept_layers(self, path: CameraPath) -> tuple[dict[str, mi.Color3f], mi.Bool]:
        """As :meth:`kept`, of the light of camera paths: the layer ``image``, or one for each component."""
        if path.by_component:
            return self.kept_together(dict(zip(COMPONENTS, path.by_component, strict=True)))
        radiance, bad = self.kept(path.radiance)
        return {"image": radiance}, bad

    def image(self, values: mi.Color3f, seed: int, iteration: int) -> Layer:
        """Image (height, width, channels) of the filtered sums over a pass's camera paths. ``values``: vectors, one
        lane a path, the paths of a pixel consecutive."""
        return self.images({"": values}, seed, iteration)[""]

    def images(self, layers: Mapping[str, Any], seed: int, iteration: int, samples: int = 0) -> dict[str, Layer]:
        """:meth:`image` of each layer, in one kernel. ``samples``: camera paths per pixel of the pass, if ``layers``
        have only the first ones of each pixel."""
        width, height = self.problem.size
        values = list(layers.values())
        count = max(1, dr.width(values[0]) // (height * width))
        if self.one_place or self.camera.independent:
            values, count = [dr.block_sum(layer, count) if count > 1 else layer for layer in values], 1
        if not self.camera.independent:
            number = dr.arange(mi.UInt32, count)
            places = self._film_numbers(number, samples or count, seed, iteration, "camera").next_2d(0, dim.FILM)
            dr.eval(values, places)
            values = self.camera.filter.spread_together(values, *places)
        raveled: Iterable[Any] = map(dr.ravel, values)  # one by one, to save memory
        if not (self.camera.independent or self.camera.filter.is_box):
            raveled = list(raveled)
            dr.eval(raveled)  # the last step of the filter, of all layers in one kernel
        # Copies, because the device reuses the memory of the raveled arrays.
        arrays = [np.array(layer, np.float32).reshape(height, width, -1) for layer in raveled]
        return dict(zip(layers, arrays, strict=True))

    def first_hits(self, lanes: mi.UInt32, iteration: int) -> FirstHits | None:
        """The recorder for a walk along the camera rays ``lanes`` of a pass; None unless ``aovs`` are wanted.
        ``iteration``: the pass whose film positions the rays have."""
        return None if self._hits is None else self._hits.of(lanes, iteration)

    def _new_hits(self, samples: int) -> FirstHits:
        return FirstHits(self.camera.pixels, samples, self.visibility.specular, self.packet)

    def first_layers(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], int]:
        """(layers of the first surfaces hit by the camera paths of a pass, or by camera rays if the pass has traced no
        paths; number of values that were not finite)."""
        hits, self._hits = self._hits or self._new_hits(samples), None
        if not hits.recorded:
            lanes = hits.lanes()
            source = self.camera_numbers(lanes, samples, seed, iteration)
            ray, _, _ = self.camera.primary(lanes // samples, source)
            recorder = hits.of(lanes, iteration)
            walker = self.walker(Walker, first=recorder)
            path = CameraPath.start(ray, self.edges, through=recorder.through, hidden=self.visibility.hidden)
            walker.walk(path, lambda s: _first_edge(s, walker, source), "first hits")
        found, bad = hits.found()
        layers = self.images(found, seed, hits.iteration, samples)
        layers["depth"] /= np.float32(self.problem.space.scale)
        return {name: layer * np.float32(samples / hits.rays) for name, layer in layers.items()}, bad


def warn_of_bands(measurement: Measurement, result: Result) -> None:
    """Log the bands of a picture that none of the wavelengths of its passes is in."""
    weights = np.atleast_1d(measurement.weights.get("image", 1.0)) / max(len(measurement.iterations), 1)
    # A pass of n camera paths a pixel has n times the weight of one.
    unseen = weights <= 2.0 * LEAST_WHITE * weights.max()
    names = [name for name, none in zip(result.metadata.get(BANDS, ()), unseen, strict=False) if none]
    if names:
        logger.warning(
            "no wavelength of the %d passes is in the bands %s of the film, which are black; render more samples",
            len(measurement.iterations),
            ", ".join(names),
        )


def _check_hidden(scene: mi.Scene) -> None:
    """Raise :class:`UnsupportedError` if a lamp that is to be hidden bounds a medium, which would be hidden with it."""
    for shape in graph.shapes(scene):
        if shape.is_emitter() and shape.is_medium_transition():
            raise UnsupportedError(
                f"{graph.describe(shape, 'shape')} emits light and bounds a medium, which hide_emitters would hide "
                "with it; give the medium a shape of its own, or leave out hide_emitters"
            )


def _first_edge(s: CameraPath, walker: Walker, source: SampleSource) -> CameraPath:
    """Record an edge of a path that mirrors and glass only scatter."""
    vertex = walker.arrive(s, source)
    walker.emission(s, vertex)
    s.active &= vertex.valid & walker.goes_on(s, vertex)
    scattered, _ = vertex.sample(source, s.active)
    walker.advance(s, vertex, scattered, source)
    s.active &= False if s.through is None else s.through
    return s
