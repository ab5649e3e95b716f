"""`etendue compare` and `demo`: several methods on one scene with the same budget, and a page that compares them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from etendue import display, film, methods
from etendue.api import start_job
from etendue.core import OptionError
from etendue.engine import Budget, Job, Task
from etendue.jobs import Outputs, Update
from etendue.scene import bundled

from ..console import note, say
from ..options import settings_by_method
from ..rendering import check_reference, follow, make_folder, summary

if TYPE_CHECKING:
    from etendue.distributed import Cluster

Image = NDArray[np.float32]

#: Ratio of the times of consecutive points of the error plot.
_HISTORY_RATIO = 1.25
_PAGE = "index.html"


def tasks(scene: Any, names: Sequence[str], settings: Mapping[str, Any], **common: Any) -> list[Task]:
    """The same task for each method of ``names``; ``settings`` as for :func:`settings_by_method`."""
    if len(set(names)) < len(names):
        raise OptionError(f"give each method once, not {', '.join(names)}")
    return [Task(scene, methods.get(n), own, **common) for n, own in settings_by_method(names, settings).items()]


@dataclass
class Comparison:
    """The methods to compare, and the outputs."""

    tasks: list[Task]
    output: Path
    reference: Path | None = None
    reference_note: str = ""
    title: str = ""
    subtitle: str = ""
    cluster: Cluster | None = None  #: makes the passes
    _reference: Image | None = field(default=None, init=False)

    def run(self, console: Console) -> int:
        """Render the methods in turn, write the page with those that succeeded and print its path. Returns the exit
        status.

        The reference and the output folder are checked before rendering.
        """
        if self.reference is not None:
            self._reference = film.read_image(self.reference)
        make_folder(self.output)
        film.check_writable(self.output / _PAGE)
        entries: list[display.Entry] = []
        try:
            for task in self.tasks:
                if exit_code := self._render(task, entries, console):
                    return exit_code
        finally:
            if entries:
                self._write(entries)
        return 0

    def _render(self, task: Task, entries: list[display.Entry], console: Console) -> int:
        """Render ``task`` and append its picture to ``entries``. Returns the exit status."""
        name = task.method.name
        outputs = Outputs.of([self.output / f"{name}.exr"])
        history = _History()

        def open_job() -> Job:
            job = Job.open(task)
            check_reference(self._reference, job.problem.size, "--size {}x{}")
            return job

        watch = history.record if self._reference is not None else None
        outcome = follow(lambda: start_job(open_job, outputs, watch, self.cluster), console, name)
        if outcome.result is not None:
            note(console, summary(outcome.result))
            layers = {k: v for k, v in outcome.result.layers.items() if k != "image"}
            errors = history.errors(self._reference)
            entries.append(display.Entry(name, outcome.result.image, outcome.result.metadata, errors, layers))
        return outcome.exit_code

    def _write(self, entries: list[display.Entry]) -> None:
        """Write the pictures at one exposure, so that they can be compared, and the page."""
        exposure = display.auto_exposure(self._reference if self._reference is not None else entries[0].image)
        for entry in entries:
            display.write_png(self.output / f"{entry.name}.png", display.tonemap(entry.image, exposure))
        page = self.output / _PAGE
        display.write_report(
            page,
            entries,
            self._reference,
            title=self.title or f"{Path(str(self.tasks[0].scene)).name}: {', '.join(e.name for e in entries)}",
            subtitle=self.subtitle,
            reference_note=self.reference_note or (str(self.reference) if self.reference else ""),
            exposure=exposure,
        )
        say(str(page))


class _History:
    """Pictures at times that grow by a ratio; they are compared with the reference after rendering."""

    def __init__(self) -> None:
        self._pictures: list[tuple[float, Image]] = []

    def record(self, update: Update) -> None:
        elapsed = update.progress.elapsed
        if not self._pictures or elapsed >= self._pictures[-1][0] * _HISTORY_RATIO:
            self._pictures.append((elapsed, update.image))

    def errors(self, reference: Image | None) -> list[tuple[float, float]]:
        if reference is None:
            return []
        return [(elapsed, film.relative_mse(picture, reference)) for elapsed, picture in self._pictures]


def demonstration(output: Path, budget: Budget, size: tuple[int, int] | None) -> Comparison:
    """The bundled demonstration scene by ``path`` and ``vcm``. Its reference has the scene's default size."""
    scene = next(iter(bundled().values()))
    return Comparison(
        tasks(scene, ["path", "vcm"], {}, budget=budget, size=size),
        output,
        reference=scene.reference if size is None else None,
        reference_note=scene.reference_note,
        title=f"étendue: {scene.name}",
        subtitle=scene.description,
    )
