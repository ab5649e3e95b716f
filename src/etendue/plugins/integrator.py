"""Methods as Mitsuba integrators, for ``mi.load_dict({"type": "vcm"})`` and ``mi.render``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import EtendueError, Method, UnsupportedError, check_variant, warn_of_nonfinite
from etendue.engine import Budget, RunError, Runner, RunResult
from etendue.film import ALPHA, BANDS, COMPONENTS, LONGER, Technique, is_variance
from etendue.methods import ImageMethod, warn_of_bands
from etendue.scene import Problem

from .prepared import Prepared

if TYPE_CHECKING:
    import mitsuba as mi

#: First-hit layers, and the names of their channels in a film, which are those of Mitsuba's 'aov' integrator.
_AOV_CHANNELS = {
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("sh_normal.X", "sh_normal.Y", "sh_normal.Z"),
    "depth": ("depth.T",),
    "emitted": ("emitted.R", "emitted.G", "emitted.B"),
    "shape": ("shape_index.I",),
}
#: The same of layers that only pictures of scenes with mirrors or glass have.
_SEEN_CHANNELS = {
    "seen_albedo": ("seen_albedo.R", "seen_albedo.G", "seen_albedo.B"),
    "seen_normal": ("seen_normal.X", "seen_normal.Y", "seen_normal.Z"),
}


def integrator_class(method: type[ImageMethod]) -> type:
    """The integrator class of a method for the current variant. Raises :class:`BackendError` if that is unsupported."""
    import mitsuba as mi

    check_variant(mi.variant())
    return _integrator_class(method, mi.variant())


@lru_cache(maxsize=64)
def _integrator_class(method: type[ImageMethod], variant: str) -> type:
    # One class per variant, because the base class depends on the variant.
    import mitsuba as mi

    class EtendueIntegrator(mi.SamplingIntegrator):
        """Runs the method's passes until ``spp`` camera paths per pixel are traced."""

        def __init__(self, props: mi.Properties) -> None:
            given = {name: props[name] for name in method.Settings.names() if name in props}
            self.plugin_name = method.plugin_name()
            self.settings = method.Settings.from_mapping(given, owner=f"integrator '{method.plugin_name()}'")
            self.options = self.settings.to_dict()
            self._prepared = Prepared(method, self.settings)
            self.timeout = float(props.get("timeout", -1.0))
            self._cancelled = False
            self._runner: Runner | None = None
            self._layers = _requested(self.options, ())  # of the film, without the picture
            self._bands: list[str] | None = None  # of the latest picture
            super().__init__(props)

        def render(
            self,
            scene: mi.Scene,
            sensor: mi.Sensor | int = 0,
            seed: mi.UInt32 | int = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> mi.TensorXf:
            """The picture as a tensor (height, width, channels); the sensor's film contains it, too."""
            import drjit as dr

            self._cancelled = False
            if isinstance(sensor, int):
                sensor = scene.sensors()[sensor]
            film = sensor.film()
            width, height = (int(v) for v in film.crop_size())
            problem = Problem(
                scene=scene,
                sensor=sensor,
                size=(width, height),
                spp=int(spp) or int(sensor.sampler().sample_count()),
                max_depth=self.options["max_depth"],
                hide_emitters=self.options["hide_emitters"],
                integrator=method.plugin_name(),
                integrator_options=dict(self.options),
            )
            with dr.suspend_grad():
                number = int(np.asarray(seed).ravel()[0])
                with self._prepared.ready(problem, number) as ready:
                    run = self._run(ready, number, problem.spp)
                    layers = run.result.layers
                warn_of_nonfinite(run.measurement)
                self._layers = _requested(self.options, layers)
                warn_of_bands(run.measurement, run.result)
                self._bands = run.result.metadata.get(BANDS)
                _fill(film, layers, self._layers, self._bands)
                if not develop:
                    return mi.TensorXf()
                image = film.develop()
                if evaluate:
                    dr.eval(image)
                    dr.sync_thread()
                return image

        def _run(self, ready: Method, seed: int, spp: int) -> RunResult:
            """Run the passes of a picture; at least the first one, even if the rendering is cancelled before."""
            passes = -(-spp // ready.samples_per_iteration)
            seconds = self.timeout if 0 < self.timeout < math.inf else None
            budget = Budget(seconds=seconds, iterations=passes)
            self._runner = Runner(ready, seed=seed, budget=budget, cancel=self, watched=False)
            try:
                return self._runner.run()
            except RunError as error:
                failure = error.__cause__ or error
            finally:
                self._runner = None  # it references the scene, which references this integrator
            raise failure

        def is_set(self) -> bool:
            """Whether the running passes should end: see ``engine.CancelEvent``."""
            runner = self._runner
            return self._cancelled and runner is not None and runner.progress.passes > 0

        def render_forward(
            self, scene: mi.Scene, params: Any, sensor: mi.Sensor | int = 0, seed: mi.UInt32 | int = 0, spp: int = 0
        ) -> mi.TensorXf:
            """Raises: derivatives are not computed."""
            raise _no_gradients(method.name)

        def render_backward(
            self,
            scene: mi.Scene,
            params: Any,
            grad_in: mi.TensorXf,
            sensor: mi.Sensor | int = 0,
            seed: mi.UInt32 | int = 0,
            spp: int = 0,
        ) -> None:
            """Raises: derivatives are not computed."""
            raise _no_gradients(method.name)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            """Raises: methods do not trace single rays, so integrators such as 'aov' cannot wrap them."""
            raise UnsupportedError(
                f"'{method.name}' renders whole pictures and cannot be nested in another integrator; "
                "use it by itself, with aovs=true for first-hit layers"
            )

        def cancel(self) -> None:
            """Stop a rendering in another thread after its current pass."""
            self._cancelled = True

        def should_stop(self) -> bool:
            """Whether :meth:`cancel` was called since the start of the rendering."""
            return self._cancelled

        def aov_names(self) -> list[str]:
            """Names of the channels after those of the picture: first-hit layers, and after a rendering also the layers
            of techniques, which depend on the scene."""
            return _channels(self._layers, self._bands)

        def to_string(self) -> str:
            rows = ",\n".join(f"  {name} = {value}" for name, value in self.options.items())
            return f"{method.plugin_name()}[\n{rows}\n]"

    EtendueIntegrator.__name__ = f"{method.name.capitalize()}Integrator"
    EtendueIntegrator.__qualname__ = EtendueIntegrator.__name__
    return EtendueIntegrator


def _no_gradients(name: str) -> EtendueError:
    return UnsupportedError(
        f"'{name}' computes pictures, not gradients; differentiate with Mitsuba's own 'prb' integrator, or detach the "
        "scene parameters"
    )


def _requested(options: dict[str, Any], layers: Iterable[str]) -> list[str]:
    """Those of ``layers`` that the settings request: families of techniques, the technique pyramid, additional merge
    radii; after first hits and components, which every picture has then."""
    names = list(_AOV_CHANNELS) if options["aovs"] else []
    names += COMPONENTS if options["components"] else ()
    names += [name for name in layers if name in _SEEN_CHANNELS]
    for name in layers:
        if is_variance(name):
            continue
        in_pyramid = name == LONGER or Technique.of_layer(name) is not None
        setting = "pyramid" if in_pyramid else "radii" if name.startswith("radius_") else "split_layers"
        if name not in ("image", *names) and options.get(setting):
            names.append(name)
    return names


def _channels(layers: Iterable[str], bands: list[str] | None) -> list[str]:
    """Names of the channels of ``layers`` in a film, which may have ``bands``."""
    return [
        channel
        for name in layers
        for channel in (_AOV_CHANNELS | _SEEN_CHANNELS).get(name, [f"{name}.{c}" for c in bands or "RGB"])
    ]


def _fill(film: mi.Film, layers: dict[str, NDArray[np.float32]], extra: list[str], bands: list[str] | None) -> None:
    """Copy the picture and the ``extra`` layers to the film, for ``film.develop()``, ``film.bitmap()`` and
    ``film.write()``."""
    import mitsuba as mi

    image = layers["image"]
    channels = [image]
    if mi.has_flag(film.flags(), mi.FilmFlags.Alpha):
        channels.append(layers[ALPHA])
    weight = np.ones((*image.shape[:2], 1), np.float32)  # by which the film divides
    more = [layers[name] for name in extra]
    channels += [weight, *more] if bands is None else [*more, weight]
    film.prepare(_channels(extra, bands))
    tensor = mi.TensorXf(np.concatenate(channels, -1, dtype=np.float32))
    film.put_block(mi.ImageBlock(tensor, mi.ScalarPoint2i(film.crop_offset())))
