"""Pictures: in memory, and their files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue import film
from etendue.core import (
    InNotebooks,
    Method,
    OptionError,
    Result,
    Settings,
    checked_path,
    logger,
    threads,
    warn_of_nonfinite,
)
from etendue.engine import Budget, Checkpoint, Job, Product, RunResult, Task, check_period, silent, versions
from etendue.methods import warn_of_bands
from etendue.scene import Problem, SceneSource, band_names, described_sensor

from .files import PathLike, Write, Writing, check_files, listed, rescued

Image = NDArray[np.float32]

#: Camera paths of a thread in a run up to which it is brief: some seconds.
_BRIEF = 1 << 21


@dataclass(repr=False)
class Rendering(InNotebooks):
    """A picture with its layers and metadata.

    ``layers`` are float32 arrays (height, width, channels), linear RGB, or bands, if the film has some: ``image``;
    with the setting ``split_layers`` the technique families whose sum it is; with ``pyramid`` the techniques
    (``film.Technique`` parses their names); with ``aovs`` first-hit layers. ``metadata`` has method, settings, seed,
    versions, passes, samples, seconds, rays and more.
    """

    layers: dict[str, Image]
    metadata: dict[str, Any]
    _checkpoint: Callable[[], Checkpoint]

    @property
    def image(self) -> Image:
        """The picture, (height, width, 3), linear RGB radiance; (height, width, bands) if the film has bands."""
        return self.layers["image"]

    def save(self, path: PathLike, tone: str = "srgb", exposure: float | str = "auto") -> None:
        """Write ``.exr`` (all layers and the metadata) or ``.png`` (with a tone curve and an exposure in stops),
        depending on the suffix.

        Raises :class:`OptionError` for another suffix or an unknown curve, :class:`OutputError` if the file cannot be
        written.
        """
        save_result(path, Result(self.layers, self.metadata), tone=tone, exposure=exposure)

    def save_checkpoint(self, path: PathLike) -> None:
        """Write all that :func:`resume` needs. Raises :class:`OutputError` if it cannot be written."""
        self._checkpoint().write(checked_path(path, "a checkpoint"))

    def __repr__(self) -> str:
        m, (height, width) = self.metadata, self.image.shape[:2]
        return f"<etendue.Rendering {m['method']} {width}x{height}, {m['samples']} spp, {m['seconds']:.1f} s>"


@dataclass
class Picture(Product[Rendering]):
    """A picture, its files and a checkpoint. :meth:`of` checks that they can be written."""

    kind: ClassVar[str] = "picture"

    pictures: tuple[Path, ...] = ()
    checkpoint: Path | None = None
    save_every: float | None = None  #: seconds between intermediate saves, ``None`` for none
    separate: bool = False  #: each layer of an ``.exr`` in a file of its own
    tone: str = "srgb"  #: tone curve of ``.png``
    exposure: float | str = "auto"  #: of ``.png``, in stops

    @classmethod
    def of(
        cls,
        pictures: PathLike | Sequence[PathLike] = (),
        checkpoint: PathLike | None = None,
        save_every: float | None = None,
        separate: bool = False,
        tone: str = "srgb",
        exposure: float | str = "auto",
    ) -> Picture:
        """Check and make. Raises :class:`OptionError` for an unknown suffix, tone curve or exposure, a file that is
        named twice or a time that is not above 0, :class:`OutputError` for a file that cannot be written."""
        check_period(save_every)
        kept = checked_path(checkpoint, "a checkpoint") if checkpoint is not None else None
        made = cls(listed(pictures), kept, save_every, separate, tone, exposure)
        for path in made.pictures:
            check_picture(path)
        if (tone, exposure) != (cls.tone, cls.exposure):
            from etendue import display  # imported late: most of it is for pages and plots

            display.check_tone(exposure, tone)
        check_files(made.files)
        return made

    @property
    def files(self) -> tuple[Path, ...]:
        """Pictures, then the checkpoint."""
        return self.pictures if self.checkpoint is None else (*self.pictures, self.checkpoint)

    def check(self, problem: Problem) -> None:
        """See :class:`Product`. Raises :class:`OptionError` for a ``.png`` of bands of wavelengths."""
        for path in self.pictures:
            if path.suffix.lower() != ".exr" and (bands := band_names(problem.sensor.film())):
                film.refuse_bands({film.BANDS: bands}, f"'{path}'")

    def default_budget(self, task: Task, problem: Problem) -> Budget:
        """The scene's own sample count."""
        return Budget(samples=max(1, problem.spp))

    def is_brief(self, problem: Problem, budget: Budget) -> bool:
        """See :class:`Product`."""
        paths = math.prod(problem.size) * (budget.samples or math.inf)
        return super().is_brief(problem, budget) or paths <= _BRIEF * threads()

    def settings(self, task: Task, problem: Problem, budget: Budget) -> Settings:
        """See :func:`scene_settings`."""
        return scene_settings(task.method, problem, task.settings)

    def saving(self, job: Job) -> dict[str, Any]:
        """See :class:`Product`."""
        if not self.files:
            return {}
        return {"on_save": lambda run: self.write(job, run), "save_every": self.save_every}

    def keep(self, job: Job, run: RunResult) -> Rendering:
        """See :class:`Product`: all files are written."""
        return self.finish(job, run)

    def finish(self, job: Job, run: RunResult, tell: Callable[[str], object] = silent) -> Rendering:
        """See :class:`Product`."""
        warn_of_nonfinite(run.measurement)
        warn_of_bands(run.measurement, run.result)
        return self.write(job, run)

    def write(self, job: Job, run: RunResult) -> Rendering:
        """Write the checkpoint, develop ``run`` and write the pictures. If one file fails, the others are still
        written.

        The errors are raised at the end, several as one :class:`OutputError`. At the end of a run, what could not be
        written is then in the system's temporary folder, if possible: a picture (as ``.npz`` arrays if its format
        fails), the checkpoint, and a checkpoint even if none is requested if the picture cannot be developed.
        """
        writing, result = Writing(), None

        def write_checkpoint(path: Path) -> None:
            job.checkpoint(run).write(path)

        def rescue(name: str, what: str, *ways: tuple[str, Write]) -> str:
            place = None if run.stopped_by == "running" else rescued(name, *ways)
            return "" if place is None else f"; the {what} is in '{place}' instead"

        if (kept := self.checkpoint) is not None:  # first, since it contains the measurement
            with writing.attempt(f"write '{kept}'", lambda: rescue(kept.name, "checkpoint", ("", write_checkpoint))):
                write_checkpoint(kept)
        last = partial(rescue, "render.checkpoint", "checkpoint", ("", write_checkpoint)) if kept is None else str
        with writing.attempt("develop the picture", last):
            result = developed(run, job.problem, job.seed)
        for picture in self.pictures if result is not None else ():
            write = partial(save_result, result=result, separate=self.separate, tone=self.tone, exposure=self.exposure)
            ways = ("", write), (".npz", partial(_write_arrays, layers=result.layers))
            with writing.attempt(f"write '{picture}'", partial(rescue, picture.name, "picture", *ways)):
                write(picture)
        writing.finish()
        assert result is not None
        return Rendering(result.layers, result.metadata, lambda: job.checkpoint(run))


