"""What `etendue form-factors` and `etendue radiosity` share: what was asked for, and the casting of lines for it with
progress, budgets, stop and checkpoint."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import CheckpointError, OptionError, Progress, SceneError, describe, format_seconds, logger
from etendue.solving import ON_SEGMENTS

from .console import error_console, note
from .options import Size
from .radiosity_outputs import OWN, SolutionOutput

if TYPE_CHECKING:
    from etendue.engine import Budget, Checkpoint, RunResult
    from etendue.jobs import LinesJob
    from etendue.radiosity import CastLines, Patches
    from etendue.scene import Problem

#: The method of checkpoints: the name of :class:`LineCasting`.
LINES = "global-lines"
#: Suffixes of scene files; whatever else is no bundled scene is a mesh.
_SCENES = (".xml", "")
#: Of a checkpoint: the request.
_NOTE = "lines"


@dataclass(frozen=True)
class Request:
    """What was asked for, in plain values that a checkpoint keeps."""

    command: str  #: "form-factors" or "radiosity"
    source: str  #: a mesh file, a scene file or a bundled scene
    output: str
    kind: str  #: the estimator, or the solver
    seed: int = 0
    max_area: float | None = None
    two_sided: bool = False
    #: Of a mesh: numbers, or names of arrays of the file.
    reflectance: str | None = None
    emission: str | None = None
    temperature: str | None = None
    ids: str | None = None
    sky: str | None = None
    #: Of a scene.
    parameters: dict[str, str] = field(default_factory=dict)
    shot: bool = True
    local_rays: bool = True
    #: The other fields of :class:`SolutionOutput`.
    outputs: dict[str, Any] = field(default_factory=dict)
    #: Whether an error ends the run, so that lines are to tell it.
    to_error: bool = False

    @property
    def is_factors(self) -> bool:
        """Whether form factors are wanted, no solution."""
        return self.command == "form-factors"

    @property
    def files(self) -> tuple[Path, ...]:
        """All that is written."""
        return (Path(self.output),) if self.is_factors else self.writer.files

    @property
    def wants_matrix(self) -> bool:
        """Whether form factors are made of the segments."""
        return self.is_factors or self.kind not in ON_SEGMENTS

    @property
    def is_mesh(self) -> bool:
        """Whether the source is a mesh file, not a scene."""
        return self.is_factors or Path(self.source).suffix.lower() not in _SCENES

    @property
    def writer(self) -> SolutionOutput:
        """What writes solutions."""
        return SolutionOutput(Path(self.output), **self.outputs)

    def located(self) -> Request:
        """With paths that hold in any folder."""
        from etendue.scene import locate

        source: Any = Path(self.source)
        if not self.is_mesh:
            source = locate(self.source, logger.debug)
        place = str(source.absolute()) if isinstance(source, Path) else source.name
        outputs = dict(self.outputs)
        if (uv := outputs.get("uv")) is not None and uv != OWN:
            outputs["uv"] = str(Path(uv).absolute())
        return replace(self, source=place, output=str(Path(self.output).absolute()), outputs=outputs)

    def patches(self, problem: Problem | None) -> Patches:
        """Patches of the source. Raises :class:`OptionError` for options of the other kind of source."""
        return self._of_mesh() if problem is None else self._of_scene(problem)

    def problem(self) -> Problem | None:
        """The scene, ``None`` for a mesh."""
        from etendue.scene import locate

        if self.is_mesh:
            return None
        found = locate(self.source, lambda text: note(error_console(), text))
        return self.writer.load(found, self.parameters)

    def _of_mesh(self) -> Patches:
        from etendue.radiosity import read_patches

        if self.parameters:
            raise OptionError("-P is for scenes in XML; a mesh file has no parameters")
        given = {name: _quantity(getattr(self, name)) for name in ("reflectance", "emission", "temperature")}
        known = {name: value for name, value in given.items() if value is not None}
        light: Any = _quantity(self.sky) or 0.0
        if isinstance(light, str):
            raise OptionError(f"--sky is a number, or one for each channel as 1,0.8,0.5, not '{light}'")
        sky = light[0] if isinstance(light, list) else light
        patches = read_patches(self.source, **known, ids=self.ids, two_sided=self.two_sided, sky=sky)
        if self.command == "radiosity" and not (patches.emission.any() or patches.sky.any()):
            raise SceneError(
                f"'{self.source}' has no light; give --emission or --temperature (a number, or the name of an array of "
                "the file), or --sky"
            )
        return patches if self.max_area is None else patches.subdivided(self.max_area)

    def _of_scene(self, problem: Problem) -> Patches:
        from etendue.radiosity import scene_patches

        for name in ("reflectance", "emission", "temperature", "ids", "sky"):
            if getattr(self, name) is not None:
                raise OptionError(f"--{name} is for mesh files; the materials and lights of a scene say it")
        if self.two_sided:
            raise OptionError("--two-sided is for mesh files; in a scene, materials of type 'twosided' make sheets")
        patches = scene_patches(problem, max_area=self.max_area)
        if not (patches.emission.any() or patches.sky.any()):
            raise SceneError(
                f"'{self.source}' has no light for radiosity; give it an emitter of type 'area' or 'constant'"
            )
        return patches

    def metadata(self, lines: CastLines, **more: Any) -> dict[str, Any]:
        """For the files."""
        software = f"etendue {metadata.version('etendue')}"
        return {"software": software, "source": self.source, "bundles": lines.count, "seed": self.seed, **more}


def _quantity(text: str | None) -> float | str | list[list[float]] | None:
    """A number, a row of them for channels, or a name."""
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        return text
    return numbers[0] if len(numbers) == 1 else [numbers]


@dataclass
class Cast:
    """What was cast, ``None`` if that is nothing, and the exit status. ``rescued`` writes a temporary checkpoint."""

    lines: CastLines | None
    status: int
    rescued: Callable[[], Path | None]


def request_of(saved: Checkpoint) -> Request:
    """What a checkpoint was asked for. Raises :class:`CheckpointError` if it is of another version."""
    try:
        request = Request(**saved.notes[_NOTE])
        size = request.outputs.get("size")  # JSON knows no tuples
        return replace(request, outputs=request.outputs | {"size": size and Size(*size)})
    except (KeyError, TypeError) as error:
        raise CheckpointError(
            f"the checkpoint does not say what was asked for ({describe(error)}); cast the lines anew"
        ) from None


def cast(
    request: Request,
    patches: Patches,
    budget: Budget,
    checkpoint: Path | None,
    save_every: float | None,
    saved: Checkpoint | None = None,
) -> Cast:
    """Cast lines until the budget is used up or a signal comes, from where ``saved`` ended."""
    from etendue.engine import Runner, Session
    from etendue.jobs import LinesJob, LinesTask

    from .rendering import follow

    console = error_console()
    task = LinesTask(
        patches,
        "rows" if request.is_factors else "irradiance",
        budget,
        request.source,
        request.seed,
        shot=request.shot and not request.is_factors,
        local_rays=request.local_rays,
        to_error=request.to_error,
        is_watched=console.is_terminal,
        needs_matrix=request.wants_matrix,
        notes={_NOTE: asdict(request.located())},
    )
    job = LinesJob(task, saved)

    def keep(run: RunResult, path: Path) -> None:
        job.checkpoint(run).write(path)

    def build(stop: threading.Event) -> Runner:
        if checkpoint is None or save_every is None:
            return job.runner(cancel=stop)
        return job.runner(cancel=stop, on_save=lambda run: keep(run, checkpoint), save_every=save_every)

    def finish(run: RunResult) -> RunResult:
        job.cast(run)
        if checkpoint is not None:
            keep(run, checkpoint)
        return run

    outcome = follow(lambda: Session(build, finish), console, request.command, _words(job))
    run = outcome.result
    if run is None:
        return Cast(None, outcome.exit_code, lambda: None)
    lines = job.cast(run)
    if job.is_full(run):
        logger.warning(
            "memory holds no more than these %d bundles of lines: free some, or make patches larger", lines.count
        )
    return Cast(lines, outcome.exit_code, lambda: job.rescued(run))


def _words(job: LinesJob) -> Callable[[Progress], list[str]]:
    def words(progress: Progress) -> list[str]:
        count = min(progress.samples, job.casting.most or progress.samples)
        bundles = f"{count} bundle{'' if count == 1 else 's'}"
        parts = [bundles, f"{progress.rays:.3g} segments", format_seconds(progress.elapsed)]
        if progress.eta is not None:
            parts.append(f"ETA {format_seconds(progress.eta)}")
        if progress.relative_error is not None:
            parts.append(f"error {math.sqrt(progress.relative_error):.2g}")
        return parts

    return words
