"""`etendue compare` and `demo`: several methods on one scene with the same budget, and a page that compares them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from etendue import display, film, methods
from etendue.core import BackendError, ClusterError, OptionError, OutputError, SceneError, UnsupportedError, describe
from etendue.engine import Job, Task
from etendue.products import Picture, Rendering, budget_of, picture_task, start_job
from etendue.scene import SceneSource, bundled, require_colours

from ..console import command_line, note, say
from ..options import settings_by_method
from ..running import Outcome, check_reference, follow, make_folder, summary
from .history import History
from .repeating import defaults_of, picture_command

if TYPE_CHECKING:
    from etendue.distributed import Cluster

Image = NDArray[np.float32]

_PAGE = "index.html"
#: Errors that all methods would have: before the first picture they end the comparison.
_OF_ALL = (OptionError, OutputError, BackendError, ClusterError, SceneError)


def tasks(
    source: SceneSource, names: Sequence[str], settings: Mapping[str, Any], *, limits: Mapping[str, Any], seed: int = 0
) -> list[Task]:
    """The same task for each method of ``names``; ``settings`` as for :func:`settings_by_method`, ``limits`` as for
    :func:`budget_of`."""
    if len(set(names)) < len(names):
        raise OptionError(f"give each method once, not {', '.join(names)}")
    return [
        picture_task(source, kind, Picture(), own, seed, budget_of(kind, limits))
        for kind, own in ((methods.get(n), own) for n, own in settings_by_method(names, settings).items())
    ]


@dataclass
class Comparison:
    """The methods to compare, and the outputs. With several ``seeds``, each method renders so many pictures, whose
    errors are averaged; the first is shown."""

    tasks: list[Task]
    output: Path
    reference: Path | None = None
    reference_note: str = ""
    title: str = ""
    subtitle: str = ""
    seeds: int = 1
    cluster: Cluster | None = None  #: makes the passes
    _reference: Image | None = field(default=None, init=False)
    _entries: list[display.Entry] = field(default_factory=list, init=False)
    _failures: list[display.Failure] = field(default_factory=list, init=False)

    def run(self, console: Console) -> int:
        """Render the methods in turn, write the page and print its path. Returns the exit status.

        The reference and the output folder are checked before rendering. A method that fails is named on the page, with
        the pictures of the seeds before, and its error raised when the others are done.
        """
        if self.reference is not None:
            self._reference = film.read_image(self.reference)
        make_folder(self.output)
        film.check_writable(self.output / _PAGE)
        first: Exception | None = None
        exit_code = 0
        try:
            for task in self.tasks:
                try:
                    exit_code = self._render(task, console)
                except Exception as error:
                    if not self._entries and isinstance(error, _OF_ALL) and not isinstance(error, UnsupportedError):
                        raise
                    first = first or error
                    self._failures.append(display.Failure(task.method.name, describe(error)))
                    note(console, f"{task.method.name} failed: {describe(error)}", "red")
                if exit_code:
                    break
        finally:
            if self._entries:
                self._write()
        if first is not None:
            raise first
        return exit_code

    def _render(self, task: Task, console: Console) -> int:
        """Render ``task`` with each seed, and note the picture of the first, also if a later one fails. Returns the
        exit status."""
        name, made, curves, exit_code = task.method.name, None, [], 0
        try:
            for index in range(self.seeds):
                label = name if index == 0 else f"{name}-seed-{task.seed + index}"
                history = History(self._reference)
                outcome = self._follow(replace(task, seed=task.seed + index), label, history, console)
                if outcome.result is not None:
                    note(console, summary(outcome.result))
                    curves.append(display.Series(label, history.errors(outcome.result.image)))
                    made = made or outcome.result
                if exit_code := outcome.exit_code:
                    break
        finally:
            if made is not None:
                self._entries.append(self._entry(task, made, curves))
        return exit_code

    def _follow(self, task: Task, label: str, history: History, console: Console) -> Outcome[Rendering]:
        product = Picture.of([self.output / f"{label}.exr"])

        def open_job() -> Job:
            job = Job.open(replace(task, product=product))
            require_colours(job.problem.sensor.film(), "a comparison")
            check_reference(self._reference, job.problem.size, "--size {}x{}")
            return job

        return follow(lambda: start_job(open_job, history.record, self.cluster), console, label)

    def _entry(self, task: Task, made: Rendering, curves: Sequence[display.Series]) -> display.Entry:
        height, width = made.image.shape[:2]
        known = made.metadata
        return display.Entry(
            task.method.name,
            made.image,
            known,
            display.over_seeds(curves) if len(curves) > 1 else curves[0].points,
            {k: v for k, v in made.layers.items() if k != "image"},
            defaults_of(task.method),
            picture_command(task, known["settings"], known["samples"], (width, height)),
        )

    @property
    def _scene(self) -> Any:
        source = self.tasks[0].source
        assert isinstance(source, SceneSource)
        return source.scene

    def _write(self) -> None:
        """Write the pictures at one exposure, so that they can be compared, and the page."""
        entries = self._entries
        exposure = display.auto_exposure(self._reference if self._reference is not None else entries[0].image)
        for entry in entries:
            display.write_png(self.output / f"{entry.name}.png", display.tonemap(entry.image, exposure))
        page = self.output / _PAGE
        names = [task.method.name for task in self.tasks]
        display.write_report(
            page,
            entries,
            self._reference,
            title=self.title or f"{Path(str(self._scene)).name}: {', '.join(names)}",
            subtitle=self.subtitle,
            reference_note=self.reference_note or (str(self.reference) if self.reference else ""),
            exposure=exposure,
            error_name=History(self._reference).error_name,
            failures=self._failures,
            repeat=[display.Command(command_line(), f"This page, from {Path.cwd()}")],
        )
        say(str(page))


def demonstration(output: Path, limits: Mapping[str, Any], size: tuple[int, int] | None) -> Comparison:
    """The bundled demonstration scene by ``path`` and ``vcm``. Its reference has the scene's default size."""
    scene = next(iter(bundled().values()))
    return Comparison(
        tasks(SceneSource(scene, size), ["path", "vcm"], {"reweight": True}, limits=limits),
        output,
        reference=scene.reference if size is None else None,
        reference_note=scene.reference_note,
        title=f"étendue: {scene.name}",
        subtitle=scene.description,
    )