def picture_task(
    source: SceneSource,
    method: type[Method],
    product: Product[Any],
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    budget: Budget | None = None,
) -> Task:
    """The task of a picture."""
    task = Task(source, method, product, settings or {}, seed, budget or Budget())
    made = method.Settings.from_mapping(task.settings)
    if getattr(made, "cryptomatte", False):  # Cryptomatte identifies shapes by their names
        task = replace(task, source=replace(source, merge=False))
    return task


def scene_settings(method: type[Method], problem: Problem, given: Mapping[str, Any]) -> Settings:
    """The settings of a method: ``given`` ones first, then those of the scene's integrator, then the defaults."""
    known = method.Settings.names()
    from_scene: dict[str, Any] = {"max_depth": problem.max_depth, "hide_emitters": problem.hide_emitters}
    if problem.integrator and problem.integrator in (method.name, method.plugin_name()):
        if unknown := sorted(problem.integrator_options.keys() - set(known)):
            logger.warning(
                "option '%s' of the scene's integrator '%s' is not supported and is ignored",
                "', '".join(unknown),
                problem.integrator,
            )
        from_scene |= problem.integrator_options
    values = {k: v for k, v in from_scene.items() if k in known} | dict(given)
    made: Settings = method.Settings.from_mapping(values, owner=f"method '{method.name}'")
    return made


def developed(run: RunResult, problem: Problem, seed: int) -> Result:
    """The picture of ``run`` with the metadata of its files."""
    result, measurement = run.result, run.measurement
    counters = {k: v for k, v in measurement.counters.items() if k not in ("samples", "seconds", "rays", "nonfinite")}
    variance = measurement.relative_error() if measurement.has_error() else float("nan")
    result.metadata = {
        **result.metadata,
        "method": run.method.name,
        "settings": run.method.settings.to_dict(),
        "seed": seed,
        "scene": problem.source,
        "fingerprint": problem.fingerprint,
        **({} if (sensor := described_sensor(problem)) is None else {"sensor": sensor}),
        "passes": run.passes,
        "samples": run.samples,
        "seconds": round(measurement.counters.get("seconds", run.elapsed), 3),
        "rays": measurement.counters.get("rays", 0.0),
        "nonfinite": measurement.counters.get("nonfinite", 0.0),
        "error": math.sqrt(variance) if variance == variance else None,
        "stopped_by": run.stopped_by,
        **({"counters": counters} if counters else {}),
        "versions": versions(),
    }
    return result


def _write_arrays(path: Path, layers: Mapping[str, Image]) -> None:
    with film.replacing(path) as part, part.open("wb") as file:
        np.savez(file, **layers)  # type: ignore[arg-type]


def save_result(
    path: PathLike, result: Result, separate: bool = False, tone: str = "srgb", exposure: float | str = "auto"
) -> None:
    """Write a result as ``.exr`` (layers and metadata; ``separate``: a file each) or ``.png`` (with the tone curve)."""
    from etendue import display  # imported late: most of it is for pages and plots

    path = checked_path(path, "a picture")
    if check_picture(path) == ".exr" and separate:
        film.write_layers(path, result)
    elif path.suffix.lower() == ".exr":
        film.write_exr(path, result)
    else:
        film.refuse_bands(result.metadata, f"'{path}'")
        display.write_png(path, display.tonemap(result.image, exposure, tone, result.layers.get(film.ALPHA)))


def check_picture(path: Path) -> str:
    """The suffix, in small letters. Raises :class:`OptionError` if no picture is written with it."""
    suffix = path.suffix.lower()
    if suffix not in (".exr", ".png"):
        raise OptionError(f"a picture is written as .exr or .png, not as '{path.name}'; change the name")
    return suffix
